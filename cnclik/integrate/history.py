"""History: what a multistep method remembers of past steps, and when it drops it.

A history is dropped, and the order rises again step by step, when the past does not predict the next step: after a jump
of the target, a change of the sampling time, a step that a limit changed, or a large change of J#. This costs no
evaluation.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax.numpy as jnp

from cnclik import errors
from cnclik.law.law import Law
from cnclik.law.null import Posture
from cnclik.law.reference import sample
from cnclik.law.shifted import true_motion
from cnclik.record import record
from cnclik.robot.rotations import safe_norm
from cnclik.shapes import Array, Float, Int

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
