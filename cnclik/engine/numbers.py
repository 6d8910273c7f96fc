"""Numbers: a function called with numbers, as C without JAX around it: NumPy in and out, in microseconds."""

import ctypes

import jax
import numpy as np

from cnclik import cache
from cnclik.cache import LRU
from cnclik.engine.native import Function, compiled, of_leaves
from cnclik.engine.plan import chosen
from cnclik.engine.program import Program, lane_avals
from cnclik.engine.rounds import LEAST, any_rounds
from cnclik.engine.tracing import engine, is_read

MOST_BYTES = 1 << 20  # of the results, at most, to lie in one block of memory


class Numbers:
    """A function of two tuples of trees, known and given, that is called with numbers.

    Known values, such as a law and a reference, stay the same from call to call: they are recognized by identity and
    flattened once. Given are an array, then numbers of the array's type and trees of arrays.
    """

    def __init__(self, fn, *, lets_go):
        """Args:
        fn: fn(*known, *given, **rounds); with `N` rounds it shares its program with other N where there is such a one.
        lets_go: release Python's lock during calls, if they are longer than a step.
        """
        self.fn, self.lets_go = fn, lets_go
        self.ready, self.functions, self.entries = {}, LRU(), LRU()

    def __call__(self, known, given, **rounds):
        """Return its results as a tree of read-only NumPy arrays, or of JAX arrays if the first given array is one.

        Numbers are computed by what `plan` has chosen, C or JAX. What is traced becomes part of a user's program.
        """
        if is_read():  # the engine reads the source itself
            return self.fn(*known, *given, **rounds)
        leaves, treedef = jax.tree.flatten(given)
        key = [treedef, jax.config.jax_enable_x64, engine.value, *rounds.values(), *map(id, known)]
        for x in leaves:
            key += type(x), x.shape, x.dtype
        key = tuple(key)
        call = self.ready.get(key) or self._prepared(key, known, given, rounds)
        return call(leaves)

    def _prepared(self, key, known, given, rounds):
        """Return the function of given leaves that computes the results; it is kept unless something is traced."""
        leaves, treedef = jax.tree.flatten(((known, given), {}))
        every, count = leaves, len(leaves) - len(jax.tree.leaves(given))
        function, first, avals = self._function(treedef, rounds), every[:count], lane_avals(every, batched=False)
        numbers, lasting = not isinstance(given[0], jax.Array), not any(map(_is_writable, first))
        if any(isinstance(x, jax.core.Tracer) for x in every):
            return lambda leaves: function(*first, *leaves)
        form, traced = chosen(function, avals, batch=False), function.trace(avals)
        if traced.stays:
            return lambda leaves: function(*first, *leaves)
        if not (isinstance(form, Program) and numbers):
            with jax.ensure_compile_time_eval():  # cached values must not become part of a user's trace
                first = jax.device_put(first)

            def call(leaves, known=known):  # keeps them alive, as their ids are in the key
                found = compiled(*first, *leaves, function=function, batched=(False,) * len(every))
                return traced.tree.unflatten(map(np.asarray, found) if numbers else found)

        elif sum(s.size * s.dtype.itemsize for s in form.shapes) > MOST_BYTES:

            def call(leaves, known=known):
                return traced.tree.unflatten(map(_only, form([*first, *leaves], 1)))

        else:
            entry = self.entries.made(form, lambda _: _Entry(form, count, self.lets_go))
            call = entry.call_with(first, known)
        if lasting:
            if len(self.ready) >= cache.KEPT_PROGRAMS:
                self.ready.clear()
            self.ready[key] = call
        return call

    def _function(self, treedef, rounds):
        """Return the function of the leaves of known and given."""

        def make(static, **more):
            return Function(of_leaves(lambda known, given: self.fn(*known, *given, **static), treedef), **more)

        N, whole = rounds.get("N", 0), None
        if N >= LEAST:
            whole = self.functions.made((treedef, "any"), lambda _: make({"N": any_rounds()}))
        return self.functions.made((treedef, N), lambda _: make(rounds, whole=whole, rounds=N))


def _is_writable(x) -> bool:
    return isinstance(x, np.ndarray) and x.flags.writeable


def _only(several):
    """The only lane of a batch, read-only."""
    several.setflags(write=False)
    return several[0, ...]


class _Entry:
    """A program's entry for numbers, with the first `count` arguments in a block of their own."""

    def __init__(self, program, count, lets_go):
        self.program, self.count = program, count
        library = (ctypes.CDLL if lets_go else ctypes.PyDLL)(None, handle=program.library._handle)
        self.run, self.run.argtypes = library.of_numbers, (ctypes.c_int64, *[ctypes.c_void_p] * 2, ctypes.c_int32)
        given = program.avals[count:]
        self.first, self.block = _layout(program.avals[:count]), _layout([*given, *program.shapes])
        self.takes, self.gives = self.block.names[: len(given)], self.block.names[len(given) :]

    def call_with(self, first, known):
        """The function of the other arguments. It keeps `known` alive."""
        filled, block_of, memory_of = np.zeros((), self.first), self.block, ctypes.c_char * self.block.itemsize
        for name, x in zip(self.first.names or (), first, strict=True):
            filled[name] = x
        run, unflatten, takes, gives = self.run, self.program.tree.unflatten, self.takes, self.gives
        count, address, rounds = self.count, filled.ctypes.data, self.program.rounds

        def call(leaves, kept=(self, known, filled)):  # the library, too
            memory = memory_of()
            block = np.ndarray((), block_of, memory)
            for name, x in zip(takes, leaves, strict=True):
                block[name] = x
            if run(count, address, memory, rounds):
                raise MemoryError
            block.setflags(write=False)
            return unflatten(map(block.__getitem__, gives))

        return call


def _layout(avals):
    """A structured dtype of arrays one after the other, each aligned to 8 bytes."""
    formats = [(a.dtype, a.shape) for a in avals]
    sizes = [-(-a.size * a.dtype.itemsize // 8) * 8 for a in avals]
    offsets = [sum(sizes[:i]) for i in range(len(sizes))]
    names = [str(i) for i in range(len(avals))]
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": sum(sizes)})
