"""Problems in Python: a file whose function `problem` returns law, reference and q0, and perhaps more."""

import dataclasses
import inspect
import pathlib
import runpy
import sys
import traceback

from cnclik import errors
from cnclik.problem.build import Problem, problem_from
from cnclik.problem.options import DRIVE, OPTIONS, check_units, drive_from, in_own_units
from cnclik.reading import read_bytes

_LOOP = ("Ts", "N", "method", "M", *DRIVE)  # options that replace what the file says


def problem_of(robot, **options) -> Problem:
    """Return the problem of a robot and its options, as `problem_from`, or of a file FILE.py.

    The file's function `problem` is called with those options that are its arguments. It returns a `Problem`, a tuple
    (law, reference, q0) or (law, reference, q0, drive), or a dict of attributes of a `Problem`. Ts, N, method, M and
    the fields of `Drive` may be options beside it.

    Raises: ArgumentError, for an error in the file with its line.
    """
    path = pathlib.Path(str(robot))
    if path.suffix != ".py":
        return problem_from(robot, **options)
    make = _executed(path).get("problem")
    if not callable(make):
        raise errors.fail("robot", "name a Python file with a function problem()", f"{path.name} has none")
    takes = inspect.signature(make).parameters
    for name in options:
        if name not in (*takes, *_LOOP):
            must = f"be an argument of problem() in {path.name}, or be left out"
            raise errors.fail(name, must, f"is given, and problem() takes {', '.join(takes) or 'none'}")
    early = {name: value for name, value in options.items() if name in OPTIONS and name in (*takes, "Ts")}
    options |= in_own_units(early, Ts=None)  # that of the file is not known yet
    made = _called(path, lambda: make(**{name: value for name, value in options.items() if name in takes}))
    if isinstance(made, tuple):
        made = dict(zip(("law", "reference", "q0", "drive"), made, strict=False))
    if isinstance(made, dict) and "law" in made:
        for name in made:
            errors.one_of(f"problem() in {path.name}", name, [field.name for field in dataclasses.fields(Problem)])
        made = Problem(**{"name": path.stem} | made)
    if not isinstance(made, Problem):
        must = "return a law, a reference and q0, as a tuple or a dict"
        raise errors.fail(f"problem() in {path.name}", must, f"returns {made!r}")
    check_units("q0", options.get("q0"), made.law.chain)
    loop = in_own_units({name: value for name, value in options.items() if name in _LOOP}, made.Ts)
    if "M" in loop:
        loop["stage"] = dataclasses.replace(made.stage, M=loop.pop("M"))
    drive = drive_from({name: loop.pop(name) for name in DRIVE if name in loop}, made.drive)
    return dataclasses.replace(made, **loop, drive=drive)


def _executed(path) -> dict:
    """The names that a file defines; it may import what is beside it."""
    read_bytes("robot", path, "a Python file")
    sys.path.insert(0, str(path.absolute().parent))
    try:
        return _called(path, lambda: runpy.run_path(str(path)))
    finally:
        sys.path.pop(0)


def _called(path, function):
    """What a function of the file returns. Raises: ArgumentError with the line, for any error."""
    try:
        return function()
    except Exception as error:  # whatever the user's code raises
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        line = error.lineno if isinstance(error, SyntaxError) and not lines else lines[-1] if lines else 0
        told = str(error) if isinstance(error, errors.ArgumentError) else errors.in_a_line(error)
        told = told.replace("`", "'")  # arguments of the file's calls, which are no options
        raise errors.ArgumentError(f"{path.name}, line {line}: {told}") from error
