"""The options that describe a problem, shared by every verb that takes one.

A verb's `Args` inherits the groups it needs; `problem(args)` builds what they say.
"""

import dataclasses
from typing import Annotated

import tyro

from cnclik.problem.build import Problem, problem_from

_hidden = {"help_behavior_hint": ""}  # "(default: None)" tells nobody anything
Numbers = Annotated[tuple[float, ...] | None, tyro.conf.arg(metavar="X ...", **_hidden)]
Number = Annotated[float | None, tyro.conf.arg(metavar="X", **_hidden)]
Name = Annotated[str | None, tyro.conf.arg(metavar="NAME", **_hidden)]


@dataclasses.dataclass(kw_only=True)
class RobotOptions:
    robot: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROBOT")]
    """A URDF file, panda, ur5, or planar:1,1,1 (link lengths in m)."""
    tip: Name = None
    """Last link of the chain in a URDF file; needed where it has several (`cnclik robots FILE` lists them)."""
    base: Name = None
    """First link of the chain in a URDF file; the root by default."""


@dataclasses.dataclass(kw_only=True)
class TaskOptions:
    task: Name = None
    """pose, position, orientation, or coordinates such as xy or xyrz; pose where there are joints enough for it."""


@dataclasses.dataclass(kw_only=True)
class ReferenceOptions:
    reference: str = "hold"
    """hold, line, circle, lissajous, or FILE.csv of waypoints: time, position, optional quaternion w x y z."""
    target: Numbers = None
    """hold: the point, as position [m] and for a pose optionally a quaternion w x y z."""
    from_: Annotated[tuple[float, ...] | None, tyro.conf.arg(name="from", metavar="X ...", **_hidden)] = None
    """line: the first point; the tip at q0 by default."""
    to: Numbers = None
    """line: the last point."""
    center: Numbers = None
    """circle and lissajous: the centre [m]."""
    radius: Number = None
    """circle: the radius [m]."""
    normal: Numbers = None
    """circle: normal of its plane; z by default."""
    amplitude: Numbers = None
    """lissajous: amplitude [m], one for all axes or one each."""
    frequency: Numbers = None
    """lissajous: cycles per period, one per axis."""
    period: Number = None
    """Time of one turn, or of the line [s]; the length of the run by default."""


@dataclasses.dataclass(kw_only=True)
class LoopOptions:
    method: str = "CN"
    """EE, IE, CN (the paper's), TRAPEZOID, HEUN, MIDPOINT, RK4."""
    stage: str = "picard"
    """How implicit stages are solved: picard, chord, newton."""
    M: int = 5
    """Passes of that iteration."""
    alpha: Annotated[tuple[float, ...], tyro.conf.arg(metavar="X ...")] = (5.0,)
    """Gain of the error [1/s], one or one per task coordinate; alpha·Ts is the dimensionless gain per step."""
    Ts: float = 0.01
    """Sampling time [s]."""
    N: int = 1000
    """Steps."""
    inverse: Name = None
    """pseudoinverse, damped, transpose, manipulability-damped, singular-damped; damped where --damping is given."""
    damping: Number = None
    """λ (not λ²) of the damped inverses."""
    threshold: Number = None
    """Manipulability or least singular value below which the last two are damped."""
    limits: str = "none"
    """How joint limits are respected: none, velocity-scaling, weighted-least-norm, saturation."""
    error_clamp: Numbers = None
    """Largest position [m] and orientation [rad] error that the gain sees: what settles before far targets."""
    posture: Numbers = None
    """Joint values to draw towards in the null space [rad, m]."""
    manipulability: Number = None
    """Gain of climbing the manipulability in the null space."""
    q0: Numbers = None
    """Joint values at the start [rad, m]; a posture inside the limits, away from singularities, by default."""


@dataclasses.dataclass(kw_only=True)
class ProblemOptions(LoopOptions, ReferenceOptions, TaskOptions, RobotOptions):
    """Everything `solve` needs."""


def table(args) -> dict:
    """The problem's part of a verb's options as a flat table, what was left out left out."""
    names = {f.name for f in dataclasses.fields(ProblemOptions)}
    given = {name: getattr(args, name) for name in names if getattr(args, name, None) is not None}
    return {name.rstrip("_"): value for name, value in given.items()}


def problem(args) -> Problem:
    """The problem that a verb's options describe. Raises ArgumentError."""
    return problem_from(**table(args))
