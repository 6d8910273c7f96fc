"""Stacked: what each task of a stack did, by its own error, and whether the targets of all its tips can be reached.

A task of several tips without names counts by its tips.
"""

import dataclasses
import functools
from typing import NamedTuple

import jax
import numpy as np

from cnclik import errors
from cnclik.measure.outcome import STALL_RATIO
from cnclik.quantities import aloud
from cnclik.reaching.result import Reached, ReachStatus
from cnclik.reaching.targets import WIDTH, aims, read, wanted_at
from cnclik.record import replace
from cnclik.stability.observed import ARRIVED, GROWN, rms
from cnclik.task.task import Task

COMPROMISE = "tasks compromise by their weights"
SHARED = "tasks of one level compromise, and each level yields to those before it"
UNKNOWN = "whether all targets can be reached together is not known"
ALL_REACHABLE = "all targets can be reached together, so other tasks, damping or the start posture keep the tips away"
TOLERANCE = (1e-4, 1e-4)  # [m], [rad] of targets that count as reached
_BEYOND = (ReachStatus.OUT_OF_REACH, ReachStatus.AT_LIMIT)


@dataclasses.dataclass(frozen=True, kw_only=True)
class TaskSeen:
    name: str  # its own, or its tip's
    words: str  # its late error, with what became of it
    settled: bool  # whether it arrived, follows its target, or has a gain of 0
    shrinks: bool  # whether the error is on its way down
    of_tips: bool  # whether it is of positions and orientations of tips


class Together(NamedTuple):
    """What `reach` finds for the targets of all tips at once, and for each alone where they can't be had together."""

    made: Reached  # of the instant that misses most
    alone: tuple[Reached, ...]


def each_task(case) -> list[TaskSeen]:
    """What each task of a case did. Errors below a thousandth of the stack's largest count as none."""
    first = max(ARRIVED * case.seen.size.max(), case.seen.floor)
    return [_seen(case, *own, enough=first) for own in _tasks(case.law.task)]


def _tasks(task) -> list[tuple[str, Task, np.ndarray]]:
    """[(name, its parts, which coordinates)] of each task."""
    if task.tasks:
        return [(name, task.alone(name), np.arange(task.m)[at]) for name, at in task.each]
    ends = np.cumsum([parts.m for _, parts in task.targets])[:-1]
    some = np.split(np.arange(task.m), ends)
    return [(path[-1], parts, at) for (path, parts), at in zip(task.targets, some, strict=True)]


def kinds(task) -> list:
    """Which coordinates are of one task, or tip, and of one unit; those of joints only where there are no others: a
    posture that yields is no error."""
    units, every = np.array(task.units), _tasks(task)
    tips = [one for one in every if not all(hasattr(part, "wanted") for part in one[1].parts)]
    return [some[units[some] == unit] for _, _, some in tips or every for unit in sorted(set(units[some]))]


def _seen(case, name, parts, some, enough) -> TaskSeen:
    e, quarter = case.errors[:, some], len(case.seen.late)
    size = np.linalg.norm(e, axis=1)
    late, before = size[-quarter:], size[:-quarter][-quarter:]
    before = before if before.size else size[:1]
    behind = rms(np.linalg.norm(case.wanted_velocity[:, some], axis=1)) * case.loop[0]
    moving = behind > case.seen.floor
    follows = moving and rms(late) <= max(behind, case.noise)
    alpha = np.asarray(case.law.alpha, float)
    idle = alpha.ndim > 0 and not alpha[some].any()  # such as a base that is held back
    settled = bool(late.max() <= max(enough, ARRIVED * size[0], 4 * case.noise) or follows or idle)
    shrinks = not case.moving and bool(late.max() < STALL_RATIO * before.max() and late.max() <= before.min())
    grows = not case.moving and bool(np.median(late) > GROWN * np.median(before))
    said = largest_in_words(np.array(case.law.task.units)[some], e[-quarter:])
    said = said if late.max() > case.seen.floor else "no more than rounding"
    kinds = {"no gain": idle, "follows": follows, "settled": settled}
    kinds |= {"lags": moving, "shrinking": shrinks, "growing": grows}
    became = next((word for word, holds in kinds.items() if holds), "remains")
    of_tips = all(hasattr(part, "axes") for part in parts.parts)
    return TaskSeen(name=name, words=f"{name} {said} ({became})", settled=settled, shrinks=shrinks, of_tips=of_tips)


def largest_in_words(units, errors) -> str:
    """The largest of errors (N, m) with their units (m,), such as "1.2 mm and 0.3 rad"."""
    units = np.array([unit if unit in ("m", "rad") else "" for unit in units])
    each = ((errors[:, units == unit], unit) for unit in ("m", "rad", ""))
    return " and ".join(aloud(float(np.linalg.norm(some, axis=1).max()), unit) for some, unit in each if some.size)


# --- whether it can be done ---------------------------------------------------------------------------


def together(case, times) -> Together | None:
    """What `reach` finds for the targets of all tips at some times (k,) of a case's path, of the one that it misses
    most; None where it can't be asked.
    """
    from cnclik.reaching.public import reach  # here: most runs end where nothing is asked of it

    law, chain = case.law, case.law.chain
    if chain.balls or not all(map(errors.concrete, jax.tree.leaves(chain))):
        return None
    try:
        task, targets = wanted_at(case.reference, law.task, times)
        task = replace(task, weights=None)
        rows, _ = read(targets, task)
    except errors.ArgumentError:  # of joint values and functions of one's own alone
        return None
    search = functools.partial(reach, chain, tolerance=TOLERANCE, limits=law.limits is not None)
    made = search(targets, task=task)
    beyond, missed = np.isin(made.status, _BEYOND), made.position_error + made.orientation_error
    k, alone = int(np.argmax(np.where(beyond, 1.0 + missed, ~made.solved))), []
    for i, aim in enumerate(aims(task)) if made.status[k] in _BEYOND else ():
        own = rows[k, WIDTH * i : WIDTH * (i + 1)]
        alone.append(search((own[:3], own[3:].reshape(3, 3)), task=Task(parts=aim.parts)))
    some = {name: getattr(made, name)[k] for name in ("q", "status", "position_error", "orientation_error", "targets")
            if getattr(made, name) is not None}  # fmt: skip
    return Together(replace(made, **some), tuple(alone))


def out_of_reach(case) -> str:
    """Why the targets of a stack's tips can't be had, in words; empty where they can, or that isn't known."""
    found = case.together
    if found is None or found.made.status not in _BEYOND:
        return ""
    every = aims(found.made.task)
    lost = [(aim, own) for aim, own in zip(every, found.alone, strict=True) if own.status in _BEYOND]
    if lost:
        each = (f"{aim.label} gets no nearer to its target than {_far(aim, own)}{_kept(own)}" for aim, own in lost)
        return "; ".join(each)
    missed = ", ".join(f"{aim.label} {_far(aim, own)}" for aim, own in zip(every, found.made.each, strict=True))
    can = "each tip by itself can be at its target, all of them together can't"
    return f"{can}{_kept(found.made)}: in the nearest posture found they are off by {missed}"


def _far(aim, missed) -> str:
    parts = [(missed.position_error, "m")] * bool(aim.linear) + [(missed.orientation_error, "rad")] * bool(aim.angular)
    return " and ".join(aloud(float(value), unit) for value, unit in parts)


def _kept(made) -> str:
    return " within the joint limits" if made.status == ReachStatus.AT_LIMIT else ""
