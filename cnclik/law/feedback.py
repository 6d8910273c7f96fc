"""Feedback held over a step: the error decays by its exact factor, whatever the gain and the sampling time.

The law's own solution over a step is x*(t + s) = x_d(t + s) − e^{−K·s} e(t). What it asks of the feedback over a whole
step, held, is (I − e^{−K·Ts}) e/Ts: K e for small K·Ts, and never more than e/Ts.

The error of an orientation goes along with the target's turn T(s) = R_d(t + s) R_d(t)ᵀ: with E = R_d Rᵀ = exp(e_R) the
law says Ė = [ω_d]E − E[ω_d + k e_R], which E(t + s) = exp(T(s) e^{−k·s} e_R) solves. What is asked for at an instant
within the step is thus k e^{−k·s} T(s) e_R, and held over the step, to second order in the turn, the mean of T(s) at
both ends times (1 − e^{−k·Ts}) e_R/Ts. Gains that differ by axis do the same, exactly for small e_R.

This is the law's solution where the controller is told the target's own velocity, all of it, and no error is clamped.
Else the error is taken as measured at the step's start, and what isn't told of the target's motion is not foreseen.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax

from cnclik.hints import opaque
from cnclik.law.curves import Hold, Tangent
from cnclik.law.law import Law, clamped, gain
from cnclik.law.null import Posture
from cnclik.law.reference import controlled
from cnclik.robot import spatial as sp

HALVINGS = 24  # of a step, from which a gain matrix's factor is doubled up: to alpha·Ts = 1e6 and beyond
_TERMS = 9  # of the series there
_HALF_TURN = 4 * 0.02**2  # 1 + the trace of a rotation by 177.7°
_NEAR = 0.01  # below this z the quotient's derivative would lose digits, and a series is exact


# --- the factor ---------------------------------------------------------------------------------------


def per_step(alpha, Ts, e):
    """Φ = (I − e^{−K·Ts})/Ts [1/s], the gain that, held over a step, does what K does: K itself where Ts = 0.

    Args:
      alpha: K as an array: (), (m,) per axis, or (m, m).
      Ts: [s].
      e: (m,), for its form.
    Returns: what `cnclik.law.law.gain` takes: of alpha's shape; a matrix is a tuple of rows where e is a tuple.
    """
    if alpha.ndim < 2:
        return alpha * _share(alpha * Ts)
    if sp.unrolled(e):
        alpha = tuple(tuple(alpha[i, j] for j in range(len(e))) for i in range(len(e)))
    return _doubled(alpha, Ts)


@opaque
def _share(z):
    """(1 − e^{−z})/z, 1 at z = 0, with derivatives to rounding."""
    near = jnp.abs(z) < _NEAR
    safe = jnp.where(near, 1.0, z)
    series = 1 - z / 2 * (1 - z / 3 * (1 - z / 4 * (1 - z / 5 * (1 - z / 6))))
    return jnp.where(near, series, -jnp.expm1(-safe) / safe)


def _doubled(k, Ts):
    """(I − e^{−K·Ts})/Ts of a matrix: a series for a small part h of the step, then G ← G − (h/2) G², h ← 2h.

    I − e^{−2hK} = 2D − D² with D = h·G = I − e^{−hK}: nothing cancels, and rounding grows with no doubling.
    """
    h = Ts * 2.0**-HALVINGS
    product = k  # K Σⱼ (−hK)ʲ/(j + 1)!, by Horner's rule
    for j in range(_TERMS, 1, -1):
        product = _less(k, h / j, sp.matmul(k, product))

    def double(carry, _):
        g, h = carry
        return (_less(g, 0.5 * h, sp.matmul(g, g)), 2 * h), None

    return lax.scan(double, (product, h), None, length=HALVINGS)[0][0]


def _less(a, factor, b):
    """A − factor·B."""
    return sp.each(lambda x, y: sp.vsub(x, sp.scale(factor, y)), a, b)


# --- feedback -----------------------------------------------------------------------------------------


def held_feedback(law: Law, e, turn, Ts):
    """What a step's feedback asks of the task (m,), held over the step, from the error at its start.

    Args:
      e: (m,).
      turn: rows of T = R_d(t + Ts) R_d(t)ᵀ; None for none, and where less than the whole orientation is controlled.
      Ts: [s]; at 0 it is K e.
    """
    e, p = clamped(law, e), len(law.task.position)
    rate = gain(per_step(law.alpha, Ts, e), e)
    if turn is None:
        return rate
    along = sp.vsub(sp.matvec(turn, rate[p:]), rate[p:])
    return sp.join(rate[:p], sp.vadd(rate[p:], sp.scale(0.5 * law.feedforward, along)))


def feedback_within(law: Law, e, times, turns, Ts) -> list:
    """What a step's feedback asks of the task (m,) at each of some times within it, in units of Ts.

    They are slopes of the parabola through what the error's decay moves the tip by, (I − e^{−K·c·Ts}) e, at c = 0, 1/2
    and 1. A quadrature of second order or more makes of them the whole decay, and one of order 3 or 4 keeps its order,
    as 3c² − 3c + 1/2, along which they miss the decay, is orthogonal to 1 and c. From K·Ts = 1 on the parabola gives
    way to the chord, whose slope is the same everywhere: 3 e/Ts at first and −e/Ts at last lead a far start astray.

    Args:
      e: (m,) at the step's start.
      turns: rows of R_d(t + c·Ts) R_d(t)ᵀ for each time, or None, as for `held_feedback`.
    """
    e, p = clamped(law, e), len(law.task.position)
    half, whole = (gain(per_step(law.alpha, c * Ts, e), e) for c in (0.5, 1.0))  # mean rates over as much of the step
    z = Ts * jnp.max(jnp.abs(law.alpha) if law.alpha.ndim < 2 else jnp.sum(jnp.abs(law.alpha), axis=1))
    half = sp.vadd(whole, sp.scale(1.0 / (1.0 + (z * z) ** 2), sp.vsub(half, whole)))
    found = []
    for c, turn in zip(times, turns, strict=True):
        rate = sp.vadd(sp.scale(2.0 - 4.0 * c, half), sp.scale(4.0 * c - 1.0, whole))
        if turn is not None:
            along = sp.vsub(sp.matvec(turn, rate[p:]), rate[p:])
            rate = sp.join(rate[:p], sp.vadd(rate[p:], sp.scale(law.feedforward, along)))
        found.append(rate)
    return found


def null_over_step(law: Law, Ts):
    """Factor of a posture term over a step, (1 − e^{−rate·Ts})/(rate·Ts); None where the term isn't linear."""
    if isinstance(law.null_velocity, Posture):
        return _share(law.null_velocity.rate * Ts)
    return None


# --- the target's motion ------------------------------------------------------------------------------


class Ahead(NamedTuple):
    """How the target moves in a step."""

    mean: tuple  # (m,) its mean velocity [m/s, rad/s]; at Ts = 0 the velocity
    turn: object = None  # rows of R_d(t + Ts) R_d(t)ᵀ; None for none, or where less than the whole is controlled


def ahead(law: Law, reference, at, t, Ts) -> Ahead:
    """The target's motion from t to t + Ts as a controller knows it; `at` is what the law sees at t.

    A velocity that the controller is told is all that it knows. The mean of a turn is log(R_d(t + Ts) R_d(t)ᵀ)/Ts.
    """
    task, p = law.task, len(law.task.position)
    whole = len(task.orientation) == 3
    if reference.feedforward is not None or isinstance(reference.curve, (Hold, Tangent)):
        if not whole or (reference.feedforward is None and isinstance(reference.curve, Hold)):
            return Ahead(at.xdot_d)
        turn = sp.exp_so3(sp.scale(Ts, at.xdot_d[p:]))
        return Ahead(at.xdot_d, turn if sp.unrolled(at.xdot_d) else sp.packed(turn, Ts.dtype))
    still = Ts == 0
    safe = jnp.where(still, 1.0, Ts)
    position, rotation = reference.curve(t + Ts, sp.unrolled(at.xdot_d))
    mean, turn = at.xdot_d[:0], None
    if p:
        moved = sp.vsub(controlled(task, position), at.position)
        mean = sp.each(lambda x, v: jnp.where(still, v, x / safe), moved, at.xdot_d[:p])
    if task.orientation:
        turn = sp.matmul(rotation, sp.transpose(at.rotation))
        angle = sp.pick(_log(turn), task.angular)
        mean = sp.join(mean, sp.each(lambda x, v: jnp.where(still, v, x / safe), angle, at.xdot_d[p:]))
    return Ahead(mean, turn if whole else None)


@opaque
def _log(turn):
    """The rotation vector of a step's turn, exact to 177°: a target that goes farther in one step has jumped."""
    w = 0.5 * jnp.sqrt(jnp.maximum(1 + turn[0][0] + turn[1][1] + turn[2][2], _HALF_TURN))
    v = sp.axial(turn)
    return sp.log_quaternion(w, sp.scale(0.25 / w, v if sp.unrolled(turn) else sp.packed(v)))
