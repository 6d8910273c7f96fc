"""What the loop is asked to do: q̇ = f(q, t)."""

from cnclik.law.inverse import damped, manipulability_damped, pseudoinverse, singular_damped, transpose
from cnclik.law.law import Law
from cnclik.law.limits import saturation, velocity_scaling, weighted_least_norm
from cnclik.law.null import maximize_manipulability, posture
from cnclik.law.reference import Reference, causal, circle, hold, line, lissajous, path, waypoints, with_feedforward
from cnclik.law.task import Task, orientation, pose, position

__all__ = [
    "Law",
    "Reference",
    "Task",
    "causal",
    "circle",
    "damped",
    "hold",
    "line",
    "lissajous",
    "manipulability_damped",
    "maximize_manipulability",
    "orientation",
    "path",
    "pose",
    "position",
    "posture",
    "pseudoinverse",
    "saturation",
    "singular_damped",
    "transpose",
    "velocity_scaling",
    "waypoints",
    "weighted_least_norm",
    "with_feedforward",
]
