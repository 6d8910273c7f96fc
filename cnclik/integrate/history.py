"""History: what a multistep method remembers of past steps, and when it drops it.

A history is dropped, and the order rises again step by step, when the past does not predict the next step: after a jump
of the target, a change of the sampling time, a step that a limit changed, or a large change of J#. This costs no
evaluation.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from cnclik import errors
from cnclik.integrate.march import CLOSED, Moved, Start, closure, combine, shift, start
from cnclik.law.inverse import remembered
from cnclik.law.law import Law, evaluate_at, observe, resolve, weighted
from cnclik.law.limits import within
from cnclik.law.null import Posture
from cnclik.law.paths import true_motion
from cnclik.law.reference import sample
from cnclik.record import Array, Bool, Float, Int, record
from cnclik.robot.chart import between, centre, into, rates
from cnclik.robot.rotations import safe_norm

UNEVEN = 0.1  # relative change of the sampling time above which the past is dropped
_SLACK = 64  # motion of a target that counts as none, in roundings


@record
class Entry:
    """What is remembered of one instant; None for what a method does not use."""

    q: Float[Array, " n"] | None = None
    slope: Float[Array, " n"] | None = None  # f there
    columns: Float[Array, "m n"] | None = None  # columns of the weighted task's J#, or of Jᵀ if there is a factor
    factor: Float[Array, " m_m"] | None = None  # (m(m + 1)/2,) between Jᵀ and J#, see `law.inverse.remembered`
    velocity: Float[Array, " m"] | None = None  # ẋ_d, times the feed-forward factor
    null: Float[Array, " n"] | None = None  # null-space part of q̇
    rows: Float[Array, "m n"] | None = None  # weighted rows of J, for a posture term without a factor


@record
class History:
    """The memory of a multistep method between two steps, which `step` takes and returns.

    Attributes:
      entries: (p − 1) `Entry`s, the newest first.
      aims: the targets at the last step, for each part of the task.
      speed: norm of the target's velocity at the last step.
      Ts: length of the last step [s].
      count: number of valid entries.
      made: steps since the start, up to p − 1, the number made by the starting method.
    """

    entries: tuple[Entry, ...]
    aims: tuple[Array, ...]
    speed: Float[Array, ""]
    Ts: Float[Array, ""]
    count: Int[Array, ""]
    made: Int[Array, ""]


def blank(law: Law, q, method):
    """The history of a loop before its first step, from q (n,); None for a one-step method."""
    if method.steps == 1:
        return None
    n, m, zeros = law.chain.n, law.task.m, functools.partial(jnp.zeros, dtype=q.dtype)
    shapes = {"q": n, "slope": n, "velocity": m, "null": n, "columns": (m, n), "rows": (m, n)}
    shapes["factor"] = m * (m + 1) // 2
    entry = Entry(**{name: zeros(shapes[name]) for name in fields_of(law, method)})
    zero, none = zeros(()), jnp.zeros((), jnp.int32)
    return History(
        entries=(entry,) * (method.steps - 1),
        aims=tuple(zeros(part.shape) for part in law.task.parts),
        speed=zero,
        Ts=zero,
        count=none,
        made=none,
    )


def fields_of(law: Law, method) -> list:
    """Names of what an `Entry` holds; a posture without a factor needs the rows of J in addition to J#."""
    if not method.exponential:
        return ["q", "slope"] if _remembers_q(law, method) else ["slope"]
    factor, posture = _remembers_factor(law), isinstance(law.null_velocity, Posture)
    there = {
        "q": _remembers_q(law, method),
        "factor": factor,
        "null": not posture and (law.null_velocity is not None or law.limits is not None),
        "rows": holds_posture(law) and not factor,
    }
    return ["columns", "velocity", *(name for name, remembered in there.items() if remembered)]


def _remembers_q(law: Law, method) -> bool:
    """Whether joint values are remembered: for formulas that use them, and to carry slopes between charts."""
    return len(getattr(method, "a", "")) > 1 or bool(law.chain.balls)


def _remembers_factor(law: Law) -> bool:
    """Whether J# is remembered as Jᵀ and the factor of J Jᵀ + λ² I, which costs much less than its columns."""
    return getattr(law.inverse, "factors", False) and law.limits is None and law.task.m <= law.chain.n


def holds_posture(law: Law) -> bool:
    """Whether the null-space term is a posture that decays by its exact factor, projected at each instant."""
    return isinstance(law.null_velocity, Posture) and law.limits is None


def checked(history, method, law):
    """Raise ArgumentError unless it is None or a history of this method and law."""
    if history is None:
        return None
    if method.steps == 1:
        raise errors.fail("history", f"be None for {method}, which has no memory", "is given")
    errors.kind("history", history, History, "be what `step` handed back, `Step.history`")
    n, m, first = law.chain.n, law.task.m, history.entries[0] if history.entries else Entry()
    main, shape = (first.columns, (m, n)) if method.exponential else (first.slope, (n,))
    alike = (first.q is not None) == _remembers_q(law, method)
    alike = alike and (first.factor is not None) == (method.exponential and _remembers_factor(law))
    fits = alike and main is not None and jnp.shape(main) == shape
    if len(history.entries) != method.steps - 1 or not fits:
        raise errors.fail("history", f"be one of {method} and this law", "is of another method or law")
    return history


# --- remembering and forgetting -----------------------------------------------------------------------


class Mark(NamedTuple):
    """The targets and their true velocity, independent of measurements and of what the controller knows."""

    aims: tuple[Array, ...]
    velocity: Float[Array, " w"]


def mark(law: Law, reference, at, t) -> Mark:
    """The target's mark at t. Args: at: the law's observation there."""
    true = true_motion(reference, law.task)
    return Mark(at.aims, at.motion) if true is reference else Mark(*sample(true, law.task, t))


def valid(history: History, law: Law, at: Mark, Ts):
    """The number of valid entries at an instant: none after a jump or a change of the sampling time, otherwise all.

    A target has jumped if it moved farther than Ts times the sum of its speeds at both ends of the step, plus rounding.
    That is twice the motion at the mean speed, so starting from rest, at any acceleration, is no jump.
    """
    parts = law.task.parts
    moved = [part.went(now, before) for part, now, before in zip(parts, at.aims, history.aims, strict=True)]
    explained = history.Ts * (safe_norm(at.velocity) + history.speed)
    size = sum(jnp.sum(jnp.abs(aim)) for part, aim in zip(parts, at.aims, strict=True) if not part.turns)
    most = explained + _SLACK * jnp.finfo(explained.dtype).eps * (1 + size)
    jumped = sum(jnp.sum(v * v) for v in moved) > most * most
    uneven = jnp.abs(Ts - history.Ts) > UNEVEN * history.Ts
    return jnp.where(jumped | uneven, 0, history.count)


def remember(history: History, entry: Entry, at: Mark, Ts, count) -> History:
    """The history after a step, with `count` valid entries."""
    dtype = history.Ts.dtype

    def like(value, old):
        return None if value is None else jnp.broadcast_to(jnp.asarray(value, dtype), jnp.shape(old))

    old = history.entries[0]
    entry = Entry(**{name: like(getattr(entry, name), getattr(old, name)) for name in Entry.__dataclass_fields__})
    return History(
        entries=(entry, *history.entries[:-1]),
        aims=tuple(map(like, at.aims, history.aims)),
        speed=jnp.asarray(safe_norm(at.velocity), dtype),
        Ts=jnp.asarray(Ts, dtype),
        count=count.astype(jnp.int32),
        made=jnp.minimum(history.made + 1, len(history.entries)).astype(jnp.int32),
    )


def weights(method, count):
    """(a, b) of `Multistep.table` for a traced number of entries."""
    rows = method.table

    def pick(several):
        *few, last = several
        if all(value == last for value in few):
            return last
        values = ((jnp.equal(count, i), value) for i, value in enumerate(few))
        return functools.reduce(lambda found, v: jnp.where(v[0], v[1], found), values, last)

    return tuple(tuple(pick([row[part][j] for row in rows]) for j in range(method.steps)) for part in (0, 1))


# --- steps with a memory ------------------------------------------------------------------------------
# Plain formulas remember slopes and joint values, see `Multistep`. Exponential ones remember J# and ẋ_d, so that the
# feedback and the closure of this step act through the same mean of J#:
#
#   q⁺ = q + Ts Σⱼ βⱼ J#[k−j] (v[k−j] + w),   v = ẋ_d,
#   w  = (I − e^{−K·Ts}) e(t)/Ts + (x_d(t + Ts) − x_d(t))/Ts − Σⱼ βⱼ v[k−j].
#
# If its own evaluation or the combination would violate a limit that the law respects, a step uses its own evaluation
# alone, as an (exponential) Euler step, and respects what Euler respects. So does an exponential step if J# has changed
# much since the last one: far from the target at a large gain, or near a singularity, the past predicts nothing.


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
