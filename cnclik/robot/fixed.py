"""Fixed transforms: geometry in which numbers stay numbers and traced values stay traced.

Vectors are tuples of scalars, matrices tuples of rows. Products with a Python 0 or 1 are folded, so the rest of the
geometry stays known in an arm whose link lengths are parameters. `robot.model` turns the result into arrays.
"""

import functools
import math

from cnclik.record import Number, record

Triple = tuple[Number, Number, Number]

IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ZERO = (0.0, 0.0, 0.0)


def is_number(a) -> bool:
    """Whether a scalar is a Python number, which is compiled in."""
    return type(a) in (float, int)


def mul(a, b):
    if is_number(b) and not is_number(a):
        a, b = b, a
    if is_number(a) and a in (0, 1, -1):
        return 0.0 if a == 0 else b if a == 1 else -b
    return a * b


def add(a, b):
    if is_number(a) and a == 0:
        return b
    return a if is_number(b) and b == 0 else a + b


def vadd(a, b):
    return tuple(map(add, a, b))


def scale(s, v):
    return tuple(mul(s, x) for x in v)


def vsub(a, b):
    return vadd(a, scale(-1.0, b))


def matvec(m, v):
    return tuple(functools.reduce(add, map(mul, row, v)) for row in m)


def matmul(a, b):
    columns = transpose(b)
    return tuple(matvec(columns, row) for row in a)


def transpose(m):
    return tuple(zip(*m, strict=True))


def rotation_parts(axis):
    """a aᵀ, [a]× and I − a aᵀ of a unit axis: a rotation about it is their sum, weighted by 1, sine and cosine.

    Rodrigues' formula (Murray, Li & Sastry 1994, eq. 2.14).
    """
    x, y, z = axis
    along = tuple(scale(a, axis) for a in axis)
    crossed = ((0.0, mul(-1.0, z), y), (z, 0.0, mul(-1.0, x)), (mul(-1.0, y), x, 0.0))
    return along, crossed, tuple(map(vsub, IDENTITY, along))


def rotation_about(axis, sine, cosine):
    """The rotation about a unit axis by an angle of this sine and cosine."""
    along, crossed, across = rotation_parts(axis)
    rows = zip(along, crossed, across, strict=True)
    return tuple(vadd(a, vadd(scale(cosine, c), scale(sine, s))) for a, s, c in rows)


def turn(axis, angle):
    """Rotation by a fixed angle; sines of literal multiples of π/2 are exact, so that they fold."""
    if is_number(angle):
        sine, cosine = (0.0 if abs(v) < 1e-15 else v for v in (math.sin(angle), math.cos(angle)))
        sine, cosine = (round(v) * 1.0 if abs(abs(v) - 1) < 1e-15 else v for v in (sine, cosine))
    else:
        import jax.numpy as jnp

        sine, cosine = jnp.sin(angle), jnp.cos(angle)
    return rotation_about(axis, sine, cosine)


@record
class Offset:
    """A fixed transform: rotation (rows), then position, in the previous frame."""

    position: Triple = ZERO  # [m]
    rotation: tuple[Triple, ...] = IDENTITY


def compose(first: Offset, second: Offset) -> Offset:
    """The transform `first`, then `second` in the frame after it."""
    return Offset(position=placed(first, second.position), rotation=matmul(first.rotation, second.rotation))


def placed(offset: Offset, point: Triple) -> Triple:
    """A point given in the frame of an offset, in the previous frame."""
    return vadd(offset.position, matvec(offset.rotation, point))


def inverse(offset: Offset) -> Offset:
    back = transpose(offset.rotation)
    return Offset(position=scale(-1.0, matvec(back, offset.position)), rotation=back)
