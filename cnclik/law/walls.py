"""Walls: boundaries that no part of the robot may cross, as one-sided rows ∇h·q̇ ≥ −rate·h with the distance h ≥ 0."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.record import Array, ArrayLike, Float, Number, leaf, record, replace
from cnclik.robot.model import modelled
from cnclik.task.parts import At
from cnclik.task.task import Task, coordinates, rows


class Rows(NamedTuple):
    """G q̇ ≥ floor."""

    rows: Float[Array, "k n"]
    floor: Float[Array, " k"]

    def size(self, qdot):
        """Return the size (k,) of the terms of each violation, for its rounding."""
        return jnp.abs(self.floor) + jnp.abs(self.rows) @ jnp.abs(qdot)

    def missed(self, qdot):
        """Return whether (k,) walls are violated by more than their softness allows."""
        size = self.size(qdot)
        return self.floor - self.rows @ qdot > 4 * float(jnp.finfo(size.dtype).eps) ** 0.5 * size


@record
class Wall:
    """See `wall`."""

    task: Task
    normal: Float[Array, " m"]
    offset: Number
    rate: Any  # `bounded` replaces None by its own
    name: str  # and "" by the wall's number

    def on(self, chain) -> Wall:
        return replace(self, task=self.task.on(chain))

    def distance(self, robot: At):
        """Return h = normal·x − offset."""
        return self.normal @ coordinates(self.task, robot) - self.offset

    def row(self, robot: At):
        """Return ∇h (n,)."""
        return self.normal @ rows(self.task, robot)


def rows_at(walls, chain, q) -> Rows:
    """Return the rows of all walls at q."""
    if not walls:
        return Rows(jnp.zeros((0, len(q)), q.dtype), jnp.zeros(0, q.dtype))
    robot = At(modelled(chain), q)
    floor = jnp.stack([-wall.rate * wall.distance(robot) for wall in walls])
    return Rows(jnp.stack([wall.row(robot) for wall in walls]), floor)


def wall(
    task: Task,
    *,
    above: Number | None = None,
    below: Number | None = None,
    normal: Float[ArrayLike, " m"] | None = None,
    rate: Number | None = None,
    name: str = "",
) -> Wall:
    """Keep the coordinate of a task above, or below, a number: a wall for `bounded(walls=[...])`.

    `wall(position("z", tip="elbow"), above=0.1)` keeps an elbow above a table, and
    `wall(distance(sphere("hand", 0.08), capsule("thigh", 0.09, ...)), above=0.02)` a hand off a leg. Joint velocities
    satisfy ∇h·q̇ ≥ −rate·h, where h is the distance to the wall: it is approached exponentially, and from behind it the
    robot comes back. A velocity that is constant over Ts may pass it by κ v² Ts/(2 rate), where the motion bends by κ.

    Args:
      task: a task of one coordinate, or of several with a normal: positions, joints, distances, functions.
      above, below: one of them [unit of the coordinate].
      normal: (m,) for several coordinates: the wall is about normal·x; with unit length h is a distance.
      rate: [1/s], at most 1/Ts; None: the rate of `bounded`.
      name: name of the wall in messages and results; default: its number.
    """
    task = errors.kind("task", task, Task)
    if any(part.turns for part in task.parts):
        raise errors.fail("task", "be of positions, joints, distances or functions", f"is {task!r}")
    if (above is None) == (below is None):
        found = "neither is" if above is None else "both are"
        raise errors.fail("above", "be given, or `below`, but not both", found)
    if normal is None and task.m != 1:
        raise errors.fail("normal", f"be given for {task.m} coordinates", "is not")
    normal = errors.array("normal", np.ones(1) if normal is None else normal, (task.m,))
    offset = errors.number("above", above) if below is None else -errors.number("below", below)
    normal = normal if below is None else -normal
    rate = None if rate is None else leaf(errors.number("rate", rate, positive=True))
    return Wall(task=task, normal=normal, offset=leaf(offset), rate=rate, name=str(name))
