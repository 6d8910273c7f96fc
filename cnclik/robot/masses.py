"""Masses: mass and centre of mass carried by each joint."""

import functools
from typing import Any

from cnclik import errors
from cnclik.record import Array, Float, Number, record, replace
from cnclik.robot.fixed import ZERO, Offset, Triple, placed, scale, vadd
from cnclik.robot.poses import library


@record
class Mass:
    """Mass and centre of mass of the links between a joint (or the base) and the next joints."""

    mass: Number = 0.0  # [kg]
    center: Triple = ZERO  # [m], in the joint's frame, or in the base's for its mass


Masses = tuple[Mass | None, ...]  # of the base, then of each joint; None where the file gives none


def _sum(*each: tuple) -> Mass:
    """Several (mass, centre) as one."""
    whole = sum(mass for mass, _ in each)
    moment = functools.reduce(vadd, (scale(mass, center) for mass, center in each), ZERO)
    return Mass(mass=whole, center=scale(1.0 / whole, moment)) if each else Mass()


def lumped(inertials: dict, at: dict, count: int) -> Masses:
    """The masses of the base and of each joint; () if there are none.

    Args:
      inertials: {link: (mass, its centre in the link's frame)}.
      at: {link: (index of the joint that carries it, −1 for the base; its place in that frame)}.
      count: of joints.
    """
    found: list = [[] for _ in range(count + 1)]
    for link, (mass, center) in inertials.items():
        if link in at:
            joint, offset = at[link]
            found[joint + 1].append((mass, placed(offset, center)))
    return tuple(_sum(*each) for each in found) if any(found) else ()


def put(masses: Masses, base: Offset) -> Masses:
    """The masses of a robot with its base moved."""
    first = [replace(m, center=placed(base, m.center)) if m else None for m in masses[:1]]
    return (*first, *masses[1:])


def added(one, other, joint: int, base: Offset) -> Masses:
    """The masses of a robot that carries another one on a joint, from a place there; () if both have none."""
    if not (one.masses or other.masses):
        return ()
    below, above = (robot.masses or (None,) * (1 + len(robot.joints)) for robot in (one, other))
    both = [(m.mass, m.center) for m in (below[joint + 1], *put(above[:1], base)) if m and m.mass]
    carrier = below[joint + 1] and _sum(*both)
    return (*below[: joint + 1], carrier, *below[joint + 2 :], *above[1:])


def shares(chain) -> Float[Array, "j+1 4"]:
    """For the base, then for each joint: its share s of the total mass and its centre, as s·(c, 1).

    Raises: ArgumentError for a robot without masses.
    """
    moved = zip(chain.joints, chain.masses[1:], strict=False)
    unknown = [chain.joint_names[joint.coordinate] for joint, m in moved if m is None]
    if unknown or not chain.masses:
        found = f"has none on {', '.join(dict.fromkeys(unknown))}" if unknown else "has none"
        raise errors.fail("robot", "have masses, as of a URDF file with <inertial> in its links", found)
    each: Any = [[*scale(m.mass, m.center), m.mass] for m in chain.masses]
    each = library(each).array(each, float)
    return each / each[:, 3].sum()
