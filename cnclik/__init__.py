"""cnclik: closed-loop inverse kinematics as a time-stepping problem.

A robot (`load_urdf`, `planar_arm`, `from_dh`, `from_screws`), a `Law` over it, a step in time (`solve`), gains that are
safe (`gains`, `advise`), many loops at once (`sweep`), loops that are tuned (`tune`); and joint values for targets
(`reach`). Pure functions over frozen records; jit, vmap and grad go through everything.
"""

import lazy_loader

_MOVED = {"pose_task": "pose"}  # names of the version before, which go with the next one
_GONE = {
    "bench": "its measurements are `python -m tests.bench.speed` in a clone",
    "use_form": "there is one form; use_engine chooses the engine",
}
_known, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name):
    if name in _MOVED:
        import warnings

        warnings.warn(f"cnclik.{name} is cnclik.{_MOVED[name]} now", DeprecationWarning, stacklevel=2)
    if name in _GONE:
        raise AttributeError(f"cnclik.{name} is gone since 0.2.0: {_GONE[name]}")
    return _known(_MOVED.get(name, name))
