"""Numbers: a function called with numbers, as C without JAX around it: NumPy in and out, in microseconds."""

import ctypes

import jax
import numpy as np

from cnclik import cache
from cnclik.cache import LRU
from cnclik.engine.native import Function, compiled, of_leaves
from cnclik.engine.plan import chosen
from cnclik.engine.program import Program, lane_avals
from cnclik.engine.tracing import engine, is_read


class Numbers:
    """A function of two tuples of trees, known and given, that is called with numbers: fn(*known, *given, **static).

    Known values, such as a law and a reference, stay the same from call to call: they are recognized by identity and
    flattened once. Given are an array, then numbers of the array's type and trees of arrays. Each of the static
    arguments has a program.
    """

    def __init__(self, fn):
        self.fn, self.ready, self.functions = fn, {}, LRU()

    def __call__(self, known, given, **static):
        """Return its results as a tree of read-only NumPy arrays, or of JAX arrays if the first given array is one.

        Numbers are computed by what `plan` has chosen, C or JAX. What is traced becomes part of a user's program.
        """
        if is_read():  # the engine reads the source itself
            return self.fn(*known, *given, **static)
        leaves, treedef = jax.tree.flatten(given)
        key = [treedef, jax.config.jax_enable_x64, engine.value, *static.values(), *map(id, known)]
        for x in leaves:
            key += type(x), x.shape, x.dtype
        key = tuple(key)
        call = self.ready.get(key) or self._prepared(key, known, given, static)
        return call(leaves)

    def _prepared(self, key, known, given, static):
        """Return the function of given leaves that computes the results; it is kept unless something is traced."""
        leaves, treedef = jax.tree.flatten(((known, given), {}))
        every, count = leaves, len(leaves) - len(jax.tree.leaves(given))
        function, first, avals = self._function(treedef, static), every[:count], lane_avals(every, batched=False)
        numbers, lasting = not isinstance(given[0], jax.Array), not any(map(_is_writable, first))
        if any(isinstance(x, jax.core.Tracer) for x in every):
            return lambda leaves: function(*first, *leaves)
        form, traced = chosen(function, avals, batch=False), function.trace(avals)
        if traced.stays:
            return lambda leaves: function(*first, *leaves)
        if isinstance(form, Program) and numbers:
            call = _in_c(form, first, known)
        else:
            with jax.ensure_compile_time_eval():  # cached values must not become part of a user's trace
                first = jax.device_put(first)

            def call(leaves, known=known):  # keeps them alive, as their ids are in the key
                found = compiled(*first, *leaves, function=function, batched=(False,) * len(every))
                return traced.tree.unflatten(map(np.asarray, found) if numbers else found)

        if lasting:
            if len(self.ready) >= cache.KEPT_PROGRAMS:
                self.ready.clear()
            self.ready[key] = call
        return call

    def _function(self, treedef, static):
        """Return the function of the leaves of known and given."""

        def fn(known, given):
            return self.fn(*known, *given, **static)

        return self.functions.made((treedef, *static.values()), lambda _: Function(of_leaves(fn, treedef)))


def _is_writable(x) -> bool:
    return isinstance(x, np.ndarray) and x.flags.writeable


def _in_c(program, first, known):
    """Return a program as a function of its arguments after the first ones, without JAX. It keeps `known` alive."""
    run = ctypes.CDLL(None, handle=program.library._handle).of_numbers
    run.argtypes = ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p
    count, given = len(first), program.avals[len(first) :]
    filled, layout = np.zeros((), _layout(program.avals[:count])), _layout([*given, *program.shapes])
    for name, x in zip(filled.dtype.names or (), first, strict=True):
        filled[name] = x
    takes, gives, memory_of = layout.names[: len(given)], layout.names[len(given) :], ctypes.c_char * layout.itemsize
    address, unflatten = filled.ctypes.data, program.tree.unflatten

    def call(leaves, kept=(program, known, filled)):  # the library, too
        memory = memory_of()
        block = np.ndarray((), layout, memory)
        for name, x in zip(takes, leaves, strict=True):
            block[name] = x
        if run(count, address, memory):
            raise MemoryError
        block.setflags(write=False)
        return unflatten(map(block.__getitem__, gives))

    return call


def _layout(avals):
    """A structured dtype of arrays one after the other, each aligned to 8 bytes."""
    sizes = [-(-a.size * a.dtype.itemsize // 8) * 8 for a in avals]
    return np.dtype(
        {
            "names": list(map(str, range(len(avals)))),
            "formats": [(a.dtype, a.shape) for a in avals],
            "offsets": [sum(sizes[:i]) for i in range(len(sizes))],
            "itemsize": sum(sizes),
        }
    )
