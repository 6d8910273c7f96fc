"""Body: a robot's shapes from its chain alone, and where they are.

Frame 0 is the base, frame i is fixed to what joint i moves. A link is a capsule from its joint to the next, a revolute
joint a cylinder about its axis, a prismatic one a square bar along its axis.
"""

from typing import NamedTuple

import numpy as np

from cnclik import markup
from cnclik.robot.bases import BALL
from cnclik.robot.chain import PRISMATIC, REVOLUTE
from cnclik.robot.model import joint_frames, modelled
from cnclik.robot.posture import arm_length
from cnclik.show import style

THICK = 0.028  # radius of a link [arm lengths]
CORNERS = 20  # corners of a round shape
GREY = "#8A8F94"  # for fixed parts, and for the second run


class Part(NamedTuple):
    """A mesh that moves with a frame."""

    frame: int
    vertices: np.ndarray  # (v, 3) [m]
    faces: np.ndarray  # (f, 3)
    color: str


def link_poses(chain, q):
    """Frames 0 … j of j joints and the tips at q (K, n): (K, 1 + j + tips, 4, 4), in NumPy."""
    model, q = modelled(chain), np.asarray(q, float)
    at = joint_frames(model, q)
    base = np.broadcast_to(np.eye(4), (len(q), 1, 4, 4))
    return np.concatenate([base, at, at[:, np.array(model.carriers)] @ np.stack(model.tips)], 1)


def radius_of(chain) -> float:
    """Radius of a link [m]."""
    after = [joint for joint, parent in zip(chain.joints, chain.parents, strict=True) if parent >= 0]
    offsets = (*(joint.origin for joint in after), *(tip.offset for tip in chain.tips))
    longest = max(np.linalg.norm(_numbers(offset.position)) for offset in offsets)
    return float(min(THICK * arm_length(chain), 0.2 * longest) if longest > 0 else THICK)


def parts_of(chain, color=style.SKY, dark=markup.BLUE) -> list:
    """Shapes of a chain, or of a tree: links in one colour, joints in another."""
    thick, found = radius_of(chain), []
    ends = [(parent + 1, joint.origin) for joint, parent in zip(chain.joints, chain.parents, strict=True)]
    for frame, offset in [*ends, *((tip.joint + 1, tip.offset) for tip in chain.tips)]:
        end = _numbers(offset.position)
        if np.linalg.norm(end) > 0.2 * thick:
            shape = capsule(np.zeros(3), end, thick * (1.15 if frame == 0 else 1.0))
            found.append(Part(frame, *shape, GREY if frame == 0 else color))
    for i, joint in enumerate(chain.joints, 1):
        axis, anywhere = _numbers(joint.axis), np.isinf([chain.lower[joint.coordinate], chain.upper[joint.coordinate]])
        if joint.kind == BALL or (joint.kind == PRISMATIC and anywhere.all()):  # joints of a base have no shape
            continue
        if joint.kind == REVOLUTE:
            shape = rod(-1.2 * thick * axis, 1.2 * thick * axis, 1.3 * thick)
            found.append(Part(i, *shape, dark))
            continue
        low, high = (bound[joint.coordinate] for bound in (chain.lower, chain.upper))
        reach = arm_length(chain)
        low, high = (v if np.isfinite(v) else side * reach for v, side in ((float(low), -1), (float(high), 1)))
        turn, start = _numbers(joint.origin.rotation), _numbers(joint.origin.position)
        low_end, high_end = (start + turn @ axis * v for v in (min(low, 0.0), max(high, 0.0)))
        found.append(Part(ends[i - 1][0], *rod(low_end, high_end, 0.5 * thick, around=4), GREY))
        found.append(Part(i, *rod(-2 * thick * axis, 2 * thick * axis, 1.4 * thick, around=4), dark))
    return found


# --- shapes -------------------------------------------------------------------------------------------


def capsule(start, end, radius) -> tuple[np.ndarray, np.ndarray]:
    """(vertices, faces) of a rod with round ends."""
    angle = np.linspace(0, np.pi / 2, 6)
    length = np.linalg.norm(np.subtract(end, start))
    below = np.c_[np.sin(angle), -np.cos(angle)] * radius
    above = np.c_[np.cos(angle), np.sin(angle)] * radius + [0.0, length]
    return _turned(np.concatenate([below, above]), start, end, CORNERS)


def rod(start, end, radius, around=CORNERS) -> tuple[np.ndarray, np.ndarray]:
    """(vertices, faces) of a cylinder, or of a prism with fewer corners."""
    length = np.linalg.norm(np.subtract(end, start))
    profile = [(0, 0), (radius, 0), (radius, 0), (radius, length), (radius, length), (0, length)]  # edges stay sharp
    return _turned(np.array(profile, float), start, end, around)


def _turned(profile, start, end, around):
    """A profile (k, 2) of radii and heights rotated about the axis from start to end."""
    angle = 2 * np.pi * np.arange(around) / around
    x, y = np.cos(angle), np.sin(angle)
    own = [[r * a, r * b, h] for r, h in profile for a, b in zip(x, y, strict=True)]
    k, i = np.meshgrid(np.arange(len(profile) - 1), np.arange(around), indexing="ij")
    a, b = k * around + i, k * around + (i + 1) % around
    faces = np.stack([np.stack([a, b, b + around], -1), np.stack([a, b + around, a + around], -1)], 2).reshape(-1, 3)
    return np.array(own) @ _frame_along(np.subtract(end, start)).T + start, faces


def _frame_along(direction):
    """A rotation whose third column points along a direction."""
    z = np.asarray(direction, float) / np.linalg.norm(direction)
    side = np.eye(3)[np.argmin(np.abs(z))]
    x = np.cross(side, z)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], 1)


def _numbers(values):
    return np.array([[float(v) for v in row] if isinstance(row, tuple) else float(row) for row in values])
