"""What is controlled: coordinates of tips and joints, their errors and their rows of the task Jacobian."""

from cnclik.task.task import Task, joints, orientation, pose, position, stack

__all__ = ["Task", "joints", "orientation", "pose", "position", "stack"]
