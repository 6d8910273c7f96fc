"""Remarks on a robot whose numbers probably have another unit, such as millimetres or degrees."""

import math

from cnclik import errors

LONG = 50.0  # [m] between joints
TURNS = 30.0  # [rad] joint limit
FAST = 60.0, 720.0  # [rad/s] range of suspicious velocity limits; larger ones, 100 and 1000 stand for no limit


def remark_on_robot(chain) -> None:
    """Remark on implausible lengths and limits of a chain that are plain numbers; at most one remark of each kind."""
    places = [(f"joint {chain.joint_names[j.coordinate]!r}", j.origin) for j in chain.joints]
    places += [(f"tip {t.name!r}" if len(chain.tips) > 1 else "the tip", t.offset) for t in chain.tips]
    for what, origin in places:
        away = max((abs(x) for x in origin.position if type(x) is float), default=0.0)
        if LONG < away < math.inf:
            errors.remark(f"{what[0].upper()}{what[1:]} is {away:g} m from the joint before it: lengths are in metres.")
            break
    for what, limits, (least, most), unit in (
        ("a limit", (*chain.lower, *chain.upper), (TURNS, math.inf), "rad"),
        ("a velocity limit", chain.velocity_limit, FAST, "rad/s"),
    ):
        for i, value in enumerate(limits):
            far = type(value) is float and least < abs(value) < most and value not in (100.0, 1000.0)
            if far and chain.units[i % chain.n] == "rad":
                joint = chain.joint_names[i % chain.n]
                errors.remark(f"Joint {joint!r} has {what} of {value:g} {unit}: angles are in radians.")
                break


def remark_on_angles(what: str, angles) -> bool:
    """Remark on angles [rad] of more than a turn; returns whether there is one. Args: what: whose angles they are."""
    most = max((a for a in angles if type(a) is float and math.isfinite(a)), key=abs, default=0.0)
    far = abs(most) > 2 * math.pi
    if far:
        errors.remark(f"{what} is {most:g} rad: angles are in radians.")
    return far
