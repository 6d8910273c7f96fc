"""Parts of a task: coordinates of one kind, of one tip, with their error and their rows of the task Jacobian.

A part is a record with

  m, names, units          how many coordinates it has, and what they are;
  aim(position, rotation)       the target in the part's own form, of what a reference's curve gives;
  x(robot)                      (m,) its coordinates where the robot is;
  error(robot, aim)             (m,) what is missing;
  rows(robot, aim)              (m, n) what joint velocities take of the error; without an aim, where none is missing;
  motion(aim, rate)             (w,) the target's own velocity, from its derivative by time;
  velocity(robot, aim, motion)  (m,) what that adds to the error,

and with what exponential methods ask of two targets, `between` and the rest. Where a target is a vector
that is all subtraction (`Vector`); orientations have their own. Rows and velocity of a part that is `tied`, a
function of joint values and target, change with the target.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.record import record
from cnclik.robot.model import Frames, Model, jacobian_rows, moved, tip_frames
from cnclik.robot.rotations import axial, exp_so3, library, log_quaternion, log_so3, product

AXES = "xyz"
_HALF_TURN = 4 * 0.02**2  # 1 + the trace of a rotation by 177.7°


class At:
    """A robot at joint values q (n,): poses and motions of its tips, for the parts of a task.

    A tip is seen from the base, or from another tip `to`, in its frame, as it moves itself. Where all are NumPy's
    numbers, q may be (..., n).
    """

    def __init__(self, chain: Model, q):
        self.chain, self.q, self._frames, self._rows = chain, q, {}, {}

    @functools.cached_property
    def _moved(self) -> tuple[Model, Any, Any]:
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

    def rows(self, tip, to, linear, angular):
        """Return rows of the axes `linear` and `angular` of the tip's velocity (v, ω) by the joints': (m, n)."""
        return self._jacobian(tip, to)[..., np.array([*linear, *(3 + i for i in angular)], int), :]

    def _jacobian(self, tip, to):
        """Return (6, n), computed once."""
        between = self._number(tip), to
        if between not in self._rows:
            alone, every = to is None, (0, 1, 2)
            jacobian = jacobian_rows(self.chain, self.frames(tip), every, every) if alone else self._relative(tip, to)
            self._rows[between] = jacobian
        return self._rows[between]

    def _relative(self, tip, to):
        """Return (6, n) of a tip as seen from another."""
        own, its, at, other = self._jacobian(tip, None), self._jacobian(to, None), self.frames(tip), self.frames(to)
        (v, w), (vo, wo) = ((each[..., :3, :], each[..., 3:, :]) for each in (own, its))
        xp, turned, away = library(own, its), other.rotation.mT, (at.position - other.position)[..., None]
        v = turned @ (v - vo + xp.cross(away, wo, axis=-2))
        return xp.concatenate([v, turned @ (w - wo)], axis=-2)


def places(axes) -> np.ndarray:
    """Return indices of axes, letters of "xyz"."""
    return np.array([AXES.index(a) for a in axes], int)


class Vector:
    """Common methods of parts whose target is a vector in their own coordinates."""

    turns = False  # whether its target is a rotation
    tied: Any = False  # whether rows and velocity change with the target
    called = "values"  # what its target holds
    names: Any
    x: Callable

    @property
    def m(self):
        return len(self.names)

    @property
    def width(self):
        """Numbers of the target's motion."""
        return self.shape[0]

    def aim(self, position, rotation):
        return position

    def check(self, position, rotation):
        if position is None or len(position) != self.width:
            size, names = "none" if position is None else f"{len(position)}", ", ".join(self.names)
            raise errors.fail("reference", f"give {self.width} {self.called} ({names})", f"gives {size}")

    def here(self, robot: At):
        """Return the target at the robot's present pose; None where it is unknown."""
        return self.x(robot)

    @property
    def shape(self):
        """Of the target."""
        return (self.m,)

    def error(self, robot: At, aim):
        return aim - self.x(robot)

    def motion(self, aim, rate):
        return rate

    def velocity(self, robot: At, aim, motion):
        return motion

    def mean(self, aim, before):
        """Return how far a target went, as a motion, and None or its turn."""
        return aim - before, None

    def averaged(self, kept, before, aim):
        """Return one sample of a low-pass filter of the target, which keeps a share of what was before."""
        return kept * before + (1 - kept) * aim

    def chart(self, aim):
        """Return a vector whose changes are no smaller than those of the target."""
        return aim


@record
class Position(Vector):
    """Coordinates of a tip's position [m], in the base frame or in that of another tip."""

    axes: str
    tip: str | None = None
    to: str | None = None

    @property
    def names(self):
        return tuple(self.axes)

    @property
    def units(self):
        return ("m",) * self.m

    def aim(self, position, rotation):
        return position if len(position) == self.m else position[places(self.axes)]

    def check(self, position, rotation):
        if position is None or len(position) not in (self.m, 3):
            size = "no position" if position is None else f"{len(position)} coordinates"
            wanted = f"{self.m} coordinates ({self.axes!r})" + (" or 3" if self.m != 3 else "")
            raise errors.fail("reference", f"give positions of {wanted}", f"gives {size}")

    def x(self, robot: At):
        return robot.position(self.tip, self.to)[places(self.axes)]

    def rows(self, robot: At, aim=None):
        return robot.rows(self.tip, self.to, places(self.axes), ())


@record
class Orientation(Vector):
    """Components of a tip's rotation vector [rad], in the base frame or that of another tip.

    e = log(R_d Rᵀ), x = log R.
    """

    axes: str
    tip: str | None = None
    to: str | None = None
    turns, shape = True, (3, 3)

    @property
    def width(self):
        return self.m

    @property
    def names(self):
        return tuple("r" + a for a in self.axes)

    @property
    def units(self):
        return ("rad",) * self.m

    @property
    def whole(self):
        return self.m == 3

    def aim(self, position, rotation):
        return rotation

    def check(self, position, rotation):
        if rotation is None:
            raise errors.fail("reference", "give a rotation for this task", "gives a position only")

    def spread(self, w):
        """Return components (m,) as a vector (3,)."""
        return jnp.zeros(3, w.dtype).at[places(self.axes)].set(w)

    def x(self, robot: At):
        return log_so3(robot.rotation(self.tip, self.to))[places(self.axes)]

    def error(self, robot: At, aim):
        return log_so3(product(aim, robot.rotation(self.tip, self.to).T))[places(self.axes)]

    def here(self, robot: At):
        return robot.rotation(self.tip, self.to)

    def rows(self, robot: At, aim=None):
        return robot.rows(self.tip, self.to, (), places(self.axes))

    def motion(self, aim, rate):
        return spin(aim, rate)[places(self.axes)]

    def mean(self, aim, before):
        turn = aim @ before.T
        return log_of_step(turn)[places(self.axes)], turn if self.whole else None

    def averaged(self, kept, before, aim):
        return exp_so3((1 - kept) * log_so3(aim @ before.T)) @ before

    def chart(self, aim):
        """Return a rotation by its chord ‖R₂ − R₁‖ (Frobenius): the angle is at most π/√8 times it."""
        return 1.111 * aim.ravel()


def spin(rotation, drotation):
    """Return the angular velocity vee(Ṙ Rᵀ) in the base frame."""
    turning = drotation @ rotation.T
    return jnp.stack([turning[2, 1], turning[0, 2], turning[1, 0]])


def log_of_step(turn):
    """Return the rotation vector of a step's turn, exact to 177°: a target that turns farther in a step has jumped."""
    w = 0.5 * jnp.sqrt(jnp.maximum(1 + jnp.trace(turn), _HALF_TURN))
    return log_quaternion(w, 0.25 / w * axial(turn))
