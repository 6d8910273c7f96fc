"""Problems in Python: a file whose function `problem` returns law, reference and q0, and perhaps more."""

import dataclasses
import inspect
import pathlib
import sys
import traceback

from cnclik import errors
from cnclik.integrate.drive import Drive
from cnclik.integrate.method import named
from cnclik.law.law import Law, check_loop
from cnclik.law.paths import hold_at
from cnclik.problem.build import Problem, drive_from, problem_from
from cnclik.problem.names import stage_from, start_from
from cnclik.problem.options import DEFAULTS, DRIVE, OPTIONS, check_units, in_own_units
from cnclik.reading import read_bytes

_LOOP = ("Ts", "N", "method", "M", *DRIVE)  # options that replace what the file says


def problem_of(robot, **options) -> Problem:
    """Return the problem of a robot and its options, as `problem_from`, or of a file FILE.py.

    The file's function `problem` is called with those options that are its arguments. It returns a `Problem`, a tuple
    (law, reference, q0) or (law, reference, q0, drive), or a dict of these and of Ts, N, method, stage, and robot, a
    file with its meshes. A reference of None stays where q0 is, and q0 of None is a posture away from singularities.
    Ts, N, method, M and the fields of `Drive` may be options beside it.

    Raises: ArgumentError, for an error in the file with its line.
    """
    path = pathlib.Path(str(robot))
    if path.suffix != ".py":
        return problem_from(robot, **options)
    names = {name: value for name, value in options.items() if name in OPTIONS and value is not None}
    numbers, written = in_own_units(names)
    options |= numbers
    make = _executed(path).get("problem")
    if not callable(make):
        raise errors.fail("robot", "name a Python file with a function problem()", f"{path.name} has none")
    takes = inspect.signature(make).parameters
    for name in options:
        if name not in (*takes, *_LOOP):
            must = f"be an argument of problem() in {path.name}, or be left out"
            raise errors.fail(name, must, f"is given, and problem() takes {', '.join(takes) or 'none'}")
    made = _called(path, lambda: make(**{name: value for name, value in options.items() if name in takes}))
    fields = {"name": path.stem} | _fields(f"problem() in {path.name}", made)
    loop = {name: value for name, value in options.items() if name not in takes}
    check_units(fields["law"].chain, written)
    return _problem(fields, loop)


def _fields(what, made) -> dict:
    """What the function returned, by name."""
    if isinstance(made, tuple):
        made = dict(zip(("law", "reference", "q0", "drive"), made, strict=False))
    made = vars(made) if isinstance(made, Problem) else made
    if not isinstance(made, dict) or not isinstance(made.get("law"), Law):
        raise errors.fail(what, "return a law, a reference and q0, as a tuple or a dict", f"returns {made!r}")
    for name in made:
        errors.one_of(what, name, [field.name for field in dataclasses.fields(Problem)])
    return made


def _problem(made, options) -> Problem:
    """The problem of what a function returned; options, of `_LOOP`, replace it."""
    made = {name: DEFAULTS[name] for name in ("Ts", "N", "method", "stage")} | made | options
    law, drive, noise = made["law"], made.get("drive"), made.get("noise")
    q0 = start_from(law.chain, law.task, made.get("q0"))
    reference = made.get("reference")
    reference = hold_at(law.chain, law.task, q0) if reference is None else reference
    check_loop(law, reference)
    changes = {name: value for name, value in options.items() if name in DRIVE}
    if drive is not None:
        changes = {name: getattr(errors.kind("drive", drive, Drive), name) for name in DRIVE} | changes
    return Problem(
        **{name: made[name] for name in ("name", "seed", "robot") if name in made},
        law=law,
        reference=reference,
        q0=q0,
        Ts=errors.number("Ts", made["Ts"], positive=True),
        N=errors.integer("N", made["N"], at_least=1, at_most=errors.MOST),
        method=named(made["method"]),
        stage=stage_from("picard", options["M"]) if "M" in options else stage_from(made["stage"]),
        noise=None if noise is None else errors.array("noise", noise, (), (law.task.m,)),
        drive=drive_from(changes, law.chain),
    )


def _executed(path) -> dict:
    """The names that a file defines; it may import what is beside it."""
    text = read_bytes("robot", path, "a Python file")
    names = {"__name__": path.stem, "__file__": str(path)}
    sys.path.insert(0, str(path.absolute().parent))
    try:
        _called(path, lambda: exec(compile(text, str(path), "exec"), names))
    finally:
        sys.path.pop(0)
    return names


def _called(path, function):
    """What a function of the file returns. Raises: ArgumentError with the line, for any error."""
    try:
        return function()
    except Exception as error:  # whatever the user's code raises
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        line = error.lineno if isinstance(error, SyntaxError) and not lines else lines[-1] if lines else 0
        told = str(error) if isinstance(error, errors.ArgumentError) else errors.in_a_line(error)
        raise errors.ArgumentError(f"{path.name}, line {line}: {told}") from error
