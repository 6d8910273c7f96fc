"""`cnclik export`: the step of a loop as C, for a controller."""

import dataclasses
import json
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
    what: Literal["step", "solve", "reach", "fk", "jacobian"] = "step"
    """What the function computes: one step; N steps in one call (solve); joint values for one target (reach); forward
    kinematics (fk); the Jacobian."""
    name: str = "clik_step"
    """Name of the function and of the files; `clik_` is prepended unless the name begins with it."""
    dtype: Literal["double", "float"] = "double"
    """C type of all numbers."""
    runtime: tuple[str, ...] | None = None
    """Parameters that can be set at run time, such as alpha; default: all. The others are compiled in."""
    compiled_in: bool = False
    """Compile in all parameters."""
    paths: bool = True
    """Compile in the given paths; with --no-paths all targets are arguments."""
    batch: bool = False
    """Also write NAME_batch.c, which runs many loops at once with vector instructions (GCC, Clang)."""
    seeds: int | None = None
    """With --what reach: number of start postures after the given joint values; default: 64."""


def run(args: Args) -> None:
    from cnclik.export.example import BUILD
    from cnclik.export.write import MANIFEST, c

    if args.compiled_in and args.runtime:
        raise errors.fail("runtime", "be left out with --compiled-in", f"is {' '.join(args.runtime)}")
    made = problem(args)
    given = [table(args)] if made.tables is None else made.tables.values()
    along = args.paths and args.what in ("step", "solve") and any(map(_has_path, given))
    reference = made.reference if along else None
    with progress.bar("C"):
        folder = c(
            made.law,
            reference,
            method=made.method,
            stage=made.stage,
            runtime=() if args.compiled_in else args.runtime,
            **{name: getattr(args, name) for name in ("out", "what", "dtype", "name", "batch", "seeds", "overwrite")},
        )
    print(*_heading(args, made, along), sep="\n")
    manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    print(f"Wrote {', '.join(sorted([*manifest['files'], MANIFEST]))} to {folder}/.")
    print(f"Build and test: {BUILD.format(sources=manifest['name'] + '.c example.c')} && ./example")


def _heading(args, made, along) -> list:
    """What was asked."""
    from cnclik.problem.heading import loop_in_words, robot_and_task, start_and_target, unless_given

    title = f"{robot_and_task(made.name, made.tip, made.law.task)}: {args.what} in {args.dtype}"
    if args.what not in ("step", "solve"):
        return [title]
    if made.tables is None:
        where = f"along {args.reference}" if along else "to a target that is an argument"
    else:
        where = "along its tasks' paths" if along else "to targets that are arguments"
    loop = f"{loop_in_words(made, args.written)} with Ts = {1e3 * made.Ts:g} ms{unless_given(args.written, 'Ts')}"
    paths = start_and_target(made, table(args)) if along else []
    return [f"{title}, {made.method} {where}", f"{loop[0].upper()}{loop[1:]}; Ts is an argument.", *paths]


def _has_path(given) -> bool:
    """Whether the options give a path or a target."""
    return given.get("reference", "hold") != "hold" or any(name in given for name in PATH)
