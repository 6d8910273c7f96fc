"""Stacked: what each task of a stack did, by its own error; a task of several tips without names counts by its tips."""

import dataclasses

import numpy as np

from cnclik.measure.outcome import STALL_RATIO
from cnclik.quantities import aloud
from cnclik.stability.observed import ARRIVED, GROWN, rms

SHARED = (
    "tasks of one level share what they can't all have, and a level yields to those before it; "
    "whether a target is out of reach is not known of several tasks"
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class TaskSeen:
    """One task's part of a run.

    Attributes:
      name: its own, or its tip's. words: its late error, with what became of it.
      settled: whether it arrived, or follows its target. shrinks: whether the error is on its way down.
    """

    name: str
    words: str
    settled: bool
    shrinks: bool


def each_task(case) -> list[TaskSeen]:
    """What each task of a case did. Errors below a thousandth of the stack's largest count as none."""
    task, first = case.law.task, max(ARRIVED * case.seen.size.max(), case.seen.floor)
    if task.tasks:
        own = [(name, np.arange(task.m)[at]) for name, at in task.each]
    else:
        ends = np.cumsum([parts.m for _, parts in task.targets])[:-1]
        own = [
            (path[-1], some) for (path, _), some in zip(task.targets, np.split(np.arange(task.m), ends), strict=True)
        ]
    return [_seen(case, name, some, first) for name, some in own]


def _seen(case, name, some, enough) -> TaskSeen:
    e, quarter = case.errors[:, some], len(case.seen.late)
    size = np.linalg.norm(e, axis=1)
    late, before = size[-quarter:], size[:-quarter][-quarter:]
    before = before if before.size else size[:1]
    behind = rms(np.linalg.norm(case.wanted_velocity[:, some], axis=1)) * case.loop[0]
    moving = behind > case.seen.floor
    follows = moving and rms(late) <= max(behind, case.noise)
    settled = bool(late.max() <= max(enough, ARRIVED * size[0], 4 * case.noise) or follows)
    shrinks = not case.moving and bool(late.max() < STALL_RATIO * before.max() and late.max() <= before.min())
    grows = not case.moving and bool(np.median(late) > GROWN * np.median(before))
    units = np.array(case.law.task.units)[some]
    parts = [(unit, np.linalg.norm(e[-quarter:, units == unit], axis=1)) for unit in ("m", "rad") if unit in units]
    parts += [("", np.linalg.norm(e[-quarter:, ~np.isin(units, ("m", "rad"))], axis=1))] * (not parts)
    said = " and ".join(aloud(float(part.max()), unit) for unit, part in parts)
    said = said if late.max() > case.seen.floor else "no more than rounding"
    kinds = {"follows": follows, "settled": settled, "lags": moving, "shrinking": shrinks, "growing": grows}
    became = next((word for word, holds in kinds.items() if holds), "stays")
    return TaskSeen(name=name, words=f"{name} {said} ({became})", settled=settled, shrinks=shrinks)
