"""What is controlled: coordinates of tips and joints, their errors and their rows of the task Jacobian."""

from cnclik.task.build import joints, orientation, pose, position, stack
from cnclik.task.task import Task

__all__ = ["Task", "joints", "orientation", "pose", "position", "stack"]
