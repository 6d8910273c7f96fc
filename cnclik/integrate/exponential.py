"""Exponential steps: the error decays by its exact factor, and a tableau integrates the joints' path.

See `cnclik.integrate.method.exponential` for the formula and `cnclik.law.feedback` for what the feedback asks.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from cnclik.integrate.march import combine, march
from cnclik.law.feedback import ahead, feedback_within, held_feedback, null_over_step
from cnclik.law.law import null_velocity, resolve, rows_at
from cnclik.law.null import Posture
from cnclik.law.reference import sample
from cnclik.shapes import Array, Float

CLOSED = 2  # order up to which a turn has its closure, see `closure`


class Start(NamedTuple):
    """What a step is to do, as known at its start."""

    feedback: Float[Array, " m"]  # held over the step
    velocity: Float[Array, " m"]  # φ ẋ_d at the start
    mean: Float[Array, " m"]  # φ times the target's mean velocity over the step
    null: Float[Array, " n"] | None  # null-space velocity, a posture's held over the step


def start(law, reference, q, at, t, Ts) -> Start:
    """What the law's exact solution asks of a step, from what the law sees at q and t."""
    to = ahead(law, reference, at, t, Ts)
    null, factor = null_velocity(law, q), null_over_step(law, Ts)
    return Start(
        feedback=held_feedback(law, at.e, to.turns, Ts),
        velocity=law.feedforward * at.xdot_d,
        mean=law.feedforward * to.mean,
        null=null if factor is None else factor * null,
    )


def closure(law, mean, quadrature, turns):
    """What a quadrature of ẋ_d misses of the target's motion, as a velocity (m,).

    Rotations have it where `turns` (1 or 0) says so: log(R_d(t + Ts) R_d(t)ᵀ) and Σ bᵢ ω_d·Ts differ by commutators
    (Magnus 1954), so that it is a gain to order 2 and a loss beyond.
    """
    missed, task = mean - quadrature, law.task
    parts = zip(task.parts, task.slices, strict=True)
    return jnp.concatenate([turns * missed[where] if part.turns else missed[where] for part, where in parts])


def exponential_march(law, reference, q, at, t, Ts, method, stage, *, looped=False):
    """One step of the exponential form of a tableau: a `Moved`, and its `Start`."""
    to = start(law, reference, q, at, t, Ts)
    known = {0.0: to.velocity}
    for c in method.c:
        if c not in known:
            known[c] = law.feedforward * sample(reference, law.task, t + c * Ts)[1]
    velocities = [known[c] for c in method.c]
    low = method.order <= CLOSED
    held = closure(law, to.mean, combine(method.b, velocities), 1.0 if low else 0.0)
    if low:
        held = to.feedback + held
    else:
        none = (None,) * len(law.task.parts)
        turns = [ahead(law, reference, at, t, c * Ts).turns if c else none for c in method.c]
        asked = feedback_within(law, at.e, method.c, turns, Ts)
        velocities = [v + w for v, w in zip(velocities, asked, strict=True)]

    def field(velocity, q):
        null = to.null if isinstance(law.null_velocity, Posture) else null_velocity(law, q)
        return resolve(law, q, rows_at(law, q)._replace(e=at.e), velocity + held, null)

    first = resolve(law, q, at, velocities[0] + held, to.null)
    return march(field, q, Ts, method, stage, first, at=velocities, looped=looped), to
