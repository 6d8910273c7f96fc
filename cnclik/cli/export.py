"""`cnclik export`: the step of a loop as C, for a controller."""

from typing import Literal

from cnclik.cli import progress
from cnclik.cli.arguments import PROBLEM
from cnclik.cli.common import problem

TAKES = PROBLEM


def run(robot: str, *, out: str, dtype: Literal["double", "float"] = "double", overwrite: bool = False, **loop) -> None:
    """Write clik_step.h, clik_step.c, example.c with test vectors, and a README. Without a reference the target is an
    argument of the function; with one the function takes the time. Of a stack in FILE.py each target is an argument,
    such as hands_left_position, where problem() returns None for the reference.

    Args:
      out: folder for the files.
      dtype: C type of all numbers.
    """
    made = problem(robot, loop)
    from cnclik.export.example import BUILD
    from cnclik.export.write import c
    from cnclik.problem.heading import loop_in_words, robot_and_task, start_and_target
    from cnclik.problem.reference import OPTIONS

    along = bool({"reference", *OPTIONS} & made.given)
    with progress.bar("C"):
        reference = made.reference if along else None
        c(made.law, reference, out=out, method=made.method, stage=made.stage, dtype=dtype, overwrite=overwrite)
    where = "along its path" if along else "to a target that is an argument"
    if made.law.task.tasks:
        where = "along its tasks' paths" if along else "to targets that are arguments"
    print(f"{robot_and_task(made.name, made.tip, made.law.task)}: step in {dtype}, {where}; Ts is an argument.")
    print(loop_in_words(made), *(start_and_target(made) if along else []), sep="\n")
    print(f"Wrote clik_step.h, clik_step.c, example.c and README.md to {out}/.")
    print(f"Build and test: {BUILD.format(name='clik_step')} && ./example")
