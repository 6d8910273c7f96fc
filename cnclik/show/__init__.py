"""Pictures: every function takes data and returns a matplotlib Figure; one `save` writes it.

Modules: `run` (one loop), `stability`, `sweeps`, `tuning`; `style` (the look, `save`); `output` (folders, `draw`).
"""

import importlib

_ROOM = {"FigureError": "output", "draw": "output", "output_folder": "output", "plot": "run", "save": "style"}
__all__ = list(_ROOM)


def __getattr__(name):
    if name not in _ROOM:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_ROOM[name]}"), name)
