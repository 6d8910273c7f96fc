"""`cnclik reach`: joint values for targets of a file, or for random ones."""

from __future__ import annotations

import contextlib
import functools
import operator
import pathlib
import time
from typing import TYPE_CHECKING

from cnclik import errors
from cnclik.cli.common import prepare, print_json
from cnclik.quantities import aloud
from cnclik.writing import output_folder

if TYPE_CHECKING:
    from cnclik.problem.build import Point

TAKES = ("robot and task",)


def run(
    robot: str,
    targets: str | None = None,
    *,
    tip: list[str] | None = None,
    target: list[Point] | None = None,
    random: int | None = None,
    near: tuple[float, ...] | None = None,
    path: bool = False,
    jump: float | None = None,
    solutions: int = 1,
    limits: bool = True,
    json: bool = False,
    out: str | None = None,
    overwrite: bool = False,
    **task,
) -> None:
    """Find joint values that put the tip at targets, or several tips at their targets at the same time. Several tips
    have a --tip and a --target each:

    cnclik reach ROBOT --tip left --tip right --task position --target 0.5 0.3 0.2 --target 0.5 -0.3 0.2

    Args:
      targets: FILE.csv with a target per row: columns x, y, z and, for a pose, qw, qx, qy, qz, by name or in this
        order. With several tips each name begins with the tip's, as in left.x.
      tip: last link of the chain. Give --tip several times for several tips with targets at the same time.
      target: one target in place of TARGETS: position [m] and, for a pose, a quaternion w x y z. Give it once for each
        tip.
      random: number of random reachable poses, in place of TARGETS.
      near: joint values from which the search starts [rad, m], such as the robot's present ones.
      path: treat the targets as a path: start each search from the previous answer.
      jump: largest distance of each joint from --near or from the previous answer [rad, m].
      solutions: number of different answers for each target.
      limits: keep joint values within their limits.
      json: print the summary as JSON.
      out: file for the answers: FILE.nc or .csv.
    """
    ways = {"TARGETS": targets, "--target": target, "--random": random}
    given = [name for name, value in ways.items() if value is not None]
    if len(given) != 1:
        found = f"are {' and '.join(given)}" if given else "is none of them"
        must = "One of TARGETS, --target X Y Z and --random N must be given"
        raise errors.ArgumentError(f"{must}, but there {found}.")
    if path and near is not None:
        raise errors.fail("near", "be left out with --path", "is given")
    prepare()
    chain, parts, title = _robot_and_task(robot, tip or [], near, **task)
    if target is not None:
        wanted, line = _given(parts, target), f"Target {'; '.join(map(_point, target))}."
    elif random is not None:
        line = f"Targets: {random:,} random reachable ones."
        wanted = _random(chain, parts, errors.integer("random", random, at_least=1, at_most=errors.MOST))
    else:
        wanted, line = _of_file(parts, pathlib.Path(targets or "")), f"Targets: those of {targets}."
    begins = ", each from the answer before it" * path
    asked = [title, line, f"Search {'within the' if limits else 'without'} joint limits{begins}, to 1 µm and 1 µrad."]
    options = dict(jump=jump, solutions=solutions, limits=limits, near="previous" if path else near)
    with errors.called("targets", "target") if target else contextlib.nullcontext():
        made, seconds = _answers(chain, wanted, parts, options, out, overwrite)
    summary = _summary(made, seconds)
    if json:
        print_json({"asked": asked} | summary)
        return
    print(*asked, sep="\n")
    _tell(made, summary, path)
    if out is not None:
        print(f"Wrote {out}.")


# --- what is asked ------------------------------------------------------------------------------------


def _robot_and_task(robot, tips, near, task=None) -> tuple:
    """(chain, task of all tips, both in words)."""
    from cnclik.problem.names import load, robot_name, task_from
    from cnclik.problem.options import check_units

    if len(tips) != len(set(tips)):
        raise errors.fail("tip", "be different names", f"is {' '.join(tips)}")
    with errors.called("tips", "tip"):
        chain = load(robot, tips=tips) if len(tips) > 1 else load(robot, *tips)
    each = [task_from(task, chain, one).on(chain) for one in (tips if len(tips) > 1 else [None])]
    whole = functools.reduce(operator.and_, each)
    check_units("near", near, chain)
    return chain, whole, f"{robot_name(robot, ' '.join(tips))}, {str(whole)[6:]}"


def _given(task, points):
    from cnclik.reaching.targets import by_name
    from cnclik.task.task import aims

    every = aims(task)
    if len(points) != len(every):
        labels = ", ".join(aim.label for aim in every)
        raise errors.fail("target", f"be given once for each tip ({labels})", f"is given {len(points)} times")
    return by_name(task, [errors.array("target", values)[None] for values in points])


def _point(values) -> str:
    return " ".join(f"{v:.5g}" for v in values)


def _of_file(task, file):
    """Targets of a CSV file, where of several tips columns begin with its name."""
    from cnclik.problem.tables import read_points
    from cnclik.reaching.targets import by_name
    from cnclik.record import replace
    from cnclik.task.task import Task, aims

    errors.ending("TARGETS", file, ".csv")
    every, each = aims(task), []
    for aim in every:
        own = Task(parts=tuple(replace(part, tip=None, to=None) for part in aim.parts))
        each.append(read_points("TARGETS", file, own, tip=aim.label if len(every) > 1 else "")[1])
    return by_name(task, each)


def _random(chain, task, count):
    """Poses of joint values drawn evenly within the limits."""
    import numpy as np

    from cnclik.reaching.starts import spans
    from cnclik.reaching.targets import by_name
    from cnclik.robot.model import modelled
    from cnclik.task.parts import At
    from cnclik.task.task import aims

    low, high = spans(chain)
    at = At(modelled(chain), np.random.default_rng(0).uniform(low, high, (count, chain.n)))
    return by_name(task, [(at.position(aim.tip, aim.to), at.rotation(aim.tip, aim.to)) for aim in aims(task)])


# --- the answers --------------------------------------------------------------------------------------


def _answers(chain, targets, task, options, out, overwrite) -> tuple:
    """(answers, seconds that they took), written to a file."""
    from cnclik.measure.answers import ENDINGS, answers, save
    from cnclik.reaching.public import reach
    from cnclik.reaching.targets import read, transforms

    pose, _ = read(targets, task)
    file = None if out is None else errors.path("out", out)
    if file is None:
        where = contextlib.nullcontext()
    else:
        errors.ending("out", file, *ENDINGS)
        where = output_folder(file.parent, overwrite=overwrite, files=[file.name])
    with where as folder:
        begun = time.perf_counter()
        made = reach(chain, targets, task=task, **options)
        seconds = time.perf_counter() - begun
        if file is not None and folder is not None:
            folder.write(file.name, functools.partial(save, answers(made, transforms(pose))))
    return made, seconds


def _summary(made, seconds) -> dict:
    from cnclik.reaching.result import ReachStatus, count

    first_of_each = made.status[..., 0] if made.status.ndim == 2 else made.status
    return {
        "targets": len(first_of_each),
        "solve_rate": float((first_of_each == ReachStatus.SOLVED).mean()),
        "status": count(first_of_each),
        "seconds": seconds,
    }


def _tell(made, summary, path) -> None:
    """Print the number of targets with each status and its meaning; for a single target also the joint values."""
    import numpy as np

    count = summary["targets"]
    print(f"{count:,} target{'s' * (count > 1)} in {summary['seconds']:.2f} s")
    for name, number in summary["status"].items():
        print(f"  {name:<14} {number:>9,}  {_MEANING[name]}")
    if count == 1:
        q = made.q.reshape(-1, made.chain.n)
        for row in q[np.isfinite(q).all(axis=1)]:
            shown = zip(made.chain.joint_names, row, made.chain.units, strict=True)
            print("  " + ", ".join(f"{n} {v:.6f} {u}" for n, v, u in shown))
        missed = [aloud(float(made.position_error.flat[0]), "m")] * bool(made.task.lengths)
        missed += [aloud(float(made.orientation_error.flat[0]), "rad")] * bool(made.task.angles)
        if np.isfinite(made.position_error.flat[0]):
            print(f"  error {' and '.join(missed)}")
    if path and np.isfinite(made.strays).any():
        print(f"  half-way between rows the tip strays by up to {aloud(float(np.nanmax(made.strays)), 'm')}")


_MEANING = {
    "SOLVED": "within 1 µm and 1 µrad",
    "AT_LIMIT": "reachable only beyond the joint limits; the nearest pose within them is given",
    "OUT_OF_REACH": "not reachable, even without joint limits; the nearest pose is given",
    "JUMP": "reachable only by a jump; no joint values are given",
    "OUT_OF_BUDGET": "no answer found, yet not shown to be out of reach",
    "NON_FINITE": "the target, or --near, is not finite",
    "NO_OTHER": "fewer solutions than requested",
}
