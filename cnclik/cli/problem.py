"""The options that describe a problem, shared by every verb that takes one.

They are those of `cnclik.problem.OPTIONS`, with its help and defaults. A verb's `Args` inherits the groups that it
needs; `problem(args)` builds the problem.
"""

import dataclasses
import keyword
from typing import Any

from cnclik.cli import progress
from cnclik.cli.arguments import option
from cnclik.problem.options import DRIVE, INTEGER, MEASURED, NAME, NUMBER, NUMBERS, OPTIONS, PACE, PATH, SWEPT
from cnclik.quantities import in_samples

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
PaceOptions: Any = _group("PaceOptions", PACE)


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

    given = {name: value for name, value in (table(args) | others).items() if value is not None}
    with progress.bar("start and path"):
        made = problem_from(**given)
    look_at_units(args, given, made.law.chain, made.law.task, made.Ts)
    return made


def look_at_units(args, given: dict, chain, task, Ts=None) -> None:
    """Check that the given units fit joints and task; remark on numbers that are probably in another unit."""
    from cnclik.problem.magnitudes import check_units, remark_on

    written = getattr(args, "written", {})
    check_units(chain, task, written)
    remark_on(given | {name: v for name in ("near", "speed") if (v := getattr(args, name, None)) is not None},
              chain, task, Ts, written)  # fmt: skip


def drive_words(made) -> str:
    """The robot's drives in words, such as "2 samples (20 ms) of dead time, feedback measured"; "" without any."""
    import numpy as np

    drive = made.drive
    if drive is None or drive.absent:
        return ""
    said = [f"{in_samples(drive.delay, made.Ts)} of dead time"] * bool(drive.delay)
    measured = drive.measurement_delay
    said += [f"measured {in_samples(measured, made.Ts)} late"] * bool(measured)
    if drive.order:
        late = 1e3 * np.max(drive.late_by(made.Ts) - drive.delay * made.Ts)
        said.append(
            f"{'velocity' if drive.command == 'velocity' else 'position'} drives {late:.3g} ms behind their commands"
        )
    said.append(f"feedback {drive.feedback}")
    return ", ".join(said)


def pace_words(made) -> str:
    """The limits to which steps are scaled, in words; "" without any."""
    named = [name for name in ("velocity", "acceleration", "jerk") if getattr(made.pace, name, None) is not None]
    return f"steps scaled along the path to limits of {', '.join(named)}" if named else ""
