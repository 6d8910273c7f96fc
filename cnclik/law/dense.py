"""Dense linear algebra for tasks of a few rows."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.scipy.linalg import cho_solve, solve_triangular

from cnclik.engine.tracing import is_read


def wide_side(rows):
    """The matrix, or its transpose, whichever has fewer rows."""
    return rows if len(rows) <= rows.shape[1] else rows.T


def shifted(matrix, shift):
    """A + shift·I, or A + diag(shift); zeros off the diagonal stay literal zeros."""
    return jnp.where(np.eye(len(matrix), dtype=bool), matrix + shift, matrix)


def cholesky(matrix):
    """L of a symmetric positive definite matrix L Lᵀ; NaN where it isn't."""
    return jnp.linalg.cholesky(matrix, symmetrize_input=False) if is_read() else _cholesky(matrix)


def cholesky_solve(lower, b):
    """Solution x of L Lᵀ x = b: of a vector, or of the columns of a matrix."""
    return cho_solve((lower, True), b) if is_read() else triangular(lower, triangular(lower, b), transposed=True)


def solved(matrix, b):
    """Solution x of A x = b, A symmetric positive definite and b a vector; not as good where A is nearly singular.

    By XLA an elimination, which is compiled in half the time of a factor, and calls no LAPACK.
    """
    if is_read():
        return cholesky_solve(cholesky(matrix), b)
    both = jnp.concatenate([matrix, b[:, None]], axis=1)
    for i in range(len(b)):
        row = both[i] / both[i, i]
        both = jnp.where(np.arange(len(b))[:, None] == i, row, both - both[:, i : i + 1] * row)
    return both[:, -1]


def triangular(lower, b, *, transposed=False, unit=False):
    """Solution x of L x = b, or of Lᵀ x = b; `unit`: with ones in place of L's diagonal."""
    if is_read():
        return solve_triangular(lower, b, lower=True, trans=int(transposed), unit_diagonal=unit)
    eye = np.eye(len(lower), dtype=bool)
    whole = jnp.where(np.tri(len(lower), dtype=bool), jnp.where(eye & unit, 1.0, lower), 0.0)

    def solved(transposed):
        return lambda _, b: _substitution(transposed)(whole, b)

    return lax.custom_linear_solve(
        lambda x: (whole.T if transposed else whole) @ x, b, solved(transposed), solved(not transposed)
    )


def packed(lower):
    """Of a Cholesky factor L √D: L below its diagonal of ones and 1/D on it, row by row, as a vector (m(m+1)/2,)."""
    inverse = 1.0 / jnp.diagonal(lower)
    unit = lower * inverse
    return jnp.where(np.eye(len(lower), dtype=bool), inverse * inverse, unit)[np.tril_indices(len(lower))]


def packed_solve(vector, b):
    """`cholesky_solve` with a factor that is `packed`, for a vector: without a root or a division."""
    ends = np.cumsum(np.arange(len(b) + 1))  # row by row: of a scatter into many cells the engine has no C
    both = jnp.stack([jnp.pad(vector[i:j], (0, len(b) - (j - i))) for i, j in itertools.pairwise(ends)])
    half = jnp.diagonal(both) * triangular(both, b, unit=True)
    return triangular(both, half, transposed=True, unit=True)


def inverse_trace(lower):
    """Trace of (L Lᵀ)⁻¹ = Σᵢⱼ (L⁻¹)ᵢⱼ²; infinite where there is no factor."""
    trace = jnp.sum(triangular(lower, jnp.eye(len(lower), dtype=lower.dtype)) ** 2)
    return jnp.where(trace > 0, trace, jnp.inf)


def _sweeps(m):
    """Of cyclic Jacobi, after which m rows are orthogonal to rounding; m = 2 needs exactly one rotation."""
    return (0, 0, 1, 6, 7, 8, 9)[m] if m <= 6 else 8 + m.bit_length()


def orthogonal_rows(rows):
    """One-sided Jacobi: U and W with J = U W, U orthogonal and the rows of W orthogonal (Hestenes 1958).

    The norms of W's rows are the singular values of J, small ones to high relative accuracy. Made for one
    matrix of few rows. Do not differentiate through it: at equal singular values U is arbitrary.
    """
    m, n = rows.shape
    if m == 1:
        return jnp.ones((1, 1), rows.dtype), rows
    one, other, order, rounds = _round(m)

    def turn(both, _):
        a, b = both[one], both[other]
        aa, bb, ab = (jnp.sum(x[:, :n] * y[:, :n], axis=1, keepdims=True) for x, y in ((a, a), (b, b), (a, b)))
        gap = bb - aa
        radius = jnp.abs(gap) + jnp.sqrt(gap * gap + 4.0 * ab * ab)
        none = radius == 0
        tangent = jnp.where(none, 0.0, 2.0 * ab * jnp.where(gap < 0, -1.0, 1.0) / jnp.where(none, 1.0, radius))
        cosine = 1.0 / jnp.sqrt(1.0 + tangent * tangent)
        sine = cosine * tangent
        return jnp.concatenate([cosine * a - sine * b, sine * a + cosine * b, both])[order], None

    # Each row of W carries its row of Uᵀ behind it, so that one rotation turns both.
    both = jnp.concatenate([rows, jnp.eye(m, dtype=rows.dtype)], axis=1)
    both, _ = lax.scan(turn, both, None, length=_sweeps(m) * rounds)
    return both[:, n:].T, both[:, :n]


def _round(m):
    """The pairs of a round-robin tournament of m, the seats of the next round, and the number of rounds.

    The first m, or m − 1 where m is even, go round the table; who has nobody opposite meets the last, who stays. Places
    are those of the winners, the losers and all, one after the other.
    """
    table = m - 1 + m % 2
    pairs = [(i, table - 1 - i) for i in range(table // 2)] + [(table // 2, m - 1)] * (m > table)
    one, other = np.array(pairs, int).reshape(-1, 2).T
    place = np.arange(m) + 2 * len(pairs)
    place[one], place[other] = np.arange(len(pairs)), np.arange(len(pairs)) + len(pairs)
    moved = [(i + 1) % table for i in range(table)] + [m - 1] * (m > table)
    return one, other, place[moved], table


def least_squared(rows):
    """σ_min² of J as the Rayleigh quotient ‖Jᵀu‖², u its left singular vector.

    With u held, the derivative uᵀ d(J Jᵀ) u is that of a simple singular value, and finite at any.
    """
    left, turned = orthogonal_rows(lax.stop_gradient(rows))
    squares = jnp.sum(turned**2, axis=1)
    least = jnp.arange(len(squares)) == jnp.argmin(squares)
    back = left @ least.astype(left.dtype) @ rows
    return back @ back


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
    if len(rows) > rows.shape[1]:
        inverse, least = pinv(rows.T)
        return inverse.T, least
    return _pinv(rows)


@jax.custom_jvp
def _pinv(rows):
    if len(rows) <= 2:  # one rotation suffices
        return _pinv_by_rotations(rows)
    quick, least, trusted = _pinv_by_elimination(rows)
    return lax.cond(trusted, lambda rows: (quick, least), _pinv_by_rotations, rows)


def _pinv_by_elimination(rows):
    """Jᵀ (J Jᵀ)⁻¹ =: P once refined, the least singular value from below within √m, and whether to trust them.

    P (2I − J P) squares what is left of I − J P, of the size eps·κ²: in the end as good as any, eps·κ, while
    κ³ < 1/eps. κ² ≤ tr(J Jᵀ) tr((J Jᵀ)⁻¹) tells; a singular J makes that infinite or NaN.
    """
    lower, inverse, trusted = _eliminated(rows)
    first = cholesky_solve(lower, rows)
    return 2.0 * first - first @ rows.T @ first, 1.0 / jnp.sqrt(inverse), trusted


def _eliminated(rows):
    """The Cholesky factor of J Jᵀ, the trace of (J Jᵀ)⁻¹, and whether to trust them."""
    lower = cholesky(rows @ rows.T)
    size, inverse = jnp.sum(rows**2), inverse_trace(lower)
    return lower, inverse, size * inverse <= jnp.finfo(size.dtype).eps ** (-2 / 3)


@jax.custom_jvp
def pinv_applied(rows, columns, t):
    """J# t of `pinv` for no more rows than joints, refined with vectors: P t + P (t − J P t). Its derivatives are made
    of J#'s `columns`, by `pinv`, which else are not looked at."""
    if len(rows) <= 2:
        return t @ _pinv(rows)[0]
    lower, _, trusted = _eliminated(rows)

    def quick(rows, t):
        first = cholesky_solve(lower, t) @ rows
        return first + cholesky_solve(lower, t - rows @ first) @ rows

    return lax.cond(trusted, quick, lambda rows, t: t @ _pinv_by_rotations(rows)[0], rows, t)


@pinv_applied.defjvp
def _pinv_applied_jvp(primals, tangents):
    return jax.jvp(lambda columns, t: t @ columns, primals[1:], tangents[1:])


def _pinv_by_rotations(rows):
    u, w = orthogonal_rows(rows)
    squares = jnp.sum(w**2, axis=1)
    largest = jnp.max(squares)
    tiny = 10 * max(rows.shape) * jnp.finfo(largest.dtype).eps
    keep = squares > tiny * tiny * largest
    inverses = jnp.where(keep, 1.0, 0.0) / jnp.where(keep, squares, 1.0)
    return (u * inverses) @ w, jnp.sqrt(jnp.min(squares))


@_pinv.defjvp
def _pinv_jvp(primals, tangents):
    """The closed form of `pinv`, transposed, with nothing larger than m×m and m vectors over the joints.

    With P = J#, A = dJ P, G = J P, S = Pᵀ P and T = dJᵀ S: dP = T + P (Aᵀ − Aᵀ G − A − J T).
    """
    (j,), (dj,) = primals, tangents
    p, least = _pinv(j)
    a, g, t = dj @ p.T, j @ p.T, p @ p.T @ dj  # t holds the rows of Tᵀ
    inner = a.T - a.T @ g - a - j @ t.T
    return (p, least), (t + inner.T @ p, jnp.zeros_like(least))


# --- without LAPACK -----------------------------------------------------------------------------------

# LAPACK's batches share the threads of the program that calls them, and where two are under way they may wait for each
# other for good (jaxlib 0.10.2). So a batch is eliminated column by column, all lanes at once; one matrix is LAPACK's.
_WRITTEN_OUT = 8  # columns up to which that is no loop


@jax.custom_jvp
def _cholesky(matrix):
    return _factored(matrix)


@_cholesky.defjvp
def _cholesky_jvp(primals, tangents):
    """L Φ(L⁻¹ dA L⁻ᵀ), Φ the lower triangle with half the diagonal (Murray 2016)."""
    lower, (tangent,) = _cholesky(*primals), tangents
    inner = triangular(lower, triangular(lower, 0.5 * (tangent + tangent.T)).T)
    half = np.tri(len(lower)) - 0.5 * np.eye(len(lower))
    return lower, lower @ (half.astype(lower.dtype) * inner)


@jax.custom_batching.custom_vmap
def _factored(matrix):
    return jnp.linalg.cholesky(matrix, symmetrize_input=False)


@_factored.def_vmap
def _factored_batch(_, __, matrices):
    every = np.arange(matrices.shape[-1])

    def one(matrix):
        def eliminate(rest, i):
            column = jnp.where(every >= i, rest[:, i], 0.0)
            scaled = column / rest[i, i]
            return rest - scaled[:, None] * column, scaled * jnp.sqrt(rest[i, i])

        return lax.scan(eliminate, matrix, every, unroll=len(every) <= _WRITTEN_OUT or 1)[1].T

    return jax.vmap(one)(matrices), True


@functools.cache
def _substitution(transposed):
    """The function of (L, b) that solves L x = b, or Lᵀ x = b."""

    @jax.custom_batching.custom_vmap
    def solve(lower, b):
        return solve_triangular(lower, b, lower=True, trans=int(transposed))

    @solve.def_vmap
    def _(size, batched, lower, b):
        every = np.arange(lower.shape[-1])

        def one(lower, b):
            def eliminate(rest, row):
                i, column = row
                found = rest[i] / column[i]
                left = every < i if transposed else every > i
                return rest - jnp.multiply.outer(jnp.where(left, column, 0.0), found), found

            rows = lower if transposed else lower.T
            short = len(every) <= _WRITTEN_OUT
            return lax.scan(eliminate, b, (every, rows), reverse=transposed, unroll=short or 1)[1]

        return jax.vmap(one, [0 if b else None for b in batched])(lower, b), True

    return solve
