"""3-vectors and rotations in component form.

A vector is a tuple of three scalars, a rotation a tuple of three rows. `vmap` turns each scalar into one
contiguous row of lanes, so the same code serves one robot and a million. A scalar may be a Python number:
products with a literal 0 or 1 then vanish while the program is traced.
"""

import jax.numpy as jnp

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
    """Sum of a sequence; an empty one is the literal 0."""
    out = 0.0
    for term in terms:
        out = add(out, term)
    return out


# --- vectors and matrices of scalars ------------------------------------------------------------------


def dot(a, b):
    return total(mul(x, y) for x, y in zip(a, b, strict=True))


def vadd(a, b):
    return tuple(add(x, y) for x, y in zip(a, b, strict=True))


def vsub(a, b):
    return tuple(sub(x, y) for x, y in zip(a, b, strict=True))


def scale(s, v):
    return tuple(mul(s, x) for x in v)


def cross(a, b):
    return (
        sub(mul(a[1], b[2]), mul(a[2], b[1])),
        sub(mul(a[2], b[0]), mul(a[0], b[2])),
        sub(mul(a[0], b[1]), mul(a[1], b[0])),
    )


def transpose(m):
    return tuple(zip(*m, strict=True))


def matvec(m, v):
    return tuple(dot(row, v) for row in m)


def matmul(a, b):
    columns = transpose(b)
    return tuple(tuple(dot(row, column) for column in columns) for row in a)


def safe_norm(v):
    """‖v‖ with derivative 0 (not NaN) at v = 0."""
    return safe_sqrt(dot(v, v))


def safe_sqrt(x):
    """√x with derivative 0 (not NaN) at x = 0."""
    zero = x == 0
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, x)))


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
    (a, b, c), (d, e, f), (g, h, i) = r
    rows = (
        (1 + a + e + i, h - f, c - g, d - b),
        (h - f, 1 + a - e - i, b + d, c + g),
        (c - g, b + d, 1 - a + e - i, f + h),
        (d - b, c + g, f + h, 1 - a - e + i),
    )
    row, largest = rows[0], rows[0][0]
    for k in (1, 2, 3):
        better = rows[k][k] > largest
        row = tuple(jnp.where(better, new, old) for new, old in zip(rows[k], row, strict=True))
        largest = jnp.where(better, rows[k][k], largest)
    factor = 0.5 / jnp.sqrt(largest)
    factor = jnp.where(row[0] < 0, -factor, factor)
    return tuple(factor * x for x in row)


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
    w, *v = quaternion_from_rotation(r)
    squared = dot(v, v)  # sin²(θ/2)
    small = squared < 1e-4
    safe = jnp.where(small, 1.0, squared)
    sine = jnp.sqrt(safe)
    # Below the threshold 2 asin(s)/s as a series; elsewhere atan2, exact up to θ = π where w = 0.
    series = _series(squared, 2.0, 1 / 3, 3 / 20, 5 / 56, 35 / 576)
    factor = jnp.where(small, series, 2 * jnp.arctan2(sine, jnp.where(small, 1.0, w)) / sine)
    return tuple(factor * x for x in v)
