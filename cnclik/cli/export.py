"""`cnclik export`: the step of a loop as C, for a controller."""

import dataclasses
from typing import Literal

from cnclik.cli.arguments import PROBLEM
from cnclik.cli.common import problem

TAKES = [group for group in PROBLEM if group != "drive"]  # the step is the controller's part of the loop


def run(robot: str, *, out: str, dtype: Literal["double", "float"] = "double", overwrite: bool = False, **loop) -> None:
    """Write clik_step.h, clik_step.c, example.c with test vectors, and a README. Along a path the function takes the
    time; a target that stands still is an argument of it, of a stack each target, such as hands_left_position.

    Args:
      out: folder for the files.
      dtype: C type of all numbers.
    """
    made = problem(robot, loop)
    from cnclik.export.example import BUILD
    from cnclik.export.write import c
    from cnclik.integrate.drive import drive_in_words

    path = None if made.reference.still else made.reference
    c(made.law, path, out=out, method=made.method, stage=made.stage, dtype=dtype, overwrite=overwrite)
    where = "to targets that are arguments" if path is None else "along its path"
    if made.drive is not None and not made.drive.prompt:
        print(f"Not part of the step: {drive_in_words(made.drive, made.Ts)}.")
    print(dataclasses.replace(made, drive=None), f"Step in {dtype}, {where}; Ts is an argument.", sep="\n")
    print(f"Wrote clik_step.h, clik_step.c, example.c and README.md to {out}/.")
    print(f"Build and test: {BUILD.format(name='clik_step')} && ./example")
