"""Fixed transforms: geometry in which numbers stay numbers and traced values stay traced.

Products with a Python 0 or 1 are folded, so the rest of the geometry stays known in an arm whose lengths are traced.
"""

import functools
import itertools
import math

from cnclik.record import Number, record

Triple = tuple[Number, Number, Number]

IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ZERO = (0.0, 0.0, 0.0)
_NUMBERS = float, int


def is_number(a) -> bool:
    """Return whether a scalar is a Python number, which is compiled in."""
    return type(a) in _NUMBERS


def mul(a, b):
    """Return a b, without a product where one is a Python 0, 1 or −1."""
    if type(a) not in _NUMBERS:
        a, b = b, a
    if type(a) in _NUMBERS and a in (0, 1, -1):
        return 0.0 if a == 0 else b if a == 1 else -b
    return a * b


def add(a, b):
    """Return a + b, without a sum where one is a Python 0."""
    if type(a) in _NUMBERS and a == 0:
        return b
    return a if type(b) in _NUMBERS and b == 0 else a + b


def dot(u, v):
    """Return Σ uᵢ vᵢ, without the terms that are a Python 0."""
    return functools.reduce(add, map(mul, u, v), 0.0)


def vadd(a, b):
    return tuple(map(add, a, b))


def vsub(a, b):
    return vadd(a, scale(-1.0, b))


def scale(s, v):
    return tuple(map(mul, itertools.repeat(s), v))


def matvec(m, v):
    return tuple(map(dot, m, itertools.repeat(v)))


def matmul(a, b):
    return tuple(map(matvec, itertools.repeat(transpose(b)), a))


def transpose(m):
    return tuple(zip(*m, strict=True))


def snapped(values):
    """Return sines and cosines with those within rounding of 0 and ±1 made exact, so that literals fold."""
    return tuple(float(round(x)) if abs(x - round(x)) < 1e-15 else x for x in values)


def turn(axis, angle):
    """Return the rotation about a unit axis by a fixed angle, R = a aᵀ + (I − a aᵀ) cos + [a]× sin.

    Rodrigues' formula (Murray, Li & Sastry 1994, eq. 2.14).
    """
    if is_number(angle):
        sine, cosine = snapped((math.sin(angle), math.cos(angle)))
    else:
        import jax.numpy as jnp

        sine, cosine = jnp.sin(angle), jnp.cos(angle)
    x, y, z = axis
    crossed = ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))
    along = tuple(scale(a, axis) for a in axis)
    across = tuple(map(vsub, IDENTITY, along))
    return tuple(
        vadd(a, vadd(scale(cosine, b), scale(sine, c))) for a, b, c in zip(along, across, crossed, strict=True)
    )


@record
class Offset:
    """A fixed transform: rotation (rows), then position, in the previous frame."""

    position: Triple = ZERO  # [m]
    rotation: tuple[Triple, ...] = IDENTITY


def compose(first: Offset, second: Offset) -> Offset:
    """Return the transform `first`, then `second` in the frame after it."""
    return Offset(position=placed(first, second.position), rotation=matmul(first.rotation, second.rotation))


def placed(offset: Offset, point: Triple) -> Triple:
    """Return a point given in the frame of an offset, in the previous frame."""
    return vadd(offset.position, matvec(offset.rotation, point))


def inverse(offset: Offset) -> Offset:
    """Return the transform back."""
    back = transpose(offset.rotation)
    return Offset(position=scale(-1.0, matvec(back, offset.position)), rotation=back)
