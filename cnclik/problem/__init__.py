"""A loop in plain names: one vocabulary and one builder."""

import importlib

# On use: the command line reads the options without loading JAX.
_ROOM = {
    "DEFAULTS": "options",
    "OPTIONS": "options",
    "REFERENCES": "reference",
    "Problem": "build",
    "inverse_from": "names",
    "limits_from": "names",
    "method_from": "names",
    "problem_from": "build",
    "reference_from": "reference",
    "robot_from": "names",
    "stage_from": "names",
    "start_from": "names",
    "task_from": "names",
}
__all__ = list(_ROOM)


def __getattr__(name):
    if name not in _ROOM:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_ROOM[name]}"), name)
