"""Dense linear algebra for tasks of a few rows."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.scipy.linalg import solve_triangular


def wide_side(rows):
    """The matrix or its transpose, whichever has fewer rows."""
    return rows if len(rows) <= rows.shape[1] else rows.T


def shifted(matrix, shift):
    """A + shift·I, or A + diag(shift); zeros off the diagonal stay literal zeros."""
    return jnp.where(np.eye(len(matrix), dtype=bool), matrix + shift, matrix)


def cholesky_solve(lower, b):
    """Solution x of L Lᵀ x = b: of a vector, or of the columns of a matrix."""
    return triangular(lower, triangular(lower, b), transposed=True)


def factored_solve(lower, product, b):
    """`cholesky_solve`, with the derivative dx = A⁻¹ (db − dA x): one more solve, and none of the factor.

    Args: product: of x: A x, from which the derivative of A is taken.
    """
    lower = lax.stop_gradient(lower)
    return lax.custom_linear_solve(product, b, lambda _, b: cholesky_solve(lower, b), symmetric=True)


@jax.custom_jvp
def between(matrix, lower, a, b):
    """A M⁻¹ Bᵀ with M = L Lᵀ, of rows (k, n), or of one; its derivatives are those of M, and need none of L."""
    return triangular(lower, a.T).T @ triangular(lower, b.T)


@between.defjvp
def _between_jvp(primals, tangents):
    (matrix, lower, a, b), (turned, _, da, db) = primals, tangents
    left, right = (factored_solve(lower, lambda x: matrix @ x, rows.T) for rows in (a, b))
    return between(*primals), da @ right + left.T @ db.T - left.T @ turned @ right


def triangular(lower, b, *, transposed=False):
    """Solve L x = b, or Lᵀ x = b."""
    whole = jnp.where(np.tri(len(lower), dtype=bool), lower, 0.0)

    def solved(transposed):
        return lambda _, b: _substitution(transposed)(whole, b)

    return lax.custom_linear_solve(
        lambda x: (whole.T if transposed else whole) @ x, b, solved(transposed), solved(not transposed)
    )


def inverse_trace(lower):
    """Trace of (L Lᵀ)⁻¹ = Σᵢⱼ (L⁻¹)ᵢⱼ²; infinite without a factor."""
    trace = jnp.sum(triangular(lower, jnp.eye(len(lower), dtype=lower.dtype)) ** 2)
    return jnp.where(trace > 0, trace, jnp.inf)


def _sweeps(m):
    """Cyclic Jacobi sweeps that make m rows orthogonal to rounding; m = 2 needs exactly one rotation."""
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

    # Each row of W is followed by its row of Uᵀ, so that one rotation turns both.
    both = jnp.concatenate([rows, jnp.eye(m, dtype=rows.dtype)], axis=1)
    both, _ = lax.scan(turn, both, None, length=_sweeps(m) * rounds)
    return both[:, n:].T, both[:, :n]


def _round(m):
    """The pairs of a round-robin tournament of m, the seats of the next round, and the number of rounds.

    The first m, or m − 1 if m is even, rotate around the table. One of them has no opponent and plays the last, who
    stays. Seats are listed as winners, losers and all.
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

    With constant u, the derivative uᵀ d(J Jᵀ) u is that of a simple singular value, and finite for any.
    """
    left, turned = orthogonal_rows(lax.stop_gradient(rows))
    squares = jnp.sum(turned**2, axis=1)
    least = jnp.arange(len(squares)) == jnp.argmin(squares)
    back = left @ least.astype(left.dtype) @ rows
    return back @ back


def pinv(rows):
    """Moore-Penrose pseudoinverse, as the m rows of its transpose, and the least singular value.

    For well conditioned J it is Jᵀ (J Jᵀ)⁻¹, refined; the singular value is then a lower estimate, within √m.
    Otherwise, and for one or two rows, J# = Σ wᵢ uᵢᵀ/σᵢ² over the singular values above max(m, n)·10·eps·σ_max, as
    numpy.linalg.pinv truncates, so a rank-deficient J is included. Its derivative is taken from the closed form (Golub
    & Pereyra 1973, eq. 4.12) and not through a decomposition:

      dJ# = −J# dJ J# + J# J#ᵀ dJᵀ (I − J J#) + (I − J# J) dJᵀ J#ᵀ J#,

    exact wherever the rank is locally constant, and finite everywhere. The least singular value carries no
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
    lower, inverse, trusted = _eliminated(rows)
    first = cholesky_solve(lower, rows)
    quick = 2.0 * first - first @ rows.T @ first, 1.0 / jnp.sqrt(inverse)
    return lax.cond(trusted, lambda rows: quick, _pinv_by_rotations, rows)


def _eliminated(rows):
    """The Cholesky factor of J Jᵀ, the trace of (J Jᵀ)⁻¹, and whether to trust them.

    With P = Jᵀ (J Jᵀ)⁻¹ from them, P (2I − J P) squares the error I − J P of size eps·κ². The result is as good as any,
    eps·κ, while κ³ < 1/eps. The test uses κ² ≤ tr(J Jᵀ) tr((J Jᵀ)⁻¹), which is infinite or NaN for a singular J.
    """
    lower = cholesky(rows @ rows.T)
    size, inverse = jnp.sum(rows**2), inverse_trace(lower)
    return lower, inverse, size * inverse <= jnp.finfo(size.dtype).eps ** (-2 / 3)


@jax.custom_jvp
def pinv_applied(rows, columns, t):
    """J# t of `pinv` for at most as many rows as joints, refined with vectors: P t + P (t − J P t).

    Its derivatives use J#'s `columns`, by `pinv`, which are not used otherwise.
    """
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

# LAPACK's batches share the threads of the calling program, and two at the same time may deadlock (jaxlib 0.10.2). So a
# batch is eliminated column by column, all lanes at once; LAPACK handles single matrices.
_WRITTEN_OUT = 8  # columns, at most, that are eliminated without a loop


@jax.custom_jvp
def cholesky(matrix):
    """L of a symmetric positive definite matrix L Lᵀ; NaN if it is not positive definite."""
    return _factored(matrix)


@cholesky.defjvp
def _cholesky_jvp(primals, tangents):
    """L Φ(L⁻¹ dA L⁻ᵀ), Φ the lower triangle with half the diagonal (Murray 2016)."""
    lower, (tangent,) = cholesky(*primals), tangents
    inner = triangular(lower, triangular(lower, 0.5 * (tangent + tangent.T)).T)
    half = np.tri(len(lower)) - 0.5 * np.eye(len(lower))
    return lower, lower @ (half.astype(lower.dtype) * inner)


@jax.custom_batching.custom_vmap
def _factored(matrix):
    return jnp.linalg.cholesky(matrix, symmetrize_input=False)


@_factored.def_vmap
def _factored_batch(_, __, matrices):
    return _factors(matrices), True


@jax.jit  # traced once, though a law has several
def _factors(matrices):
    every = np.arange(matrices.shape[-1])

    def one(matrix):
        def eliminate(rest, i):
            column = jnp.where(every >= i, rest[:, i], 0.0)
            scaled = column / rest[i, i]
            return rest - scaled[:, None] * column, scaled * jnp.sqrt(rest[i, i])

        return lax.scan(eliminate, matrix, every, unroll=len(every) <= _WRITTEN_OUT or 1)[1].T

    return jax.vmap(one)(matrices)


@jax.custom_batching.custom_vmap
def solved(matrix, b):
    """Solution x of A x = b, A symmetric positive definite and b a vector; without derivatives in reverse."""
    return cholesky_solve(cholesky(matrix), b)


@solved.def_vmap
def _solved_batch(_, batched, matrices, b):
    """By elimination, less accurately if A is nearly singular: it compiles in a quarter of the time."""

    def one(matrix, b):
        both = jnp.concatenate([matrix, b[:, None]], axis=1)
        for i in range(len(b)):
            row = both[i] / both[i, i]
            both = jnp.where(np.arange(len(b))[:, None] == i, row, both - both[:, i : i + 1] * row)
        return both[:, -1]

    return jax.vmap(one, [0 if each else None for each in batched])(matrices, b), True


@functools.cache
def _substitution(transposed):
    """The function of (L, b) that solves L x = b, or Lᵀ x = b."""

    @jax.custom_batching.custom_vmap
    def solve(lower, b):
        return solve_triangular(lower, b, lower=True, trans=int(transposed))

    @solve.def_vmap
    def _(size, batched, lower, b):
        every = np.arange(lower.shape[-1])
        if not batched[0]:  # several right sides of one matrix are columns
            wide = jnp.moveaxis(b, 0, -1)
            return jnp.moveaxis(solve(lower, wide.reshape(len(every), -1)).reshape(wide.shape), -1, 0), True

        return eliminated(lower, b, axis=0 if batched[1] else None), True

    @functools.partial(jax.jit, static_argnames="axis")  # traced once, though a law solves tens of times
    def eliminated(lower, b, axis):
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

        return jax.vmap(one, (0, axis))(lower, b)

    return solve
