"""Tasks: coordinates of tips and joints, their errors and their rows of the task Jacobian."""

from cnclik.task.build import joints, orientation, pose, position, stack
from cnclik.task.shapes import capsule, distance, half_space, sphere
from cnclik.task.task import Task

__all__ = [
    "Task",
    "capsule",
    "distance",
    "half_space",
    "joints",
    "orientation",
    "pose",
    "position",
    "sphere",
    "stack",
]
