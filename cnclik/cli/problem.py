"""The options that describe a problem, shared by every verb that takes one.

They are those of `cnclik.problem.OPTIONS`, with its help and defaults. A verb's `Args` inherits the groups that it
needs; `problem(args)` builds the problem.
"""

import dataclasses
import keyword
from typing import Any

from cnclik.cli import progress
from cnclik.cli.arguments import option
from cnclik.problem.options import DRIVE, INTEGER, MEASURED, NAME, NUMBER, NUMBERS, OPTIONS, PATH, SWEPT

_TYPES = {NAME: str, NUMBER: float, NUMBERS: tuple[float, ...], INTEGER: int}


def _field(name):
    """(name, type, field) of one option, for a dataclass of options."""
    one = SWEPT[name]
    kind, default = _TYPES[one.kind], one.default
    if name == "robot":
        return name, str, option(about=one.help, positional=True)
    kind = kind | None if default is None else kind
    default = (default,) if one.kind == NUMBERS and default is not None else default
    return name + "_" * keyword.iskeyword(name), kind, option(default, unit=one.unit, name=name, about=one.help)


def _group(title, names):
    made = dataclasses.make_dataclass(title, [_field(name) for name in names], kw_only=True)
    made.__module__, made.__doc__ = __name__, ""
    return made


_ROBOT, _TASK, _PATHS = (
    ("robot", "tip", "base", "lengths"),
    ("task", "stack"),
    ("reference", *(n for n in OPTIONS if n in PATH), "future"),
)
RobotOptions: Any = _group("RobotOptions", _ROBOT)
TaskOptions: Any = _group("TaskOptions", _TASK)
ReferenceOptions: Any = _group("ReferenceOptions", _PATHS)
LoopOptions: Any = _group("LoopOptions", [n for n in OPTIONS if n not in (*_ROBOT, *_TASK, *_PATHS)])
DriveOptions: Any = _group("DriveOptions", DRIVE)
MeasuredOptions: Any = _group("MeasuredOptions", MEASURED)


@dataclasses.dataclass(kw_only=True)
class ProblemOptions(LoopOptions, ReferenceOptions, TaskOptions, RobotOptions):
    """Everything `solve` needs."""


def table(args) -> dict:
    """The given options of the problem among a verb's options, as a flat table."""
    names = {name: name + "_" * keyword.iskeyword(name) for name in SWEPT}
    given = {name: getattr(args, field, None) for name, field in names.items()}
    return {name: value for name, value in given.items() if value not in (None, [])}


def problem(args, **others):
    """The `Problem` that a verb's options describe, some of which stand for its own. Raises: ArgumentError."""
    from cnclik.problem.build import problem_from
    from cnclik.problem.magnitudes import remark_on

    given = {name: value for name, value in (table(args) | others).items() if value is not None}
    with progress.bar("start and path"):
        made = problem_from(**given)
    named = given | ({} if getattr(args, "speed", None) is None else {"speed": args.speed})
    remark_on(named, made.law.chain, made.law.task, made.Ts, args.written)
    return made
