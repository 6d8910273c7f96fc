"""Turned: what no smaller gain ends. Error and Jacobian in frames turned against each other, and a wrong sign.

Turned by θ about an axis, a step leaves e[k+1] = (1 − z e^{iθ}) e[k] of what lies across the axis: a spiral, in which
one coordinate follows another by a quarter turn. Dead time alone lets all coordinates swing together.
"""

from typing import NamedTuple

import numpy as np

ROUND = 0.2  # |vᵀv|/‖v‖² of a shape v: 0 of a circle, 1 where all swing together; up to this it is a circle
APART = 0.95  # below this columns do not swing together


class Turned(NamedTuple):
    """Frames that are turned against each other."""

    degrees: float  # by which the error's is turned, about the axis, as the Jacobian sees it
    axis: np.ndarray  # (3,) of the coordinates, in their order; of two the third
    z: float


def together(shape) -> float:
    """|vᵀv|/‖v‖² of a shape (k,): 1 where all columns swing together or against each other, 0 of a circle."""
    return float(np.abs(np.sum(shape**2)) / np.sum(np.abs(shape) ** 2))


def turned_of(shape, factor):
    """`Turned` where a complex shape (k,) of two or three coordinates is a circle, of six both halves; else None.

    One that turns in a plane as 1 − z e^{iθ}: λ is told as the factor above the real axis, and the shape the direction.
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
