"""Small dense linear algebra: what a task of 1 to 6 rows needs.

Unrolled, a matrix is a tuple of rows, each a tuple of scalars, loops over its size are written out, without a branch,
and every operation is one instruction on a whole row of lanes. Rolled, it is an array, and the library does the work.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.scipy.linalg import cho_solve, solve_triangular

from cnclik.hints import on_cpu, opaque
from cnclik.robot import spatial as sp


@opaque
def gram(rows, shift):
    """Lower triangle of J Jᵀ + shift·I: row i has i + 1 entries; rolled, the whole matrix."""
    if not sp.unrolled(rows):
        return shifted(sp.products(rows, rows), shift)
    return tuple(
        tuple(sp.add(sp.dot(rows[i], rows[j]), shift if i == j else 0.0) for j in range(i + 1))
        for i in range(len(rows))
    )


def trace(lower):
    """Trace of a matrix given as `gram` gives it."""
    return sp.total(row[-1] for row in lower) if sp.unrolled(lower) else jnp.trace(lower)


def shifted(lower, shift):
    """The same with shift·I added."""
    if not sp.unrolled(lower):
        return lower + shift * jnp.eye(len(lower), dtype=lower.dtype)
    return tuple((*row[:-1], sp.add(row[-1], shift)) for row in lower)


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
    if not sp.unrolled(lower):
        root = jnp.linalg.cholesky(lower, symmetrize_input=False)  # L √D
        pivots = jnp.diagonal(root) ** 2
        return root, 1.0 / pivots, pivots
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
    """Solution x of L D Lᵀ x = b: of a vector, or, from the rows of a matrix, the rows of one."""
    columns, inverses, _ = factor
    if not sp.unrolled(columns):
        return cho_solve((columns, True), b)
    x = list(b)
    m = len(x)
    for j in range(m):
        for i in range(j + 1, m):
            x[i] = sp.vsub(x[i], sp.scale(columns[j][i - j - 1], x[j]))
    x = [sp.scale(inverses[i], x[i]) for i in range(m)]
    for j in reversed(range(m)):
        for i in range(j + 1, m):
            x[j] = sp.vsub(x[j], sp.scale(columns[j][i - j - 1], x[i]))
    return tuple(x)


def packed_factor(factor):
    """L and 1/d of L D Lᵀ as one vector (m(m+1)/2,): row i of L, then its 1/dᵢ."""
    columns, inverses, pivots = factor
    if sp.unrolled(columns):
        m = len(inverses)
        return tuple(inverses[i] if i == j else columns[j][i - j - 1] for i in range(m) for j in range(i + 1))
    lower = columns / jnp.sqrt(pivots)
    return jnp.where(jnp.eye(len(pivots), dtype=bool), jnp.diag(inverses), lower)[np.tril_indices(len(pivots))]


def packed_solve(packed, b):
    """Solution x of L D Lᵀ x = b (m,), from `packed_factor`."""
    m = len(b)
    if sp.unrolled(packed):
        at = {place: x for place, x in zip(zip(*np.tril_indices(m), strict=True), packed, strict=True)}
        columns = tuple(tuple(at[i, j] for i in range(j + 1, m)) for j in range(m))
        return ldl_solve((columns, tuple(at[i, i] for i in range(m)), None), b)
    lower = jnp.zeros((m, m), packed.dtype).at[np.tril_indices(m)].set(packed)
    unit = functools.partial(solve_triangular, lower, lower=True, unit_diagonal=True)
    return unit(jnp.diagonal(lower) * unit(b), trans=1)


@opaque
def inverse_trace(factor):
    """Trace of (L D Lᵀ)⁻¹ = Σᵢⱼ (L⁻¹)ᵢⱼ² / dᵢ."""
    columns, inverses, _ = factor
    if not sp.unrolled(columns):
        trace = sp.squares(solve_triangular(columns, jnp.eye(len(columns), dtype=columns.dtype), lower=True))
        return jnp.where(trace > 0, trace, jnp.inf)  # NaN: not positive definite
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
    if not sp.unrolled(b):
        return jnp.linalg.solve(matrix, b)
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
    if not sp.unrolled(rows):
        u, sigma, vt = jnp.linalg.svd(rows, full_matrices=False)
        return u, sigma[:, None] * vt
    m, n = len(rows), len(rows[0])
    rows, zero = _filled(rows)
    eye = tuple(tuple(zero + float(i == j) for j in range(m)) for i in range(m))
    if m == 1:
        return eye, rows

    pairs, moved = _round(m)

    def turn(carry, _):
        # Each row of W carries its row of Uᵀ behind it, so that one rotation turns both.
        both = list(carry)
        for p, r in pairs:
            both[p], both[r] = _rotate(both[p], both[r], n)
        return tuple(both[i] for i in moved), None

    both = tuple(w + u for w, u in zip(rows, eye, strict=True))
    both, _ = lax.scan(turn, both, None, length=_SWEEPS[m] * _rounds(m))
    return sp.transpose(tuple(row[n:] for row in both)), tuple(row[:n] for row in both)


def _rounds(m) -> int:
    """Rounds in which each of m rows meets every other once."""
    return m - 1 + m % 2


def _round(m):
    """Who meets whom in a round of a tournament of m, and who sits where in the next: a round's code is a sweep's.

    The first m, or m − 1 where m is even, go round the table; who has nobody opposite meets the last, who stays.
    """
    table = _rounds(m)
    pairs = [(i, table - 1 - i) for i in range(table // 2)] + [(table // 2, m - 1)] * (m > table)
    return pairs, [(i + 1) % table for i in range(table)] + [m - 1] * (m > table)


def _filled(rows):
    """The rows with no literal left, and a 0 of their kind."""
    zero = jnp.zeros_like(sp.total(x for row in rows for x in row))
    return tuple(tuple(x + zero for x in row) for row in rows), zero


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


@opaque
def least_squared(rows):
    """σ_min² of J as the Rayleigh quotient ‖Jᵀu‖², u its left singular vector.

    With u held, the derivative uᵀ d(J Jᵀ) u is that of a simple singular value, and finite at any.
    """
    held = lax.stop_gradient(rows)
    if not sp.unrolled(rows):
        u = jnp.linalg.eigh(held @ held.T)[1][:, 0]  # its rounding enters ‖Jᵀu‖ squared
    else:
        left, turned = orthogonal_rows(held)
        columns = sp.transpose(left)
        u, least = columns[0], sp.dot(turned[0], turned[0])
        for column, row in zip(columns[1:], turned[1:], strict=True):
            squared = sp.dot(row, row)
            u = sp.each(functools.partial(jnp.where, squared < least), column, u)
            least = jnp.minimum(least, squared)
    back = sp.combine(u, rows)
    return sp.dot(back, back)


def pinv(rows):
    """Moore-Penrose pseudoinverse, as the m rows of its transpose, and the least singular value.

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
    return _pinv(_filled(rows)[0] if sp.unrolled(rows) else rows)


@jax.custom_jvp
def _pinv(rows):
    return _pinv_value(rows)


@opaque
def _pinv_value(rows):
    if len(rows) <= 2 or not on_cpu():  # two rows need one rotation; a GPU's kernel has no loop of unknown length
        return _pinv_by_rotations(rows)
    quick, least, trusted = _pinv_by_elimination(rows)

    def choose(a, b):
        return sp.each(lambda x, y: sp.each(functools.partial(jnp.where, trusted), x, y), a, b)

    # Where rows are nearly dependent, a lane carries J into the loop in the place of J# (cf. `robot.trig`): the loop
    # runs once if some lane needs it, else not at all, and no lane's result depends on its neighbours.
    def rotate(carry):
        _, state, least = carry
        slow, exact = _pinv_by_rotations(state)
        return jnp.zeros_like(trusted), choose(state, slow), jnp.where(trusted, least, exact)

    start = ~trusted, choose(quick, rows), least
    _, state, least = lax.while_loop(lambda carry: jnp.any(carry[0]), rotate, start)
    return state, least


def _pinv_by_elimination(rows):
    """Jᵀ (J Jᵀ)⁻¹ =: P once refined, the least singular value from below within √m, and whether to trust them.

    P (2I − J P) squares what is left of I − J P, of the size eps·κ²: in the end as good as any, eps·κ, while
    κ³ < 1/eps. κ² ≤ tr(J Jᵀ) tr((J Jᵀ)⁻¹) tells; a singular J makes that infinite or NaN.
    """
    factor = ldl(gram(rows, 0.0))
    size, inverse = sp.squares(rows), inverse_trace(factor)
    if sp.unrolled(rows):
        first = sp.transpose(tuple(ldl_solve(factor, column) for column in sp.transpose(rows)))
    else:
        first = ldl_solve(factor, rows)
    definite = sp.smallest(factor[2]) > 0
    trusted = definite & (size * inverse <= jnp.finfo(size.dtype).eps ** (-2 / 3))
    return _refined(rows, first), 1.0 / jnp.sqrt(jnp.where(definite, inverse, 1.0)), trusted


@opaque
def _refined(rows, p):
    product = sp.products(p, rows)
    if not sp.unrolled(rows):
        return 2.0 * p - sp.matmul(product, p)
    left = [[2.0 * (i == k) - x for i, x in enumerate(row)] for k, row in enumerate(product)]
    return sp.matmul(left, p)


def _pinv_by_rotations(rows):
    u, w = orthogonal_rows(rows)
    if sp.unrolled(rows):
        squares = tuple(sp.dot(row, row) for row in w)
        largest = functools.reduce(jnp.maximum, squares)
    else:
        squares = jnp.sum(w * w, axis=1)
        largest = jnp.max(squares)
    tiny = 10 * max(len(rows), len(rows[0])) * jnp.finfo(largest.dtype).eps

    def inverse(s):
        keep = s > tiny * tiny * largest
        return jnp.where(keep, 1.0, 0.0) / jnp.where(keep, s, 1.0)

    scaled = sp.transpose(sp.rescale(sp.transpose(w), sp.each(inverse, squares)))
    return sp.matmul(u, scaled), jnp.sqrt(sp.smallest(squares))


@_pinv.defjvp
def _pinv_jvp(primals, tangents):
    (j,), (dj,) = primals, tangents
    p, least = _pinv(j)
    return (p, least), (_pinv_tangent(j, dj, p), jnp.zeros_like(least))


@opaque
def _pinv_tangent(j, dj, p):
    """The closed form of `pinv`, transposed, with nothing larger than m×m and m vectors over the joints.

    With P = J#, A = dJ P, G = J P, S = Pᵀ P and T = dJᵀ S: dP = T + P (Aᵀ − Aᵀ G − A − J T).
    """
    a, g, t = sp.products(dj, p), sp.products(j, p), sp.matmul(sp.products(p, p), dj)  # t holds the rows of Tᵀ
    at, back = sp.transpose(a), sp.products(j, t)
    inner = functools.reduce(functools.partial(sp.each, sp.vsub), (at, sp.matmul(at, g), a, back))
    return sp.each(sp.vadd, t, sp.matmul(sp.transpose(inner), p))
