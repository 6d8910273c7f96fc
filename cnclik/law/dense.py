"""Small dense linear algebra in component form: what a task of 1 to 6 rows needs, without a branch.

A matrix is a tuple of rows, each a tuple of scalars. Loops over its size are unrolled; every operation is
then one instruction on a whole row of lanes.
"""

import functools

import jax
import jax.numpy as jnp
from jax import lax

from cnclik.hints import on_cpu, opaque
from cnclik.robot import spatial as sp


@opaque
def gram(rows, shift):
    """Lower triangle of J Jᵀ + shift·I: row i has i + 1 entries."""
    return tuple(
        tuple(sp.add(sp.dot(rows[i], rows[j]), shift if i == j else 0.0) for j in range(i + 1))
        for i in range(len(rows))
    )


def _eliminate(entries, left):
    """Column j of L D Lᵀ from its entries i = j … m−1 and, of each column k < j, (L[j…, k], dₖ)."""
    products = [column[0] * pivot for column, pivot in left]
    reduced = [
        sp.sub(entry, sp.total(column[i] * v for (column, _), v in zip(left, products, strict=True)))
        for i, entry in enumerate(entries)
    ]
    inverse = 1.0 / reduced[0]
    return reduced[0], inverse, tuple(x * inverse for x in reduced[1:])


@opaque
def ldl(lower):
    """Factor a symmetric positive definite matrix given by its lower triangle: (columns of L, 1/d, d)."""
    m = len(lower)
    columns, pivots, inverses = [], [], []
    for j in range(m):
        left = tuple((columns[k][j - k - 1 :], pivots[k]) for k in range(j))
        pivot, inverse, column = _eliminate(tuple(lower[i][j] for i in range(j, m)), left)
        columns.append(column)
        pivots.append(pivot)
        inverses.append(inverse)
    return tuple(columns), tuple(inverses), tuple(pivots)


@opaque
def ldl_solve(factor, b):
    """Solution x of L D Lᵀ x = b."""
    columns, inverses, _ = factor
    x = list(b)
    m = len(x)
    for j in range(m):
        for i in range(j + 1, m):
            x[i] = sp.sub(x[i], sp.mul(columns[j][i - j - 1], x[j]))
    x = [sp.mul(inverses[i], x[i]) for i in range(m)]
    for j in reversed(range(m)):
        for i in range(j + 1, m):
            x[j] = sp.sub(x[j], sp.mul(columns[j][i - j - 1], x[i]))
    return tuple(x)


@opaque
def inverse_trace(factor):
    """Trace of (L D Lᵀ)⁻¹ = Σᵢⱼ (L⁻¹)ᵢⱼ² / dᵢ."""
    columns, inverses, _ = factor
    m = len(inverses)
    out = []
    for j in range(m):  # column j of L⁻¹
        x = {j: 1.0}
        for i in range(j + 1, m):
            x[i] = sp.sub(0.0, sp.total(sp.mul(columns[k][i - k - 1], x[k]) for k in range(j, i)))
        out += [sp.mul(sp.mul(x[i], x[i]), inverses[i]) for i in x]
    return sp.total(out)


@opaque
def solve(matrix, b):
    """Solution x of A x = b for any square A, by elimination with partial pivoting."""
    n = len(b)
    rows = [[*row, right] for row, right in zip(matrix, b, strict=True)]
    for j in range(n):
        for i in range(j + 1, n):  # the row with the largest entry in column j rises to place j
            larger = jnp.abs(rows[i][j]) > jnp.abs(rows[j][j])
            above = [jnp.where(larger, x, y) for x, y in zip(rows[i][j:], rows[j][j:], strict=True)]
            below = [jnp.where(larger, y, x) for x, y in zip(rows[i][j:], rows[j][j:], strict=True)]
            rows[j][j:], rows[i][j:] = above, below
        inverse = 1.0 / rows[j][j]
        for i in range(j + 1, n):
            factor = rows[i][j] * inverse
            rows[i][j + 1 :] = [x - factor * y for x, y in zip(rows[i][j + 1 :], rows[j][j + 1 :], strict=True)]
        rows[j] = [*rows[j][: j + 1], *(x * inverse for x in rows[j][j + 1 :])]
    x = [row[n] for row in rows]
    for i in reversed(range(n)):
        x[i] = sp.sub(x[i], sp.total(rows[i][j] * x[j] for j in range(i + 1, n)))
    return tuple(x)


# Sweeps of cyclic Jacobi after which m rows are orthogonal to rounding (m = 2 needs exactly one rotation).
_SWEEPS = (0, 0, 1, 6, 7, 8, 9)


def orthogonal_rows(rows):
    """One-sided Jacobi: U and W with J = U W, U orthogonal and the rows of W orthogonal (Hestenes 1958).

    The norms of W's rows are the singular values of J, small ones to high relative accuracy. Made for one
    matrix of m ≤ 6 rows per lane. Do not differentiate through it: at equal singular values U is arbitrary.
    """
    m, n = len(rows), len(rows[0])
    like = sp.total(x for row in rows for x in row)
    eye = tuple(tuple(jnp.full_like(like, float(i == j)) for j in range(m)) for i in range(m))
    rows = tuple(tuple(x + jnp.zeros_like(like) for x in row) for row in rows)
    if m == 1:
        return eye, rows

    def sweep(carry, _):
        # Each row of W carries its row of Uᵀ behind it, so that one rotation turns both.
        both = list(carry)
        for p in range(m):
            for r in range(p + 1, m):
                both[p], both[r] = _rotate(both[p], both[r], n)
        return tuple(both), None

    both = tuple(w + u for w, u in zip(rows, eye, strict=True))
    both, _ = lax.scan(sweep, both, None, length=_SWEEPS[m])
    return sp.transpose(tuple(row[n:] for row in both)), tuple(row[:n] for row in both)


def _rotate(a, b, n):
    """Turn two rows so that their first n entries become orthogonal."""
    aa, bb, ab = sp.dot(a[:n], a[:n]), sp.dot(b[:n], b[:n]), sp.dot(a[:n], b[:n])
    gap = bb - aa
    radius = jnp.abs(gap) + jnp.sqrt(gap * gap + 4.0 * ab * ab)
    none = radius == 0
    tangent = jnp.where(none, 0.0, 2.0 * ab * jnp.where(gap < 0, -1.0, 1.0) / jnp.where(none, 1.0, radius))
    cosine = 1.0 / jnp.sqrt(1.0 + tangent * tangent)
    sine = cosine * tangent
    return (
        tuple(cosine * x - sine * y for x, y in zip(a, b, strict=True)),
        tuple(sine * x + cosine * y for x, y in zip(a, b, strict=True)),
    )


def pinv(rows):
    """Moore-Penrose pseudoinverse J# (n rows of m scalars) and the least singular value (see below).

    Well conditioned, it is Jᵀ (J Jᵀ)⁻¹, refined; the singular value is then an estimate, from below and within √m.
    Else, and for one or two rows, J# = Σ wᵢ uᵢᵀ/σᵢ² over the singular values above max(m, n)·10·eps·σ_max, as
    numpy.linalg.pinv truncates, so a rank-deficient J is included. Its derivative is taken from the closed form (Golub
    & Pereyra 1973, eq. 4.12) and not through a decomposition:

      dJ# = −J# dJ J# + J# J#ᵀ dJᵀ (I − J J#) + (I − J# J) dJᵀ J#ᵀ J#,

    right wherever the rank is locally constant, and finite everywhere. The least singular value carries no
    derivative.
    """
    if len(rows) > len(rows[0]):
        inverse, least = pinv(sp.transpose(rows))
        return sp.transpose(inverse), least
    like = sp.total(x for row in rows for x in row)
    return _pinv(tuple(tuple(x + jnp.zeros_like(like) for x in row) for row in rows))


@jax.custom_jvp
def _pinv(rows):
    return _pinv_value(rows)


@opaque
def _pinv_value(rows):
    if len(rows) <= 2 or not on_cpu():  # two rows need one rotation; a GPU's kernel has no loop of unknown length
        return _pinv_by_rotations(rows)
    quick, least, trusted = _pinv_by_elimination(rows)
    # Where rows are nearly dependent, a lane carries J into the loop in the place of J# (cf. `robot.trig`): the loop
    # runs once if some lane needs it, else not at all, and no lane's result depends on its neighbours.
    state = tuple(
        tuple(jnp.where(trusted, x, y) for x, y in zip(*pair, strict=True))
        for pair in zip(quick, sp.transpose(rows), strict=True)
    )

    def rotate(carry):
        _, state, least = carry
        slow, exact = _pinv_by_rotations(sp.transpose(state))
        choose = functools.partial(jnp.where, trusted)
        state = tuple(tuple(map(choose, a, b)) for a, b in zip(state, slow, strict=True))
        return jnp.zeros_like(trusted), state, choose(least, exact)

    _, state, least = lax.while_loop(lambda carry: jnp.any(carry[0]), rotate, (~trusted, state, least))
    return state, least


def _pinv_by_elimination(rows):
    """Jᵀ (J Jᵀ)⁻¹ =: P once refined, the least singular value from below within √m, and whether to trust them.

    P (2I − J P) squares what is left of I − J P, of the size eps·κ²: in the end as good as any, eps·κ, while
    κ³ < 1/eps. κ² ≤ tr(J Jᵀ) tr((J Jᵀ)⁻¹) tells; a singular J makes that infinite or NaN.
    """
    columns = sp.transpose(rows)
    factor = ldl(gram(rows, 0.0))
    size, inverse = sp.total(sp.dot(row, row) for row in rows), inverse_trace(factor)
    first = tuple(ldl_solve(factor, column) for column in columns)
    definite = functools.reduce(jnp.minimum, factor[2]) > 0
    trusted = definite & (size * inverse <= jnp.finfo(size.dtype).eps ** (-2 / 3))
    return _refined(rows, first), 1.0 / jnp.sqrt(jnp.where(definite, inverse, 1.0)), trusted


@opaque
def _refined(rows, p):
    product = sp.matmul(rows, p)
    eye = ((float(i == j) for j in range(len(rows))) for i in range(len(rows)))
    left = tuple(tuple(2.0 * e - x for e, x in zip(*pair, strict=True)) for pair in zip(eye, product, strict=True))
    return sp.matmul(p, left)


def _pinv_by_rotations(rows):
    u, w = orthogonal_rows(rows)
    squares = [sp.dot(row, row) for row in w]
    largest, least = functools.reduce(jnp.maximum, squares), functools.reduce(jnp.minimum, squares)
    tiny = 10 * max(len(rows), len(rows[0])) * jnp.finfo(largest.dtype).eps
    keep = [s > tiny * tiny * largest for s in squares]
    inverses = [jnp.where(k, 1.0, 0.0) / jnp.where(k, s, 1.0) for k, s in zip(keep, squares, strict=True)]
    scaled = tuple(sp.scale(i, row) for i, row in zip(inverses, w, strict=True))  # m rows of n
    return sp.matmul(sp.transpose(scaled), sp.transpose(u)), jnp.sqrt(least)


@_pinv.defjvp
def _pinv_jvp(primals, tangents):
    (j,), (dj,) = primals, tangents
    p, least = _pinv(j)
    return (p, least), (_pinv_tangent(j, dj, p), jnp.zeros_like(least))


@opaque
def _pinv_tangent(j, dj, p):
    pt, djt = sp.transpose(p), sp.transpose(dj)
    y = sp.matmul(p, pt)  # n×n
    dj_p = sp.matmul(dj, p)  # m×m
    pt_p = sp.matmul(pt, p)  # m×m
    first = sp.matmul(p, dj_p)
    # (I − J J#) from the right and (I − J# J) from the left, without forming the projections.
    y_djt = sp.matmul(y, djt)
    second = _minus(y_djt, sp.matmul(sp.matmul(y_djt, j), p))
    djt_pt_p = sp.matmul(djt, pt_p)
    third = _minus(djt_pt_p, sp.matmul(p, sp.matmul(j, djt_pt_p)))
    return tuple(
        tuple(b + c - a for a, b, c in zip(*rows, strict=True)) for rows in zip(first, second, third, strict=True)
    )


def _minus(a, b):
    return tuple(sp.vsub(x, y) for x, y in zip(a, b, strict=True))
