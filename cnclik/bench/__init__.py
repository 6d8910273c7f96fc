"""What this machine does in a second: `bench.measure_apart(bench.Line(robot="panda", method="EE", stage="picard"))`."""

import importlib

# On use: `timing` is also the program of a process of its own.
_ROOM = {
    "Line": "lines",
    "LineError": "timing",
    "measure": "timing",
    "measure_apart": "timing",
    "product": "lines",
    "table": "lines",
}
__all__ = list(_ROOM)


def __getattr__(name):
    if name not in _ROOM:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_ROOM[name]}"), name)
