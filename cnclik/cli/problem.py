"""The options that describe a problem, shared by every verb that takes one.

They are arguments of `problem_from` and fields of `Drive`, with their help, units and defaults. A verb's `Args`
inherits the groups that it needs; `problem(args)` builds the problem.
"""

import dataclasses
from typing import Any

from cnclik.cli import progress
from cnclik.cli.arguments import option
from cnclik.problem.options import INTEGER, NAME, NUMBER, NUMBERS, OPTIONS

_TYPES: dict[str, Any] = {NAME: str, NUMBER: float, NUMBERS: tuple[float, ...], INTEGER: int}
_ROBOT = ("robot", "tip", "base", "task", "q0")
_PATH = ("reference", "target", "center", "radius", "period", "speed", "begin")
_LAW = ("alpha", "damping", "limits", "posture", "feedforward")
_LOOP = ("method", "M", "Ts", "N")
_DRIVE = (
    "delay",
    "lag",
    "natural_frequency",
    "damping_ratio",
    "command",
    "feedback",
    "smoothing",
    "cutoff",
    "smoothed",
)
# The other arguments are for sweeps and Python.


def _field(name, group):
    """(name, type, field) of one option, for a dataclass of options."""
    one, default = OPTIONS[name], OPTIONS[name].default
    if name == "robot":
        return name, str, option(about=one.help, positional=True, group=group)
    kind = _TYPES[one.kind] | None if default is None else _TYPES[one.kind]
    default = (default,) if one.kind == NUMBERS and default is not None else default
    return name, kind, option(default, unit=one.unit, about=one.help, group=group)


def _group(title, names):
    made = dataclasses.make_dataclass("Options", [_field(name, title) for name in names], kw_only=True)
    made.__module__, made.__doc__ = __name__, ""
    return made


RobotOptions: Any = _group("robot and task", _ROBOT)
PathOptions: Any = _group("path", _PATH)
LawOptions: Any = _group("law", _LAW)
LoopOptions: Any = _group("loop", _LOOP)
DriveOptions: Any = _group("drive", _DRIVE)


@dataclasses.dataclass(kw_only=True)
class ProblemOptions(DriveOptions, LoopOptions, LawOptions, PathOptions, RobotOptions):
    """Everything `solve` needs."""


def given(args) -> dict:
    """The options of the problem that the user gave, {name: value}; a single number is no list."""
    names = [one.name for one in dataclasses.fields(args) if one.metadata.get("group")]
    return {name: _number(name, getattr(args, name)) for name in names if name in args.written}


def _number(name, value):
    single = isinstance(value, tuple) and len(value) == 1 and OPTIONS[name].unit not in ("q", "x")
    return value[0] if single else list(value) if isinstance(value, tuple) else value


def problem(args):
    """The `Problem` that a verb's options describe. Raises: ArgumentError."""
    from cnclik.problem.file import problem_of
    from cnclik.problem.options import check_units

    options = given(args) if args.robot.endswith(".py") else {"N": getattr(args, "N", None)} | given(args)
    with progress.bar("start and path"):
        made = problem_of(args.robot, **{name: value for name, value in options.items() if value is not None})
    check_units(made.law.chain, made.law.task, args.written)
    return made
