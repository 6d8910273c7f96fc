"""The same function by JAX and as C, lane by lane."""

import jax
import numpy as np

from cnclik.engine.program import Program, lane_avals


def in_c(fn, *args, cores=1):
    """Results of the function as C, of a batch."""
    leaves, treedef = jax.tree.flatten(args)
    made = Program(fn, lane_avals(leaves), treedef)
    return jax.tree.unflatten(made.tree, made(leaves, len(leaves[0]), cores))


def check(fn, *args, ulps=4.0, each=False, by=None):
    """Raises AssertionError where C and `jax.vmap` of it, or of `by`, differ.

    Whole numbers and truths have to be equal, and infinity and NaN where they are in JAX. Other numbers may differ by
    some ulps: each by its own, or all by those of the largest one in their array.
    """
    wanted = jax.jit(jax.vmap(by or fn))(*args)
    found = in_c(fn, *args)
    same(found, wanted, ulps=ulps, each=each)
    return found


def same(found, wanted, *, ulps=4.0, each=False):
    """What `check` asserts, of two trees of arrays."""
    assert jax.tree.structure(found) == jax.tree.structure(wanted)
    for a, b in zip(*(map(np.asarray, jax.tree.leaves(x)) for x in (found, wanted)), strict=True):
        assert a.shape == b.shape and a.dtype == b.dtype, (a.shape, a.dtype, b.shape, b.dtype)
        if a.dtype.kind != "f":
            np.testing.assert_array_equal(a, b)
            continue
        good = np.isfinite(b)
        np.testing.assert_array_equal(np.where(good, 0, a), np.where(good, 0, b))
        size = np.abs(b[good]) if each else np.abs(b[good]).max(initial=0)
        off = np.abs(a[good] - b[good]) - ulps * np.finfo(a.dtype).eps * size - 2 * np.finfo(a.dtype).tiny
        assert np.isfinite(a[good]).all() and (off <= 0).all(), (a[good][off.argmax()], b[good][off.argmax()])
