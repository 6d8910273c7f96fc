"""lanes(fn): the meaning of jax.vmap(fn), laid out for the processor.

The batch is cut into tiles of a few dozen lanes. Inside a tile the lane axis comes last, so each scalar of
component-form code is one contiguous row; on a CPU a tile is compiled as one native function, loops
included. Tiles run in blocks of bounded size, the blocks side by side on all cores. Under `hints(False)` the
same tiles run without compiler hints.
"""

import functools
import os
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.hints import one_function

TILE = 64  # lanes; from 64 to 256 the speed is nearly the same, and compile time grows
BLOCK = 1 << 15  # lanes that one call of a compiled program carries: bounds memory, feeds the cores


def lanes(fn, *, tile: int = TILE, block: int = BLOCK, cores: int | None = None):
    """Same arguments and, to rounding, same results as `jax.vmap(fn)`, but fast.

    Every argument is a tree of arrays with one leading batch axis of any size from 1 to tens of millions; what
    all lanes share is best closed over. `fn` should return what is wanted of a loop (an error, a metric) and not
    its whole trajectory: memory is that of inputs and results plus one block per core.

    Args:
      fn: function of one lane, such as `lambda q0: cnclik.solve(law, reference, q0, 0.01, 100).e[-1]`.
      tile: lanes per tile. block: lanes per call, a multiple of `tile`.
      cores: how many cores may work at once, by default all this process may use.

    Under jit, vmap or grad it is one traced program on one core; called with arrays it uses all cores.
    """
    tile = errors.integer("tile", tile, at_least=1)
    block = errors.integer("block", block, at_least=tile)
    cores = _cores() if cores is None else errors.integer("cores", cores, at_least=1)
    traced = functools.partial(_tiled, fn, tile)
    compiled = jax.jit(traced)

    @functools.wraps(fn)
    def call(*args):
        size = _size(args)
        leaves, treedef = jax.tree.flatten(args)
        if not all(map(errors.concrete, leaves)):
            return traced(*args)
        if size <= tile:
            return compiled(*args)
        return _blocks(compiled, leaves, treedef, size, _block(size, tile, block, cores), cores)

    return call


def _cores() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1


def _size(args) -> int:
    """The batch size all leaves share."""
    sizes = {np.shape(leaf)[:1] for leaf in jax.tree.leaves(args)}
    if len(sizes) != 1 or sizes == {()}:
        found = sorted(str(s[0]) if s else "none" for s in sizes) or ["no arrays"]
        raise errors.fail("args", "be arrays with one leading batch axis of the same size", f"have {', '.join(found)}")
    ((size,),) = sizes
    if size == 0:
        raise errors.fail("args", "hold at least one lane", "hold 0")
    return size


def _block(size, tile, block, cores):
    """Lanes per call: whole tiles, an equal share for each core, at most `block`."""
    share = -(-size // cores)
    return min(-(-share // tile) * tile, block // tile * tile)


def _tiled(fn, tile, *args):
    """vmap(fn) as a loop over tiles, the lane axis last inside each; elsewhere than on a CPU, vmap(fn) itself."""
    size = _size(args)
    if jax.default_backend() != "cpu":
        return jax.vmap(fn)(*args)
    tile = min(tile, size)
    inner = one_function(jax.vmap(fn, in_axes=-1, out_axes=-1))
    last = functools.partial(jax.tree.map, lambda x: jnp.moveaxis(x, 0, -1))
    first = functools.partial(jax.tree.map, lambda x: jnp.moveaxis(x, -1, 0))
    if size == tile:
        return first(inner(*last(args)))
    count = -(-size // tile)
    padded = jax.tree.map(lambda x: _pad(jnp.asarray(x), count * tile).reshape(count, tile, *np.shape(x)[1:]), args)
    out = lax.map(lambda args: first(inner(*last(args))), padded)
    return jax.tree.map(lambda x: x.reshape(count * tile, *x.shape[2:])[:size], out)


def _pad(x, size):
    """Repeat the last lane: padding computes what some lane computes, never something new."""
    missing = size - x.shape[0]
    if not missing:
        return x
    return jnp.concatenate([x, jnp.broadcast_to(x[-1:], (missing, *x.shape[1:]))])


def _blocks(compiled, leaves, treedef, size, block, cores):
    """Run blocks side by side; each result is copied into place as soon as it is there."""
    leaves = [np.asarray(leaf) for leaf in leaves]  # no copy on a CPU; slicing a jax.Array would compile

    def run(start):
        part = [_take(leaf, start, block) for leaf in leaves]
        return start, jax.block_until_ready(compiled(*jax.tree.unflatten(treedef, part)))

    starts = range(0, size, block)
    # The first block compiles; the others find the program ready.
    first = run(0)
    flat, out_treedef = jax.tree.flatten(first[1])
    results = [np.empty((size, *x.shape[1:]), x.dtype) for x in flat]

    def keep(start, out):
        stop = min(start + block, size)
        for whole, x in zip(results, jax.tree.leaves(out), strict=True):
            whole[start:stop] = np.asarray(x)[: stop - start]

    keep(*first)
    with ThreadPoolExecutor(cores) as pool:
        for start, out in pool.map(run, starts[1:]):
            keep(start, out)
    return jax.tree.unflatten(out_treedef, [jnp.asarray(x) for x in results])


def _take(leaf, start, block):
    part = leaf[start : start + block]
    return part if part.shape[0] == block else np.concatenate([part, np.repeat(part[-1:], block - part.shape[0], 0)])
