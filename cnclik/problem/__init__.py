"""A loop in plain names: one vocabulary and one builder."""

from cnclik.lazy import on_use

__getattr__, __all__ = on_use(
    __name__,
    {
        "options": "DEFAULTS OPTIONS",
        "reference": "REFERENCES reference_from",
        "build": "Problem problem_from",
        "names": "inverse_from limits_from method_from robot_from stage_from start_from task_from",
    },
)
