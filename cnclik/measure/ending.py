"""Ending: how a loop ended, from its errors and status bits as `solve` stores them."""

import jax.numpy as jnp

from cnclik.integrate.status import Status
from cnclik.measure import outcome
from cnclik.robot.rotations import safe_sqrt


def ending(e, status, tolerance=1e-3):
    """How a loop ended: the code of an `outcome.Ending`, judged by its last quarter against its initial error.

    Args:
      e: (N + 1, m) errors, the first not 0. status: (N,) bits.
      tolerance: fraction of the initial error that counts as arrived.
    Returns: the code, or NaN where the initial error is 0: a float. What begins with an error that is not finite has
      diverged.
    """
    size = safe_sqrt(jnp.sum(e * e, axis=-1))
    N, scale = status.shape[0], jnp.where(jnp.isfinite(size[0]), size[0], jnp.nan)
    size = jnp.where(jnp.isfinite(size), size, jnp.inf)
    third, last = size[N - 2 * (N // 4) : N - N // 4], jnp.max(size[N - N // 4 :])
    grown = jnp.cumsum(~(size[:-1] <= scale * outcome.GROWTH)) > 0
    singular_first = jnp.any(~grown & ((status & int(Status.NEAR_SINGULAR)) != 0))
    least, largest = jnp.min(third, initial=jnp.inf), jnp.max(third, initial=0.0)
    code = outcome.classify(last, least, largest, scale, tolerance, singular_first)
    return jnp.where(scale == 0, jnp.nan, code.astype(e.dtype))
