"""Rotations as arrays: exponential and logarithm, quaternions; norms with derivatives everywhere."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from cnclik.record import register_waiting

register_waiting()  # all of the robot that needs JAX comes by here


def library(*arrays):
    """Return NumPy, which does not compile, if all arrays are NumPy's; otherwise JAX's."""
    return np if all(isinstance(v, (np.ndarray, np.generic)) for v in arrays) else jnp


def product(a, b):
    """Return A B of small matrices (..., k, k), as sums: the library that XLA calls takes ten times as long."""
    if a.ndim > 2 and library(a, b) is np:  # of many in NumPy it takes a third
        return a @ b
    return (a[..., :, :, None] * b[..., None, :, :]).sum(axis=-2)


def safe_norm(v):
    """Return ‖v‖ with derivative 0 (not NaN) at v = 0."""
    return safe_sqrt(v @ v)


def safe_sqrt(x):
    """Return √x with derivative 0 (not NaN) at x = 0.

    A rounding replaces 0 below the root: with 1, a compiler that computes x twice, once with a fused multiply-add, and
    finds 0 only once would make a resting target move by 1 m.
    """
    zero, least = x == 0, float(jnp.finfo(jnp.result_type(x)).eps) ** 2
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, least, x)))


def crossed(w):
    """Return [w]×, the matrix of the cross product with w (3, ...)."""
    (x, y, z), xp = w, library(w)
    zero = xp.zeros_like(x)
    return xp.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]])


def exp_so3(w):
    """Return exp([w]×) = I + a [w]× + b [w]×² of a rotation vector [rad], finite with all derivatives at w = 0."""
    squared = w @ w
    small = squared < 1e-4
    safe = jnp.where(small, 1.0, squared)
    angle = jnp.sqrt(safe)
    a = jnp.where(small, _series(squared, 1, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880), jnp.sin(angle) / angle)
    b = jnp.where(small, _series(squared, 1 / 2, -1 / 24, 1 / 720, -1 / 40320), (1 - jnp.cos(angle)) / safe)
    identity = jnp.eye(3, dtype=w.dtype)
    return identity + a * crossed(w) + b * (jnp.outer(w, w) - squared * identity)


def _series(x, *coefficients):
    """Return c0 + c1 x + c2 x² + … by Horner's rule."""
    out = coefficients[-1]
    for c in coefficients[-2::-1]:
        out = c + x * out
    return out


def quaternion_from_rotation(r):
    """Return the unit quaternion (w, x, y, z), w ≥ 0, of a rotation (after Shepperd 1978).

    The rows of 4 q qᵀ are linear in the entries of R. That with the largest diagonal keeps the one square root away
    from 0, so values and derivatives stay finite everywhere.
    """
    rows = jnp.array(products_of_quaternion(r))
    row, largest = rows[0], rows[0, 0]
    for k in (1, 2, 3):
        better = rows[k, k] > largest
        row, largest = jnp.where(better, rows[k], row), jnp.where(better, rows[k, k], largest)
    factor = 0.5 / jnp.sqrt(largest)
    return jnp.where(row[0] < 0, -factor, factor) * row


def products_of_quaternion(r):
    """Return rows of 4 q qᵀ of a rotation's quaternion, each entry linear in those of the rotation."""
    (a, b, c), (d, e, f), (g, h, i) = r
    return [
        [1 + a + e + i, h - f, c - g, d - b],
        [h - f, 1 + a - e - i, b + d, c + g],
        [c - g, b + d, 1 - a + e - i, f + h],
        [d - b, c + g, f + h, 1 - a - e + i],
    ]


def rotation_from_quaternion(q):
    """Return the rotation of a unit quaternion (w, x, y, z), as rows of scalars, or of arrays if q is four arrays."""
    w, x, y, z = q
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


@functools.partial(jax.jit, inline=True)  # a stack has dozens: traced once
def log_so3(r):
    """Return the rotation vector [rad], of length at most π, of a rotation: the inverse of `exp_so3`.

    Values and derivatives are finite at 0 and at π. At exactly π the vector and its negative describe the
    same rotation; one of them is returned, with the derivative of its branch.
    """
    q = quaternion_from_rotation(r)
    w, v = q[0], q[1:]
    squared = v @ v  # sin²(θ/2)
    small = squared < 1e-4
    sine = jnp.sqrt(jnp.where(small, 1.0, squared))
    # Below the threshold 2 asin(s)/s as a series; elsewhere atan2, exact up to θ = π where w = 0.
    series = _series(squared, 2.0, 1 / 3, 3 / 20, 5 / 56, 35 / 576)
    return jnp.where(small, series, 2 * jnp.arctan2(sine, jnp.where(small, 1.0, w)) / sine) * v


def log_quaternion(w, v):
    """Return the rotation vector [rad], of length at most π, of a unit quaternion with w ≥ 0; smooth, without a branch.

    From y = tan²(θ/8) ≤ 0.172, where the series of atan(√y)/√y is short: a third of the time of `log_so3`.
    """
    up = 1.0 / (1.0 + w)
    x = (v @ v) * up * up  # tan²(θ/4)
    upper = 1.0 / (1.0 + jnp.sqrt(1.0 + x))
    y = x * upper * upper
    terms = 10 if jnp.finfo(jnp.result_type(y)).bits <= 32 else 22
    return 8 * up * upper * _series(y, *((-1) ** k / (2 * k + 1) for k in range(terms))) * v


def quaternion(v):
    """Return the unit quaternion, w and (x, y, z), of rotation vectors (..., 3), finite with all derivatives at 0."""
    xp = library(v)
    squared = 0.25 * xp.sum(v * v, axis=-1)
    small = squared < 1e-4
    safe = xp.where(small, 1.0, squared)
    half = xp.sqrt(safe)
    cosine = 1 - squared / 2 * (1 - squared / 12 * (1 - squared / 30))
    sine = 1 - squared / 6 * (1 - squared / 20 * (1 - squared / 42))
    return xp.where(small, cosine, xp.cos(half)), 0.5 * xp.where(small, sine, xp.sin(half) / half)[..., None] * v
