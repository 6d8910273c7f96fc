"""march: one step of a tableau over any field, a law's or a linear one."""

import functools
import operator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from cnclik.integrate.method import Method
from cnclik.law.feedback import ahead, feedback_within, held_feedback, held_null
from cnclik.law.law import resolve, rows_at
from cnclik.law.reference import sample
from cnclik.record import Array, Float
from cnclik.robot import chart
from cnclik.robot.chart import centre
from cnclik.task.task import velocity


class Moved(NamedTuple):
    """One step over any field: its result, its quality, and the field at its start."""

    q: Float[Array, " n"]
    qdot: Float[Array, " n"]
    first: Any  # an `Evaluation`, for a law's field
    residual: Float[Array, ""]
    contraction: Float[Array, ""]


def charted(chain, start, field):
    """A law's field in the chart centred at `start` (n,), see `cnclik.robot.chart`."""
    if not chain.balls:
        return field

    def within(at, y):
        found = field(at, chart.out(chain, start, y))
        return found._replace(qdot=chart.rates(chain, y, found.qdot))

    return within


def march(field, q, Ts, method: Method, stage, first=None, *, at=None, looped=False):
    """One step of the method over `field`.

    field(c, q) is the right-hand side at time t + c·Ts: anything with `qdot` (n,) and, for stages that
    use it, `newton`. A law's field is an `Evaluation`; the stability function steps over a linear one.

    Args:
      first: field(0, q), if known.
      at: arguments of the field in place of c, one per stage, if it needs more than the time.
      looped: run an explicit method's stages as a loop, which is compiled once; the first stage is at c = 0.
    """
    at = method.c if at is None else at
    first = field(at[0], q) if first is None else first  # explicit Euler's, a stage of most methods
    if looped:
        return _looped(field, q, Ts, method, first, at)
    slopes = []
    residual = contraction = jnp.zeros((), q.dtype)
    for i, (row, c) in enumerate(zip(method.A, method.c, strict=True)):
        base = shift(q, Ts, row[:i], slopes)
        if row[i] == 0:
            slopes.append(first.qdot if c == 0 and not any(row) else field(at[i], base).qdot)
            continue
        h = row[i] * Ts
        ahead = combine([w / row[i] for w in row[:i]], slopes) if any(row[:i]) else 0.0 * q

        def g(k, at=at[i], base=base, h=h):
            return field(at, shift(base, h, (1.0,), (k,)))

        solved = stage(g, first, h, ahead)
        slopes.append(solved.slope)
        residual = jnp.maximum(residual, solved.residual)
        contraction = jnp.maximum(contraction, solved.contraction)
    return _moved(q, Ts, method, slopes, first, residual, contraction)


def _looped(field, q, Ts, method, first, at):
    """A step of an explicit method whose first stage is `first`."""
    count = len(method.b)
    weights = [(*row, *(0.0,) * (count - len(row))) for row in method.A]

    def one(slopes, stage):
        i, row, at = stage
        made = field(at, q + Ts * combine([row[j] for j in range(count)], slopes)).qdot
        return tuple(jnp.where(i == j, made, k) for j, k in enumerate(slopes)), None

    dtype = jnp.result_type(q[0])
    rows, ats = jax.tree.map(
        lambda *v: jnp.stack([jnp.asarray(x, dtype) for x in v]), *zip(weights[1:], at[1:], strict=True)
    )
    start = (first.qdot, *(jnp.zeros_like(q),) * (count - 1))
    slopes, _ = lax.scan(one, start, (jnp.arange(1, count), rows, ats))
    zero = jnp.zeros((), q.dtype)
    return _moved(q, Ts, method, slopes, first, zero, zero)


def _moved(q, Ts, method, slopes, first, residual, contraction) -> Moved:
    """The end of a step, from the slopes of its stages."""
    qdot = combine(method.b, slopes)
    return Moved(shift(q, Ts, (1.0,), (qdot,)), qdot, first, residual, contraction)


def combine(weights, vectors):
    """Σ wᵢ vᵢ, without terms whose weight is known to be 0."""
    parts = [w * v for w, v in zip(weights, vectors, strict=True) if not (type(w) is float and w == 0)]
    return functools.reduce(operator.add, parts)


def shift(q, h, weights, slopes):
    """q + h Σ wᵢ kᵢ."""
    return q + h * combine(weights, slopes) if any(weights) else q


# --- exponential steps: the error decays by its exact factor ------------------------------------------
# See `cnclik.integrate.method.exponential` for the formula and `cnclik.law.feedback` for the feedback.


CLOSED = 2  # largest order with a closure of rotations, see `closure`


class Start(NamedTuple):
    """The quantities of a step that are known at its start."""

    feedback: Float[Array, " m"]  # constant over the step
    velocity: Float[Array, " m"]  # φ ẋ_d at the start
    mean: Float[Array, " m"]  # φ times the target's mean velocity over the step
    null: Float[Array, " n"] | None  # pull of the posture, constant over the step


def start(law, reference, q, at, t, Ts) -> Start:
    """The parts of a step's exact solution, from the law's observation at q and t."""
    to = ahead(law, reference, at, t, Ts)
    return Start(
        feedback=held_feedback(law, at.e, to.turns, Ts),
        velocity=law.feedforward * at.xdot_d,
        mean=law.feedforward * to.mean,
        null=held_null(law, q, Ts),
    )


def closure(law, mean, quadrature, turns, *, remembered=False):
    """The part of the target's motion that a quadrature of ẋ_d misses, as a velocity (m,).

    Rotations are included if `turns` is 1, not 0: log(R_d(t + Ts) R_d(t)ᵀ) and Σ bᵢ ω_d·Ts differ by commutators
    (Magnus 1954), so including them helps up to order 2 and harms beyond. Functions of the target omit
    what is `remembered`, as it belongs to other instants.
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
        there = rows_at(law, q, aims)._replace(e=at.e)
        return resolve(law, q, there, velocity(task, there.robot, aims, motion) + correction, to.null)

    first = resolve(law, q, at, to.velocity + feedback[0], to.null)
    field, y = charted(law.chain, q, field), centre(law.chain, q)
    return march(field, y, Ts, method, stage, first, at=stages, looped=looped), to
