"""Dense linear algebra for tasks of a few rows."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.scipy.linalg import solve_triangular

from cnclik.engine.tracing import is_read


def shifted(matrix, shift):
    """Return A + shift·I, or A + diag(shift); zeros off the diagonal stay literal zeros."""
    return jnp.where(np.eye(len(matrix), dtype=bool), matrix + shift, matrix)


def cholesky_solve(lower, b):
    """Solve L Lᵀ x = b: for a vector, or of the columns of a matrix."""
    return triangular(lower, triangular(lower, b), transposed=True)


def factored_solve(lower, product, b):
    """Solve L Lᵀ x = b, with the derivative dx = A⁻¹ (db − dA x): one more solve, and none of the factor.

    Args: product: of x: A x, from which the derivative of A is taken.
    """
    lower = lax.stop_gradient(lower)
    return lax.custom_linear_solve(product, b, lambda _, b: cholesky_solve(lower, b), symmetric=True)


@functools.partial(jax.jit, static_argnames="transposed", inline=True)  # its derivatives are traced once, too
def triangular(lower, b, *, transposed=False):
    """Solve L x = b, or Lᵀ x = b."""
    whole = jnp.where(np.tri(len(lower), dtype=bool), lower, 0.0)

    def solved(transposed):
        return lambda _, b: _substitution(transposed)(whole, b)

    return lax.custom_linear_solve(
        lambda x: (whole.T if transposed else whole) @ x, b, solved(transposed), solved(not transposed)
    )


@functools.partial(jax.jit, inline=True)
def inverse_trace(lower):
    """Return the trace of (L Lᵀ)⁻¹ = Σᵢⱼ (L⁻¹)ᵢⱼ²; infinite without a factor."""
    trace = jnp.sum(triangular(lower, jnp.eye(len(lower), dtype=lower.dtype)) ** 2)
    return jnp.where(trace > 0, trace, jnp.inf)


# --- without LAPACK -----------------------------------------------------------------------------------

# LAPACK's batches share the threads of the calling program, and two at the same time may deadlock (jaxlib 0.10.2). So a
# batch is eliminated column by column, all lanes at once; LAPACK handles single matrices.
_WRITTEN_OUT = 8  # columns, at most, that are eliminated without a loop


@jax.custom_jvp
def cholesky(matrix):
    """Return L of a symmetric positive definite matrix L Lᵀ; NaN if it is not positive definite."""
    return _factored(matrix)


@cholesky.defjvp
def _cholesky_jvp(primals, tangents):
    """Return L and L Φ(L⁻¹ dA L⁻ᵀ), Φ the lower triangle with half the diagonal (Murray 2016)."""
    lower, (tangent,) = (_whole if is_read() else _eliminated)(*primals), tangents  # `_factored` has no second gradient
    inner = triangular(lower, triangular(lower, 0.5 * (tangent + tangent.T)).T)
    half = np.tri(len(lower)) - 0.5 * np.eye(len(lower))
    return lower, lower @ (half.astype(lower.dtype) * inner)


_whole = functools.partial(jnp.linalg.cholesky, symmetrize_input=False)
_factored = jax.custom_batching.custom_vmap(_whole)


@_factored.def_vmap
def _factored_batch(_, __, matrices):
    return jax.vmap(_eliminated)(matrices), True


@jax.jit  # traced once, though a law has several
def _eliminated(matrix):
    every = np.arange(len(matrix))

    def eliminate(rest, i):
        column = jnp.where(every >= i, rest[:, i], 0.0)
        scaled = column / rest[i, i]
        return rest - scaled[:, None] * column, scaled * jnp.sqrt(rest[i, i])

    return lax.scan(eliminate, matrix, every, unroll=len(every) <= _WRITTEN_OUT or 1)[1].T


@functools.cache
def _substitution(transposed):
    """Return the function of (L, b) that solves L x = b, or Lᵀ x = b."""

    @jax.custom_batching.custom_vmap
    def solve(lower, b):
        return solve_triangular(lower, b, lower=True, trans=int(transposed))

    @solve.def_vmap
    def _(size, batched, lower, b):
        if not any(batched):
            return eliminated(lower[None], b[None], axis=0)[0], False
        if not batched[0]:  # several right sides of one matrix are columns
            wide = jnp.moveaxis(b, 0, -1)
            return jnp.moveaxis(solve(lower, wide.reshape(len(wide), -1)).reshape(wide.shape), -1, 0), True
        return eliminated(lower, b, axis=0 if batched[1] else None), True

    @functools.partial(jax.jit, static_argnames="axis")  # traced once, though a law solves tens of times
    def eliminated(lower, b, axis):
        every = np.arange(lower.shape[-1])

        def eliminate(rest, row):
            i, column = row
            solved = rest[i] / column[i]
            left = every < i if transposed else every > i
            return rest - jnp.multiply.outer(jnp.where(left, column, 0.0), solved), solved

        def one(lower, b):
            rows, short = lower if transposed else lower.T, len(every) <= _WRITTEN_OUT
            return lax.scan(eliminate, b, (every, rows), reverse=transposed, unroll=short or 1)[1]

        return jax.vmap(one, (0, axis))(lower, b)

    return solve
