"""Outcome: how a whole nonlinear loop ended within a given number of steps.

A loop is judged by its last quarter, not by its last instant: a nonlinear loop can stay bounded and wrong, and pass
close to the target on the way.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from cnclik.integrate.drive import Drive
from cnclik.integrate.loop import loop_of, one, start
from cnclik.integrate.method import DEFAULT, MethodLike, named
from cnclik.integrate.stage import Stage, picard
from cnclik.integrate.status import Status
from cnclik.record import Array, Bool, Float, Int, cast, record
from cnclik.robot.rotations import safe_norm, safe_sqrt


class Ending(enum.IntEnum):
    """How a loop ended."""

    CONVERGED = 0  # throughout the last quarter the error is below tolerance·scale
    SLOW = 1  # not there yet, but every error of the last quarter is clearly below every one of the quarter before, or,
    # through a drive, whose errors swing, below the largest of that quarter
    STALLED = 2  # bounded, but neither there nor on the way: the error stays below the scale
    DIVERGED = 3  # not finite, or in the last quarter the error reaches the scale again
    NEAR_SINGULAR = 4  # stalled or diverged, after a step near a singularity while the error was below the scale


GROWTH = 1 + 1e-3  # an error above this times the scale has grown
STALL_RATIO = 0.98  # ratio of the largest errors of two quarters; above it the loop stands still short of the target


def stable(code):
    """Whether endings are those of a stable loop: converged, or slowly converging."""
    return (code == Ending.CONVERGED) | (code == Ending.SLOW)


def classify(largest, least_before, largest_before, scale, tolerance, singular_first):
    """The `Ending` of a loop from the largest error of its last quarter, and the extremes of the quarter before."""
    wrong = jnp.where(largest < scale, Ending.STALLED, Ending.DIVERGED)  # with a scale of NaN nothing is below
    failed = jnp.where(singular_first, Ending.NEAR_SINGULAR, wrong)
    slow = (largest < jnp.minimum(least_before, scale)) & (largest < STALL_RATIO * largest_before)
    return jnp.where(largest <= tolerance * scale, Ending.CONVERGED, jnp.where(slow, Ending.SLOW, failed))


def ending(e, status, tolerance=1e-3):
    """How a stored run ended: the code of an `Ending` as a float, NaN where the initial error is 0.

    Args:
      e: (N + 1, m) errors; a run that begins with one that is not finite has diverged. status: (N,) bits.
      tolerance: fraction of the initial error that counts as arrived.
    """
    size = safe_sqrt(jnp.sum(e * e, axis=-1))
    N, scale = status.shape[0], jnp.where(jnp.isfinite(size[0]), size[0], jnp.nan)
    size = jnp.where(jnp.isfinite(size), size, jnp.inf)
    third, last = size[N - 2 * (N // 4) : N - N // 4], jnp.max(size[N - N // 4 :])
    grown = jnp.cumsum(~(size[:-1] <= scale * GROWTH)) > 0
    singular_first = jnp.any(~grown & ((status & int(Status.NEAR_SINGULAR)) != 0))
    least, largest = jnp.min(third, initial=jnp.inf), jnp.max(third, initial=0.0)
    code = classify(last, least, largest, scale, tolerance, singular_first)
    return jnp.where(scale == 0, jnp.nan, code.astype(e.dtype))


@record
class Outcome:
    """What a loop did in N steps.

    Attributes:
      ending: an `Ending`.
      steps: number of steps after which the error stays below tolerance·scale; N + 1 if it never does.
      rate: mean factor per step down to that tolerance, tolerance^(1/steps); NaN if not converged.
      final: largest ‖e‖ in the last quarter [m, rad].
      near_singular: whether some step was marked NEAR_SINGULAR.
      stage_not_converged: whether some step was marked NOT_CONVERGED.
    """

    ending: Int[Array, ""]
    steps: Int[Array, ""]
    rate: Float[Array, ""]
    final: Float[Array, ""]
    near_singular: Bool[Array, ""]
    stage_not_converged: Bool[Array, ""]


class _Observation(NamedTuple):
    """What `outcome` remembers of a loop while it runs."""

    scale: jax.Array  # the error to compare with
    last_above: jax.Array  # last step with an error above tolerance·scale
    least_before: jax.Array  # least and largest error in the third quarter
    largest_before: jax.Array
    largest: jax.Array  # in the last quarter
    status: jax.Array  # bits of all steps
    grown: jax.Array  # an error has been beyond the scale
    singular_first: jax.Array  # a step was near a singularity before that


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
    scale=None,
):
    """How the loop ends after N steps; its path is not kept. Pure, for vmap over many loops.

    Args:
      law, reference, q0, Ts, N, method, stage: as for `solve`; nothing is checked here.
      drive: what lies between command and motion; the error is that of the true motion.
      model: the drive as `moving` samples it, where that is known.
      tolerance: fraction of `scale` that counts as arrived.
      scale: error to compare with [m, rad]; the initial ‖e‖ by default, which must then not be 0.
    """
    loop = loop_of(law, reference, q0, Ts, N, named(method), stage, drive=drive, model=model)
    tolerance = cast(tolerance, q0.dtype)
    given = None if scale is None else jnp.asarray(scale, q0.dtype)

    def step(carry, k):
        state, made = one(loop, carry[0], k)
        return (state, _after(carry[1], k, made, N, tolerance, first=given is None)), None

    # One step too many is made for the last error: a second function for errors alone would take longer to compile.
    k = jnp.arange(N + 1).astype(q0.dtype)
    zero, never = jnp.zeros((), q0.dtype), jnp.zeros((), bool)
    before = _Observation(
        scale=zero if given is None else given,
        last_above=zero - 1,
        least_before=zero + jnp.inf,
        largest_before=zero,
        largest=zero,
        status=jnp.zeros((), jnp.int32),
        grown=never,
        singular_first=never,
    )
    (_, seen), _ = lax.scan(step, (start(loop, q0), before), k)
    # Through a drive an error swings; such a loop converges if its swings become smaller.
    least = seen.least_before if drive.prompt else seen.largest_before
    code = classify(seen.largest, least, seen.largest_before, seen.scale, tolerance, seen.singular_first)
    steps = seen.last_above + 1
    return Outcome(
        ending=code.astype(jnp.int8),
        steps=steps.astype(jnp.int32),
        rate=jnp.where(code == Ending.CONVERGED, tolerance ** (1 / jnp.maximum(steps, 1)), jnp.nan),
        final=seen.largest,
        near_singular=(seen.status & int(Status.NEAR_SINGULAR)) != 0,
        stage_not_converged=(seen.status & int(Status.NOT_CONVERGED)) != 0,
    )


def _after(seen: _Observation, k, made, N, tolerance, *, first) -> _Observation:
    """What is remembered after step k, whose result is `made`. Args: first: whether the first error is the scale."""
    size = safe_norm(made.e)
    scale = seen.scale
    if first:  # without a finite first error the loop cannot converge
        scale = jnp.where(k == 0, jnp.where(jnp.isfinite(size), size, jnp.nan), scale)
    # A diverging loop wanders through singularities; only one met before that can be the cause.
    grown = seen.grown | ~(size <= scale * GROWTH)
    size = jnp.where(jnp.isfinite(size), size, jnp.inf)
    status = jnp.where(k < N, made.status.astype(jnp.int32), 0)
    last = k >= N - N // 4
    third = (k >= N - 2 * (N // 4)) & ~last
    return _Observation(
        scale=scale,
        last_above=jnp.where(size <= tolerance * scale, seen.last_above, k),
        least_before=jnp.where(third, jnp.minimum(seen.least_before, size), seen.least_before),
        largest_before=jnp.where(third, jnp.maximum(seen.largest_before, size), seen.largest_before),
        largest=jnp.where(last, jnp.maximum(seen.largest, size), seen.largest),
        status=seen.status | status,
        grown=grown,
        singular_first=seen.singular_first | (~grown & ((status & int(Status.NEAR_SINGULAR)) != 0)),
    )
