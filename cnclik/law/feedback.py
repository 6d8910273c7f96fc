"""Constant feedback over a step: the error decays by its exact factor, whatever the gain and the sampling time.

A constant feedback (1 − e^{−K·Ts}) e/Ts, never more than e/Ts, leads to the law's own solution over a step, x_d(t + s)
− e^{−K·s} e(t). The error of an orientation turns with the target by T(s) = R_d(t + s) R_d(t)ᵀ: E(t + s) =
exp(T(s) e^{−k·s} e_R) solves Ė = [ω_d]E − E[ω_d + k e_R]. So its feedback is k e^{−k·s} T(s) e_R, and a constant one
has, to second order in the turn, the mean of T(s) at both ends. Gains that differ by axis do so exactly for small e_R.
"""

import jax.numpy as jnp

from cnclik.law.law import Law, clamped, null_velocity
from cnclik.law.paths import Tangent
from cnclik.law.reference import aims_of, by_target
from cnclik.robot.rotations import exp_so3

_NEAR = 0.01  # below this z the series is exact, but the quotient's derivative loses digits


def per_step(alpha, Ts):
    """Return Φ = (1 − e^{−K·Ts})/Ts [1/s], the constant gain over a step with the effect of K; K itself for Ts = 0."""
    return alpha * _share(alpha * Ts)


def _share(z):
    """Return (1 − e^{−z})/z, 1 at z = 0, with derivatives to rounding."""
    near = jnp.abs(z) < _NEAR
    safe = jnp.where(near, 1.0, z)
    series = 1 - z / 2 * (1 - z / 3 * (1 - z / 4 * (1 - z / 5 * (1 - z / 6))))
    return jnp.where(near, series, -jnp.expm1(-safe) / safe)


def _along(law, rate, turns, share):
    """Return a task velocity (m,) whose rotational parts turn with the target by a share of its turn."""
    if all(turn is None for turn in turns):
        return rate
    each = zip((rate[where] for where in law.task.slices), turns, strict=True)
    share = share * law.feedforward
    return jnp.concatenate([own if turn is None else own + share * (turn @ own - own) for own, turn in each])


def held_feedback(law: Law, e, turns, Ts):
    """Return the feedback (m,) of a step, constant over it, from the error e (m,) at its start; K e for Ts = 0.

    Args: turns: of each part T = R_d(t + Ts) R_d(t)ᵀ; None without a turn or a whole orientation.
    """
    return _along(law, per_step(law.alpha, Ts) * clamped(law, e), turns, 0.5)


def feedback_within(law: Law, e, times, turns, Ts) -> list:
    """Return the feedback (m,) of a step at each of some times within it, in units of Ts.

    They are slopes of the parabola through (1 − e^{−K·c·Ts}) e at c = 0, 1/2, 1, which a quadrature of order 2 to 4
    integrates exactly. From K·Ts = 1 on the parabola gives way to the chord: slopes of 3 e/Ts lead a far start astray.

    Args: turns: for each time, as for `held_feedback`.
    """
    e = clamped(law, e)
    half, whole = (per_step(law.alpha, c * Ts) * e for c in (0.5, 1.0))
    z = Ts * jnp.max(jnp.abs(jnp.asarray(law.alpha)))
    half = whole + 1.0 / (1.0 + (z * z) ** 2) * (half - whole)
    rates = ((2.0 - 4.0 * c) * half + (4.0 * c - 1.0) * whole for c in times)
    return [_along(law, rate, turn, 1.0) for rate, turn in zip(rates, turns, strict=True)]


def held_null(law: Law, q, Ts):
    """Return the pull (n,) of the law's posture over a step, (1 − e^{−rate·Ts})/(rate·Ts) q̇₀; None without one."""
    posture = law.null_velocity
    return None if posture is None else _share(posture.rate * Ts) * null_velocity(law, q)


def ahead(law: Law, reference, at, t, Ts) -> tuple:
    """Return the target's motion from t to t + Ts as a controller knows it; `at` is the law's observation at t.

    Returns: its mean velocity (m,) [m/s, rad/s], of a turn log(R_d(t + Ts) R_d(t)ᵀ)/Ts, at Ts = 0 the velocity; and of
      each part R_d(t + Ts) R_d(t)ᵀ, or None where no whole orientation turns.
    """
    still = Ts == 0
    safe = jnp.where(still, 1.0, Ts)
    means, turns, before = [], [], zip(at.aims, law.task.slices, strict=True)
    for path, task in by_target(reference, law.task):
        constant = path.still or isinstance(path.curve, Tangent)
        later = (None,) * len(task.parts) if constant else aims_of(path, task, t + Ts)
        for part, aim in zip(task.parts, later, strict=True):
            now, where = next(before)
            xdot, turn = at.xdot_d[where], None
            if aim is not None:
                went, turn = part.mean(aim, now)
                xdot = jnp.where(still, xdot, went / safe)
            elif part.turns and part.m == 3 and not path.still:
                turn = exp_so3(Ts * xdot)
            means.append(xdot)
            turns.append(turn)
    return jnp.concatenate(means), turns
