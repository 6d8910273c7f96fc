"""Task: which coordinates of the tip's pose the loop controls, and their error.

x are the task coordinates, e = x_d − x their error: positions along chosen axes [m], then the rotation
vector [rad] that turns the tip into the desired orientation, in the base frame.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.record import brief, record
from cnclik.robot.model import Frames, jacobian_rows
from cnclik.robot.rotations import log_so3
from cnclik.shapes import Array, ArrayLike, Float

_AXES = "xyz"


@record
class Task:
    """Task coordinates: positions along `position`, then rotations about `orientation` (letters of "xyz")."""

    position: str
    orientation: str
    weights: Float[Array, " m"] | None = None  # of the coordinates, in the least-squares sense

    @property
    def m(self) -> int:
        """Number of task coordinates."""
        return len(self.position) + len(self.orientation)

    @property
    def linear(self) -> tuple:
        return tuple(_AXES.index(a) for a in self.position)

    @property
    def angular(self) -> tuple:
        return tuple(_AXES.index(a) for a in self.orientation)

    @property
    def names(self) -> tuple:
        """Names of the task coordinates, in order: x, y, z for positions, rx, ry, rz for rotations."""
        return (*self.position, *("r" + a for a in self.orientation))

    @property
    def units(self) -> tuple:
        return ("m",) * len(self.position) + ("rad",) * len(self.orientation)

    def __repr__(self):
        parts = [f"{', '.join(self.position)} [m]"] if self.position else []
        parts += [f"{', '.join('r' + a for a in self.orientation)} [rad]"] if self.orientation else []
        return f"Task: {', '.join(parts)}" + ("" if self.weights is None else f", weights {brief(self.weights)}")


def position(axes: str = "xyz", *, weights: Float[ArrayLike, " m"] | None = None) -> Task:
    """Position of the tip along some of the base axes [m].

    Args:
      axes: letters of "xyz" in that order, such as "xy".
      weights: (m,) positive weights of the coordinates in the least-squares sense, or None.
    """
    return _task(_letters("axes", axes), "", weights)


def orientation(axes: str = "xyz", *, weights: Float[ArrayLike, " m"] | None = None) -> Task:
    """Orientation of the tip: error log(R_d Rᵀ) as a rotation vector in the base frame [rad].

    Args:
      axes: components of the rotation vector that count, such as "z" for a planar arm.
      weights: (m,) positive weights, or None.
    """
    return _task("", _letters("axes", axes), weights)


def pose(axes: str = "xyz", rotation_axes: str = "xyz", *, weights: Float[ArrayLike, " m"] | None = None) -> Task:
    """Position [m] and orientation [rad] of the tip; `pose("xy", "z")` is the whole pose in a plane."""
    return _task(_letters("axes", axes), _letters("rotation_axes", rotation_axes), weights)


def _letters(name, axes):
    if hasattr(axes, "joints"):  # of a robot, whose tip's pose `ck.pose` was until 0.2
        raise errors.fail(name, 'be letters of "xyz"', "is a robot: its tip's pose is ck.forward(robot, q)")
    if not isinstance(axes, str) or not axes or axes != "".join(a for a in _AXES if a in axes):
        raise errors.fail(name, 'be letters of "xyz" in that order', f"is {axes!r}")
    return axes


def _task(position, orientation, weights):
    task = Task(position=position, orientation=orientation)
    if weights is None:
        return task
    weights = errors.array("weights", weights, (task.m,))
    if errors.concrete(weights) and not np.all(np.asarray(weights) > 0):
        raise errors.fail("weights", "be positive", f"is {np.asarray(weights).tolist()}")
    return Task(position=position, orientation=orientation, weights=weights)


def error_and_rows(task: Task, chain, at: Frames, position_d, rotation_d):
    """The error e (m,) and the rows of the task Jacobian (m, n), before weighting."""
    e = position_d - at.position[np.array(task.linear, int)]
    if task.orientation:
        e = jnp.concatenate([e, log_so3(rotation_d @ at.rotation.T)[np.array(task.angular, int)]])
    return e, jacobian_rows(chain, at, task.linear, task.angular)


def coordinates(task: Task, position, rotation):
    """Task coordinates x (m,) of a pose: positions [m], then components of its rotation vector [rad]."""
    x = position[np.array(task.linear, int)]
    return jnp.concatenate([x, log_so3(rotation)[np.array(task.angular, int)]]) if task.orientation else x
