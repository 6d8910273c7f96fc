"""cnclik: closed-loop inverse kinematics as a time-stepping problem.

A robot (`load_urdf`, `planar_arm`, `from_dh`, `from_screws`), a `Law` over it, a step in time (`solve`), many of them
studied (`sweep`), judged (`recommend`) and tuned (`tune`); and joint values for targets (`reach`). Pure functions over
frozen records; jit, vmap and grad go through everything.
"""

import importlib
from typing import TYPE_CHECKING

from cnclik.lazy import on_use
from cnclik.version import __version__

if TYPE_CHECKING:  # everything is loaded on use; this is for editors and type checkers
    from cnclik import bench, diagnosis, export, measure, paper, problem, reaching, show, stability, sweeps, tuning
    from cnclik.compilation import use_cache
    from cnclik.diagnosis.diagnose import diagnose
    from cnclik.diagnosis.fit import fit_drive
    from cnclik.engine.native import native
    from cnclik.engine.plan import use_engine
    from cnclik.errors import ArgumentError
    from cnclik.hints import use_hints
    from cnclik.integrate.drive import Drive
    from cnclik.integrate.history import History
    from cnclik.integrate.lanes import lanes
    from cnclik.integrate.method import CN, EE, HEUN, IE, METHODS, MIDPOINT, RK4, TRAPEZOID, Method, exponential
    from cnclik.integrate.multistep import Multistep
    from cnclik.integrate.pace import Pace, Pacing, pace_at_rest, paced
    from cnclik.integrate.solve import Step, solve, step
    from cnclik.integrate.stage import chord, newton, picard
    from cnclik.integrate.status import Status, StepError, require_ok
    from cnclik.integrate.trajectory import Trajectory
    from cnclik.law.inverse import damped, manipulability_damped, pseudoinverse, singular_damped, transpose
    from cnclik.law.law import Law
    from cnclik.law.limits import saturation, velocity_scaling, weighted_least_norm
    from cnclik.law.null import maximize_manipulability, posture
    from cnclik.law.reference import Reference, causal, circle, hold, line, lissajous, path, waypoints, with_feedforward
    from cnclik.law.resampled import resampled
    from cnclik.law.task import Task, orientation, position
    from cnclik.law.task import pose as pose_task
    from cnclik.measure.dataset import to_dataset
    from cnclik.measure.kept import check_limits
    from cnclik.measure.metrics import Metrics, measure_run
    from cnclik.problem.build import problem_from
    from cnclik.reaching.map import reachability
    from cnclik.reaching.reach import reach
    from cnclik.reaching.result import Reached, ReachStatus
    from cnclik.record import replace
    from cnclik.robot.builtin import panda, ur5
    from cnclik.robot.chain import Chain, from_dh, from_screws, planar_arm, with_base, with_tool
    from cnclik.robot.kinematics import Pose, jacobian, manipulability, pose
    from cnclik.robot.urdf import load_urdf
    from cnclik.show.run import plot
    from cnclik.stability.linear import stability_limit
    from cnclik.stability.recommend import margin, recommend
    from cnclik.stability.spectrum import settle, spectral_radius
    from cnclik.stability.verdict import verdict
    from cnclik.sweeps.sweep import sweep
    from cnclik.tuning.calibrate import calibrate
    from cnclik.tuning.tune import tune

# Where each name is: nothing is loaded before it is asked for, so that the command line answers at once where no
# number is asked of it.
_ROOMS = (
    *("bench", "diagnosis", "export", "measure", "paper", "problem", "reaching", "show", "stability", "sweeps"),
    "tuning",
)
_INNER = (
    "compilation",
    "engine",
    "errors",
    "hints",
    "integrate",
    "law",
    "markup",
    "precision",
    "reading",
    "record",
    "robot",
    "version",
    "writing",
)
_ON_USE = {
    "compilation": "use_cache",
    "diagnosis.diagnose": "diagnose",
    "diagnosis.fit": "fit_drive",
    "engine.native": "native",
    "engine.plan": "use_engine",
    "errors": "ArgumentError",
    "hints": "use_hints",
    "integrate.drive": "Drive",
    "integrate.history": "History",
    "integrate.lanes": "lanes",
    "integrate.method": "CN EE HEUN IE METHODS MIDPOINT RK4 TRAPEZOID Method exponential",
    "integrate.multistep": "Multistep",
    "integrate.pace": "Pace Pacing pace_at_rest paced",
    "integrate.solve": "Step solve step",
    "integrate.stage": "chord newton picard",
    "integrate.status": "Status StepError require_ok",
    "integrate.trajectory": "Trajectory",
    "law.inverse": "damped manipulability_damped pseudoinverse singular_damped transpose",
    "law.law": "Law",
    "law.limits": "saturation velocity_scaling weighted_least_norm",
    "law.null": "maximize_manipulability posture",
    "law.reference": "Reference causal circle hold line lissajous path waypoints with_feedforward",
    "law.resampled": "resampled",
    "law.task": "Task orientation pose_task=pose position",
    "measure.dataset": "to_dataset",
    "measure.kept": "check_limits",
    "measure.metrics": "Metrics measure_run",
    "problem.build": "problem_from",
    "reaching.map": "reachability",
    "reaching.reach": "reach",
    "reaching.result": "Reached ReachStatus",
    "record": "replace",
    "robot.builtin": "panda ur5",
    "robot.chain": "Chain from_dh from_screws planar_arm with_base with_tool",
    "robot.kinematics": "Pose jacobian manipulability pose",
    "robot.urdf": "load_urdf",
    "show.run": "plot",
    "stability.linear": "stability_limit",
    "stability.recommend": "margin recommend",
    "stability.spectrum": "settle spectral_radius",
    "stability.verdict": "verdict",
    "sweeps.sweep": "sweep",
    "tuning.calibrate": "calibrate",
    "tuning.tune": "tune",
}
__all__ = [
    *("ArgumentError", "CN", "Chain", "Drive", "EE", "HEUN", "History", "IE", "Law", "METHODS", "MIDPOINT"),
    *("Method", "Metrics", "Multistep", "Pace", "Pacing", "Pose", "RK4", "ReachStatus", "Reached", "Reference"),
    *("Status", "Step", "StepError", "TRAPEZOID", "Task", "Trajectory", "__version__", "bench", "calibrate"),
    *("causal", "check_limits", "chord", "circle", "damped", "diagnose", "diagnosis", "exponential", "export"),
    *("fit_drive", "from_dh", "from_screws", "hold", "jacobian", "lanes", "line", "lissajous", "load_urdf"),
    *("manipulability", "manipulability_damped", "margin", "maximize_manipulability", "measure", "measure_run"),
    *("native", "newton", "orientation", "pace_at_rest", "paced", "panda", "paper", "path", "picard", "planar_arm"),
    *("plot", "pose", "pose_task", "position", "posture", "problem", "problem_from", "pseudoinverse", "reach"),
    *("reachability", "reaching", "recommend", "replace", "require_ok", "resampled", "saturation", "settle"),
    *("show", "singular_damped", "solve", "spectral_radius", "stability", "stability_limit", "step", "sweep"),
    *("sweeps", "to_dataset", "transpose", "tune", "tuning", "ur5", "use_cache", "use_engine"),
    *("use_hints", "velocity_scaling", "verdict", "waypoints", "weighted_least_norm", "with_base", "with_feedforward"),
    "with_tool",
]


_of_modules, _ = on_use(__name__, _ON_USE)


def __getattr__(name):
    if name in (*_ROOMS, *_INNER):
        return importlib.import_module(f"cnclik.{name}")
    return _of_modules(name)


def __dir__():
    return __all__
