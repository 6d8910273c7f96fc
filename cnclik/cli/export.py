"""`cnclik export`: the step of a loop as C, for a controller."""

import dataclasses
from pathlib import Path
from typing import Literal

from cnclik import errors
from cnclik.cli import progress
from cnclik.cli.common import ComputeOptions
from cnclik.cli.problem import ProblemOptions, problem, table
from cnclik.problem.options import PATH


@dataclasses.dataclass(kw_only=True)
class Args(ComputeOptions, ProblemOptions):
    """Write NAME.h, NAME.c, example.c with test vectors, and a README. Without a reference the target is an argument of
    the function. With one the function takes the time, unless --no-paths is given. In a stack each target is an
    argument, such as hands_left_position:

    cnclik export ROBOT --stack FILE.toml --no-paths --out DIR"""

    out: Path
    """Folder for the files."""
    kinematics: bool = False
    """Export pose and Jacobian of each tip instead of a step."""
    name: str | None = None
    """Name of the function and of the files; `clik_` is prepended unless the name begins with it. Default: clik_step,
    or clik_kinematics."""
    dtype: Literal["double", "float"] = "double"
    """C type of all numbers."""
    runtime: tuple[str, ...] | None = None
    """Parameters that can be set at run time, such as alpha; default: all. The others are compiled in."""
    compiled_in: bool = False
    """Compile in all parameters."""
    paths: bool = True
    """Compile in the given paths; with --no-paths all targets are arguments."""


def run(args: Args) -> None:
    from cnclik.export.example import BUILD
    from cnclik.export.source import prefixed
    from cnclik.export.write import c

    if args.compiled_in and args.runtime:
        raise errors.fail("runtime", "be left out with --compiled-in", f"is {' '.join(args.runtime)}")
    made = problem(args)
    given = [table(args)] if made.tables is None else made.tables.values()
    along = args.paths and not args.kinematics and any(map(_has_path, given))
    name = args.name or ("kinematics" if args.kinematics else "step")
    with progress.bar("C"):
        c(
            made.law.chain if args.kinematics else made.law,
            made.reference if along else None,
            out=args.out,
            method=made.method,
            stage=made.stage,
            dtype=args.dtype,
            name=name,
            runtime=() if args.compiled_in else args.runtime,
            overwrite=args.overwrite,
        )
    print(*_heading(args, made, along), sep="\n")
    name = prefixed(name)
    print(f"Wrote {name}.h, {name}.c, example.c and README.md to {args.out}/.")
    print(f"Build and test: {BUILD.format(name=name)} && ./example")


def _heading(args, made, along) -> list:
    """Return what was asked, line by line."""
    from cnclik.problem.heading import loop_in_words, robot_and_task, start_and_target, unless_given

    if args.kinematics:
        return [f"{made.name}: kinematics in {args.dtype}"]
    title = f"{robot_and_task(made.name, made.tip, made.law.task)}: step in {args.dtype}"
    if made.tables is None:
        where = f"along {args.reference}" if along else "to a target that is an argument"
    else:
        where = "along its tasks' paths" if along else "to targets that are arguments"
    loop = f"{loop_in_words(made, args.written)} with Ts = {1e3 * made.Ts:g} ms{unless_given(args.written, 'Ts')}"
    paths = start_and_target(made, table(args)) if along else []
    return [f"{title}, {made.method} {where}", f"{loop[0].upper()}{loop[1:]}; Ts is an argument.", *paths]


def _has_path(given) -> bool:
    """Return whether the options give a path or a target."""
    return given.get("reference", "hold") != "hold" or any(name in given for name in PATH)
