"""lanes(fn): the meaning of jax.vmap(fn), laid out for the processor.

What `cnclik.engine.plan` does not run as C runs in JAX, on a CPU in tiles whose data stay in the cache, in blocks of
bounded size, side by side on all cores or devices.
"""

import functools
import itertools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.cache import LRU, bounded_jit
from cnclik.engine.native import native
from cnclik.engine.plan import as_here, chosen
from cnclik.engine.program import Bound, Program, lane_avals
from cnclik.engine.to_jax import Derived
from cnclik.engine.tracing import is_read
from cnclik.threads import cores as available
from cnclik.threads import side_by_side

TILE = 64  # lanes; from 64 to 256 the speed is nearly the same, and compile time grows
LANES_PER_CALL = 1 << 15  # lanes per call of a compiled program: few enough for memory, enough to feed the cores
DEVICE_BLOCK = 1 << 18  # the same on a GPU, to fit its cache: up to twice as fast as 2**20
ALONE = 1024  # lanes, at most, that one thread runs
CAPACITY = 1024  # lanes of a call of XLA's program, which serves batches of all sizes


def lanes(fn: Callable, *, cores: int | None = None) -> Callable:
    """Map a function over a batch as `jax.vmap(fn)` does, with the same results to rounding, but faster.

    Every argument is a tree of arrays with one leading batch axis, of any size from 1 to tens of millions. Close over
    what all lanes share. `fn` should return a small result of a loop (an error, a metric) and not the whole trajectory:
    memory is needed for inputs and results plus one block per core or device.

    Args:
      fn: function of one lane, such as `lambda q0: cnclik.solve(law, reference, q0, 0.01, 100).e[-1]`.
      cores: number of CPU cores that may work at once; default: all that this process may use.

    Under jit, vmap or grad it becomes part of that program: as C on JAX's threads, or through XLA on one core. Called
    with arrays it uses all cores or devices.
    """
    cores = available() if cores is None else errors.integer("cores", cores, at_least=1, at_most=1 << 16)
    if not callable(fn):
        raise errors.fail("fn", "be a function of one lane", f"is {fn!r}")
    as_c, on_cpu, devices = native(fn), jax.default_backend() == "cpu", jax.local_devices()
    # One thread per core, or per device: XLA's own threads gain nothing on so small operations.
    workers = [None] * cores if on_cpu and len(devices) == 1 else devices
    in_jax, compiled = jax.jit(functools.partial(tiled, as_c)), LRU()

    @functools.wraps(fn)
    def call(*args):
        treedef, (function, leaves) = jax.tree.structure(args), as_c.of(*args)  # leaves are as JAX takes them
        args, size = jax.tree.unflatten(treedef, leaves), _size(leaves)
        avals, concrete = lane_avals(leaves), all(map(errors.concrete, leaves))
        if is_read():  # as a part of what calls it
            return jax.vmap(fn)(*args)
        form = chosen(function, avals, batch=True)
        if isinstance(form, Program) and concrete:
            return function.trace(avals).tree.unflatten(jax.device_put(form(leaves, size, cores)))
        if isinstance(form, Program):
            return jax.vmap(as_c)(*args)
        if not concrete or size <= TILE or (workers[0] is not None and len(workers) == 1):  # there arrays stay
            return in_jax(*args)
        able = workers if isinstance(form, Derived) or not on_cpu else workers[:1]  # LAPACK, see `shares_threads`
        return _blocks(in_jax, compiled, args, size, able)

    return call


def _size(leaves) -> int:
    """Return the batch size of all leaves."""
    sizes = {np.shape(leaf)[:1] for leaf in leaves}  # of the numbers of a list ()
    if len(sizes) != 1 or sizes == {()}:
        found = sorted(str(s[0]) if s else "none" for s in sizes) or ["no arrays"]
        raise errors.fail(
            "args",
            "be arrays, such as jnp.asarray(...) of a list, with one leading batch axis of the same size",
            f"have {', '.join(found)}",
        )
    ((size,),) = sizes
    if size == 0:
        raise errors.fail("args", "hold at least one lane", "hold 0")
    return size


def tiled(fn, *args, count=None):
    """Compute vmap(fn) as a loop over tiles, read and written in place.

    Args: count: number of wanted lanes, from the first; results of others are undefined. Traced, so that one program
      serves batches of any size up to that of `args`.
    """
    size = _size(jax.tree.leaves(args))
    tile = min(TILE if jax.default_backend() == "cpu" else DEVICE_BLOCK, size)

    def results_from(start):
        return jax.vmap(fn)(*jax.tree.map(lambda x: lax.dynamic_slice_in_dim(x, start, tile), args))

    if size == tile:
        return results_from(0)

    def put(i, out):
        start = jnp.minimum(i * tile, size - tile)  # the last tile overlaps the one before instead of being padded
        return jax.tree.map(lambda o, y: lax.dynamic_update_slice_in_dim(o, y, start, 0), out, results_from(start))

    shapes = jax.eval_shape(lambda: results_from(0))
    empty = jax.tree.map(lambda s: jnp.zeros((size, *s.shape[1:]), s.dtype), shapes)
    return lax.fori_loop(0, ((size if count is None else count) + tile - 1) // tile, put, empty)


def _blocks(in_jax, compiled, args, size, workers):
    """Run blocks of whole tiles side by side, as many for each worker. Args: compiled: keys of what is compiled."""
    most = LANES_PER_CALL if jax.default_backend() == "cpu" else DEVICE_BLOCK
    calls = len(workers) * -(-size // (len(workers) * most))
    block = -(-size // (calls * TILE)) * TILE
    args = jax.tree.map(np.asarray, args)  # no copy on a CPU; slicing a jax.Array would compile
    leaves, treedef = jax.tree.flatten(args)
    key = block, treedef, *[(x.shape[1:], x.dtype) for x in leaves]

    @as_here
    def run(start):
        part, device = jax.tree.map(lambda x: _part(x, start, block), args), workers[start // block % len(workers)]
        return jax.tree.map(np.asarray, in_jax(*(part if device is None else jax.device_put(part, device))))

    starts = range(0, size, block)
    with side_by_side(len(workers)) as pool:
        first = None if compiled.get(key) else run(0)  # compile once, not once per thread
        compiled[key], whole = True, None
        parts = pool.map(run, starts) if first is None else itertools.chain([first], pool.map(run, starts[1:]))
        for start, part in zip(starts, parts, strict=True):  # in place, so that memory holds the results once
            if start == 0:
                whole = jax.tree.map(lambda x: np.empty((size, *x.shape[1:]), x.dtype), part)
            for into, x in zip(*map(jax.tree.leaves, (whole, part)), strict=True):
                into[start : start + block] = x[: size - start]
    return jax.tree.map(jnp.asarray, whole)


def _part(x, start, block):
    """Return a block of lanes; the last one is filled up."""
    part = x[start : start + block]
    return part if len(part) == block else np.resize(part, (block, *part.shape[1:]))


class Batches:
    """A function of one lane with one result, compiled in float64 for batches."""

    def __init__(self, fn, avals, *, single=False):
        """Args: avals: of all arguments of a lane. single: for one lane only."""
        self.avals, self.most = avals, 1 if single else CAPACITY
        as_c = native(fn)
        with jax.enable_x64(True):
            function, _ = as_c.of(*[np.zeros(a.shape, a.dtype) for a in avals])
            self.program = chosen(function, avals, batch=not single)

        def run(kept, lanes, count):
            return tiled(lambda *own: as_c(*kept, *own), *lanes, count=count)

        self.run = bounded_jit(run)

    def bound(self, *kept):
        """Return the function call(leaves, size) of batches, on all cores. Args: kept: the first arguments, of all.

        Its leaves are the other arguments, (size, ...), or (...) for what all lanes share.
        """
        call: Any
        if isinstance(self.program, Program):
            call = Bound(self.program, kept)
        else:
            with jax.enable_x64(True):
                call = functools.partial(self._in_tiles, jax.device_put(kept))

        return lambda leaves, size: call(leaves, size, 1 if size <= ALONE else available())[0]

    def _in_tiles(self, kept, leaves, size, cores):
        avals = self.avals[len(kept) :]
        leaves = [np.broadcast_to(x, (size, *a.shape)).astype(a.dtype) for x, a in zip(leaves, avals, strict=True)]

        def part(first):
            some, count = [_part(x, first, self.most) for x in leaves], min(self.most, size - first)
            return np.asarray(self.run(kept, some, np.int32(count)))[:count]

        with jax.enable_x64(True), side_by_side(cores) as pool:
            return [np.concatenate(list(pool.map(as_here(part), range(0, size, self.most))))]
