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


def run(
    robot: str,
    targets: str | None = None,
    *,
    target: Point | None = None,
    random: int | None = None,
    near: tuple[float, ...] | None = None,
    path: bool = False,
    jump: float | None = None,
    solutions: int = 1,
    limits: bool = True,
    json: bool = False,
    out: str | None = None,
    overwrite: bool = False,
    **arm,
) -> None:
    """Find joint values that put the tip at targets.

    Args:
      targets: FILE.csv with a target per row: columns x, y, z and, for a pose, qw, qx, qy, qz, by name or in this
        order.
      target: one target in place of TARGETS: position [m] and, for a pose, a quaternion w x y z.
      random: number of random reachable poses, in place of TARGETS.
      near: joint values from which the search starts [rad, m], such as the robot's present ones.
      path: treat the targets as a path: start each search from the previous answer.
      jump: largest distance of each joint from --near or from the previous answer [rad, m].
      solutions: number of different answers for each target.
      limits: keep joint values within their limits.
      json: print the summary as JSON.
      out: file for the answers: FILE.csv, with a row per target and solution.
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
    from cnclik.problem.names import load, robot_name, task_from
    from cnclik.problem.options import check_units
    from cnclik.problem.tables import read_points
    from cnclik.reaching.public import reach
    from cnclik.reaching.result import ReachStatus, count
    from cnclik.reaching.targets import read, transforms

    chain = load(robot, arm.get("tip"))
    task = task_from(arm.get("task"), chain)
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
    begins = ", each from the answer before it" * path
    asked = [f"{robot_name(robot, arm.get('tip'))}, {str(task.on(chain))[6:]}", line]
    asked.append(f"Search {'within the' if limits else 'without'} joint limits{begins}, to 1 µm and 1 µrad.")
    where: contextlib.AbstractContextManager = contextlib.nullcontext()
    if out is not None:
        file = errors.path("out", out)
        errors.ending("out", file, ".csv")
        where = output_folder(file.parent, overwrite=overwrite, files=[file.name])
    with errors.called("targets", "target" if target else "targets"):
        pose, _ = read(wanted, task.on(chain))
    with where as folder:
        begun = time.perf_counter()
        begin = "previous" if path else near
        made = reach(chain, wanted, near=begin, task=task, jump=jump, solutions=solutions, limits=limits)
        seconds = time.perf_counter() - begun
        if folder is not None:
            folder.write(file.name, functools.partial(_save, made, transforms(pose)))
    first = made.status[..., 0] if made.status.ndim == 2 else made.status  # of several solutions
    solved = float((first == ReachStatus.SOLVED).mean())
    summary = {"targets": len(first), "solve_rate": solved, "status": count(first), "seconds": seconds}
    if json:
        print_json({"asked": asked} | summary)
        return
    print(*asked, sep="\n")
    _tell(made, summary, path)
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


def _save(made, transforms, path) -> None:
    """Write answers for targets (B, 4, 4) as CSV, with a row per target and solution."""
    import numpy as np

    from cnclik.measure.files import save_csv
    from cnclik.reaching.result import ReachStatus

    shape, joints = np.shape(made.status), np.array(made.chain.joint_names)
    columns: dict = dict(zip(("target", "solution"), np.indices(shape).reshape(len(shape), -1), strict=False))
    columns["status"] = [ReachStatus(code).name for code in made.status.ravel()]
    columns |= dict(zip(joints, made.q.reshape(-1, len(joints)).T, strict=True))
    columns |= {name: getattr(made, name).ravel() for name in ("position_error", "orientation_error", "distance")}
    columns["at_limit"] = [" ".join(joints[hit]) for hit in made.at_limit.reshape(-1, len(joints))]
    targets = np.repeat(transforms.reshape(len(transforms), 16), len(columns["status"]) // len(transforms), axis=0)
    columns |= {f"t{k // 4}{k % 4}": column for k, column in enumerate(targets.T)}
    plain = [(v + 0.0).tolist() if np.asarray(v).dtype.kind == "f" else v for v in columns.values()]  # no −0
    save_csv([list(columns), *zip(*plain, strict=True)], path)


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
