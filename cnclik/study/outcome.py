"""Outcome: what a whole nonlinear loop did over a stated horizon, and maps of it over alpha, Ts and M.

A loop is judged by its last quarter, not by its last instant: a nonlinear map can stay bounded and wrong, and
pass close to the target on its way.
"""

import enum

import jax
import jax.numpy as jnp
from jax import lax

from cnclik.integrate.method import EE, METHODS, Method
from cnclik.integrate.solve import advance, cast
from cnclik.integrate.stage import picard
from cnclik.integrate.status import Status
from cnclik.law.law import evaluate
from cnclik.record import record
from cnclik.robot import spatial as sp


class Kind(enum.IntEnum):
    """How a loop ended."""

    CONVERGED = 0  # throughout the last quarter the error is below tolerance·scale
    SLOW = 1  # not there yet, but all of the last quarter is below all of the one before, and clearly
    NOT_CONVERGED = 2  # bounded and wrong: neither there nor on the way, yet below the scale
    DIVERGED = 3  # not finite, or in the last quarter the error comes up to the scale again
    NEAR_SINGULAR = 4  # one of the last two, after a step near a singularity while the error was below the scale


_GROWN = 1 + 1e-3  # an error beyond this times the scale has grown
_ON_THE_WAY = 0.98  # largest ratio of two quarters' largest errors that is not standing still short of the target


def stable(kind):
    """Whether outcomes are those of a stable loop: converged, or slowly on the way."""
    return (kind == Kind.CONVERGED) | (kind == Kind.SLOW)


@record
class Outcome:
    """What a loop did in N steps.

    Attributes:
      kind: a `Kind`.
      steps: number of steps after which the error stays below tolerance·scale, N + 1 where it never does.
      rate: mean factor per step down to that tolerance, tolerance^(1/steps); NaN where not converged.
      final: largest ‖e‖ in the last quarter [m, rad].
      near_singular: whether some step was marked NEAR_SINGULAR.
      not_converged: whether some implicit stage was marked NOT_CONVERGED.
    """

    kind: jax.Array
    steps: jax.Array
    rate: jax.Array
    final: jax.Array
    near_singular: jax.Array
    not_converged: jax.Array


def outcome(law, reference, q0, Ts, N: int, method: Method = EE, stage=picard(5), *, tolerance=1e-3, scale=None):
    """Run the loop for N steps and say how it ended, without keeping its path: pure, for vmap over many.

    Args:
      law, reference, q0, Ts, N, method, stage: as for `solve`; nothing is checked here.
      tolerance: fraction of `scale` that counts as arrived.
      scale: error to compare with [m, rad]; the initial ‖e‖ by default, which must then not be 0.
    """
    method = METHODS[method] if isinstance(method, str) else method
    law, reference, Ts, tolerance = cast((law, reference, Ts, tolerance), q0.dtype)
    tail, before = N - N // 4, N - 2 * (N // 4)
    first = sp.safe_norm(evaluate(law, reference, jnp.zeros_like(Ts), tuple(q0)).e)
    scale = first if scale is None else jnp.asarray(scale, q0.dtype)
    bound = tolerance * scale

    def judge(k, e, seen):
        above, least, most, final = seen
        size = sp.safe_norm(e)
        size = jnp.where(jnp.isfinite(size), size, jnp.inf)
        return (
            jnp.where(size > bound, k, above),
            jnp.where((k >= before) & (k < tail), jnp.minimum(least, size), least),
            jnp.where((k >= before) & (k < tail), jnp.maximum(most, size), most),
            jnp.where(k >= tail, jnp.maximum(final, size), final),
        )

    def one(carry, k):
        q, seen, bits, grown, first_near = carry
        made = advance(law, reference, q, k * Ts, Ts, method, stage)
        # A loop that diverges wanders through singularities; one that meets them first is another matter.
        grown |= ~(sp.safe_norm(made.e) <= scale * _GROWN)
        first_near |= ~grown & ((made.status & int(Status.NEAR_SINGULAR)) != 0)
        return (made.q, judge(k, made.e, seen), bits | made.status.astype(jnp.int32), grown, first_near), None

    k = jnp.arange(N + 1).astype(q0.dtype)
    nothing = (jnp.full_like(first, -1.0), jnp.full_like(first, jnp.inf), jnp.zeros_like(first), jnp.zeros_like(first))
    never = jnp.zeros_like(first, bool)
    start = (tuple(q0), nothing, jnp.zeros_like(first, jnp.int32), never, never)
    (q, seen, bits, _, first_near), _ = lax.scan(one, start, k[:-1])
    above, least, most, final = judge(k[-1], evaluate(law, reference, k[-1] * Ts, q).e, seen)
    near, stuck = (bits & int(Status.NEAR_SINGULAR)) != 0, (bits & int(Status.NOT_CONVERGED)) != 0
    converged = final <= bound
    failed = jnp.where(first_near, Kind.NEAR_SINGULAR, jnp.where(final >= scale, Kind.DIVERGED, Kind.NOT_CONVERGED))
    slow = (final < jnp.minimum(least, scale)) & (final < _ON_THE_WAY * most)
    kind = jnp.where(converged, Kind.CONVERGED, jnp.where(slow, Kind.SLOW, failed))
    steps = above + 1
    rate = jnp.where(converged, tolerance ** (1 / jnp.maximum(steps, 1)), jnp.nan)
    return Outcome(
        kind=kind.astype(jnp.int8),
        steps=steps.astype(jnp.int32),
        rate=rate,
        final=final,
        near_singular=near,
        not_converged=stuck,
    )
