"""`cnclik reach`: joint values for targets of a file, or for random ones."""

import contextlib
import dataclasses
import functools
import pathlib
import time

from cnclik import errors
from cnclik.cli import progress
from cnclik.cli.arguments import option
from cnclik.cli.common import ComputeOptions, print_json
from cnclik.cli.problem import RobotOptions
from cnclik.quantities import aloud
from cnclik.writing import checked_file, output_folder


@dataclasses.dataclass(kw_only=True)
class Args(ComputeOptions, RobotOptions):
    """Find joint values that put the tip at targets, or several tips at their targets at the same time. Several tips
    have a --tip and a --target each:

    cnclik reach ROBOT --tip left --tip right --task position --target 0.5 0.3 0.2 --target 0.5 -0.3 0.2"""

    targets: pathlib.Path | None = option(None, positional=True)
    """FILE.csv with a target per row: columns x, y, z and, for a pose, qw, qx, qy, qz, by name or in this order. With
    several tips each name begins with the tip's, as in left.x. Or FILE.npy, an array as `cnclik.reach` takes it."""
    tip: list[str] = option(list, group="robot and task")
    """Last link of the chain. Give --tip several times for several tips with targets at the same time."""
    target: list[tuple[float, ...]] = option(list, unit="x")
    """One target in place of TARGETS: position [m] and, for a pose, a quaternion w x y z. Give it once for each tip."""
    random: int | None = None
    """Number of random reachable poses, in place of TARGETS."""
    seed: int = 0
    """Seed of the random numbers of --random and of the search."""
    tolerance: tuple[float, float] = option((1e-6, 1e-6), unit="m, rad")
    """Tolerance of position [m] and orientation [rad]."""
    accept: tuple[float, float] | None = option(None, unit="m, rad")
    """Wider tolerances. An answer within them that misses --tolerance is reported as ACCEPTED."""
    near: tuple[float, ...] | None = option(None, unit="q")
    """Joint values from which the search starts [rad, m], such as the robot's present ones."""
    path: bool = False
    """Treat the targets as a path: start each search from the previous answer."""
    jump: float | None = option(None, unit="q")
    """Largest distance of each joint from --near or from the previous answer [rad, m]."""
    solutions: int = 1
    """Number of different answers for each target."""
    seeds: int = 512
    """Largest number of tries for each target."""
    limits: bool = True
    """Keep joint values within their limits."""
    json: bool = False
    """Print the summary as JSON. The search then runs twice, to measure its time without compilation."""
    out: pathlib.Path | None = None
    """File for the answers: FILE.nc or .csv."""


def run(args: Args) -> None:
    _check(args)
    from cnclik.problem.targets import wanted_of

    wanted = wanted_of(args)
    asked = [wanted.title, wanted.line, _search(args, wanted.chain)]
    if not args.json:
        print(*asked, sep="\n")
    with errors.called("targets", "target") if args.target else contextlib.nullcontext():
        _answers(args, wanted, asked)


def _search(args, chain) -> str:
    """A sentence about the search: its tolerance, start and limits."""
    from cnclik.record import in_words

    near = "" if args.near is None else f" from {in_words(args.near)} {', '.join(dict.fromkeys(chain.units))}"
    near = ", each from the answer before it" if args.path else near
    exact = " and ".join(aloud(v, unit) for v, unit in zip(args.tolerance, ("m", "rad"), strict=True))
    limits = "within the joint limits" if args.limits else "without joint limits"
    return f"Search {limits}{near}, to {exact}{' (default)' * ('tolerance' not in args.written)}."


def _check(args):
    ways = {"TARGETS": args.targets, "--target": args.target or None, "--random": args.random}
    given = [name for name, value in ways.items() if value is not None]
    if len(given) != 1:
        found = f"are {' and '.join(given)}" if given else "is none of them"
        must = "One of TARGETS, --target X Y Z and --random N must be given"
        raise errors.ArgumentError(f"{must}, but there {found}.")
    if args.random is not None:
        errors.integer("random", args.random, at_least=1, at_most=errors.MOST)
    if args.path and args.near is not None:
        raise errors.fail("near", "be left out with --path", "is given")


def _answers(args, wanted, asked):
    from cnclik.measure.answers import ENDINGS, answers, save
    from cnclik.reaching.public import reach
    from cnclik.reaching.result import with_axis
    from cnclik.reaching.targets import read, transforms

    chain, task, targets = wanted.chain, wanted.task, wanted.targets
    pose, _ = read(targets, task)
    if args.out is not None:
        checked_file("out", args.out, *ENDINGS, overwrite=args.overwrite)
    names = ("tolerance", "accept", "jump", "solutions", "seeds", "limits", "seed")
    options = {name: getattr(args, name) for name in names} | {"near": "previous" if args.path else args.near}
    with contextlib.nullcontext() if args.out is None else output_folder(args.out.parent) as folder:
        begun = time.perf_counter()
        with progress.bar("targets", len(pose)) as report:
            made = reach(chain, targets, task=task, **options, progress=report)
        first = time.perf_counter() - begun
        made = with_axis(made)
        if folder is not None:
            folder.write(args.out.name, functools.partial(save, answers(made, transforms(pose))))
    again = first
    if args.json:  # run again, to time it without compiling
        begun = time.perf_counter()
        reach(chain, targets, task=task, **options)
        again = time.perf_counter() - begun
    summary = _summary(made, first, again)
    if args.json:
        print_json({"asked": asked} | summary)
    else:
        _tell(made, summary, first, args.path)
        if args.out is not None:
            print(f"Wrote {args.out}.")


def _summary(made, first, again):
    from cnclik.reaching.result import ReachStatus, count
    from cnclik.threads import cores

    first_of_each = made.status[..., 0] if made.status.ndim == 2 else made.status
    total = len(first_of_each)
    return {
        "targets": total,
        "solve_rate": float((first_of_each <= ReachStatus.ACCEPTED).mean()),
        "status": count(first_of_each),
        "us_per_target": 1e6 * again / total,
        "compile_s": max(first - again, 0.0),
        "cores": cores(),
        "evaluations_per_target": float(made.evaluations.mean()),
    }


def _tell(made, summary, seconds, path):
    """Print the number of targets with each status and its meaning; for a single target also the joint values."""
    import numpy as np

    from cnclik.reaching.result import ReachStatus
    from cnclik.task.aims import aims

    count, each = summary["targets"], f"{summary['evaluations_per_target']:.0f}"
    evaluations = f"{each} evaluation{'s' * (each != '1')}{' each' * (count > 1)}"
    print(f"{count:,} target{'s' * (count > 1)} in {seconds:.2f} s, {evaluations}")
    for name, number in summary["status"].items():
        print(f"  {name:<14} {number:>9,}  {_MEANING[name]}")
    if count == 1:
        q = made.q.reshape(-1, made.chain.n)
        for row in q[np.isfinite(q).all(axis=1)]:
            shown = zip(made.chain.joint_names, row, made.chain.units, strict=True)
            print("  " + ", ".join(f"{n} {v:.6f} {u}" for n, v, u in shown))
        missed, least = _error(made, made.task.lengths, made.task.angles), made.least_singular_value.flat[0]
        print(f"  error {missed}; least singular value {least:.3g}")
        for aim, own in zip(aims(made.task), made.each, strict=True) if made.targets is not None else ():
            print(f"    {aim.label}: {_error(own, aim.linear, aim.angular)}")
    if path and np.isfinite(made.strays).any():
        print(f"  half-way between rows the tip strays by up to {aloud(float(np.nanmax(made.strays)), 'm')}")
    held = made.at_limit.reshape(-1, made.chain.n)[(made.status == ReachStatus.AT_LIMIT).ravel()]
    if len(held):
        often = [(int(n), name) for n, name in zip(held.sum(axis=0), made.chain.joint_names, strict=True) if n]
        print("  at limits: " + ", ".join(f"{name} ({n:,} times)" for n, name in sorted(often, reverse=True)[:4]))


def _error(made, lengths, angles) -> str:
    """Position and orientation error of the first target, as far as its task has coordinates of them."""
    parts = [(made.position_error, "m")] * bool(lengths) + [(made.orientation_error, "rad")] * bool(angles)
    return " and ".join(aloud(float(values.flat[0]), unit) for values, unit in parts)


_MEANING = {
    "SOLVED": "within the tolerance",
    "ACCEPTED": "within --accept, but not within the tolerance",
    "AT_LIMIT": "reachable only beyond the joint limits; the nearest pose within them is given",
    "OUT_OF_REACH": "not reachable, even without joint limits; the nearest pose is given",
    "JUMP": "reachable only by a jump; no joint values are given",
    "OUT_OF_BUDGET": "no answer found, yet not shown to be out of reach: try more --seeds",
    "NON_FINITE": "the target, or --near, is not finite",
    "NO_OTHER": "fewer solutions than requested",
}
