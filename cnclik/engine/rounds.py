"""Rounds: a number of rounds that a program gets when it is called, so that one program serves runs of any length.

While a function is traced, read and written, a symbolic dimension of JAX stands for it. In C it is the variable
`rounds`. Lengths that depend on it are rounds + a constant; all others have no C form.
"""

import contextlib
import functools

import jax
import numpy as np

from cnclik.engine.graph import UnsupportedError

try:
    from jax.errors import InconclusiveDimensionOperation
except ImportError:  # JAX 0.10.0
    from jax.extend.core import InconclusiveDimensionOperation


class RoundsError(UnsupportedError):
    """It has no C form for any number of rounds; for one that is known it may have one."""


LEAST = 8  # rounds, at least, so that what a source decides by their number is decided


@functools.cache
def any_rounds():
    """The symbolic number of rounds."""
    from jax import export

    return export.symbolic_shape("rounds", constraints=(f"rounds >= {LEAST}",))[0]


@contextlib.contextmanager
def known_rounds():
    """Context manager: what cannot be decided inside without the number of rounds is a RoundsError."""
    try:
        yield
    except (InconclusiveDimensionOperation, TypeError) as error:
        if "_DimExpr" not in str(error) and not isinstance(error, InconclusiveDimensionOperation):
            raise
        raise RoundsError(f"it depends on the number of rounds: {str(error).splitlines()[0]}") from None


def beyond(length) -> int | None:
    """The constant c of a length rounds + c; None for a length that is known.

    Raises: RoundsError for any other.
    """
    if isinstance(length, int | np.integer):
        return None
    if isinstance(more := length - any_rounds(), int):
        return more
    raise RoundsError(f"a length of {length} has no C form")


def settled(avals) -> tuple:
    """(avals for 0 rounds, for each whether its first axis grows with the rounds)"""
    more = [beyond(a.shape[0]) if a.shape else None for a in avals]
    pairs = list(zip(avals, more, strict=True))
    return (
        [a if c is None else jax.ShapeDtypeStruct((c, *a.shape[1:]), a.dtype) for a, c in pairs],
        [c is not None for c in more],
    )
