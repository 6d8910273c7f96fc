"""Outcome: how a whole nonlinear loop ended within a given number of steps, by the last quarter of them: it can stay
bounded and wrong, and pass close to the target on the way."""

from __future__ import annotations

import enum

import jax.numpy as jnp
from jax import lax

from cnclik.integrate.drive import Drive
from cnclik.integrate.loop import loop_of, one, start
from cnclik.integrate.method import DEFAULT, MethodLike, named
from cnclik.integrate.stage import Stage, picard
from cnclik.integrate.status import Status
from cnclik.record import Array, Float, Int, cast, record
from cnclik.robot.rotations import safe_norm


class Ending(enum.IntEnum):
    """How a loop ended."""

    CONVERGED = 0  # throughout the last quarter the error is below tolerance times the first one
    SLOW = 1  # not there yet, but every error of the last quarter is clearly below every one of the quarter before, or,
    # through a drive, whose errors swing, below the largest of that quarter
    STALLED = 2  # bounded, but neither there nor on the way: the error stays below the first one
    DIVERGED = 3  # not finite, or in the last quarter the error reaches the first one again
    NEAR_SINGULAR = 4  # stalled or diverged, after a step near a singularity while the error was below the first one


GROWTH = 1 + 1e-3  # an error above this times the first one has grown
STALL_RATIO = 0.98  # ratio of the largest errors of two quarters; above it the loop stands still short of the target


def stable(code):
    """Return whether endings are those of a stable loop: converged, or slowly converging."""
    return (code == Ending.CONVERGED) | (code == Ending.SLOW)


@record
class Outcome:
    """What a loop did in N steps.

    Attributes:
      ending: an `Ending`.
      steps: number of steps after which the error stays below the tolerance; N + 1 if it never does.
      rate: mean factor per step down to that tolerance, tolerance^(1/steps); NaN if not converged.
      final: largest ‖e‖ in the last quarter [m, rad].
    """

    ending: Int[Array, ""]
    steps: Int[Array, ""]
    rate: Float[Array, ""]
    final: Float[Array, ""]


def judge(size, status, tolerance=1e-3, *, swings=False) -> Outcome:
    """Return the outcome of a run. Pure.

    Args:
      size: (N + 1,) norms of its errors. status: (N,) bits of its steps.
      tolerance: fraction of the first error that counts as arrived. If that isn't finite, the run has diverged.
      swings: whether its errors may swing, as through a drive: it is slow if the swings become smaller.
    """
    N = status.shape[0]
    scale = jnp.where(jnp.isfinite(size[0]), size[0], jnp.nan)
    size = jnp.where(jnp.isfinite(size), size, jnp.inf)
    before, largest = size[N - 2 * (N // 4) : N - N // 4], jnp.max(size[N - N // 4 :])
    largest_before = jnp.max(before, initial=0.0)
    bound = largest_before if swings else jnp.min(before, initial=jnp.inf)
    # A diverging loop wanders through singularities; only one met before that can be the cause.
    grown = jnp.cumsum(~(size[:-1] <= scale * GROWTH)) > 0
    singular = jnp.any(((status & int(Status.NEAR_SINGULAR)) != 0) & ~grown)
    wrong = jnp.where(largest < scale, Ending.STALLED, Ending.DIVERGED)  # with a scale of NaN nothing is below
    slow = (largest < jnp.minimum(bound, scale)) & (largest < STALL_RATIO * largest_before)
    late = jnp.where(slow, Ending.SLOW, jnp.where(singular, Ending.NEAR_SINGULAR, wrong))
    converged = largest <= tolerance * scale
    steps = jnp.max(jnp.where(size <= tolerance * scale, 0, jnp.arange(1, N + 2)))
    return Outcome(
        ending=jnp.where(converged, Ending.CONVERGED, late).astype(jnp.int8),
        steps=steps.astype(jnp.int32),
        rate=jnp.where(converged, tolerance ** (1 / jnp.maximum(steps, 1).astype(size.dtype)), jnp.nan),
        final=largest,
    )


def outcome(
    law,
    reference,
    q0,
    Ts,
    N: int,
    method: MethodLike = DEFAULT,
    stage: Stage = picard(5),
    *,
    drive: Drive = Drive(),
    model=None,
    tolerance=1e-3,
):
    """Return how a loop ends after N steps. Pure, for vmap over many loops.

    Args:
      law, reference, q0, Ts, N, method, stage: as for `solve`; nothing is checked here.
      drive: what lies between command and motion; the error is that of the true motion.
      model: the drive as `sampled` gives it, where that is known.
      tolerance: fraction of the initial ‖e‖, which must not be 0, that counts as arrived.
    """
    loop = loop_of(law, reference, q0, Ts, N, named(method), stage, drive=drive, model=model)

    def step(state, k):
        state, made = one(loop, state, k)
        return state, (safe_norm(made.e), made.status.astype(jnp.int32))

    # One step too many is made for the last error: a second function for errors alone would take longer to compile.
    _, (size, status) = lax.scan(step, start(loop, q0), jnp.arange(N + 1).astype(q0.dtype))
    return judge(size, status[:-1], cast(tolerance, q0.dtype), swings=not drive.prompt)
