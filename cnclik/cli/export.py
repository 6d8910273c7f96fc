"""`cnclik export`: the step of a loop as C, for a controller."""

import dataclasses
from pathlib import Path
from typing import Literal

from cnclik.cli import progress
from cnclik.cli.common import ComputeOptions
from cnclik.cli.problem import ProblemOptions, problem


@dataclasses.dataclass(kw_only=True)
class Args(ComputeOptions, ProblemOptions):
    """Write clik_step.h, clik_step.c, example.c with test vectors, and a README. Without a reference the target is an
    argument of the function; with one the function takes the time. Of a stack in FILE.py each target is an argument,
    such as hands_left_position, where problem() returns None for the reference."""

    out: Path
    """Folder for the files."""
    dtype: Literal["double", "float"] = "double"
    """C type of all numbers."""


def run(args: Args) -> None:
    from cnclik.export.example import BUILD
    from cnclik.export.write import c
    from cnclik.problem.heading import loop_in_words, robot_and_task, start_and_target
    from cnclik.problem.reference import OPTIONS

    made = problem(args)
    along = bool({"reference", *OPTIONS} & made.given)
    loop = dict(method=made.method, stage=made.stage, dtype=args.dtype, overwrite=args.overwrite)
    with progress.bar("C"):
        c(made.law, made.reference if along else None, out=args.out, **loop)
    where = "along its path" if along else "to a target that is an argument"
    if made.law.task.tasks:
        where = "along its tasks' paths" if along else "to targets that are arguments"
    print(f"{robot_and_task(made.name, made.tip, made.law.task)}: step in {args.dtype}, {where}; Ts is an argument.")
    print(loop_in_words(made), *(start_and_target(made) if along else []), sep="\n")
    print(f"Wrote clik_step.h, clik_step.c, example.c and README.md to {args.out}/.")
    print(f"Build and test: {BUILD.format(name='clik_step')} && ./example")
