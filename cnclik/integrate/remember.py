"""Steps with a memory: one evaluation of f per step, combined with earlier ones.

Plain formulas remember slopes and joint values, see `cnclik.integrate.multistep`. Exponential ones remember J# and ẋ_d,
so that the feedback and the closure of this step act through the same mean of J#:

  q⁺ = q + Ts Σⱼ βⱼ J#[k−j] (v[k−j] + w),   v = ẋ_d,
  w  = (I − e^{−K·Ts}) e(t)/Ts + (x_d(t + Ts) − x_d(t))/Ts − Σⱼ βⱼ v[k−j].

If its own evaluation or the combination would violate a limit that the law respects, a step uses its own evaluation
alone, as an (exponential) Euler step, and respects what Euler respects. So does an exponential step if J# has changed
much since the last one: far from the target at a large gain, or near a singularity, the past predicts nothing.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from cnclik.integrate.exponential import CLOSED, Start, closure, start
from cnclik.integrate.history import Entry, History, fields_of, holds_posture, mark, remember, valid, weights
from cnclik.integrate.march import Moved, combine, shift
from cnclik.law.inverse import remembered
from cnclik.law.law import evaluate_at, observe, resolve, weighted
from cnclik.law.limits import within
from cnclik.robot.chart import between, centre, into, rates
from cnclik.shapes import Array, Bool


class Stepped(NamedTuple):
    """A step and its new memory."""

    moved: Moved
    history: History | None = None
    restarted: Bool[Array, ""] | None = None  # whether the memory was dropped


class Begun(NamedTuple):
    """A step by the starting method, and the `Start` of an exponential method."""

    moved: Moved
    to: Start | None = None


def over_history(law, reference, q, at, now, t, Ts, method, history: History, begun: Begun | None) -> Stepped:
    """A step of a multistep method, from the law's observation at q and t.

    Args:
      now: the target's `mark`.
      begun: during the start, the starting method's step.
    """
    count = valid(history, law, now, Ts)
    make = _exponential if method.exponential else _plain
    first, slope, entry, turned = make(law, reference, q, at, t, Ts, method, history, count, begun)
    left = count
    if turned is not None:
        left = jnp.where(turned, 0, count)
    if law.limits is not None:
        alone = first.limited | broken(law, slope, q, Ts)
        slope = jnp.where(alone, first.qdot, slope)
        left = jnp.where(alone, -1, left)
    zero = jnp.zeros((), q.dtype)
    moved = Moved(shift(centre(law.chain, q), Ts, (1.0,), (slope,)), slope, first, zero, zero)
    kept = remember(history, entry, now, Ts, jnp.minimum(left + 1, len(history.entries)))
    return Stepped(moved, kept, (history.count > 0) & ((count == 0) | (left < count)))


def _plain(law, reference, q, at, t, Ts, method, history, count, begun):
    """Evaluation, slope, and entry of a formula on f, and None, as it remembers no J#."""
    first = evaluate_at(law, q, at) if begun is None else begun.moved.first
    entry = Entry(q=q if "q" in fields_of(law, method) else None, slope=first.qdot)
    if begun is not None:
        return first, begun.moved.qdot, entry, None
    a, b = weights(method, count)
    slopes = [(b[0], first.qdot), *zip(b[1:], (_carried(law, q, e, e.slope) for e in history.entries), strict=True)]
    slope = combine(*zip(*slopes, strict=True))
    if len(method.a) > 1:
        per_time = 1.0 / jnp.where(Ts == 0, 1.0, Ts)
        for w, past in zip(a[1:], history.entries, strict=True):
            slope = slope + w * per_time * between(law.chain, q, past.q)
    return first, slope, entry, None


def _carried(law, q, entry: Entry, qdot):
    """A past instant's joint velocity as a slope in the present chart."""
    return rates(law.chain, into(law.chain, q, entry.q), qdot) if law.chain.balls else qdot


def _exponential(law, reference, q, at, t, Ts, method, history, count, begun):
    """Evaluation, slope, and entry of an exponential formula, and whether J# has changed."""
    to = start(law, reference, q, at, t, Ts) if begun is None else begun.to
    alone = to.feedback + to.mean
    first = resolve(law, q, at, alone, to.null) if begun is None else begun.moved.first
    null = None
    if to.null is not None or law.limits is not None:
        null = first.qdot - first.apply(first.task_velocity)
    if first.memory is None:
        columns, factor = jax.vmap(first.apply)(jnp.eye(law.task.m, dtype=q.dtype)), None
    else:
        columns, factor = first.memory()
    found, kept = {"q": q, "columns": columns, "factor": factor, "velocity": to.velocity}, fields_of(law, method)
    found |= {"null": null, "rows": first.rows}
    entry = Entry(**{name: found[name] for name in kept})
    if begun is not None:
        return first, begun.moved.qdot, entry, None
    betas = weights(method, count)[1]
    entries = [entry, *history.entries]
    quadrature = combine(betas, [e.velocity for e in entries])
    turns = 1.0 if method.order <= CLOSED else jnp.where(count < CLOSED, 1.0, 0.0).astype(Ts.dtype)
    held = to.feedback
    if reference.known:  # otherwise only past velocities predict the motion, so there is no closure
        held = held + closure(law, to.mean, quadrature, turns, remembered=True)
    parts = [_applied(e, weighted(law.task, e.velocity + held)) for e in entries]
    turned = (count > 0) & _another(*parts[:2], entry.velocity, entries[1].velocity, held)
    if holds_posture(law):
        rows = [e.rows if e.factor is None else e.columns for e in entries]
        each = zip(parts, entries, rows, strict=True)
        parts = [part + (to.null - _applied(e, j @ to.null)) for part, e, j in each]
    elif "null" in kept:
        parts = [part + e.null for part, e in zip(parts, entries, strict=True)]
    slope = combine(betas, [parts[0], *(_carried(law, q, *one) for one in zip(entries[1:], parts[1:], strict=True))])
    if null is not None and not holds_posture(law) and "null" not in kept:
        slope = slope + null

    def own():  # where nothing else needs it, it is computed only if it is used
        return first.qdot if law.limits is not None else resolve(law, q, at, alone, to.null).qdot

    return first, lax.cond(turned, own, lambda: slope), entry, turned


def _another(now, past, velocity, before, held):
    """Whether J# has changed by more than the past can predict, judged by the joint velocities a, b of two instants.

    It has if their distance exceeds the longer one: |a − b|² > max(|a|², |b|²), which is 2 a·b < min(|a|², |b|²).
    False if the target's own velocity changed by half of the requested velocity, as J# is not the cause then.
    """
    change, requested = velocity - before, before + held
    far = 2 * (now @ past) < jnp.minimum(now @ now, past @ past)
    return far & (4 * (change @ change) < requested @ requested)


def _applied(entry: Entry, velocity):
    """J# of a past instant, times a weighted task velocity (m,)."""
    return remembered(entry.columns, entry.factor, velocity)


def broken(law, qdot, q, Ts):
    """Whether a velocity, or the posture it leads to, violates a limit of the law by more than rounding."""
    rounding = 64 * jnp.finfo(qdot.dtype).eps
    kept = within(law, centre(law.chain, q), qdot, Ts)[1]
    return jnp.any(jnp.abs(qdot - kept) > rounding * jnp.abs(qdot))


def primed(law, reference, past, t, Ts, method, history: History) -> History:
    """The history of a loop that was at the joint values `past`, newest first, with the target as it is at t."""
    for q in reversed(past):
        at = observe(law, reference, t, q)
        make = _exponential if method.exponential else _plain
        entry = make(law, reference, q, at, t, Ts, method, history, history.count, None)[2]
        count = jnp.minimum(history.count + 1, len(history.entries))
        history = remember(history, entry, mark(law, reference, at, t), Ts, count)
    return history
