"""Mounted: a robot with a tool, on a base, or with another robot on it; the masses that its base and joints carry."""

import functools
from typing import Any

from cnclik import errors
from cnclik.record import Array, Float, replace, xp_for
from cnclik.robot.chain import Chain, Masses, Tip, assemble, offset_of
from cnclik.robot.fixed import ZERO, Offset, compose, placed, scale, vadd
from cnclik.robot.poses import PoseLike


def with_tool(chain: Chain, tool: PoseLike, *, tip: str | None = None) -> Chain:
    """Return the chain with a fixed tool after its tip.

    The tool is a (3,) offset [m] or a pose: a 4×4 transform, [x, y, z, w, x, y, z], a `Pose`, or an object with
    translation and rotation such as Pinocchio's SE3.

    Args: tip: name of the tip that carries the tool; None: the only one.
    """
    number, tool = errors.kind("chain", chain, Chain).tip_number(tip), offset_of("tool", tool)
    tips = (replace(t, offset=compose(t.offset, tool)) if i == number else t for i, t in enumerate(chain.tips))
    return replace(chain, tips=tuple(tips))


def with_base(chain: Chain, base: PoseLike) -> Chain:
    """Return the chain with its base at a (3,) position [m] or a pose (as for `with_tool`) in the world frame.

    Targets, Jacobians and tip poses are then in the world frame.
    """
    place = offset_of("base", base)
    joints = _placed(errors.kind("chain", chain, Chain), place)
    return replace(chain, joints=joints, masses=_put(chain.masses, place))


def _placed(chain, base):
    """Return a chain's joints with a fixed transform before those on the base."""
    return tuple(
        replace(joint, origin=compose(base, joint.origin)) if parent < 0 else joint
        for joint, parent in zip(chain.joints, chain.parents, strict=True)
    )


def join(
    chain: Chain,
    other: Chain,
    *,
    at: str | None = None,
    transform: PoseLike | None = None,
    prefix: str = "",
    keep: bool = False,
) -> Chain:
    """Mount a robot on a tip of another one: an arm on a torso, a hand on an arm.

    The coordinates are those of `chain`, followed by those of `other`. The tips are those of `chain`, without the one
    that carries `other` unless `keep` is true, followed by those of `other`.

    Args:
      at: name of the tip of `chain` that carries `other`; None: the only one.
      transform: place of the base of `other` in the frame of that tip: a (3,) position [m] or a pose, as for
        `with_tool`; None: at the tip.
      prefix: text before the names of the joints and tips of `other`, such as "left_".
      keep: whether the carrying tip remains a tip, such as a torso's, for another arm.
    Raises: ArgumentError where a name would occur twice.
    """
    carrier = errors.kind("chain", chain, Chain).tips[chain.tip_number(at)]
    start, count = compose(carrier.offset, offset_of("transform", transform)), len(chain.joints)
    joints = list(chain.joints)
    for joint, parent in zip(_placed(errors.kind("other", other, Chain), start), other.parents, strict=True):
        changes = {"parent": carrier.joint if parent < 0 else count + parent, "coordinate": chain.n + joint.coordinate}
        joints.append(replace(joint, **changes, follower=joint.follower and prefix + joint.follower))
    tips = [tip for tip in chain.tips if tip is not carrier or keep]
    tips += [Tip(name=prefix + t.name, joint=count + t.joint, offset=t.offset) for t in other.tips]
    names = [*chain.joint_names, *(prefix + name for name in other.joint_names)]
    for several in (names, [t.name for t in tips]):
        if twice := sorted({name for name in several if several.count(name) > 1}):
            raise errors.fail("prefix", "tell the names of both robots apart", f"leaves {', '.join(twice)} twice")
    limits = {name: getattr(chain, name) + getattr(other, name) for name in ("lower", "upper", "velocity_limit")}
    masses: Any = ()
    if chain.masses and other.masses:
        (first, *above), below = _put(other.masses, start), list(chain.masses)
        below[carrier.joint + 1] = _sum(*(mass for mass in (below[carrier.joint + 1], first) if mass[0]))
        masses = (*below, *above)
    return assemble(joints, tuple(tips), joint_names=names, **limits, masses=masses)


# --- masses -------------------------------------------------------------------------------------------


def _sum(*each) -> tuple:
    """Return several masses as one."""
    whole = sum(mass for mass, _ in each)
    moment = functools.reduce(vadd, (scale(mass, center) for mass, center in each), ZERO)
    return (whole, scale(1.0 / whole, moment)) if each else (0.0, ZERO)


def lumped(inertials: dict, at: dict, count: int) -> Masses:
    """Return the masses of the base and of each of `count` joints; () if there are none.

    Args: inertials, at: {link: (mass, its centre)}; {link: (index of the joint that carries it, its place there)}.
    """
    carried: list = [[] for _ in range(count + 1)]
    for link, (mass, center) in inertials.items():
        if link in at:
            joint, offset = at[link]
            carried[joint + 1].append((mass, placed(offset, center)))
    return tuple(_sum(*each) for each in carried) if any(carried) else ()


def _put(masses: Masses, base: Offset) -> Masses:
    """Return the masses of a robot with its base moved."""
    return (*((mass, placed(base, center)) for mass, center in masses[:1]), *masses[1:])


def shares(chain) -> Float[Array, "j+1 4"]:
    """Return for the base, then for each joint its share s of the total mass and its centre, as s·(c, 1).

    Raises: ArgumentError for a robot without masses.
    """
    if not chain.masses:
        found = "has none, or was joined from one without"
        raise errors.fail("robot", "have masses, as of a URDF file with <inertial> in its links", found)
    each: Any = [[*scale(mass, center), mass] for mass, center in chain.masses]
    each = xp_for(each).array(each, float)
    return each / each[:, 3].sum()
