"""Masses: mass and centre of mass carried by the base and by each joint."""

import functools
from typing import Any

from cnclik import errors
from cnclik.record import Array, Float, Number
from cnclik.robot.fixed import ZERO, Offset, Triple, placed, scale, vadd
from cnclik.robot.poses import library

Mass = tuple[Number, Triple]  # [kg] of the links between a joint and the next ones; their centre in its frame [m]
Masses = tuple[Mass, ...]  # of the base, then of each joint; () if they are unknown


def _sum(*each: Mass) -> Mass:
    """Return several masses as one."""
    whole = sum(mass for mass, _ in each)
    moment = functools.reduce(vadd, (scale(mass, center) for mass, center in each), ZERO)
    return (whole, scale(1.0 / whole, moment)) if each else (0.0, ZERO)


def lumped(inertials: dict, at: dict, count: int) -> Masses:
    """Return the masses of the base and of each joint; () if there are none.

    Args:
      inertials: {link: (mass, its centre in the link's frame)}.
      at: {link: (index of the joint that carries it, −1 for the base; its place in that frame)}.
      count: of joints.
    """
    carried: list = [[] for _ in range(count + 1)]
    for link, (mass, center) in inertials.items():
        if link in at:
            joint, offset = at[link]
            carried[joint + 1].append((mass, placed(offset, center)))
    return tuple(_sum(*each) for each in carried) if any(carried) else ()


def put(masses: Masses, base: Offset) -> Masses:
    """Return the masses of a robot with its base moved."""
    return (*((mass, placed(base, center)) for mass, center in masses[:1]), *masses[1:])


def joined(one, other, joint: int, base: Offset) -> Masses:
    """Return the masses of a robot that carries another one on a joint, from a place there; () if one has none."""
    if not (one.masses and other.masses):
        return ()
    (first, *above), below = put(other.masses, base), list(one.masses)
    below[joint + 1] = _sum(*(mass for mass in (below[joint + 1], first) if mass[0]))
    return (*below, *above)


def shares(chain) -> Float[Array, "j+1 4"]:
    """Return for the base, then for each joint its share s of the total mass and its centre, as s·(c, 1).

    Raises: ArgumentError for a robot without masses.
    """
    if not chain.masses:
        found = "has none, or was joined from one without"
        raise errors.fail("robot", "have masses, as of a URDF file with <inertial> in its links", found)
    each: Any = [[*scale(mass, center), mass] for mass, center in chain.masses]
    each = library(each).array(each, float)
    return each / each[:, 3].sum()
