"""The centre of mass as a task; walls keep it above the feet."""

from __future__ import annotations

from typing import Any

import numpy as np

from cnclik import errors
from cnclik.record import record, replace
from cnclik.robot.chain import Chain
from cnclik.robot.kinematics import as_joint_values
from cnclik.robot.masses import shares
from cnclik.robot.model import mass_frames, modelled
from cnclik.shapes import Array, ArrayLike, Float
from cnclik.task.build import Weights, letters_of
from cnclik.task.parts import At, Vector, places
from cnclik.task.task import Task, with_weights


@record
class Center(Vector):
    """See `center_of_mass`."""

    along: str  # letters of axes
    to: str | None = None
    bodies: Float[Array, "j+1 4"] | None = None  # see `robot.masses.shares`, once the robot is known
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
        """As a tip."""
        return mass_frames(chain, self.bodies, q)

    def x(self, robot: At):
        return robot.position(self, self.to)[..., places(self.along)]

    def rows(self, robot: At, aim=None):
        return robot.rows(self, self.to, places(self.along), ())


def center_of_mass(axes: str = "xyz", *, relative_to: str | None = None, weights: Weights = None) -> Task:
    """The robot's centre of mass as a task, c = Σ mₖ cₖ / Σ mₖ over its links [m]; its target is hold([x, y]).

    Masses come from `load_urdf` and `load_mjcf`. Links on joints that are no coordinates of the robot count at the
    position that these loaders give them. The rows are Σ mₖ Jₖ / Σ mₖ (Sugihara, Nakamura & Inoue 2002, eq. 5), Jₖ
    those of cₖ.

    Args:
      axes: letters of "xyz" in that order: "xy" for balance.
      relative_to: name of the tip, such as a foot, in whose frame the centre of mass is expressed; None: the base.
      weights: (m,) positive weights, or one for all.
    Raises: ArgumentError, when a law is made with it, for a robot without masses.
    """
    return with_weights(Task(parts=(Center(along=letters_of("axes", axes), to=relative_to),)), weights)


def com(chain: Chain, q: Float[ArrayLike, " n"], *, relative_to: str | None = None) -> Float[Array, " 3"]:
    """Centre of mass at q (n,), (3,) [m], as `center_of_mass` controls it.

    Raises: ArgumentError for a robot without masses.
    """
    part, q = Center(along="xyz", to=relative_to).on(errors.kind("chain", chain, Chain)), as_joint_values(chain, q)
    known: Any = np.asarray(q, float) if errors.concrete(q) and errors.concrete(part.bodies) else q
    return part.x(At(modelled(chain), known))
