"""cnclik: closed-loop inverse kinematics as a time-stepping problem.

A robot (`load_urdf`, `planar_arm`, `from_dh`, `from_screws`), a `Law` over it, a step in time (`solve`), many of them
studied (`sweep`), judged (`recommend`) and tuned (`tune`). Pure functions over frozen records; jit, vmap and grad go
through everything.
"""

import importlib
from typing import TYPE_CHECKING

from cnclik.errors import ArgumentError
from cnclik.hints import use_form, use_hints
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

if TYPE_CHECKING:  # what is loaded on use, for editors and type checkers
    from cnclik import bench, measure, paper, problem, show, stability, sweeps, tuning
    from cnclik.measure.dataset import to_dataset
    from cnclik.measure.metrics import Metrics, measure_run
    from cnclik.problem.build import problem_from
    from cnclik.show.run import plot
    from cnclik.stability.linear import stability_limit
    from cnclik.stability.recommend import margin, recommend
    from cnclik.stability.spectrum import settle, spectral_radius
    from cnclik.stability.verdict import verdict
    from cnclik.sweeps.sweep import sweep
    from cnclik.tuning.calibrate import calibrate
    from cnclik.tuning.tune import tune

# Rooms, and names of theirs, that a newcomer's first loop doesn't need: loaded when they are first asked for.
_ROOMS = ("bench", "measure", "paper", "problem", "show", "stability", "sweeps", "tuning")
_ON_USE = {
    "Metrics": "measure.metrics",
    "calibrate": "tuning.calibrate",
    "margin": "stability.recommend",
    "measure_run": "measure.metrics",
    "plot": "show.run",
    "problem_from": "problem.build",
    "recommend": "stability.recommend",
    "settle": "stability.spectrum",
    "spectral_radius": "stability.spectrum",
    "stability_limit": "stability.linear",
    "sweep": "sweeps.sweep",
    "to_dataset": "measure.dataset",
    "tune": "tuning.tune",
    "verdict": "stability.verdict",
}

__all__ = [
    *("CN", "EE", "HEUN", "IE", "METHODS", "MIDPOINT", "RK4", "TRAPEZOID", "ArgumentError", "Chain", "Law", "Method"),
    *("Metrics", "Pose", "Reference", "Status", "Step", "StepError", "Task", "Trajectory", "__version__", "bench"),
    *("calibrate", "chord", "circle", "damped", "from_dh", "from_screws", "hold", "jacobian", "lanes", "line"),
    *("lissajous", "load_urdf", "manipulability", "manipulability_damped", "margin", "maximize_manipulability"),
    *("measure", "measure_run", "newton", "orientation", "panda", "paper", "path", "picard", "planar_arm", "plot"),
    *("pose", "pose_task", "position", "posture", "problem", "problem_from", "pseudoinverse", "recommend", "replace"),
    *("require_ok", "saturation", "settle", "show", "singular_damped", "solve", "spectral_radius", "stability"),
    *("stability_limit", "step", "sweep", "sweeps", "to_dataset", "transpose", "tune", "tuning", "ur5", "use_hints"),
    *("velocity_scaling", "verdict", "waypoints", "weighted_least_norm", "with_feedforward", "with_tool"),
]


def __getattr__(name):
    if name in _ROOMS:
        return importlib.import_module(f"cnclik.{name}")
    if name not in _ON_USE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(importlib.import_module(f"cnclik.{_ON_USE[name]}"), name)
    globals()[name] = found
    return found


def __dir__():
    return __all__
