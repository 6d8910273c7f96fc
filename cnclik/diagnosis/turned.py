"""Turned: causes that no smaller gain removes: frames of error and Jacobian turned against each other, or a wrong sign.

If the frames are turned by θ about an axis, a step leaves e[k+1] = (1 − z e^{iθ}) e[k] across the axis: a spiral, in
which one coordinate follows another by a quarter turn. With dead time alone all coordinates oscillate in phase.
"""

from typing import NamedTuple

import numpy as np

ROUND = 0.2  # |vᵀv|/‖v‖² of a shape v, at most, to count as a circle: 0 for a circle, 1 in phase
APART = 0.95  # below this, columns are not in phase


class Turned(NamedTuple):
    """Frames that are turned against each other."""

    degrees: float  # angle of the error's frame about the axis, relative to the Jacobian's
    axis: np.ndarray  # (3,) in the order of the coordinates; for two coordinates, the third axis
    z: float


def together(shape) -> float:
    """|vᵀv|/‖v‖² of a shape (k,): 1 if all columns are in phase or opposite, 0 for a circle."""
    return float(np.abs(np.sum(shape**2)) / np.sum(np.abs(shape) ** 2))


def turned_of(shape, factor):
    """`Turned` if a complex shape (k,) of two or three coordinates, or both halves of six, are circles; otherwise None.

    A mode turns in a plane by 1 − z e^{iθ}. λ is given as the factor above the real axis; the shape gives the
    direction.
    """
    blocks = {2: [shape], 3: [shape], 6: [shape[:3], shape[3:]]}.get(len(shape), [])
    power = [np.sum(np.abs(block) ** 2) for block in blocks]
    blocks = [block for block, p in zip(blocks, power, strict=True) if p > 1e-2 * max(power)]
    if not blocks or not factor.imag or max(map(together, blocks)) > ROUND:
        return None
    block = max(blocks, key=lambda block: np.sum(np.abs(block) ** 2))
    block = np.pad(block, (0, 3 - len(block)))
    axis = np.cross(block.real, -block.imag)  # y = Re(v λ^k) turns from Re v to −Im v
    axis = axis / np.linalg.norm(axis)
    degrees = np.degrees(np.angle(1 - factor))
    if axis[np.argmax(np.abs(axis))] < 0:
        axis, degrees = -axis, -degrees
    return Turned(float(degrees), axis, float(np.abs(1 - factor)))
