"""Exponential steps: the error decays by its exact factor, and a tableau integrates the joints' path.

See `cnclik.integrate.method.exponential` for the formula and `cnclik.law.feedback` for the feedback.
"""

from typing import NamedTuple

import jax.numpy as jnp

from cnclik.integrate.march import charted, combine, march
from cnclik.law.feedback import ahead, feedback_within, held_feedback, null_over_step
from cnclik.law.law import null_velocity, resolve, rows_at
from cnclik.law.null import Posture
from cnclik.law.reference import sample
from cnclik.robot.chart import centre
from cnclik.shapes import Array, Float
from cnclik.task.task import velocity

CLOSED = 2  # largest order with a closure of rotations, see `closure`


class Start(NamedTuple):
    """The quantities of a step that are known at its start."""

    feedback: Float[Array, " m"]  # constant over the step
    velocity: Float[Array, " m"]  # φ ẋ_d at the start
    mean: Float[Array, " m"]  # φ times the target's mean velocity over the step
    null: Float[Array, " n"] | None  # null-space velocity, constant over the step for a posture


def start(law, reference, q, at, t, Ts) -> Start:
    """The parts of a step's exact solution, from the law's observation at q and t."""
    to = ahead(law, reference, at, t, Ts)
    null, factor = null_velocity(law, q), null_over_step(law, Ts)
    return Start(
        feedback=held_feedback(law, at.e, to.turns, Ts),
        velocity=law.feedforward * at.xdot_d,
        mean=law.feedforward * to.mean,
        null=null if factor is None else factor * null,
    )


def closure(law, mean, quadrature, turns, *, remembered=False):
    """The part of the target's motion that a quadrature of ẋ_d misses, as a velocity (m,).

    Rotations are included if `turns` is 1, not 0: log(R_d(t + Ts) R_d(t)ᵀ) and Σ bᵢ ω_d·Ts differ by commutators
    (Magnus 1954), so including them helps up to order 2 and harms beyond. Parts in a tip's own frame omit what is
    `remembered`, as it is in the frames of other instants.
    """
    missed, task, found = mean - quadrature, law.task, []
    for part, where in zip(task.parts, task.slices, strict=True):
        own = turns * missed[where] if part.turns else missed[where]
        found.append(jnp.zeros_like(own) if remembered and part.tied else own)
    return jnp.concatenate(found)


def exponential_march(law, reference, q, at, t, Ts, method, stage, *, looped=False):
    """One step of the exponential form of a tableau: a `Moved`, and its `Start`."""
    to, task = start(law, reference, q, at, t, Ts), law.task
    known = {0.0: (at.aims, law.feedforward * at.motion)}
    for c in method.c:
        if c not in known:
            aims, motion = sample(reference, task, t + c * Ts)
            known[c] = aims, law.feedforward * motion
    low = method.order <= CLOSED
    quadrature = velocity(task, at.robot, at.aims, combine(method.b, [known[c][1] for c in method.c]))
    held = closure(law, to.mean, quadrature, 1.0 if low else 0.0)
    if low:
        feedback = [to.feedback + held] * len(method.c)
    else:
        none = (None,) * len(task.parts)
        turns = [ahead(law, reference, at, t, c * Ts).turns if c else none for c in method.c]
        feedback = [w + held for w in feedback_within(law, at.e, method.c, turns, Ts)]
    stages = [(known[c][0] if task.tied else None, known[c][1], w) for c, w in zip(method.c, feedback, strict=True)]

    def field(stage, q):
        aims, motion, correction = stage
        null = to.null if isinstance(law.null_velocity, Posture) else null_velocity(law, q)
        there = rows_at(law, q, aims)._replace(e=at.e)
        return resolve(law, q, there, velocity(task, there.robot, aims, motion) + correction, null)

    first = resolve(law, q, at, to.velocity + feedback[0], to.null)
    field, y = charted(law.chain, q, field), centre(law.chain, q)
    return march(field, y, Ts, method, stage, first, at=stages, looped=looped), to
