"""Names: records made from the words that a user may write, by the table in `words`."""

import itertools
import os
import pathlib
import re
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from cnclik import errors, quantities
from cnclik.integrate.method import named
from cnclik.law import null
from cnclik.problem import words
from cnclik.record import replace
from cnclik.robot import urdf
from cnclik.robot.chain import Chain
from cnclik.robot.files import file_of, read_robot
from cnclik.robot.posture import is_planar, least_singular_values, singular_values, spread_postures, start_posture
from cnclik.robot.tree import text_of
from cnclik.task import build
from cnclik.task.task import Task


def fitting(what: str, name: str, choice: words.Takes, given: dict) -> dict:
    """The given options of a name.

    Raises: ArgumentError for an option that it needs but lacks, or that it does not use and would drop silently.
    """
    for key in choice.needs:
        if given.get(key) is None:
            raise errors.fail(key, f"be given for the {what} {name!r}", "is not")
    given = {key: value for key, value in given.items() if value is not None}
    for key, value in given.items():
        if key not in choice.options:
            raise errors.fail(key, f"be left out for the {what} {name!r}", f"is {value!r}")
    return given


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
    if isinstance(robot, (str, os.PathLike)):
        file = _file_of(str(robot))
        if file is None:
            for name, value in {"base": base, "tips": tips, "freeze": freeze}.items():
                if value is not None:
                    raise errors.fail(name, f"be left out for the robot {str(robot)!r}", f"is {value!r}")
            return robot_from(robot, tip)
        robot = file
    return urdf.chain(read_robot(robot), tip, base, tips=tips, freeze=freeze)


def _file_of(name: str) -> str | None:
    """The file, or its text, that a name means; None for a built-in robot. Raises: ArgumentError for other names."""
    if name.partition(":")[0] in words.ROBOTS:
        return None
    file = name if text_of(name) else file_of(name)
    if file is None:
        names = ", ".join(n for n in words.ROBOTS if not words.ROBOTS[n].needs)
        must = f"be a URDF or MJCF file, {names}, planar:1,1,1 or a name of robot_descriptions"
        raise errors.fail("robot", must, f"is {name!r}")
    return file


def robot_from(text, tip=None, base=None, lengths=None) -> Chain:
    """A file or a name as for `load`, or a planar arm; `planar:1,1,1` is `planar` with these link lengths [m].

    `planar-clockwise` turns as the paper's arms do. `tip` and `base` name links of a file.
    """
    return robot_and_tip(text, tip, base, lengths)[0]


@errors.called("path", "robot")
def robot_and_tip(text, tip=None, base=None, lengths=None, tips=None) -> tuple:
    """(chain, name of its tip; "" if it has none).

    Args: as `robot_from`; tips: in place of `tip`, for several, {name: the argument that names it}.
    """
    if isinstance(text, Chain):
        return text, tip or ", ".join(tips or ())
    if not isinstance(text, (str, pathlib.Path)):
        raise errors.fail("robot", "be a URDF file or the name of a robot", f"is {text!r}")
    name, colon, parts = str(text).partition(":")
    given = {"tip": tip, "base": base, "lengths": lengths}
    if colon and name in words.ROBOTS and "lengths" in words.ROBOTS[name].needs:
        if lengths is not None:
            raise errors.fail("lengths", f"be left out for the robot {str(text)!r}", f"is {lengths!r}")
        try:
            given["lengths"] = [m for part in parts.split(",") for m in quantities.read(part, "m")]
        except ValueError:
            raise errors.fail("robot", "give link lengths such as planar:1,1,1", f"is {str(text)!r}") from None
    elif str(text) not in words.ROBOTS:
        name = str(text)
        tree, links = read_robot(_file_of(name)), fitting("robot", name, words.URDF, given)
        if tips is not None:
            links["tips"] = urdf.tips_of(tree, base, tips)
            return urdf.chain(tree, **links), ", ".join(links["tips"])
        return urdf.chain(tree, **links), urdf.tip_of(tree, **links)
    robot = words.ROBOTS[name]
    if given.pop("tip") not in (None, robot.tip):
        raise errors.fail("tip", f"be {robot.tip!r} for the robot {name!r}", f"is {tip!r}")
    return robot.make(**fitting("robot", name, robot, given)), robot.tip


def robot_name(text, tip=None) -> str:
    """The name of a robot in titles: its file's name without folder, and the tip if it is given."""
    if isinstance(text, Chain):
        return f"{text.n}-joint chain"
    text = str(text)
    name = text if text.partition(":")[0] in words.ROBOTS else pathlib.Path(text).stem
    return f"{name} {tip}" if tip else name


def task_from(text, chain: Chain | None = None, **of) -> Task:
    """`pose`, `position`, `orientation`, or task coordinates by name such as `xy`, `rz`, `xyzrxry`.

    On a planar arm the three words mean its plane: xy with rz, xy, rz. The default is `pose` if the chain has
    the joints for it, else `position`.

    Args: of: `tip`, `relative_to` and `weights`, as `cnclik.pose` takes them.
    """
    if isinstance(text, Task):
        return text
    flat = chain is not None and is_planar(chain)
    if text is None:
        text = "pose" if not flat and (chain is None or _moved_by(chain, of) >= 6) else "position"
    if isinstance(text, str) and text in words.TASKS:
        axes, turns = ("xy", "z") if flat else ("xyz", "xyz")
        axes, turns = axes * (text != "orientation"), turns * (text != "position")
    else:
        found = re.fullmatch(r"(x?y?z?)((?:rx)?(?:ry)?(?:rz)?)", str(text))
        if not found or not text:
            kinds = words.STACKED if of else words.TASKS
            must = f"be {', '.join(kinds)}, or coordinates such as xy or xyrz"
            raise errors.fail("task", must, f"is {text!r}")
        axes, turns = found[1], found[2].replace("r", "")
    if not turns:
        return build.position(axes, **of)
    return build.pose(axes, turns, **of) if axes else build.orientation(turns, **of)


def _moved_by(chain, of) -> int:
    """How many joint coordinates move a tip, relative to another tip if the task is."""
    ways = [chain.way(chain.tip_number(of.get("tip")))]
    ways += [chain.way(chain.tip_number(of["relative_to"]))] if of.get("relative_to") else []
    return len({chain.joints[i].coordinate for way in ways for i in way})


_APART = 1e-3  # least singular value, for an arm of length 1, below which coordinates do not move independently


def require_free(chain: Chain, task) -> None:
    """Raise ArgumentError if no posture of a chain moves a task's coordinates independently.

    The message names coordinates that would do: as many as possible, positions before rotations, with the largest
    least singular value over postures that fill the limits.
    """
    postures = spread_postures(chain)

    def apart(some):
        return float(np.max(least_singular_values(chain, some, postures))) if some.m <= chain.n else 0.0

    if apart(task) > _APART:
        return
    such = ""
    for count in range(min(task.m - 1, chain.n), 0, -1):
        found = [task_from("".join(names)) for names in itertools.combinations(task.names, count)]
        most = max(len(task.position) for task in found)
        best = max((task for task in found if len(task.position) == most), key=apart)
        if apart(best) > _APART:
            such = f", such as {''.join(best.names)}"
            break
    must = f"be coordinates that {chain.n} joints can move independently{such}"
    raise errors.fail("task", must, f"is {' '.join(task.names)}, always singular")


def start_from(chain: Chain, task, q0=None):
    """q0 (n,) [rad, m], checked. The default is a posture inside the limits and away from singularities: of each tip's
    task, and of all tips together."""
    if q0 is None:
        return start_posture(chain, *_of_tips(task).values())
    q0 = errors.array("q0", q0, (chain.n,))
    return np.asarray(q0, float) if errors.concrete(q0) else q0


def _of_tips(task) -> dict:
    """{path: what it asks of one tip, in the base frame}."""
    poses = {path: one for path, one in task.targets if hasattr(one.parts[0], "axes")}
    return {path: replace(one, parts=tuple(replace(p, to=None) for p in one.parts)) for path, one in poses.items()}


def near_singular_start(chain: Chain, task, q0, below) -> str:
    """A sentence on the tasks near a singularity at q0 (n,), by themselves or together; empty where none is, or where
    every posture is near it.

    Args: below: least singular value from which on none is; lengths are in the arm's own unit.
    """
    tips = _of_tips(task)
    least = singular_values(chain, tips.values(), np.asarray(q0, float)[None])[:, 0]
    if (least >= below).all():
        return ""
    most = singular_values(chain, tips.values(), spread_postures(chain)).max(axis=1)
    names = [path[0] for path in tips]
    names.append(f"{' and '.join(dict.fromkeys(names))} together")
    found = [(name, value) for name, value, best in zip(names, least, most, strict=False) if value < below <= best]
    if not found:
        return ""
    where, value = found[0]
    where = where if task.tasks else "the task"
    return f"The start is near a singularity of {where} (least singular value {value:.2g}): give another --q0."


# --- law ----------------------------------------------------------------------------------------------


def gain_from(alpha):
    """A gain [1/s], at least 0: a number, or one per task coordinate; a list of one is a number."""
    alpha = errors.array("alpha", alpha, (), (None,))
    if errors.concrete(alpha) and np.any(np.asarray(alpha) < 0):
        raise errors.fail("alpha", "be at least 0", f"is {' '.join(f'{v:g}' for v in np.atleast_1d(alpha))}")
    return alpha[0] if alpha.shape == (1,) else alpha


def inverse_from(name=None, damping=None, threshold=None):
    """J# by name, one of `words.INVERSES`.

    Args:
      name: the default is damped if `damping` is given, else pseudoinverse.
      damping: λ of the damped ones (never λ²).
      threshold: least singular value below which singular-damped is damped.
    """
    if name is None:
        name = "pseudoinverse" if damping is None else "damped"
    choice = words.INVERSES[errors.one_of("inverse", name, words.INVERSES)]
    given = fitting("inverse", name, choice, {"damping": damping, "threshold": threshold})
    return choice.make(**{key: errors.number(key, value) for key, value in given.items()})


def limits_from(name="none", Ts=None, rate=None, walls=()):
    """The limit method by name, one of `words.LIMITS`; with walls it is bounded.

    The default rate [1/s] is 10, but at most 1/Ts if the sampling time is known: the rate at which one step can stop a
    joint at its limit.
    """
    if walls and name not in ("none", "bounded"):
        raise errors.fail("limits", "be bounded, or be left out, where there are walls", f"is {name!r}")
    name, walls = ("bounded", {"walls": walls}) if walls else (name, {})
    choice = words.LIMITS[errors.one_of("limits", name, words.LIMITS)]
    if name != "bounded":
        if rate is not None:
            raise errors.fail("limit_rate", "come with limits bounded", f"comes with {name}")
        return choice.make() if choice.maker else None
    if rate is None:
        rate = 10.0
        if Ts is not None:
            rate = min(rate, 1.0 / float(Ts)) if errors.concrete(Ts) else jnp.minimum(rate, 1.0 / Ts)
    return choice.make(errors.number("limit_rate", rate, positive=True), **walls)


def null_from(chain: Chain, posture=None, posture_rate=None):
    """The null-space term, or None: towards a `posture` (n,) at `posture_rate` (default 1/s)."""
    if posture is None:
        if posture_rate is not None:
            raise errors.fail("posture_rate", "come with `posture`", "comes without")
        return None
    rate = 1.0 if posture_rate is None else errors.number("posture_rate", posture_rate, positive=True)
    return null.posture(errors.array("posture", posture, (chain.n,)), rate)


# --- loop ---------------------------------------------------------------------------------------------

method_from = named


def stage_from(name="picard", M=5, **options):
    """The solver of implicit stages. Args: name: of the iteration; M: its passes; options: its other options."""
    if hasattr(name, "tolerance"):
        return name
    return words.STAGES[errors.one_of("stage", name, words.STAGES)].make(M, **options)
