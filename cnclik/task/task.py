"""Task: what the loop controls, as parts; x are its coordinates, e = x_d − x their error.

Of a pose these are positions [m], then components of the rotation vector [rad] that turns the tip as desired.
"""

from __future__ import annotations

import itertools
from typing import Any

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.record import ArrayLike, Float, brief, memoized, record, replace, xp_for
from cnclik.robot.chain import Chain
from cnclik.robot.rotations import library
from cnclik.task.parts import At, Joints, places

Part = Any  # one of those in `parts`, or of the same form


@record
class Task:
    """Task coordinates, as parts one after the other.

    Attributes:
      parts: positions, orientations, joints and functions, in the order of the coordinates.
      weights: (m,) of the coordinates, in the least-squares sense, or None; while a robot's joints are unknown, one of
        each part.
      tasks: of a stack the names of its tasks, and how many parts each has.
    """

    parts: tuple[Part, ...]
    weights: Float[ArrayLike, " m"] | tuple | None = None
    tasks: tuple[tuple[str, int], ...] = ()

    @property
    def m(self) -> int:
        """Number of task coordinates."""
        return sum(part.m for part in self.parts)

    @property
    def slices(self) -> tuple[slice, ...]:
        """Where the coordinates of each part stand."""
        return _slices(part.m for part in self.parts)

    @property
    def targets(self) -> tuple[tuple[tuple[str, ...], Task], ...]:
        """The targets that a reference must give: (task, tip) or (tip,), and the parts that each is for."""
        parts, targets = iter(self.parts), []
        for name, count in self.tasks or (("", len(self.parts)),):
            for (tip, _), some in itertools.groupby(itertools.islice(parts, count), lambda part: (part.tip, part.to)):
                targets.append(((name,) * bool(name) + (tip or "tip",), Task(parts=tuple(some))))
        return tuple(targets)

    @property
    def target_names(self) -> list[tuple[str, ...]]:
        """Of each target: its task and its tip, without a tip that is the only one."""
        before = [path[:-1] for path, _ in self.targets]
        return [path if before.count(path[:-1]) > 1 else path[:-1] for path, _ in self.targets]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates: x, y, z, rx, ry, rz; of several tasks or tips after theirs, as hands.x."""
        every = zip(self.target_names, self.targets, strict=True)
        return tuple(".".join([*path, name]) for path, (_, of) in every for part in of.parts for name in part.names)

    @property
    def units(self) -> tuple[str, ...]:
        return tuple(unit for part in self.parts for unit in part.units)

    @property
    def lengths(self) -> list[int]:
        """Which of the coordinates are in m: of a pose its position."""
        return [i for i, unit in enumerate(self.units) if unit == "m"]

    @property
    def angles(self) -> list[int]:
        """Which of the coordinates are in rad: of a pose its orientation."""
        return [i for i, unit in enumerate(self.units) if unit == "rad"]

    @property
    def each(self) -> tuple[tuple[str, slice], ...]:
        """The names of a stack's tasks, and where the coordinates of each stand."""
        sizes, parts = [part.m for part in self.parts], _slices(count for _, count in self.tasks)
        ends = _slices(sum(sizes[some]) for some in parts)
        return tuple((name, at) for (name, _), at in zip(self.tasks, ends, strict=True))

    def of(self, name: str) -> slice:
        """Return where the coordinates of a stack's task stand. Raises: ArgumentError for an unknown one."""
        each = dict(self.each)
        return each[errors.one_of("name", name, each)]

    def require_each(self, argument: str, must: str, names) -> None:
        """Raise ArgumentError unless these are the names of a stack's tasks, each once."""
        tasks = [name for name, _ in self.tasks]
        if not tasks or sorted(names) != sorted(tasks):
            have = ", ".join(tasks) or "none: they are given names by ck.stack(name=task, ...)"
            raise errors.fail(argument, f"{must}; they are {have}", f"has {', '.join(names) or 'none'}")

    @property
    def weight_of_parts(self) -> tuple:
        """The weights of each part, None for ones."""
        if self.weights is None or isinstance(self.weights, tuple):
            return self.weights or (None,) * len(self.parts)
        return tuple(self.weights[at] for at in self.slices)  # type: ignore[index]

    def only(self, kept) -> Task:
        """Return the task of some parts, a stack without its names. Args: kept: of each part, whether it stays."""
        parts, weights = (itertools.compress(each, kept) for each in (self.parts, self.weight_of_parts))
        return weighted(tuple(parts), weights)

    def alone(self, name: str) -> Task:
        """Return one of a stack's tasks."""
        where = self.of(name)
        return self.only([where.start <= at.start < where.stop for at in self.slices])

    def on(self, chain) -> Task:
        """Return the task on this robot. Raises: ArgumentError for tips and joints that the robot has not."""
        for part in self.parts:
            for tip in [part.tip] * hasattr(part, "axes") + [part.to] * (part.to is not None):
                chain.tip_number(tip)
        parts = tuple(part.on(chain) if hasattr(part, "on") else part for part in self.parts)
        if all(new is old for new, old in zip(parts, self.parts, strict=True)):
            return self
        return replace(weighted(parts, self.weight_of_parts), tasks=self.tasks)

    def rows_at(self, chain, q):
        """Return the task Jacobian (..., m, n) of a `Model` at q (n,), or in NumPy (..., n), before weighting."""
        return rows(self, At(chain, q))

    # --- of a task of one tip's pose alone ---

    @property
    def of_one_tip(self) -> bool:
        """Whether it is of one tip's pose in the base frame."""
        alone = not self.tasks and len(self.targets) == 1
        return alone and all(part.to is None and hasattr(part, "axes") for part in self.parts)

    @property
    def position(self) -> str:
        """Letters of the axes along which one tip is placed."""
        return self._axes(False)

    @property
    def orientation(self) -> str:
        """Letters of the axes about which one tip is turned."""
        return self._axes(True)

    def _axes(self, turns):
        if not self.of_one_tip:
            raise errors.fail("task", "be of one tip's pose for this", f"is {self!r}")
        return "".join(part.axes for part in self.parts if part.turns == turns)

    def __and__(self, other: Task) -> Task:
        if self.tasks or errors.kind("task", other, Task, "be a task such as ck.position()").tasks:
            raise errors.fail("task", "be joined before it has names, by ck.stack(name=task & task)", "has names")
        made = weighted(self.parts + other.parts, self.weight_of_parts + other.weight_of_parts)
        kinds = [{part.turns for part in of.parts} for _, of in made.targets]
        if len(dict(made.targets)) < len(kinds) or sum(map(len, kinds)) < len(made.parts):
            raise errors.fail("task", "have each position, orientation and joints once, tip by tip", f"is {made!r}")
        return made

    def __repr__(self):
        said = []
        for path, of in self.targets:
            parts = ", ".join(map(_in_words, of.parts))
            about = f" of {path[-1]}" if len(self.targets) > 1 and path[-1] != "joints" else ""
            said.append("".join(f"{name}: " for name in path[:-1]) + parts + about)
        return f"Task: {'; '.join(said)}" + ("" if self.weights is None else f", weights {brief(self.weights)}")


def _in_words(part) -> str:
    """Return a text such as "x, y, z [m]". Joints that are all of a robot have no names or units until it is known."""
    if isinstance(part, Joints) and part.wanted is None:
        return "all joints"
    return ", ".join(part.names) + f" [{', '.join(dict.fromkeys(part.units))}]" * bool(part.units)


def _slices(sizes):
    ends = [0, *itertools.accumulate(sizes)]
    return tuple(slice(a, b) for a, b in itertools.pairwise(ends))


# --- weights ---------------------------------------------------------------------------------------


def weighted(parts, each) -> Task:
    """Return the task of some parts with a weight of each: None, a number, or one per coordinate.

    They stay so while a part has as many coordinates as a robot has joints, and no robot is known.
    """
    each = tuple(each)
    if all(weights is None for weights in each):
        return Task(parts=parts)
    if any(isinstance(part, Joints) and part.wanted is None for part in parts):
        return Task(parts=parts, weights=each)
    whole = [spread(1.0 if weights is None else weights, part.m) for weights, part in zip(each, parts, strict=True)]
    return Task(parts=parts, weights=xp_for(whole).concatenate(whole))


def spread(weights, m):
    """Return positive weights (m,), of one number for all, too."""
    weights = errors.array("weights", weights, (), (m,), positive=True)
    return weights if weights.ndim else weights * np.ones(m)


# --- where the robot is -------------------------------------------------------------------------------


def coordinates(task: Task, robot: At):
    """Return x (m,)."""
    return jnp.concatenate([part.x(robot) for part in task.parts])


def error(task: Task, robot: At, aims):
    """Return e (m,), for an aim of each part."""
    return jnp.concatenate([part.error(robot, aim) for part, aim in zip(task.parts, aims, strict=True)])


def rows(task: Task, robot: At):
    """Return the rows of the task Jacobian (m, n), before weighting."""
    each = [part.rows(robot) for part in task.parts]
    return library(*each).concatenate(each, axis=-2)


# --- aims: what a task asks of each tip, a position, an orientation, or both ---------------------------------

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
    every: list = []
    for path, of in task.targets:
        if not all(hasattr(part, "axes") for part in of.parts):
            raise errors.fail("task", "be of positions and orientations of tips", f"has {', '.join(of.names)}")
        axes = {part.turns: tuple(range(3)[places(part.axes)]) for part in of.parts}
        tip, to, linear, angular = of.parts[0].tip, of.parts[0].to, axes.get(False, ()), axes.get(True, ())
        every.append(Aim(path=path, parts=of.parts, tip=tip, to=to, linear=linear, angular=angular))
    return tuple(every)


def of_tips(task: Task) -> Task:
    """The parts of a task that are poses of tips. Raises: ArgumentError where there are none."""
    kept = [hasattr(part, "axes") for part in task.parts]
    if all(kept):
        return task
    if not any(kept):
        raise errors.fail("task", "be of positions and orientations of tips", f"has {', '.join(task.names)}")
    left = iter(kept)
    counts = [(name, sum(itertools.islice(left, count))) for name, count in task.tasks]
    return replace(task.only(kept), tasks=tuple((name, count) for name, count in counts if count))


def told_apart(task: Task) -> str:
    """A text that differs for tasks with different aims."""
    return str([aim.parts for aim in aims(task)])


def owners(task: Task, chain: Chain) -> np.ndarray:
    """(n,) the number of the aim whose tip each joint moves; the first one of several."""
    ways = [{chain.joints[i].coordinate for i in aim.way(chain)} for aim in aims(task)]
    return np.array([next((k for k, way in enumerate(ways) if i in way), 0) for i in range(chain.n)], np.int32)
