"""The robot: chains and the ways to build one, where the tip is and how it moves."""

from cnclik.robot.builtin import panda, ur5
from cnclik.robot.chain import Chain, Joint, Offset, assemble, from_dh, from_screws, planar_arm, with_tool
from cnclik.robot.kinematics import Pose, jacobian, manipulability, pose
from cnclik.robot.urdf import load_urdf

__all__ = [
    "Chain",
    "Joint",
    "Offset",
    "Pose",
    "assemble",
    "from_dh",
    "from_screws",
    "jacobian",
    "load_urdf",
    "manipulability",
    "panda",
    "planar_arm",
    "pose",
    "ur5",
    "with_tool",
]
