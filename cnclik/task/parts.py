"""Parts of a task: coordinates of one kind, of one tip, with their error and their rows of the task Jacobian.

A part is a record with

  m, names, units          how many coordinates it has, and what they are;
  aim(position, rotation)  the target in the part's own form, of what a reference's curve gives;
  here(robot)              the target that is reached where the robot is;
  x(robot)                 (m,) its coordinates there;
  error(robot, aim)        (m,) what is missing;
  rows(robot)              (m, n) what joint velocities take of the error;
  motion(aim, rate)        (m,) the target's velocity, from its derivative by time;
  mean(aim, before)        (m,) how far a target went, and None or its turn, for exponential methods.

Where a target is a vector that is all subtraction (`Vector`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.record import record, replace
from cnclik.robot import chart
from cnclik.robot.model import Frames, Model, jacobian_at, moved, tip_frames
from cnclik.robot.rotations import library, log_quaternion, log_so3, product

AXES = "xyz"


class At:
    """A robot at joint values q (n,): poses and motions of its tips, for the parts of a task.

    A tip is seen from the base, or from another tip `to`, in its frame, as it moves itself. Where all are NumPy's
    numbers, q may be (..., n).
    """

    def __init__(self, chain: Model, q):
        self.chain, self.q, self._frames, self._rows = chain, q, {}, {}

    @functools.cached_property
    def _moved(self) -> tuple[Model, Any]:
        return moved(self.chain, self.q)

    def frames(self, tip) -> Frames:
        """Return the frames of a tip by its name, of the only one, or of a part `seen` as one; each computed once."""
        number = self._number(tip)
        if number not in self._frames:
            self._frames[number] = tip.seen(self.chain, self.q) if number < 0 else tip_frames(*self._moved, number)
        return self._frames[number]

    def _number(self, tip):
        return -1 if hasattr(tip, "seen") else self.chain.tip_number(tip)

    def position(self, tip, to=None):
        """Return the position (3,) of a tip [m]."""
        if to is None:
            return self.frames(tip).position
        away = self.frames(tip).position - self.frames(to).position
        return (away[..., None, :] @ self.frames(to).rotation)[..., 0, :]

    def rotation(self, tip, to=None):
        """Return the rotation (3, 3) of a tip."""
        own = self.frames(tip).rotation
        return own if to is None else self.frames(to).rotation.mT @ own

    def jacobian(self, tip, to=None):
        """Return the tip's velocity (v, ω) by the joints', (6, n); computed once."""
        between = self._number(tip), to
        if between not in self._rows:
            jacobian = jacobian_at(self.chain, self.frames(tip)) if to is None else self._relative(tip, to)
            self._rows[between] = jacobian
        return self._rows[between]

    def _relative(self, tip, to):
        """Return (6, n) of a tip as seen from another."""
        own, its, at, other = self.jacobian(tip), self.jacobian(to), self.frames(tip), self.frames(to)
        (v, w), (vo, wo) = ((each[..., :3, :], each[..., 3:, :]) for each in (own, its))
        xp, turned, away = library(own, its), other.rotation.mT, (at.position - other.position)[..., None]
        v = turned @ (v - vo + xp.cross(away, wo, axis=-2))
        return xp.concatenate([v, turned @ (w - wo)], axis=-2)


def places(axes: str) -> slice:
    """Return where axes are among "xyz"."""
    return slice(AXES.index(axes[0]), AXES.index(axes[-1]) + 1, 2 if axes == "xz" else 1)


class Vector:
    """Common methods of parts whose target is a vector in their own coordinates."""

    turns = False  # whether its target is a rotation
    names: Any
    x: Callable

    @property
    def m(self):
        return len(self.names)

    def aim(self, position, rotation):
        return position

    def check(self, position, rotation):
        size = 0 if position is None else len(position)
        if size not in (self.m, 3 if hasattr(self, "axes") else self.m):
            raise errors.fail("reference", f"give {self.m} values ({', '.join(self.names)})", f"gives {size}")

    def here(self, robot: At):
        return self.x(robot)

    def error(self, robot: At, aim):
        return aim - self.x(robot)

    def motion(self, aim, rate):
        return rate

    def mean(self, aim, before):
        return aim - before, None


@record
class Position(Vector):
    """Coordinates of a tip's position [m], in the base frame or in that of another tip."""

    axes: str
    tip: str | None = None
    to: str | None = None
    unit = "m"

    @property
    def names(self):
        return tuple(self.axes)

    @property
    def units(self):
        return (self.unit,) * self.m

    def aim(self, position, rotation):
        return position if len(position) == self.m else position[places(self.axes)]

    def x(self, robot: At):
        return robot.position(self.tip, self.to)[places(self.axes)]

    def rows(self, robot: At):
        return robot.jacobian(self.tip, self.to)[..., places(self.axes), :]


@record
class Orientation(Position):
    """Components of a tip's rotation vector [rad], in the base frame or that of another tip.

    e = log(R_d Rᵀ), x = log R.
    """

    turns, unit = True, "rad"

    @property
    def names(self):
        return tuple("r" + a for a in self.axes)

    def aim(self, position, rotation):
        return rotation

    def check(self, position, rotation):
        if getattr(rotation, "shape", None) != (3, 3):
            found = "gives a position only" if rotation is None else f"gives one of shape {rotation.shape}"
            raise errors.fail("reference", "give a rotation for this task", found)

    def x(self, robot: At):
        return log_so3(robot.rotation(self.tip, self.to))[places(self.axes)]

    def error(self, robot: At, aim):
        return log_so3(product(aim, robot.rotation(self.tip, self.to).T))[places(self.axes)]

    def here(self, robot: At):
        return robot.rotation(self.tip, self.to)

    def rows(self, robot: At):
        return robot.jacobian(self.tip, self.to)[..., 3:, :][..., places(self.axes), :]

    def motion(self, aim, rate):
        return spin(aim, rate)[places(self.axes)]

    def mean(self, aim, before):
        turn = aim @ before.T
        return _log_of_step(turn)[places(self.axes)], turn if self.m == 3 else None


def spin(rotation, drotation):
    """Return the angular velocity vee(Ṙ Rᵀ) in the base frame."""
    turning = drotation @ rotation.T
    return jnp.stack([turning[2, 1], turning[0, 2], turning[1, 0]])


def _log_of_step(turn):
    """Return the rotation vector of a step's turn, exact to 177°: a target that turns farther in a step has jumped."""
    w = 0.5 * jnp.sqrt(jnp.maximum(1 + jnp.trace(turn), 4 * 0.02**2))
    axis = jnp.stack([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return log_quaternion(w, 0.25 / w * axis)


# --- parts that are no tip's pose -----------------------------------------------------------------------


@record
class Joints(Vector):
    """Joint values themselves [rad, m]: a posture as a task."""

    wanted: tuple[str, ...] | None  # names of joints; None: all
    which: tuple[int, ...] | None = None  # set by `on`, for the robot
    units: tuple[str, ...] = ()
    tip, to = "joints", None

    @property
    def names(self):
        if self.wanted is None:
            raise errors.fail("task", "name its joints where no robot is known", "is joints() of all of them")
        return self.wanted

    def on(self, chain):
        if self.which is not None:
            return self
        turned = {i + k for _, i in chain.balls for k in range(3)}
        wanted, names = self.wanted, chain.joint_names
        if wanted is None:  # all joints but floating ones
            bodies = {names[i][:-2] + names[i][-1] for i in turned}  # base_x of base_rx
            wanted = tuple(name for i, name in enumerate(names) if i not in turned and name not in bodies)
        which = tuple(names.index(errors.one_of("joints", name, names)) for name in wanted)
        if bad := [names[i] for i in which if i in turned]:
            must = "leave out rotations, which ck.orientation(tip=...) of the link that turns is for"
            raise errors.fail("joints", must, f"name {bad[0]}")
        return replace(self, wanted=wanted, which=which, units=tuple(chain.units[i] for i in which))

    def x(self, robot: At):
        return robot.q[np.array(self.which)]

    def rows(self, robot: At):
        q = robot.q
        rows = np.eye(robot.chain.n)[np.array(self.which)].astype(q.dtype)
        return library(q).broadcast_to(rows, (*q.shape[:-1], *rows.shape))


@record
class Function(Vector):
    """Any differentiable function of the joint values, see `function`."""

    value: Callable
    names: tuple[str, ...]
    units: tuple[str, ...]
    tip, to = "function", None

    def x(self, robot: At):
        values = jnp.asarray(self.value(robot.chain, robot.q))
        if values.shape != (self.m,):
            raise errors.fail("value", f"return shape ({self.m},), one of each name", f"returns shape {values.shape}")
        return values.astype(robot.q.dtype)

    def rows(self, robot: At):
        def derivative(q):
            moved = jax.jacfwd(lambda y: self.x(At(robot.chain, chart.out(robot.chain, q, y))))
            return moved(chart.centre(robot.chain, q))

        return derivative(robot.q) if robot.q.ndim == 1 else np.asarray(jax.vmap(derivative)(robot.q))
