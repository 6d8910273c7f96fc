"""Numbers: a function called with numbers, as C without JAX around it: NumPy in and out, in microseconds."""

import contextlib
import ctypes
import functools

import jax
import numpy as np

from cnclik import cache
from cnclik.cache import LRU
from cnclik.engine.graph import TooLargeError, UnsupportedError
from cnclik.engine.native import called, native, of_rounds
from cnclik.engine.plan import choice, in_c, most_nodes
from cnclik.engine.program import Program, key_of, lane_avals
from cnclik.engine.rounds import LEAST, RoundsError, any_rounds
from cnclik.programs import name_of, recalled, remember

MOST_BYTES = 1 << 20  # of the results, at most, to lie in one block of memory
Tracer = jax.core.Tracer


@functools.cache
def whole_of(fn):
    """A function of two tuples of trees, known and given, and of any number of rounds, its `N`."""
    return native(lambda known, given: fn(*known, *given, N=any_rounds()))


class Numbers:
    """A function of two tuples of trees, known and given, that is called with numbers.

    Known values, such as a law and a reference, stay the same from call to call: they are recognized by identity and
    flattened once. Given are an array, then numbers of the array's type and trees of arrays.
    """

    def __init__(self, fn, *, lets_go, **static):
        """fn(*known, *given, **static). lets_go: release Python's lock during calls, if they are longer than a step.

        A function of `N` rounds shares its program with those of other numbers, where there is such a program. It is no
        C where that would take too long to compile, see `most_nodes`.
        """
        self.fn, self.static, self.lets_go = fn, static, lets_go
        N = self.rounds = static.get("N", 0)
        self.native = of_rounds(self.source, whole_of(fn) if N >= LEAST else None, N)
        self.ready, self.entries = {}, LRU()
        self.ran_in_c = False  # the last call

    def source(self, known, given):
        return self.fn(*known, *given, **self.static)

    def __call__(self, known, given):
        """Its results as a tree of read-only NumPy arrays, or of JAX arrays if the first given array is one.

        None if it does not run as C.
        """
        leaves, treedef = jax.tree.flatten(given)
        key = [treedef, jax.config.jax_enable_x64, *choice(), *map(id, known)]
        for x in leaves:
            key += type(x), x.shape, x.dtype
        key = tuple(key)
        call = self.ready.get(key) or self._prepared(key, known, given)
        self.ran_in_c = call is not None
        return call and call(leaves)

    def _prepared(self, key, known, given):
        if not in_c():
            return None
        function, every = self.native.of(known, given)
        if any(isinstance(x, Tracer) for x in every):
            return None
        most = most_nodes(self.rounds)
        avals, others = lane_avals(every, batched=False), len(jax.tree.leaves(given))
        program, tree = self._program(function, avals, known, given, most)
        if not isinstance(program, Program) or program.nodes > most:
            return None
        first, given = every[: len(every) - others], every[len(every) - others :]
        lasting = not any(isinstance(x, np.ndarray) and x.flags.writeable for x in first)
        if isinstance(given[0], jax.Array):
            with jax.ensure_compile_time_eval():  # cached values must not become part of a user's trace
                first, none = jax.device_put(first), (False,) * len(every)

            def call(leaves, known=known):  # keeps the known values alive, as their ids are the key
                return tree.unflatten(called(*first, *leaves, function=function, batched=none))

        elif sum(s.size * s.dtype.itemsize for s in program.shapes) > MOST_BYTES:
            return lambda leaves: tree.unflatten(map(_only, program([*first, *leaves], 1)))
        else:
            entry = self.entries.made(program, lambda _: _Entry(program, len(first), tree, self.lets_go))
            call = entry.call_with(first, known)
        if lasting:
            if len(self.ready) >= cache.KEPT_PROGRAMS:
                self.ready.clear()
            self.ready[key] = call
        return call

    def _program(self, function, avals, known, given, most):
        """(the program, the tree of its results)"""
        if function.whole is not None:
            found, tree = self._made(function.whole, "any", avals, known, given, most)
            if isinstance(found, Program):
                return function.one_lane(avals), tree
            if not isinstance(found, RoundsError):
                return found, None
        return self._made(function, self.static, avals, known, given, most)

    def _made(self, function, about, avals, known, given, most):
        """The same of one function; with a cache of programs, what an earlier process made."""
        made, trees, key = function.single, function.trees, key_of(avals)
        name = name_of((self.fn, about), (known, given)) if made.known(avals) is None else None
        found = recalled(name) if name else None
        if isinstance(found, int):  # too many nodes for the process that read it
            if found > most:
                return TooLargeError(found), None
        elif found:
            with contextlib.suppress(UnsupportedError):  # its library no longer exists
                program = made.found[key] = Program.kept(avals, *found)
                trees[key] = jax.tree.structure(found[1])
                return program, trees[key]
        program = made.of(avals, most=most)
        if name and isinstance(program, Program):
            remember(name, lambda: (program.path, trees[key].unflatten(program.shapes), program.grows))
        elif name and isinstance(program, TooLargeError):
            remember(name, lambda: program.nodes)
        return program, trees.get(key)


def _only(several):
    """The only lane of a batch, read-only."""
    several.setflags(write=False)
    return several[0, ...]


class _Entry:
    """A program's entry for numbers, with the first `count` arguments in a block of their own."""

    def __init__(self, program, count, tree, lets_go):
        self.program, self.count, self.unflatten = program, count, tree.unflatten
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
        run, unflatten, takes, gives = self.run, self.unflatten, self.takes, self.gives
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
