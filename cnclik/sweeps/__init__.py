"""Sweeps: many loops over a labelled grid, from Python (`ck.sweep`) or from one TOML file.

data = sweeps.run_spec("sweeps/plane.toml")                # in memory
data = sweeps.run_spec("sweeps/plane.toml", "sweep-plane")   # in a store that survives a kill
print(sweeps.estimate("sweeps/plane.toml"))                # size, memory and time first
"""

import importlib

# name here -> module and name there; loaded when asked for.
_PUBLIC = {
    "Estimate": ("cost", "Estimate"),
    "Spec": ("spec", "Spec"),
    "estimate": ("cost", "estimate"),
    "export": ("summary", "export"),
    "open_sweep": ("store", "read"),
    "read_spec": ("spec", "read"),
    "run_spec": ("run", "run_spec"),
    "summarize": ("summary", "table"),
}
__all__ = sorted(_PUBLIC)


def __getattr__(name):
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, there = _PUBLIC[name]
    return getattr(importlib.import_module(f"{__name__}.{module}"), there)


def __dir__():
    return sorted({*globals(), *_PUBLIC})
