"""`cnclik tune`: gains by gradient, between bounds that the drives allow."""

import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import Any

from cnclik import errors, quantities
from cnclik.cli import progress
from cnclik.cli.arguments import option
from cnclik.cli.common import ComputeOptions
from cnclik.cli.problem import ProblemOptions, given, problem
from cnclik.show.output import draw, drawn_by, load_ahead
from cnclik.version import __version__
from cnclik.writing import output_folder


@dataclasses.dataclass(kw_only=True)
class Args(ComputeOptions, ProblemOptions):
    """Tune the loop that these options describe. Writes tuned.json and a figure of the error before and after. A gain
    is at most the recommended one of `cnclik stability` for the same drives: without any option of the drives, 30 ms of
    dead time and a lag of 100 ms are assumed."""

    N: int = option(200, group="loop")
    """Number of steps."""
    over: tuple[str, ...] = ("alpha",)
    """What to tune: alpha in the form that --alpha has, posture_rate, damping, feedforward; of a stack also the gain of
    one task, as in hands.alpha, and of a posture only so."""
    bounds: tuple[str, ...] = option((), metavar="NAME=LOWER,UPPER ...")
    """Bounds in place of the defaults, as in alpha=0.1,12."""
    loss: tuple[str, ...] = option(("tracking",), metavar="NAME[=WEIGHT] ...")
    """What to minimize: tracking (RMS of the error), settling, effort, jerk. Several have weights, as in tracking=1
    jerk=1e-4."""
    out: Path = Path("tuned")
    """Folder for tuned.json and the figure."""
    figures: bool = True
    """Draw the figure."""


def run(args: Args) -> None:
    bounds, loss = _pairs("bounds", args.bounds, 2), _pairs("loss", args.loss, 1)
    made = problem(args)
    from cnclik.problem.heading import robot_and_task, start_and_target
    from cnclik.tuning import tune

    if args.figures:
        load_ahead("cnclik.show.style")
    loop: dict[str, Any] = dict(Ts=made.Ts, N=made.N, method=made.method, stage=made.stage, drive=made.drive)
    asked: dict[str, Any] = dict(over=args.over, bounds=bounds, loss=loss, noise=made.drawn())
    with output_folder(args.out, overwrite=args.overwrite, files=["tuned.json", "error.png"]) as folder:
        begin = time.perf_counter()
        with progress.bar("evaluations") as report:
            found = tune(made.law, made.reference, made.q0, **loop, **asked, progress=report)
        seconds = time.perf_counter() - begin
        data = _plain(found, args)
        folder.write_text("tuned.json", json.dumps(data, indent=1, allow_nan=False) + "\n")
    print(f"{robot_and_task(made.name, made.tip, made.law.task)}, {made.method}, Ts {1e3 * made.Ts:g} ms, N {made.N}.")
    print(*start_and_target(made), found, sep="\n")
    print(f"{found.evaluations} evaluations in {seconds:.1f} s, compilation included.")
    about = {"Title": f"{made.name}: tuned", "Comment": json.dumps(data["config"])}
    figures = {"error.png": (drawn_by("run", "tuned", found), about)} if args.figures else {}
    written = draw(figures, args.out, overwrite=args.overwrite)
    print(f"Wrote {', '.join(sorted(folder.made + written))} to {args.out}/.")
    if not found.satisfied:
        sys.exit(1)


def _pairs(name, words, count) -> dict:
    """`tracking`, `tracking=1 jerk=1e-4` or `alpha=0.1,12` as a table."""
    made: dict = {}
    for word in words:
        key, _, text = word.partition("=")
        values = [quantities.number(part) for part in text.split(",")] if text or count > 1 else [1.0]
        if key in made or len(values) != count or None in values:
            what = "weights as numbers, such as jerk=1e-4" if count == 1 else "NAME=LOWER,UPPER"
            raise errors.fail(name, f"give {what}, each name once", f"is {' '.join(words)!r}")
        made[key] = values[0] if count == 1 else tuple(values)
    return made


def _plain(found, args) -> dict:
    """The result as nested tables of plain numbers, lists and texts."""
    from cnclik.measure.files import plain

    allowed = found.advice.gains
    made = {"cnclik": __version__, "alpha": found.law.alpha}
    made |= {name: {p.name: getattr(p, name) for p in found.parameters} for name in ("start", "lower", "upper", "unit")}
    names = ("values", "loss", "losses", "speeds", "satisfied", "status", "why", "evaluations", "drive")
    made |= {name: getattr(found, name) for name in names} | {"response": found.advice.rates[0].response}
    made["gains"] = {k: getattr(allowed, k) for k in ("recommended", "without_overshoot", "largest_stable", "assumed")}
    own = {name: getattr(args, name) for name in ("robot", "N", "over", "bounds", "loss")}
    return plain(made | {"config": own | given(args)})
