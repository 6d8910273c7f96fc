"""Outcome: what a whole nonlinear loop did over a stated horizon, and maps of it over alpha, Ts and M.

A loop is judged by its last quarter, not by its last instant: a nonlinear map can stay bounded and wrong, and
pass close to the target on its way.
"""

import enum
import functools

import jax
import jax.numpy as jnp
from jax import lax

from cnclik.hints import one_function
from cnclik.integrate.method import EE, METHODS, Method
from cnclik.integrate.solve import advance, cast
from cnclik.integrate.stage import picard
from cnclik.integrate.status import Status
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
    Ts = jnp.asarray(Ts, q0.dtype)
    tail, before = N - N // 4, N - 2 * (N // 4)
    given = None if scale is None else jnp.asarray(scale, q0.dtype)

    def one(own, carry, k):
        law, reference, Ts, stage, tolerance, given = own
        q, scale, (above, least, most, final), bits, grown, first_near = carry
        made = advance(law, reference, q, k * Ts, Ts, method, stage)
        size = sp.safe_norm(made.e)
        if given is None:
            scale = jnp.where(k == 0, size, scale)
        # A loop that diverges wanders through singularities; one that meets them first is another matter.
        grown |= ~(size <= scale * _GROWN)
        size = jnp.where(jnp.isfinite(size), size, jnp.inf)
        seen = (
            jnp.where(size > tolerance * scale, k, above),
            jnp.where((k >= before) & (k < tail), jnp.minimum(least, size), least),
            jnp.where((k >= before) & (k < tail), jnp.maximum(most, size), most),
            jnp.where(k >= tail, jnp.maximum(final, size), final),
        )
        status = jnp.where(k < N, made.status.astype(jnp.int32), 0)
        first_near |= ~grown & ((status & int(Status.NEAR_SINGULAR)) != 0)
        return (made.q, scale, seen, bits | status, grown, first_near), None

    def loop(own, start, k):
        return lax.scan(functools.partial(one, own), start, k)[0]

    # The step after the last is made too, only for its error: one more way to evaluate it would cost far more to
    # compile than it costs to run.
    k = jnp.arange(N + 1).astype(q0.dtype)
    zero = jnp.zeros((), q0.dtype)
    nothing = (zero - 1, zero + jnp.inf, zero, zero)
    never = jnp.zeros((), bool)
    start = (tuple(q0), zero if given is None else given, nothing, jnp.zeros((), jnp.int32), never, never)
    own = (law, reference, Ts, stage, tolerance, given)
    _, scale, (above, least, most, final), bits, _, first_near = one_function(loop)(own, start, k)
    near, stuck = (bits & int(Status.NEAR_SINGULAR)) != 0, (bits & int(Status.NOT_CONVERGED)) != 0
    converged = final <= tolerance * scale
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
