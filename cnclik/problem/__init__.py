"""A loop in plain names: one vocabulary and one builder."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "options": ["DEFAULTS", "MEASURED", "OF_SHAPE", "OF_TASK", "OF_WALL", "OPTIONS"],
        "reference": ["reference_from"],
        "words": ["REFERENCES"],
        "build": ["Problem", "problem_from"],
        "names": [
            "inverse_from",
            "limits_from",
            "load",
            "method_from",
            "robot_from",
            "stage_from",
            "start_from",
            "task_from",
        ],
    },
)
