"""Ending: how a loop ended, from its errors and status bits as `solve` stores them."""

import jax.numpy as jnp

from cnclik.integrate.status import Status
from cnclik.robot import spatial as sp

# The codes and thresholds of `cnclik.measure.outcome`, which says the same of a loop without storing its path.
CONVERGED, SLOW, STALLED, DIVERGED, NEAR_SINGULAR = range(5)
GROWTH, STALL_RATIO = 1 + 1e-3, 0.98


def ending(e, status, tolerance=1e-3):
    """How a loop ended, judged by its last quarter against its initial error.

    0 converged: below tolerance · ‖e₀‖; 1 slow: not there yet, but all of it below all of the quarter before; 2
    stalled: neither, yet below ‖e₀‖; 3 diverged: not finite, or up to ‖e₀‖ again; 4: one of the last two, after a
    step near a singularity while the error had not grown.

    Args:
      e: (N + 1, m) errors, the first not 0. status: (N,) bits.
      tolerance: fraction of the initial error that counts as arrived.
    Returns: the code, or NaN where the initial error is 0: a float.
    """
    size = sp.safe_sqrt(jnp.sum(e * e, axis=-1))
    size = jnp.where(jnp.isfinite(size), size, jnp.inf)
    N, scale = status.shape[0], size[0]
    third, last = size[N - 2 * (N // 4) : N - N // 4], jnp.max(size[N - N // 4 :])
    grown = jnp.cumsum(size[:-1] > scale * GROWTH) > 0
    singular_first = jnp.any(~grown & ((status & int(Status.NEAR_SINGULAR)) != 0))
    failed = jnp.where(singular_first, NEAR_SINGULAR, jnp.where(last >= scale, DIVERGED, STALLED))
    least, largest = jnp.min(third, initial=jnp.inf), jnp.max(third, initial=0.0)
    slow = (last < jnp.minimum(least, scale)) & (last < STALL_RATIO * largest)
    code = jnp.where(last <= tolerance * scale, CONVERGED, jnp.where(slow, SLOW, failed))
    return jnp.where(scale > 0, code.astype(e.dtype), jnp.nan)


def stable(e, status):
    """1 where the loop ended as a stable one does, converged or slowly on the way, else 0."""
    return (ending(e, status) <= SLOW).astype(e.dtype)
