"""Two built-in robots with their makers' published parameters; no file is needed."""

import functools
import math

from cnclik.robot.chain import Chain, from_dh
from cnclik.robot.mounted import with_tool

_QUARTER = math.pi / 2


@functools.cache
def panda() -> Chain:
    """Return a Franka Emika Panda, 7 revolute joints, base to flange.

    Modified Denavit-Hartenberg parameters and limits as published in the Franka Control Interface
    documentation ("Robot and interface specifications").
    """
    arm = from_dh(
        a=[0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088],
        alpha=[0.0, -_QUARTER, _QUARTER, _QUARTER, -_QUARTER, _QUARTER, _QUARTER],
        d=[0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.0],
        convention="modified",
        joint_names=[f"panda_joint{i}" for i in range(1, 8)],
        lower=[-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973],
        upper=[2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973],
        velocity_limit=[2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61],
    )
    return with_tool(arm, [0.0, 0.0, 0.107])


@functools.cache
def ur5() -> Chain:
    """Return a Universal Robots UR5, 6 revolute joints, base to tool flange.

    Standard Denavit-Hartenberg parameters as published by the maker ("DH parameters for calculations of
    kinematics and dynamics"); joints turn ±360° at up to 180°/s (technical specification).
    """
    return from_dh(
        a=[0.0, -0.425, -0.39225, 0.0, 0.0, 0.0],
        alpha=[_QUARTER, 0.0, 0.0, _QUARTER, -_QUARTER, 0.0],
        d=[0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823],
        joint_names=["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"],
        lower=[-2 * math.pi] * 6,
        upper=[2 * math.pi] * 6,
        velocity_limit=[math.pi] * 6,
    )
