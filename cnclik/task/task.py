"""Task: what the loop controls, as parts; x are its coordinates, e = x_d − x their error.

Of a pose they are positions along chosen axes [m], then components of the rotation vector [rad] that turns the tip
into the desired orientation, in the base frame. Tasks are joined by `&`, and given names by `stack`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.record import brief, record, replace
from cnclik.robot.rotations import library
from cnclik.shapes import ArrayLike, Float
from cnclik.task.parts import AXES, At, Function, Joints, Orientation, Position, places

Part = Any  # one of those in `parts`, or of the same form


@record
class Task:
    """Task coordinates, as parts one after the other.

    Attributes:
      parts: positions, orientations, joints and functions, in the order of the coordinates.
      weights: (m,) of the coordinates, in the least-squares sense, or None.
      tasks: of a stack the names of its tasks, and how many parts each has.
    """

    parts: tuple[Part, ...]
    weights: Float[ArrayLike, " m"] | None = None
    tasks: tuple[tuple[str, int], ...] = ()

    @property
    def m(self) -> int:
        """Number of task coordinates."""
        return sum(part.m for part in self.parts)

    @property
    def slices(self) -> tuple[slice, ...]:
        """Where the coordinates of each part stand."""
        ends = [0, *itertools.accumulate(part.m for part in self.parts)]
        return tuple(slice(a, b) for a, b in itertools.pairwise(ends))

    @property
    def targets(self) -> tuple[tuple[tuple[str, ...], Task], ...]:
        """Where a target is due: its path, (task, tip) or (tip,), and the parts that it is for."""
        every, found = iter(self.parts), []
        for name, count in self.tasks or (("", len(self.parts)),):
            own = itertools.groupby(itertools.islice(every, count), lambda part: (part.tip, part.to))
            found += [((name,) * bool(name) + (tip or "tip",), Task(parts=tuple(parts))) for (tip, _), parts in own]
        return tuple(found)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates: x, y, z, rx, ry, rz; of several tasks or tips after theirs, as hands.x."""
        every, found = self.targets, []
        for path, one in every:
            alone = sum(other[:-1] == path[:-1] for other, _ in every) == 1
            before = path[:-1] if alone else path
            found += [".".join([*before, coordinate]) for part in one.parts for coordinate in part.names]
        return tuple(found)

    @property
    def units(self) -> tuple[str, ...]:
        return tuple(unit for part in self.parts for unit in part.units)

    @property
    def each(self) -> tuple[tuple[str, slice], ...]:
        """Of a stack the names of its tasks, and where the coordinates of each stand."""
        ends = [0, *itertools.accumulate(count for _, count in self.tasks)]
        its = [self.slices[a:b] for a, b in itertools.pairwise(ends)]
        return tuple((n, slice(at[0].start, at[-1].stop)) for (n, _), at in zip(self.tasks, its, strict=True))

    def rows_at(self, chain, q):
        """The task Jacobian (..., m, n) of a `Model` at q (n,), or in NumPy (..., n), before weighting."""
        return rows(self, At(chain, q))

    @property
    def lengths(self) -> list[int]:
        """Which of the coordinates are in m: of a pose its position."""
        return [i for i, unit in enumerate(self.units) if unit == "m"]

    @property
    def angles(self) -> list[int]:
        """Which of the coordinates are in rad: of a pose its orientation."""
        return [i for i, unit in enumerate(self.units) if unit == "rad"]

    def of(self, name: str) -> slice:
        """Where the coordinates of a stack's task stand. Raises: ArgumentError for an unknown one."""
        known = dict(self.each)
        return known[errors.one_of("name", name, known)]

    def alone(self, name: str) -> Task:
        """One of a stack's tasks."""
        its = self.of(name)
        own = (p for p, at in zip(self.parts, self.slices, strict=True) if its.start <= at.start < its.stop)
        weights = None if self.weights is None else self.weights[its]  # type: ignore[index]
        return Task(parts=tuple(own), weights=weights)

    def about(self, tip: str | None) -> Task:
        """The task with those of its parts that name no tip being of this one."""
        if tip is None:
            return self
        named = (replace(p, tip=tip) if hasattr(p, "axes") and p.tip is None else p for p in self.parts)
        return replace(self, parts=tuple(named))

    def on(self, chain) -> Task:
        """The task of this robot. Raises: ArgumentError for tips and joints that it has not."""
        for part in self.parts:
            if hasattr(part, "axes"):
                chain.tip_number(part.tip)
            if part.to is not None:
                chain.tip_number(part.to)
        parts = tuple(part.on(chain) if hasattr(part, "on") else part for part in self.parts)
        if all(new is old for new, old in zip(parts, self.parts, strict=True)):
            return self
        task = replace(self, parts=parts)
        return task if task.weights is None else replace(task, weights=_weights(task, task.weights))

    # --- of a task of one tip's pose alone ---

    @property
    def of_one_tip(self) -> bool:
        """Whether it is of one tip's pose in the base frame."""
        alone = not self.tasks and len(self.targets) == 1
        return alone and all(part.to is None and hasattr(part, "axes") for part in self.parts)

    @property
    def position(self) -> str:
        """Letters of the axes along which one tip is placed."""
        return "".join(part.axes for part in _pose(self) if not part.turns)

    @property
    def orientation(self) -> str:
        """Letters of the axes about which one tip is turned."""
        return "".join(part.axes for part in _pose(self) if part.turns)

    @property
    def linear(self) -> tuple[int, ...]:
        return tuple(places(self.position).tolist())

    @property
    def angular(self) -> tuple[int, ...]:
        return tuple(places(self.orientation).tolist())

    def __and__(self, other: Task) -> Task:
        other = errors.kind("task", other, Task, "be a task such as ck.position()")
        for task in (self, other):
            if task.tasks:
                raise errors.fail("task", "be joined before it has names, by ck.stack(name=task & task)", "has names")
        return Task(parts=self.parts + other.parts, weights=_joined((self, other)))

    def __repr__(self):
        said = []
        for path, one in self.targets:
            of = [f"{', '.join(part.names)} [{', '.join(dict.fromkeys(part.units))}]" for part in one.parts]
            about = f" of {path[-1]}" if len(self.targets) > 1 else ""
            said.append("".join(f"{name}: " for name in path[:-1]) + ", ".join(of) + about)
        return f"Task: {'; '.join(said)}" + ("" if self.weights is None else f", weights {brief(self.weights)}")


def _pose(task):
    """The parts of a task of one tip's pose. Raises: ArgumentError for others."""
    if not task.of_one_tip:
        raise errors.fail("task", "be of one tip's pose for this", f"is {task!r}")
    return task.parts


# --- builders -----------------------------------------------------------------------------------------

Weights = Float[ArrayLike, " m"] | None


def position(
    axes: str = "xyz", *, tip: str | None = None, relative_to: str | None = None, weights: Weights = None
) -> Task:
    """Position of a tip along some of the axes of a frame [m].

    Args:
      axes: letters of "xyz" in that order, such as "xy".
      tip: its name; None: the robot's only one.
      relative_to: name of the tip in whose frame, and as seen from which, it is; None: the base.
      weights: (m,) positive weights of the coordinates in the least-squares sense, or None.
    """
    return _task(weights, Position(axes=_letters("axes", axes), tip=tip, to=relative_to))


def orientation(
    axes: str = "xyz", *, tip: str | None = None, relative_to: str | None = None, weights: Weights = None
) -> Task:
    """Orientation of a tip: error log(R_d Rᵀ) as a rotation vector in the base frame [rad].

    Args:
      axes: components of the rotation vector that count, such as "z" for a planar arm.
      tip, relative_to: as for `position`.
      weights: (m,) positive weights, or None.
    """
    return _task(weights, Orientation(axes=_letters("axes", axes), tip=tip, to=relative_to))


def pose(
    axes: str = "xyz",
    rotation_axes: str = "xyz",
    *,
    tip: str | None = None,
    relative_to: str | None = None,
    weights: Weights = None,
) -> Task:
    """Position [m] and orientation [rad] of a tip; `pose("xy", "z")` is the whole pose in a plane.

    Args: as for `position` and `orientation`.
    """
    place = Position(axes=_letters("axes", axes), tip=tip, to=relative_to)
    return _task(weights, place, Orientation(axes=_letters("rotation_axes", rotation_axes), tip=tip, to=relative_to))


def joints(names: Sequence[str] | None = None, *, weights: Weights = None) -> Task:
    """Joint values as a task, such as a posture: x = q of these joints [rad, m]; its target is hold(values=...).

    Args:
      names: of the joints; None: all.
      weights: (m,) positive weights, or None.
    """
    if isinstance(names, str):
        names = (names,)
    return _task(weights, Joints(wanted=None if names is None else tuple(names)))


def function(value: Callable, names: Sequence[str], units: Sequence[str], *, weights: Weights = None) -> Task:
    """A function of the joint values as a task, x = value(robot, q); its rows are its derivative, by JAX.

    Args:
      value: (robot, q (n,)) to (m,), differentiable, such as the distance of a tip from a point:
        lambda robot, q: jnp.linalg.norm(ck.forward(robot, q, tip="hand").position - point)[None].
      names, units: of the m coordinates.
      weights: (m,) positive weights, or None.
    """
    if not callable(value):
        raise errors.fail("value", "be a function of the robot and q", f"is {value!r}")
    if len(names) != len(units) or not names:
        raise errors.fail("units", f"be as many as `names`, {len(names)}", f"are {len(units)}")
    return _task(weights, Function(value=value, names=tuple(names), units=tuple(units)))


def stack(**tasks: Task) -> Task:
    """Tasks with names, controlled together: `stack(hands=pose(tip="left") & pose(tip="right"), rest=joints())`.

    What they can't all have is shared by their weights, or by the levels of an inverse such as `levels`.

    Raises: ArgumentError naming what is no task.
    """
    if not tasks:
        raise errors.fail("tasks", "be at least one, such as hands=ck.pose(tip=...)", "are none")
    for name, task in tasks.items():
        if errors.kind(name, task, Task, "be a task such as ck.position()").tasks:
            raise errors.fail(name, "be a task without names of its own", "is a stack")
    parts = tuple(part for task in tasks.values() for part in task.parts)
    named = tuple((name, len(task.parts)) for name, task in tasks.items())
    return Task(parts=parts, weights=_joined(list(tasks.values())), tasks=named)


def _letters(name, axes):
    if hasattr(axes, "joints"):  # of a robot, whose tip's pose `ck.pose` was until 0.2
        raise errors.fail(name, 'be letters of "xyz"', "is a robot: its tip's pose is ck.forward(robot, q)")
    if not isinstance(axes, str) or not axes or axes != "".join(a for a in AXES if a in axes):
        raise errors.fail(name, 'be letters of "xyz" in that order', f"is {axes!r}")
    return axes


def _task(weights, *parts):
    task = Task(parts=parts)
    return task if weights is None else replace(task, weights=_weights(task, weights))


def _weights(task, weights):
    if any(isinstance(part, Joints) and part.wanted is None for part in task.parts):
        return weights  # how many there are, the robot will say
    if isinstance(weights, _Several):
        each = zip(weights, task.slices, strict=True)
        weights = [np.ones(at.stop - at.start) if w is None else w for w, at in each]
        weights = (np if all(map(errors.concrete, weights)) else jnp).concatenate(weights)
    weights = errors.array("weights", weights, (task.m,))
    if errors.concrete(weights) and not np.all(np.asarray(weights) > 0):
        raise errors.fail("weights", "be positive", f"is {np.asarray(weights).tolist()}")
    return weights


class _Several(list):
    """Weights of each part, or None, until the robot says how many joints() there are."""


def _joined(tasks):
    """The weights of several tasks, one after the other; None where none has any."""
    if all(task.weights is None for task in tasks):
        return None
    several = _Several()
    for task in tasks:
        if isinstance(task.weights, _Several) or task.weights is None:
            several += task.weights or (None,) * len(task.parts)
        elif len(task.parts) == 1:
            several.append(task.weights)
        else:
            several += [task.weights[at] for at in task.slices]
    whole = Task(parts=tuple(part for task in tasks for part in task.parts))
    return _weights(whole, several)


# --- where the robot is -------------------------------------------------------------------------------


def coordinates(task: Task, robot: At):
    """x (m,)."""
    return jnp.concatenate([part.x(robot) for part in task.parts])


def error(task: Task, robot: At, aims):
    """e (m,), for an aim of each part."""
    return jnp.concatenate([part.error(robot, aim) for part, aim in zip(task.parts, aims, strict=True)])


def rows(task: Task, robot: At):
    """The rows of the task Jacobian (m, n), before weighting."""
    each = [part.rows(robot) for part in task.parts]
    return library(*each).concatenate(each, axis=-2)
