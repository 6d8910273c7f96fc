"""The tasks that users ask for: position, orientation, pose, joints, function; and stacks of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from cnclik import errors
from cnclik.record import Array, ArrayLike, Float, record, replace
from cnclik.robot.chain import Chain
from cnclik.robot.model import as_joint_values, mass_frames, modelled
from cnclik.robot.mounted import shares
from cnclik.task.parts import AXES, At, Function, Joints, Orientation, Position, Vector, places
from cnclik.task.task import Task, spread, weighted

Weights = Float[ArrayLike, " m"] | None
Tip = str | None


def position(axes: str = "xyz", *, tip: Tip = None, relative_to: Tip = None, weights: Weights = None) -> Task:
    """Control the position of a tip along some of the axes of a frame [m].

    Args:
      axes: letters of "xyz" in that order, such as "xy".
      tip: its name; None: the robot's only one.
      relative_to: name of the tip in whose frame the position is expressed; None: the base.
      weights: (m,) positive least-squares weights of the coordinates, one number for all, or None for ones.
    """
    return _task(weights, _part(Position, "axes", axes, tip, relative_to))


def orientation(axes: str = "xyz", *, tip: Tip = None, relative_to: Tip = None, weights: Weights = None) -> Task:
    """Control the orientation of a tip: error log(R_d Rᵀ), a rotation vector in the frame of the position's axes [rad].

    Args:
      axes: components of the rotation vector that count, such as "z" for a planar arm.
      tip, relative_to, weights: as for `position`.
    """
    return _task(weights, _part(Orientation, "axes", axes, tip, relative_to))


def pose(
    axes: str = "xyz",
    rotation_axes: str = "xyz",
    *,
    tip: Tip = None,
    relative_to: Tip = None,
    weights: Weights = None,
) -> Task:
    """Control position [m] and orientation [rad] of a tip; `pose("xy", "z")` is the whole pose in a plane.

    Args: as for `position` and `orientation`.
    """
    place = _part(Position, "axes", axes, tip, relative_to)
    return _task(weights, place, _part(Orientation, "rotation_axes", rotation_axes, tip, relative_to))


def _part(kind, name, axes, tip, to):
    if to is not None and to == tip:
        raise errors.fail("relative_to", "be another tip than `tip`", f"is {to!r}, too")
    return kind(axes=_letters(name, axes), tip=tip, to=to)


def _letters(name, axes):
    if not isinstance(axes, str) or not axes or axes != "".join(a for a in AXES if a in axes):
        raise errors.fail(name, 'be letters of "xyz" in that order', f"is {axes!r}")
    return axes


def _task(weights, *parts):
    """Return the task of parts with weights: None, one for all coordinates, or (m,)."""
    if weights is None or len(parts) == 1:
        return weighted(parts, (weights,) * len(parts))
    return Task(parts=parts, weights=spread(weights, sum(part.m for part in parts)))


def joints(names: Sequence[str] | None = None, *, weights: Weights = None) -> Task:
    """Control joint values, such as a posture: x = q of these joints [rad, m]; its target is hold(values=...).

    Args:
      names: of the joints; None: all but those of a free base.
      weights: as for `position`.
    """
    return _task(weights, Joints(wanted=None if names is None else _names("names", names)))


def function(
    value: Callable,
    names: Sequence[str],
    units: Sequence[str],
    *,
    weights: Weights = None,
) -> Task:
    """Control a function of the joint values, x = value(robot, q); its rows are its derivative, by JAX.

    Where a faster form of a derivative is known, give the function that one by `jax.custom_jvp`.

    Args:
      value: (robot, q (n,)) to (m,), differentiable, such as the distance of a tip from a point: lambda robot, q:
        jnp.linalg.norm(ck.forward(robot, q, tip="hand").position - point)[None].
      names, units: of the m coordinates.
      weights: as for `position`.
    """
    if not callable(value):
        raise errors.fail("value", "be a function of the robot and q", f"is {value!r}")
    names, units = _names("names", names), _names("units", units)
    if len(names) != len(units):
        raise errors.fail("units", f"be as many as `names`, {len(names)}", f"are {len(units)}")
    return _task(weights, Function(value=value, names=names, units=units))


def _names(name, value):
    several = (value,) if isinstance(value, str) else value
    if not isinstance(several, (list, tuple)) or not several or not all(isinstance(text, str) for text in several):
        raise errors.fail(name, "be texts, at least one", f"is {value!r}")
    return tuple(several)


def stack(**tasks: Task) -> Task:
    """Control named tasks together: `stack(hands=pose(tip="left") & pose(tip="right"), rest=joints())`.

    Conflicts between them are resolved by their weights, or by the levels of an inverse such as `levels`.

    Raises: ArgumentError naming the argument that is no task.
    """
    if not tasks:
        raise errors.fail("tasks", "be at least one, such as hands=ck.pose(tip=...)", "are none")
    for name, task in tasks.items():
        if errors.kind(name, task, Task, "be a task such as ck.position()").tasks:
            raise errors.fail(name, "be a task without names of its own", "is a stack")
    parts = tuple(part for task in tasks.values() for part in task.parts)
    whole = weighted(parts, (weights for task in tasks.values() for weights in task.weight_of_parts))
    return replace(whole, tasks=tuple((name, len(task.parts)) for name, task in tasks.items()))


# --- the centre of mass; walls keep it above the feet -------------------------------------------------


@record
class Center(Vector):
    """See `center_of_mass`."""

    along: str  # letters of axes
    to: str | None = None
    bodies: Float[Array, "j+1 4"] | None = None  # see `robot.mounted.shares`, once the robot is known
    tip = "center_of_mass"

    @property
    def names(self):
        return tuple(self.along)

    @property
    def units(self):
        return ("m",) * self.m

    def on(self, chain):
        return self if self.bodies is not None else replace(self, bodies=shares(chain))

    def seen(self, chain, q):
        """Return its frames, as those of a tip."""
        return mass_frames(chain, self.bodies, q)

    def x(self, robot: At):
        return robot.position(self, self.to)[..., places(self.along)]

    def rows(self, robot: At):
        return robot.jacobian(self, self.to)[..., places(self.along), :]


def center_of_mass(axes: str = "xyz", *, relative_to: str | None = None, weights: Weights = None) -> Task:
    """Control the robot's centre of mass, c = Σ mₖ cₖ / Σ mₖ over its links [m]; its target is hold([x, y]).

    Masses come from `load_urdf` and `load_mjcf`, and so does the position of links on joints that are no coordinates.
    The rows are Σ mₖ Jₖ / Σ mₖ (Sugihara, Nakamura & Inoue 2002, eq. 5), Jₖ those of cₖ.

    Args:
      axes: letters of "xyz" in that order: "xy" for balance.
      relative_to: name of the tip, such as a foot, in whose frame it is expressed; None: the base.
      weights: as for `position`.
    Raises: ArgumentError, when a law is made with it, for a robot without masses.
    """
    return _task(weights, Center(along=_letters("axes", axes), to=relative_to))


def com(chain: Chain, q: Float[ArrayLike, " n"], *, relative_to: str | None = None) -> Float[Array, " 3"]:
    """Return the centre of mass at q (n,), (3,) [m], as `center_of_mass` controls it.

    Raises: ArgumentError for a robot without masses.
    """
    part, q = Center(along="xyz", to=relative_to).on(errors.kind("chain", chain, Chain)), as_joint_values(chain, q)
    known: Any = np.asarray(q, float) if errors.concrete(q) and errors.concrete(part.bodies) else q
    return part.x(At(modelled(chain), known))
