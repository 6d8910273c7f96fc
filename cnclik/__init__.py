"""cnclik: closed-loop inverse kinematics as a time-stepping problem.

A robot (`load_urdf`, `planar_arm`, `from_dh`), a `Law` over it, a step in time (`solve`), gains that are
safe (`gains`, `advise`), many loops at once (`sweep`), loops that are tuned (`tune`); and joint values for targets
(`reach`). Pure functions over frozen records; jit, vmap and grad go through everything.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
