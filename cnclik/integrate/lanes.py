"""lanes(fn): the meaning of jax.vmap(fn), laid out for the processor.

`cnclik.engine.plan` chooses what runs a batch. On a CPU with a C compiler it is C on vectors, on all cores. Otherwise
JAX gets it, on a CPU in tiles of a few dozen lanes, so few that a tile's data stay in the cache. Batches run in blocks
of bounded size, side by side on all cores, or on all devices.
"""

import contextlib
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


def lanes(fn: Callable, *, tile: int | None = None, block: int | None = None, cores: int | None = None) -> Callable:
    """Map a function over a batch as `jax.vmap(fn)` does, with the same results to rounding, but faster.

    Every argument is a tree of arrays with one leading batch axis, of any size from 1 to tens of millions. Close over
    what all lanes share. `fn` should return a small result of a loop (an error, a metric) and not the whole trajectory:
    memory is needed for inputs and results plus one block per core or device.

    Args:
      fn: function of one lane, such as `lambda q0: cnclik.solve(law, reference, q0, 0.01, 100).e[-1]`.
      tile: lanes per tile of XLA's programs on a CPU; default: 64. C has its own tiles.
      block: lanes per call of a program, a multiple of `tile`; default: 32768, on a GPU one tile of 2**18 lanes.
      cores: number of CPU cores that may work at once; default: all that this process may use.

    Under jit, vmap or grad it becomes part of that program: as C on JAX's threads, or through XLA on one core. Called
    with arrays it uses all cores or devices.
    """
    on_cpu = jax.default_backend() == "cpu"
    tile = errors.integer("tile", TILE if tile is None else tile, at_least=1)
    default = max(LANES_PER_CALL if on_cpu else DEVICE_BLOCK, tile)
    block = errors.integer("block", default if block is None else block, at_least=tile)
    cores = available() if cores is None else errors.integer("cores", cores, at_least=1, at_most=1 << 16)
    if not callable(fn):
        raise errors.fail("fn", "be a function of one lane", f"is {fn!r}")

    as_c = native(fn)
    # One thread per core, or per device: XLA's own threads gain nothing on so small operations.
    devices = jax.local_devices()
    workers = [None] * cores if on_cpu and len(devices) == 1 else devices
    in_jax, ready = jax.jit(functools.partial(tiled, as_c, tile, block=block)), LRU()

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
        if not concrete or size <= tile or (workers[0] is not None and len(workers) == 1):  # there arrays stay
            return in_jax(*args)
        able = workers if isinstance(form, Derived) or not on_cpu else workers[:1]  # LAPACK, see `shares_threads`
        return _blocks(in_jax, ready, leaves, treedef, size, _block(size, tile, block, len(able)), able)

    return call


def _signature(leaves, treedef) -> tuple:
    """Return the types of one lane of the arguments: equal ones share a program."""
    return treedef, *[(x.shape[1:], x.dtype) for x in leaves]


def _size(leaves) -> int:
    """Return the batch size of all leaves."""
    for leaf in leaves:
        if not hasattr(leaf, "dtype"):  # the numbers of a list have shape ()
            raise errors.fail("args", "be arrays, such as jnp.asarray(...) of a list", f"hold {leaf!r}")
    sizes = {leaf.shape[:1] for leaf in leaves}
    if len(sizes) != 1 or sizes == {()}:
        found = sorted(str(s[0]) if s else "none" for s in sizes) or ["no arrays"]
        raise errors.fail("args", "be arrays with one leading batch axis of the same size", f"have {', '.join(found)}")
    ((size,),) = sizes
    if size == 0:
        raise errors.fail("args", "hold at least one lane", "hold 0")
    return size


def _block(size, tile, block, workers):
    """Return the lanes per call: at most `block`, in whole tiles, so that all workers get equally many calls."""
    calls = workers * -(-size // (workers * block))
    return -(-size // (calls * tile)) * tile


def tiled(fn, tile, *args, block=DEVICE_BLOCK, count=None):
    """Compute vmap(fn) as a loop over tiles, read and written in place.

    Args:
      tile, block: lanes of a tile, on a CPU and elsewhere.
      count: number of wanted lanes, from the first; results of others are undefined. Traced, so that one program
        serves batches of any size up to that of `args`.
    """
    size = _size(jax.tree.leaves(args))
    tile = min(tile if jax.default_backend() == "cpu" else block, size)

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


def _blocks(compiled, ready, leaves, treedef, size, block, workers):
    """Run blocks side by side; each result is copied into place as soon as it is ready."""
    leaves = [np.asarray(leaf) for leaf in leaves]  # no copy on a CPU; slicing a jax.Array would compile
    key = block, _signature(leaves, treedef)

    @as_here
    def run(start):
        part = [_take(leaf, start, block) for leaf in leaves]
        device = workers[start // block % len(workers)]
        if device is not None:
            part = jax.device_put(part, device)
        return start, jax.block_until_ready(compiled(*jax.tree.unflatten(treedef, part)))

    starts = list(range(0, size, block))
    whole = None
    with side_by_side(len(workers)) as pool:
        if not ready.get(key):  # compile once, not once per thread
            done = [run(starts.pop(0))]
            ready[key] = True
        else:
            done = []
        for start, out in itertools.chain(done, pool.map(run, starts)):
            flat, out_treedef = jax.tree.flatten(out)
            if whole is None:
                whole = [np.empty((size, *x.shape[1:]), x.dtype) for x in flat]
            for into, x in zip(whole, flat, strict=True):
                part = into[start : start + block]
                part[...] = np.asarray(x)[: len(part)]
    return jax.tree.unflatten(out_treedef, [jnp.asarray(x) for x in whole])


def _take(leaf, start, block):
    part = leaf[start : start + block]
    return part if part.shape[0] == block else np.concatenate([part, np.repeat(part[-1:], block - part.shape[0], 0)])


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
            return tiled(lambda *own: as_c(*kept, *own), min(TILE, self.most), *lanes, count=count)

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

        def threaded(leaves, size):
            alone = size <= ALONE or available() == 1
            with contextlib.nullcontext() if alone else side_by_side() as pool:
                return call(leaves, size, pool, available())[0]

        return threaded

    def _in_tiles(self, kept, leaves, size, pool, _):
        avals = self.avals[len(kept) :]
        leaves = [np.broadcast_to(x, (size, *a.shape)).astype(a.dtype) for x, a in zip(leaves, avals, strict=True)]

        def part(first):
            some = [x[first : first + self.most] for x in leaves]
            count = len(some[0])
            some = [np.resize(x, (self.most, *x.shape[1:])) for x in some]
            return np.asarray(self.run(kept, some, np.int32(count)))[:count]

        with jax.enable_x64(True):
            parts = (map if pool is None else pool.map)(as_here(part), range(0, size, self.most))
            return [np.concatenate(list(parts))]
