"""`cnclik reach`: joint values for targets of a file, or for random ones."""

from __future__ import annotations

import contextlib
import functools
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
MEANING = {
    "SOLVED": "within 1 µm and 1 µrad",
    "AT_LIMIT": "reachable only beyond the joint limits; the nearest pose within them is given",
    "OUT_OF_REACH": "not reachable, even without joint limits; the nearest pose is given",
    "JUMP": "reachable only by a jump; no joint values are given",
    "OUT_OF_BUDGET": "no answer found, yet not shown to be out of reach",
    "NON_FINITE": "the target, or --near, is not finite",
}


def run(
    robot: str,
    targets: str | None = None,
    *,
    target: Point | None = None,
    random: int | None = None,
    near: tuple[float, ...] | None = None,
    path: bool = False,
    jump: float | None = None,
    json: bool = False,
    out: str | None = None,
    overwrite: bool = False,
    **arm,
) -> None:
    """Find joint values within the joint limits that put the tip at targets.

    Args:
      robot: a URDF or MJCF file, a name of robot_descriptions, or a built-in robot such as panda.
      targets: FILE.csv with a target per row: columns x, y, z and, for a pose, qw, qx, qy, qz, by name or in this
        order.
      target: one target in place of TARGETS: position [m] and, for a pose, a quaternion w x y z.
      random: number of random reachable poses, in place of TARGETS.
      near: joint values from which the search starts [rad, m], such as the robot's present ones.
      path: treat the targets as a path: start each search from the answer before it.
      jump: largest distance of each joint from --near, or from the answer before it [rad, m].
      json: print the summary as JSON.
      out: file for the answers: FILE.csv, with a row for each target.
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
    import numpy as np

    from cnclik.problem.names import load, robot_name, task_from
    from cnclik.problem.options import check_units
    from cnclik.problem.tables import read_points
    from cnclik.reaching.public import reach
    from cnclik.reaching.result import ReachStatus, count
    from cnclik.reaching.targets import read

    chain = load(robot, arm.get("tip"))
    task = task_from(arm.get("task"), chain).on(chain)
    check_units("near", near, chain)
    if target is not None:
        wanted = errors.array("target", target)[None]
        line = f"Target {' '.join(f'{v:.5g}' for v in wanted[0])}."
    elif random is not None:
        line = f"Targets: {random:,} random reachable ones."
        wanted = _random(chain, errors.integer("random", random, at_least=1, at_most=errors.MOST))
    else:
        errors.ending("TARGETS", pathlib.Path(targets or ""), ".csv")
        wanted, line = read_points("TARGETS", targets, task)[1], f"Targets: those of {targets}."
    where: contextlib.AbstractContextManager = contextlib.nullcontext()
    if out is not None:
        file = errors.path("out", out)
        errors.ending("out", file, ".csv")
        where = output_folder(file.parent, overwrite=overwrite, files=[file.name])
    with errors.called("targets", "target" if target else "targets"):
        pose, _ = read(wanted, task)
    with where as folder:
        begun = time.perf_counter()
        made = reach(chain, wanted, task=task, near="previous" if path else near, jump=jump)
        seconds = time.perf_counter() - begun
        if folder is not None:
            folder.write(file.name, functools.partial(_save, made))
    asked = [f"{robot_name(robot, arm.get('tip'))}, {str(task)[6:]}", line]
    solved, statuses = float((made.status == ReachStatus.SOLVED).mean()), count(made.status)
    if json:
        facts: dict = {"targets": len(pose), "solve_rate": solved, "status": statuses, "seconds": seconds}
        print_json({"asked": asked} | facts)
        return
    print(*asked, f"{len(pose):,} target{'s' * (len(pose) > 1)} in {seconds:.2f} s", sep="\n")
    for name, number in statuses.items():
        print(f"  {name:<14} {number:>9,}  {MEANING[name]}")
    if path and np.isfinite(made.strays).any():
        print(f"  half-way between rows the tip strays by up to {aloud(float(np.nanmax(made.strays)), 'm')}")
    if len(pose) == 1:
        _print_one(made)
    if out is not None:
        print(f"Wrote {out}.")


def _random(chain, count):
    """Poses of joint values drawn evenly within the limits."""
    import numpy as np

    from cnclik.reaching.starts import spans
    from cnclik.robot.model import modelled
    from cnclik.task.parts import At

    low, high = spans(chain)
    at = At(modelled(chain), np.random.default_rng(0).uniform(low, high, (count, chain.n)))
    return at.position(None, None), at.rotation(None, None)


def _save(made, path) -> None:
    """Write answers as CSV, with a row for each target."""
    import numpy as np
    import pandas

    from cnclik.reaching.result import ReachStatus

    joints = np.array(made.chain.joint_names)
    columns: dict = {"status": [ReachStatus(code).name for code in made.status]}
    columns |= dict(zip(joints, made.q.T + 0.0, strict=True))  # no −0, here and below
    columns |= {name: getattr(made, name) + 0.0 for name in ("position_error", "orientation_error", "distance")}
    columns["at_limit"] = [" ".join(joints[hit]) for hit in made.at_limit]
    pandas.DataFrame(columns).to_csv(path, index_label="target", na_rep="nan")


def _print_one(made) -> None:
    """Print the joint values and the error of a single target."""
    import numpy as np

    (q,), where, turn = made.q, float(made.position_error[0]), float(made.orientation_error[0])
    if np.isfinite(q).all():
        shown = zip(made.chain.joint_names, q, made.chain.units, strict=True)
        print("  " + ", ".join(f"{name} {v:.6f} {unit}" for name, v, unit in shown))
        missed = [aloud(where, "m")] * bool(made.task.lengths) + [aloud(turn, "rad")] * bool(made.task.angles)
        print(f"  error {' and '.join(missed)}")
