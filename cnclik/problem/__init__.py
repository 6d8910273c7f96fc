"""A loop in plain names: one vocabulary and one builder."""

from cnclik.problem.build import Problem, problem_from
from cnclik.problem.names import inverse_from, limits_from, method_from, robot_from, stage_from, start_from, task_from
from cnclik.problem.options import DEFAULTS, OPTIONS
from cnclik.problem.reference import REFERENCES, reference_from

__all__ = [
    "DEFAULTS",
    "OPTIONS",
    "REFERENCES",
    "Problem",
    "inverse_from",
    "limits_from",
    "method_from",
    "problem_from",
    "reference_from",
    "robot_from",
    "stage_from",
    "start_from",
    "task_from",
]
