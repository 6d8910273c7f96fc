"""Names: robots, tasks, starts and stages from the words that a user may write."""

import itertools
import os
import pathlib
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from cnclik import errors, quantities
from cnclik.integrate import stage
from cnclik.problem.words import PLANAR, ROBOTS, TASKS
from cnclik.record import replace
from cnclik.robot import builtin, urdf
from cnclik.robot.chain import Chain, planar_arm
from cnclik.robot.files import file_of, read_robot
from cnclik.robot.posture import is_planar, singular_values, spread_postures, start_posture
from cnclik.robot.tree import text_of
from cnclik.task import build
from cnclik.task.task import Task

# --- robot, task and start ----------------------------------------------------------------------------


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
    tree = _tree(robot)
    if tree is None:
        return _built_in(str(robot), tip, base=base, tips=tips, freeze=freeze)[0]
    return urdf.chain(tree, tip, base, tips=tips, freeze=freeze)


@errors.called("path", "robot")
def robot_and_tip(robot, tip=None, base=None) -> tuple:
    """(chain, name of its tip; "" if it has none) of a robot as for `load`."""
    if isinstance(robot, Chain):
        return robot, tip or ""
    if not isinstance(robot, (str, pathlib.Path)):
        raise errors.fail("robot", "be a URDF file or the name of a robot", f"is {robot!r}")
    tree = _tree(robot)
    if tree is None:
        return _built_in(str(robot), tip, base=base)
    return urdf.chain(tree, tip, base), urdf.tip_of(tree, tip, base)


def _tree(robot):
    """The tree of a robot's file, text or model; None for a built-in robot. Raises: ArgumentError for other names."""
    if not isinstance(robot, (str, os.PathLike)):
        return read_robot(robot)
    name = str(robot)
    if name.partition(":")[0] in (*ROBOTS, *PLANAR):
        return None
    file = name if text_of(name) else file_of(name)
    if file is None:
        near = errors.nearest(name, ROBOTS)
        must = f"be a URDF or MJCF file, {', '.join(ROBOTS)}, planar:1,1,1 or a name of robot_descriptions"
        raise errors.fail("robot", must, f"is {name!r}{near}")
    return read_robot(file)


def _built_in(name, tip, **others) -> tuple:
    """(chain, name of its tip) of a robot that cnclik has."""
    kind, _, lengths = name.partition(":")
    own = ROBOTS.get(name) or PLANAR.get(kind)
    if own is None:
        raise errors.fail("robot", f"be {kind}", f"is {name!r}")
    for key, value in ({"tip": tip if tip != own else None} | others).items():
        if value is not None:
            must = f"be {own!r}" if key == "tip" else "be left out"
            raise errors.fail(key, f"{must} for the robot {name!r}", f"is {value!r}")
    if name in ROBOTS:
        return getattr(builtin, name)(), own
    try:
        lengths = [m for part in lengths.split(",") for m in quantities.read(part, "m")]
    except ValueError:
        raise errors.fail("robot", "give link lengths such as planar:1,1,1", f"is {name!r}") from None
    return planar_arm(lengths, clockwise=kind != "planar"), own


def robot_name(robot, tip=None) -> str:
    """The name of a robot in titles: its file's name without folder, and the tip if it is given."""
    if isinstance(robot, Chain):
        return f"{robot.n}-joint chain"
    text = str(robot)
    name = text if text.partition(":")[0] in (*ROBOTS, *PLANAR) else pathlib.Path(text).stem
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
            near = errors.nearest(text, TASKS)
            must = f"be {', '.join(TASKS)}, or coordinates such as xy or xyrz"
            raise errors.fail("task", must, f"is {text!r}{near}")
        axes, turns = found[1], found[2].replace("r", "")
    if not turns:
        return build.position(axes, tip=tip)
    return build.pose(axes, turns, tip=tip) if axes else build.orientation(turns, tip=tip)


_APART = 1e-3  # least singular value, for an arm of length 1, below which coordinates do not move independently


def require_free(chain: Chain, task) -> None:
    """Raise ArgumentError if no posture of a chain moves a task's coordinates independently.

    The message names coordinates that would do: as many as possible, positions before rotations, with the largest
    least singular value over postures that fill the limits.
    """
    postures = spread_postures(chain)

    def apart(some):
        each = [some.alone(name) for name, _ in some.tasks] or [some]
        least = [singular_values(chain, [one], postures)[0] for one in each]
        return float(np.min(least, axis=0).max()) if some.m <= chain.n else 0.0

    if apart(task) > _APART:
        return
    counts = range(1, min(task.m - 1, chain.n) + 1)
    fewer = [task_from("".join(names)) for k in counts for names in itertools.combinations(task.names, k)]
    best = max(fewer, key=lambda one: (apart(one) > _APART) * (one.m, len(one.position), apart(one)), default=None)
    such = f", such as {''.join(best.names)}" if best is not None and apart(best) > _APART else ""
    must = f"be coordinates that {chain.n} joints can move independently{such}"
    raise errors.fail("task", must, f"is {' '.join(task.names)}, always singular")


def start_from(chain: Chain, task, q0=None):
    """q0 (n,) [rad, m], checked. The default is a posture inside the limits and away from singularities: of each tip's
    task, and of all tips together."""
    if q0 is None:
        return start_posture(chain, *_of_tips(task).values())
    q0 = errors.array("q0", q0, (chain.n,), of="joint values")
    return np.asarray(q0, float) if errors.concrete(q0) else q0


def _of_tips(task) -> dict:
    """{path: what it asks of one tip, in the base frame}."""
    poses = {path: one for path, one in task.targets if hasattr(one.parts[0], "axes")}
    return {path: replace(one, parts=tuple(replace(p, to=None) for p in one.parts)) for path, one in poses.items()}


# --- loop ---------------------------------------------------------------------------------------------


def stage_from(name="picard", M=5, **options):
    """The solver of implicit stages. Args: name: of the iteration; M: its passes; options: its other options."""
    if hasattr(name, "tolerance"):
        return name
    return getattr(stage, errors.one_of("stage", name, ("picard", "chord", "newton")))(M, **options)
