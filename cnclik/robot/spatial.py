"""Vectors and matrices in two forms, and rotations.

A vector is a tuple of scalars and a matrix a tuple of rows: the unrolled form. `vmap` turns each scalar into one
contiguous row of lanes, so the same code serves one robot and a million; and a scalar may be a Python number, with
which products with a literal 0 or 1 vanish while the program is traced. Or they are arrays: the rolled form, which
makes small programs (see `robot.rolled`). What is written with the functions here serves both.
"""

import functools
import itertools
import math

import jax.numpy as jnp
import numpy as np
from jax import lax

IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ZERO = (0.0, 0.0, 0.0)


# --- scalars: literals fold ---------------------------------------------------------------------------


def is_number(a) -> bool:
    return type(a) in (float, int)


def mul(a, b):
    if is_number(b) and not is_number(a):
        a, b = b, a
    if is_number(a):
        if a == 0:
            return 0.0
        if a == 1:
            return b
        if a == -1:
            return -b
    return a * b


def add(a, b):
    if is_number(a) and a == 0:
        return b
    if is_number(b) and b == 0:
        return a
    return a + b


def sub(a, b):
    if is_number(a) and a == 0:
        return -b
    if is_number(b) and b == 0:
        return a
    return a - b


def total(terms):
    """Sum of a sequence, of which an empty one is the literal 0, or of an array."""
    return jnp.sum(terms) if hasattr(terms, "dtype") else functools.reduce(add, terms, 0.0)


# --- vectors and matrices in both forms ---------------------------------------------------------------


def unrolled(v) -> bool:
    """Whether a vector or matrix is a tuple."""
    return isinstance(v, (tuple, list))


def each(fn, *vectors):
    """fn of the entries of one or more vectors of one form, entry by entry."""
    if unrolled(vectors[0]):
        return tuple(fn(*entries) for entries in zip(*vectors, strict=True))
    return fn(*vectors)


def parts(fn, *vectors):
    """Several vectors at once: fn of the entries returns a tuple, an entry of each."""
    found = each(fn, *vectors)
    return transpose(found) if unrolled(vectors[0]) else found


def vadd(a, b):
    return each(add, a, b)


def vsub(a, b):
    return each(sub, a, b)


def scale(s, v):
    return each(lambda x: mul(s, x), v)


def dot(a, b):
    return total(each(mul, a, b))


def cross(a, b):
    return (
        sub(mul(a[1], b[2]), mul(a[2], b[1])),
        sub(mul(a[2], b[0]), mul(a[0], b[2])),
        sub(mul(a[0], b[1]), mul(a[1], b[0])),
    )


def transpose(m):
    return tuple(zip(*m, strict=True)) if unrolled(m) else m.T


def matvec(m, v):
    return tuple(dot(row, v) for row in m) if unrolled(m) else _product(m, v)


def matmul(a, b):
    if not unrolled(a):
        return _product(a, b)
    columns = transpose(b)
    return tuple(tuple(dot(row, column) for column in columns) for row in a)


def _product(a, b):
    # A GPU would round to fewer digits otherwise.
    return a @ b if library(a, b) is np else lax.dot(a, b, precision="highest")


def combine(weights, rows):
    """Σ wᵢ rᵢ, the transpose of a matrix times w, or the same of a tuple of vectors in any form."""
    return functools.reduce(vadd, map(scale, weights, rows)) if unrolled(rows) else _product(weights, rows)


def rescale(rows, factors):
    """The matrix with its columns times some factors."""
    return tuple(each(mul, row, factors) for row in rows) if unrolled(rows) else rows * factors


def products(a, b):
    """A Bᵀ, from rows."""
    return tuple(tuple(dot(x, y) for y in b) for x in a) if unrolled(a) else _product(a, b.T)


def squares(rows):
    """Sum of the squares of all entries of a matrix: the trace of A Aᵀ."""
    return total(dot(row, row) for row in rows) if unrolled(rows) else jnp.sum(rows * rows)


def library(*arrays):
    """NumPy, which compiles nothing, where all of some arrays are its own, else JAX's."""
    return np if all(isinstance(v, (np.ndarray, np.generic)) for v in arrays) else jnp


def thin(rows):
    """The matrix, or its transpose, whichever has fewer rows."""
    return rows if len(rows) <= len(rows[0]) else transpose(rows)


def pick(v, indices):
    """Some entries of a vector."""
    if unrolled(v):
        return tuple(v[i] for i in indices)
    indices = tuple(indices)
    in_order = indices == tuple(range(len(indices)))
    return v[: len(indices)] if in_order else library(v).stack([v[i] for i in indices])


def join(a, b):
    """The entries of two vectors, one after the other."""
    if unrolled(a):
        return (*a, *b)
    return library(a, b).concatenate([a, b]) if len(a) else b


def packed(v, dtype=None, axis=0):
    """A vector or matrix in either form as an array, numbers among its entries in the given dtype."""
    if unrolled(v):
        return jnp.stack([packed(x, dtype, axis) for x in v], axis) if len(v) else jnp.zeros(0, dtype)
    return jnp.asarray(v, dtype)


def like(q, values):
    """An array (n,) in the form of q."""
    return tuple(values[i] for i in range(len(q))) if unrolled(q) else values


# --- over the entries of a vector ---------------------------------------------------------------------


def smallest(v):
    return functools.reduce(jnp.minimum, v) if unrolled(v) else jnp.min(v)


def product(v):
    return functools.reduce(mul, v) if unrolled(v) else jnp.prod(v)


def some(v):
    """Whether some entry is true; the literal False where that is known of all."""
    return functools.reduce(_either, v) if unrolled(v) else jnp.any(v)


def _either(a, b):
    return b if a is False else a if b is False else a | b


def first(v):
    """The first true entry alone."""
    if not unrolled(v):
        return v & (jnp.cumsum(v) == 1)
    before = (jnp.zeros_like(v[0]), *itertools.accumulate(v[:-1], jnp.logical_or))
    return tuple(x & ~b for x, b in zip(v, before, strict=True))


def safe_norm(v):
    """‖v‖ with derivative 0 (not NaN) at v = 0."""
    return safe_sqrt(dot(v, v))


def safe_sqrt(x):
    """√x with derivative 0 (not NaN) at x = 0.

    What stands for 0 below the root is a rounding: a compiler may work x out twice, once without rounding a product
    (fused multiply-add), and find 0 only once; with 1 there, a target that rests would then have moved by 1 m.
    """
    zero, least = x == 0, float(jnp.finfo(jnp.result_type(x)).eps) ** 2
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, least, x)))


# --- rotations ----------------------------------------------------------------------------------------


def rotation_about(axis, sine, cosine):
    """Rodrigues' formula for a unit axis: c I + s [a]× + (1 − c) a aᵀ (Murray, Li & Sastry 1994, eq. 2.14).

    Written so that a literal axis along x, y or z leaves only the four entries that move.
    """
    x, y, z = axis

    def diagonal(a):
        square = mul(a, a)
        return add(square, mul(sub(1.0, square), cosine))

    def off(a, b, c, sign):
        product = mul(a, b)
        return add(sub(product, mul(product, cosine)), mul(sign, mul(c, sine)))

    return (
        (diagonal(x), off(x, y, z, -1.0), off(x, z, y, 1.0)),
        (off(x, y, z, 1.0), diagonal(y), off(y, z, x, -1.0)),
        (off(x, z, y, -1.0), off(y, z, x, 1.0), diagonal(z)),
    )


def axial(m):
    """Twice the vector of a 3×3 matrix's antisymmetric part: of a rotation by θ about a, 2 sin θ a."""
    return m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]


def exp_so3(w):
    """Rotation of a rotation vector [rad]: exp([w]×), finite with all derivatives at w = 0."""
    squared = dot(w, w)
    small = squared < 1e-4
    safe = jnp.where(small, 1.0, squared)
    angle = jnp.sqrt(safe)
    a = jnp.where(small, _series(squared, 1, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880), jnp.sin(angle) / angle)
    b = jnp.where(small, _series(squared, 1 / 2, -1 / 24, 1 / 720, -1 / 40320), (1 - jnp.cos(angle)) / safe)
    x, y, z = w
    return (
        (1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y),
        (b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x),
        (b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)),
    )


def _series(x, *coefficients):
    """Horner's rule: c0 + c1 x + c2 x² + ..."""
    out = coefficients[-1]
    for c in coefficients[-2::-1]:
        out = c + x * out
    return out


def quaternion_from_rotation(r):
    """Unit quaternion (w, x, y, z), w ≥ 0, of a rotation.

    The rows of 4 q qᵀ are linear in the entries of R; taking the row with the largest diagonal keeps the
    one square root away from 0, so values and derivatives stay finite everywhere (after Shepperd 1978).
    """
    if unrolled(r):
        rows = _four_qq(r)
        row, largest = rows[0], rows[0][0]
        for k in (1, 2, 3):
            better = rows[k][k] > largest
            row = tuple(jnp.where(better, new, old) for new, old in zip(rows[k], row, strict=True))
            largest = jnp.where(better, rows[k][k], largest)
    else:
        constant, slopes = (part.astype(r.dtype) for part in _FOUR_QQ)
        rows = constant + _product(slopes, r.reshape(9)).reshape(4, 4)
        k = jnp.argmax(jnp.diagonal(rows))
        row, largest = rows[k], rows[k, k]  # not the maximum: where several are largest its derivative is their mean
    factor = 0.5 / jnp.sqrt(largest)
    return scale(jnp.where(row[0] < 0, -factor, factor), row)


def _four_qq(r):
    (a, b, c), (d, e, f), (g, h, i) = r
    return (
        (1 + a + e + i, h - f, c - g, d - b),
        (h - f, 1 + a - e - i, b + d, c + g),
        (c - g, b + d, 1 - a + e - i, f + h),
        (d - b, c + g, f + h, 1 - a - e + i),
    )


def _affine(fn):
    """An affine map of 3×3 matrices as its value at 0 and its matrix: vec fn(R) = vec first + second · vec R."""
    zero = np.array(fn(np.zeros((3, 3))))
    return zero, np.stack([np.array(fn(unit)) - zero for unit in np.eye(9).reshape(9, 3, 3)], -1).reshape(-1, 9)


_FOUR_QQ = _affine(_four_qq)


def rotation_from_quaternion(q):
    """Rotation of a unit quaternion (w, x, y, z)."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def log_so3(r):
    """Rotation vector [rad], of length at most π, of a rotation: the inverse of `exp_so3`.

    Values and derivatives are finite at 0 and at π. At exactly π the vector and its negative describe the
    same rotation; one of them is returned, with the derivative of its branch.
    """
    q = quaternion_from_rotation(r)
    w, v = q[0], q[1:]
    squared = dot(v, v)  # sin²(θ/2)
    small = squared < 1e-4
    safe = jnp.where(small, 1.0, squared)
    sine = jnp.sqrt(safe)
    # Below the threshold 2 asin(s)/s as a series; elsewhere atan2, exact up to θ = π where w = 0.
    series = _series(squared, 2.0, 1 / 3, 3 / 20, 5 / 56, 35 / 576)
    factor = jnp.where(small, series, 2 * jnp.arctan2(sine, jnp.where(small, 1.0, w)) / sine)
    return scale(factor, v)


def log_quaternion(w, v):
    """Rotation vector [rad], of length at most π, of a unit quaternion with w ≥ 0; smooth, without a branch.

    From y = tan²(θ/8) ≤ 0.172, where the series of atan(√y)/√y is short: a third of the time of `log_so3`.
    """
    up = 1.0 / (1.0 + w)
    x = dot(v, v) * up * up  # tan²(θ/4)
    upper = 1.0 / (1.0 + jnp.sqrt(1.0 + x))
    y = x * upper * upper
    terms = 10 if jnp.finfo(jnp.result_type(y)).bits <= 32 else 22
    return scale(8 * up * upper * _series(y, *((-1) ** k / (2 * k + 1) for k in range(terms))), v)


def turn_from(a, b):
    """log(exp(−a) exp(b)) of rotation vectors [rad]: exact relative to their size, however small they are."""
    (wa, va), (wb, vb) = half_turn(a), half_turn(b)
    across = cross(va, vb)
    w = add(wa * wb, dot(va, vb))
    v = vsub(vsub(scale(wa, vb), scale(wb, va)), across if unrolled(a) else packed(across))
    sign = jnp.where(w < 0, -1.0, 1.0).astype(w.dtype)  # the shorter way
    return log_quaternion(sign * w, scale(sign, v))


def half_turn(v):
    """Unit quaternion (w, (x, y, z)) of a rotation vector no longer than 2π [rad], by series without a branch."""
    squared = 0.25 * dot(v, v)
    terms = 9 if jnp.finfo(jnp.result_type(squared)).bits <= 32 else 15
    sine = _series(squared, *((-1) ** k / math.factorial(2 * k + 1) for k in range(terms)))
    cosine = _series(squared, *((-1) ** k / math.factorial(2 * k) for k in range(terms)))
    return cosine, scale(0.5 * sine, v)
