"""Float64 where an answer needs it, whatever the caller's setting.

JAX computes in float32 by default, and eigenvalues that are 1 to seven digits can't tell a stable loop
from an unstable one. What advises (stability, tuning, sweeps) therefore works in float64 by itself.
"""

import functools
import inspect

import jax
import numpy as np

from cnclik import errors


def of_numbers(fn):
    """Decorator: `fn` decides by numbers. Where an argument is traced (jit, vmap, grad) one line names it."""
    names = inspect.signature(fn).parameters

    @functools.wraps(fn)
    def known(*args, **kwargs):
        for name, value in (*zip(names, args, strict=False), *kwargs.items()):
            as_numbers(fn.__name__, name, value)
        return fn(*args, **kwargs)

    return known


def as_numbers(door, name, value) -> None:
    """Refuse a traced argument that `door` decides by."""
    if not _known(value):
        raise errors.fail(name, "hold numbers", f"is traced by JAX: call {door} outside of jit, vmap and grad")


def in_float64(fn):
    """Decorator: run `fn` in float64; arrays among its arguments are widened, results stay as they come."""
    return of_numbers(in_float64_if_known(fn))


def in_float64_if_known(fn):
    """Decorator: `in_float64` of what takes traced arguments, too: then the caller's own precision is all there is."""

    @functools.wraps(fn)
    def wide(*args, **kwargs):
        leaves = jax.tree.leaves((args, kwargs))
        narrow = any(_floating(leaf) and leaf.dtype.itemsize < 8 for leaf in leaves)
        if not _known(leaves) or (jax.config.jax_enable_x64 and not narrow):
            return fn(*args, **kwargs)
        with jax.enable_x64(True):
            args, kwargs = jax.tree.map(_widened, (args, kwargs))
            return fn(*args, **kwargs)

    return wide


def precise(fn):
    """Decorator: matrix products in full precision, where a GPU would round to fewer digits."""

    @functools.wraps(fn)
    def exact(*args, **kwargs):
        with jax.default_matmul_precision("highest"):
            return fn(*args, **kwargs)

    return exact


def _known(tree) -> bool:
    return all(map(errors.concrete, jax.tree.leaves(tree)))


def _floating(leaf):
    return hasattr(leaf, "dtype") and np.issubdtype(leaf.dtype, np.floating)


def _widened(leaf):
    """A floating array in float64, as a copy: JAX remembers some constants by identity; anything else as it is."""
    return np.array(leaf, np.float64) if _floating(leaf) else leaf
