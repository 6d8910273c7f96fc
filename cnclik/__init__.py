"""cnclik: closed-loop inverse kinematics as a time-stepping problem.

A robot (`load_urdf`, `planar_arm`, `from_dh`, `from_screws`), a `Law` over it, a step in time (`solve`), many of them
studied (`sweep`). Pure functions over frozen records; jit, vmap and grad go through everything.
"""

import importlib
from typing import TYPE_CHECKING

from cnclik.errors import ArgumentError
from cnclik.hints import hints
from cnclik.integrate.lanes import lanes
from cnclik.integrate.method import CN, EE, HEUN, IE, METHODS, MIDPOINT, RK4, TRAPEZOID, Method
from cnclik.integrate.solve import Step, solve, step
from cnclik.integrate.stage import chord, newton, picard
from cnclik.integrate.status import Status, StepError, require_ok
from cnclik.integrate.trajectory import Trajectory
from cnclik.law.inverse import damped, manipulability_damped, pseudoinverse, singular_damped, transpose
from cnclik.law.law import Law
from cnclik.law.limits import saturation, velocity_scaling, weighted_least_norm
from cnclik.law.null import maximize_manipulability, posture
from cnclik.law.reference import Reference, circle, hold, line, lissajous, path, waypoints, with_feedforward
from cnclik.law.task import Task, orientation, position
from cnclik.law.task import pose as pose_task
from cnclik.record import replace
from cnclik.robot.builtin import panda, ur5
from cnclik.robot.chain import Chain, from_dh, from_screws, planar_arm, with_tool
from cnclik.robot.kinematics import Pose, jacobian, manipulability, pose
from cnclik.robot.urdf import load_urdf
from cnclik.version import __version__

if TYPE_CHECKING:
    from cnclik.measure.metrics import Metrics, measure_run
    from cnclik.sweeps.sweep import sweep
    from cnclik.tuning.tune import calibrate, tune


# Public names of rooms that a newcomer's first loop doesn't need: loaded when they are first asked for.
_ON_USE = {
    "Metrics": "cnclik.measure.metrics",
    "calibrate": "cnclik.tuning.tune",
    "measure_run": "cnclik.measure.metrics",
    "sweep": "cnclik.sweeps.sweep",
    "tune": "cnclik.tuning.tune",
}


def __getattr__(name):
    if name not in _ON_USE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(importlib.import_module(_ON_USE[name]), name)
    globals()[name] = found
    return found


def __dir__():
    return sorted({*globals(), *_ON_USE})
