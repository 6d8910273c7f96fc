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
from cnclik.problem.build import Problem, drive_from, noise_from, problem_from
from cnclik.problem.names import stage_from, start_from
from cnclik.problem.options import DEFAULTS, DRIVE, OPTIONS, check_units, in_own_units
from cnclik.reading import read_bytes

ORDER = ("law", "reference", "q0", "drive")  # of a tuple
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
    options = {name: value for name, value in options.items() if value is not None}
    numbers, written = in_own_units({name: value for name, value in options.items() if name in OPTIONS})
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
    fields = _fields(f"problem() in {path.name}", made)
    found = _problem(path.stem, fields, {k: v for k, v in options.items() if k not in takes})
    check_units(found.law.chain, found.law.task, written)
    return found


def _fields(what, made) -> dict:
    """What the function returned, by name."""
    if isinstance(made, Problem):
        return {field.name: getattr(made, field.name) for field in dataclasses.fields(made)}
    if isinstance(made, (tuple, list)) and 2 <= len(made) <= len(ORDER):
        made = dict(zip(ORDER, made, strict=False))
    if not isinstance(made, dict) or not isinstance(made.get("law"), Law):
        raise errors.fail(what, "return a law, a reference and q0, as a tuple or a dict", f"returns {made!r}")
    for name in made:
        errors.one_of(what, name, sorted(field.name for field in dataclasses.fields(Problem)))
    return made


def _problem(name, made, options) -> Problem:
    """The problem of what a function returned; options, of `_LOOP`, replace it."""
    law, given = made["law"], frozenset(made) | set(options) | {"alpha"}
    q0 = start_from(law.chain, law.task, made.get("q0"))
    reference, drive = made.get("reference"), made.get("drive")
    if reference is None:
        reference, given = hold_at(law.chain, law.task, q0), given - {"reference"}
    check_loop(law, reference)
    if drive is not None:
        errors.kind("drive", drive, Drive)
    changes = {key: value for key, value in options.items() if key in DRIVE}
    if own := drive_from(changes, law.chain):
        drive = own if drive is None else dataclasses.replace(drive, **{key: getattr(own, key) for key in changes})
    loop = {key: options.get(key, made.get(key, DEFAULTS[key])) for key in ("Ts", "N", "method")}
    stage = stage_from("picard", options["M"]) if "M" in options else stage_from(made.get("stage", "picard"))
    return Problem(
        **{"name": name} | {key: made[key] for key in ("seed", "tip", "name", "robot") if key in made},
        law=law,
        reference=reference,
        q0=q0,
        Ts=errors.number("Ts", loop["Ts"], positive=True),
        N=errors.integer("N", loop["N"], at_least=1, at_most=errors.MOST),
        method=named(loop["method"]),
        stage=stage,
        noise=noise_from(made.get("noise"), law.task.m),
        drive=drive,
        given=given,
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
