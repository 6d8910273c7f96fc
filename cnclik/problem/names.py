"""Names: robots, tasks, starts and stages from the words that a user may write."""

import functools
import os
import pathlib
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from cnclik import errors, quantities
from cnclik.integrate import stage
from cnclik.problem.options import PLANAR, ROBOTS, TASKS
from cnclik.record import replace
from cnclik.robot import builtin, urdf
from cnclik.robot.chain import Chain, planar_arm
from cnclik.robot.files import file_of, read_robot
from cnclik.robot.posture import is_planar, start_posture
from cnclik.robot.tree import text_of
from cnclik.task import build
from cnclik.task.task import Task


@errors.called("path", "robot")
def load(
    robot: str | os.PathLike | Any,
    tip: str | None = None,
    base: str | None = None,
    *,
    tips: Sequence[str] | dict | None = None,
    freeze: dict[str, float] | None = None,
) -> Chain:
    """The robot of a file or a name, as the command line reads it.

    Args:
      robot: a URDF or MJCF file, which its first element distinguishes, or its text; a `mujoco.MjSpec` or `MjModel`;
        `panda`, `ur5` or `planar:1,1,1`; or a name of the package robot_descriptions, if that is installed, such as
        `g1_description` or `ur5e_mj_description`.
      tip, base, tips, freeze: as for `load_urdf` and `load_mjcf`.
    Raises: ArgumentError, as those.
    """
    if isinstance(robot, (str, os.PathLike)) and not text_of(robot):
        name, file = str(robot), None
        if is_built_in(name):
            for key, value in {"tip": tip, "base": base, "tips": tips, "freeze": freeze}.items():
                if value is not None:
                    raise errors.fail(key, f"be left out for the robot {name!r}", f"is {value!r}")
            return _built_in(name)
        if (file := file_of(name)) is None:
            must = f"be a URDF or MJCF file, {', '.join(ROBOTS)}, planar:1,1,1 or a name of robot_descriptions"
            raise errors.fail("robot", must, f"is {name!r}{errors.nearest(name, ROBOTS)}")
        robot = file
    return urdf.chain(read_robot(robot), tip, base, tips=tips, freeze=freeze)


@functools.lru_cache  # what is made for a chain, such as a search, is made once
def _built_in(name) -> Chain:
    if name in ROBOTS:
        return getattr(builtin, name)()
    kind, _, lengths = name.partition(":")
    if kind in ROBOTS:
        raise errors.fail("robot", f"be {kind}", f"is {name!r}")
    try:
        metres = [m for part in lengths.split(",") for m in quantities.read(part, "m")]
    except ValueError:
        raise errors.fail("robot", "give link lengths such as planar:1,1,1", f"is {name!r}") from None
    return planar_arm(metres, clockwise=kind != "planar")


def is_built_in(robot) -> bool:
    """Whether it is the name of a built-in robot, such as planar:1,1."""
    return str(robot).partition(":")[0] in (*ROBOTS, *PLANAR)


def robot_name(robot, tip) -> str:
    """The name of a robot in titles: its file's name without folder, and the tip if it is given."""
    if isinstance(robot, Chain):
        return f"{robot.n}-joint chain"
    name = str(robot) if is_built_in(robot) else pathlib.Path(str(robot)).stem
    return f"{name} {tip}" if tip else name


def task_from(text, chain: Chain | None = None, tip: str | None = None) -> Task:
    """`pose`, `position`, `orientation`, or task coordinates by name such as `xy`, `rz`, `xyzrxry`, of a tip.

    On a planar arm the three words mean its plane: xy with rz, xy, rz. The default is `pose` if the chain has
    the joints for it, else `position`.
    """
    if isinstance(text, Task):
        return text
    flat = chain is not None and is_planar(chain)
    if text is None:
        moved = 6 if chain is None else len({chain.joints[i].coordinate for i in chain.way(chain.tip_number(tip))})
        text = "pose" if not flat and moved >= 6 else "position"
    if text in TASKS:
        axes, turns = ("xy", "z") if flat else ("xyz", "xyz")
        axes, turns = axes * (text != "orientation"), turns * (text != "position")
    else:
        found = re.fullmatch(r"(x?y?z?)((?:rx)?(?:ry)?(?:rz)?)", str(text))
        if not found or not text:
            must = f"be {', '.join(TASKS)}, or coordinates such as xy or xyrz"
            raise errors.fail("task", must, f"is {text!r}{errors.nearest(text, TASKS)}")
        axes, turns = found[1], found[2].replace("r", "")
    if not turns:
        return build.position(axes, tip=tip)
    return build.pose(axes, turns, tip=tip) if axes else build.orientation(turns, tip=tip)


def start_from(chain: Chain, task, q0=None):
    """q0 (n,) [rad, m], checked. The default is a posture inside the limits and away from singularities: of each tip's
    task, and of all tips together."""
    if q0 is None:
        poses = (of for _, of in errors.kind("task", task, Task).targets if hasattr(of.parts[0], "axes"))
        return start_posture(chain, *(replace(of, parts=tuple(replace(p, to=None) for p in of.parts)) for of in poses))
    q0 = errors.array("q0", q0, (chain.n,), of="joint values")
    return np.asarray(q0, float) if errors.concrete(q0) else q0


def stage_from(name="picard", M=5, **options):
    """The solver of implicit stages. Args: name: of the iteration; M: its passes; options: its other options."""
    if hasattr(name, "tolerance"):
        return name
    return getattr(stage, errors.one_of("stage", name, ("picard", "chord", "newton")))(M, **options)
