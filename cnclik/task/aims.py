"""Aims: what a task asks of each tip: a position, an orientation, or both."""

import itertools

import numpy as np

from cnclik import errors
from cnclik.record import memoized, record, replace
from cnclik.robot.chain import Chain
from cnclik.task.parts import places
from cnclik.task.task import Part, Task

WIDTH = 12  # of an aim's target: a position [m], and the rows of a rotation


@record
class Aim:
    """Position, orientation or both of one tip."""

    path: tuple[str, ...]  # its name: the task of a stack, and the tip where there are several
    parts: tuple[Part, ...]  # of the task: the coordinates that count
    tip: str | None
    to: str | None  # the tip from which it is seen; None: the base
    linear: tuple[int, ...]  # axes of the position
    angular: tuple[int, ...]

    @property
    def label(self) -> str:
        """Its name as a text, such as "hands.left", or "right in left" of a tip as seen from another."""
        return ".".join(self.path) + (f" in {self.to}" if self.to else "")

    def way(self, chain: Chain) -> list[int]:
        """Indices of the joints that move the tip, from the base or from the tip that it is seen from."""
        own, other = (chain.way(chain.tip_number(tip)) for tip in (self.tip, self.to or self.tip))
        return own if self.to is None else sorted(set(own) ^ set(other))


def aims(task: Task) -> tuple[Aim, ...]:
    """The aims of a task. Raises: ArgumentError for coordinates that are no tip's, and for a tip that has two aims."""
    return memoized(task, "_aims", _aims)


def _aims(task):
    found = []
    for path, own in task.targets:
        if not all(hasattr(part, "axes") for part in own.parts):
            raise errors.fail("task", "be of positions and orientations of tips", f"has {', '.join(own.names)}")
        if path in [aim.path for aim in found]:
            raise errors.fail("task", "have what it wants of a tip in one place", f"has {path[-1]} in two")
        tip, to = own.parts[0].tip, own.parts[0].to
        axes = [[i for part in own.parts if part.turns == turns for i in places(part.axes)] for turns in (False, True)]
        linear, angular = (tuple(map(int, of)) for of in axes)
        if len({*linear, *(3 + i for i in angular)}) < len(linear + angular):
            raise errors.fail("task", "have each axis of a tip once", f"has {', '.join(own.names)}")
        found.append(Aim(path=path, parts=own.parts, tip=tip, to=to, linear=linear, angular=angular))
    return tuple(found)


def of_tips(task: Task) -> Task:
    """The parts of a task that are poses of tips. Raises: ArgumentError where there are none."""
    kept = [hasattr(part, "axes") for part in task.parts]
    if all(kept):
        return task
    if not any(kept):
        raise errors.fail("task", "be of positions and orientations of tips", f"has {', '.join(task.names)}")
    left, tasks = iter(kept), []
    for name, count in task.tasks:
        tasks += [(name, of)] if (of := sum(itertools.islice(left, count))) else []
    return replace(task.only(kept), tasks=tuple(tasks))


def told_apart(task: Task) -> str:
    """A text that differs for tasks with different aims."""
    return str([aim.parts for aim in aims(task)])


def owners(task: Task, chain: Chain) -> np.ndarray:
    """(n,) the number of the aim whose tip each joint moves; the first one of several."""
    ways = [{chain.joints[i].coordinate for i in aim.way(chain)} for aim in aims(task)]
    return np.array([next((k for k, way in enumerate(ways) if i in way), 0) for i in range(chain.n)], np.int32)
