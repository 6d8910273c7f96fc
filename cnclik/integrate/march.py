"""march: one step of a tableau over any field, a law's or a linear one."""

import functools
import operator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from cnclik.integrate.method import Method
from cnclik.law.feedback import ahead, feedback_within, held_feedback, held_null
from cnclik.law.law import resolve
from cnclik.law.reference import sample
from cnclik.precision import precise
from cnclik.record import Array, Float
from cnclik.robot import chart
from cnclik.robot.chart import centre
from cnclik.task.parts import At
from cnclik.task.task import rows


class Moved(NamedTuple):
    """One step over any field: its result, its quality, and the field at its start."""

    q: Float[Array, " n"]
    qdot: Float[Array, " n"]
    first: Any  # an `Evaluation`, for a law's field
    residual: Float[Array, ""]
    contraction: Float[Array, ""]


def charted(chain, start, field):
    """Return a law's field in the chart centred at `start` (n,), see `cnclik.robot.chart`."""
    if not chain.balls:
        return field

    def within(at, y):
        evaluation = field(at, chart.out(chain, start, y))
        return evaluation._replace(qdot=chart.rates(chain, y, evaluation.qdot))

    return within


def march(field, q, Ts, method: Method, stage, first=None, *, at=None):
    """Make one step of the method over `field`.

    Args:
      field: of (c, q), the right-hand side at t + c·Ts: anything with `qdot` (n,) and, for some stages, `newton`.
      first: field(0, q), if known.
      at: arguments of the field in place of c, one per stage, if it needs more than the time.
    """
    at = method.c if at is None else at
    first = field(at[0], q) if first is None else first  # explicit Euler's, a stage of most methods
    # A loop over the stages compiles several times faster, but runs 15 to 25 % slower.
    if not method.implicit and len(method.b) >= 3 and method.c[0] == 0:
        return _looped(field, q, Ts, method, first, at)
    slopes = []
    residual = contraction = jnp.zeros((), q.dtype)
    for i, (row, c) in enumerate(zip(method.A, method.c, strict=True)):
        base = q + Ts * combine(row[:i], slopes) if any(row[:i]) else q
        if row[i] == 0:
            slopes.append(first.qdot if c == 0 and not any(row) else field(at[i], base).qdot)
            continue
        h = row[i] * Ts
        ahead = combine([w / row[i] for w in row[:i]], slopes) if any(row[:i]) else 0.0 * q

        def g(k, at=at[i], base=base, h=h):
            return field(at, base + h * k)

        solved = stage(g, first, h, ahead)
        slopes.append(solved.slope)
        residual = jnp.maximum(residual, solved.residual)
        contraction = jnp.maximum(contraction, solved.contraction)
    qdot = combine(method.b, slopes)
    return Moved(q + Ts * qdot, qdot, first, residual, contraction)


def _looped(field, q, Ts, method, first, at):
    """Make a step of an explicit method whose first stage is `first`."""
    count = len(method.b)
    weights = [(*row, *(0.0,) * (count - len(row))) for row in method.A]

    def next_slope(slopes, stage):
        i, row, at = stage
        slope = field(at, q + Ts * combine([row[j] for j in range(count)], slopes)).qdot
        return tuple(jnp.where(i == j, slope, k) for j, k in enumerate(slopes)), None

    dtype = jnp.result_type(q[0])
    rows, ats = jax.tree.map(
        lambda *v: jnp.stack([jnp.asarray(x, dtype) for x in v]), *zip(weights[1:], at[1:], strict=True)
    )
    start = (first.qdot, *(jnp.zeros_like(q),) * (count - 1))
    slopes, _ = lax.scan(next_slope, start, (jnp.arange(1, count), rows, ats))
    qdot, zero = combine(method.b, slopes), jnp.zeros((), q.dtype)
    return Moved(q + Ts * qdot, qdot, first, zero, zero)


def combine(weights, vectors):
    """Return Σ wᵢ vᵢ, without terms whose weight is known to be 0."""
    parts = [w * v for w, v in zip(weights, vectors, strict=True) if not (type(w) is float and w == 0)]
    return functools.reduce(operator.add, parts)


# --- exponential steps: the error decays by its exact factor ------------------------------------------
# See `cnclik.integrate.method.exponential` for the formula and `cnclik.law.feedback` for the feedback.


CLOSED = 2  # largest order at which a closure of rotations helps: Σ bᵢ ω_d·Ts misses commutators (Magnus 1954)


def exponential_march(law, reference, q, at, t, Ts, method, stage) -> Moved:
    """Make one step of the exponential form of a tableau, from the law's observation at q and t."""
    task, feedforward, null = law.task, law.feedforward, held_null(law, q, Ts)
    mean, turns = ahead(law, reference, at, t, Ts)
    rates = {0.0: feedforward * at.xdot_d}
    for c in method.c:
        if c not in rates:
            rates[c] = feedforward * sample(reference, task, t + c * Ts)[1]
    missed = feedforward * mean - combine(method.b, [rates[c] for c in method.c])  # by the quadrature of ẋ_d
    if method.order <= CLOSED:
        feedback = [held_feedback(law, at.e, turns, Ts)] * len(method.c)
    else:
        parts = zip(task.parts, task.slices, strict=True)
        missed = jnp.concatenate([0.0 * missed[own] if part.turns else missed[own] for part, own in parts])
        none = (None,) * len(task.parts)
        within = [ahead(law, reference, at, t, c * Ts)[1] if c else none for c in method.c]
        feedback = feedback_within(law, at.e, method.c, within, Ts)
    stages = [rates[c] + (w + missed) for c, w in zip(method.c, feedback, strict=True)]

    @precise
    def field(velocity, q):
        return resolve(law, q, at._replace(rows=rows(task, At(law.chain, q))), velocity, null)

    first = resolve(law, q, at, stages[0], null)
    field, y = charted(law.chain, q, field), centre(law.chain, q)
    return march(field, y, Ts, method, stage, first, at=stages)
