"""`cnclik tune`: gains by gradient, between bounds that the drives allow."""

import json
import sys
import time
from pathlib import Path

from cnclik import errors, quantities
from cnclik.cli import progress
from cnclik.cli.arguments import PROBLEM
from cnclik.cli.common import numbers, problem
from cnclik.show.output import draw, drawn_by, load_ahead
from cnclik.version import __version__
from cnclik.writing import output_folder

TAKES = PROBLEM


def run(
    robot: str,
    *,
    N: int = 200,
    over: tuple[str, ...] = ("alpha",),
    bounds: tuple[str, ...] = (),
    out: str = "tuned",
    figures: bool = True,
    overwrite: bool = False,
    **loop,
) -> None:
    """Tune the loop that these options describe, so that its RMS error is small. Writes tuned.json and a figure of the
    error before and after. A gain is at most the recommended one of `cnclik stability` for the same drives: without any
    option of the drives, 30 ms of dead time and a lag of 100 ms are assumed.

    Args:
      over: what to tune: alpha in the form that --alpha has, damping, feedforward; of a stack also the gain of one
        task, as in hands.alpha, and of a posture only so.
      bounds: NAME=LOWER,UPPER in place of the defaults, as in alpha=0.1,12.
      out: folder for tuned.json and the figure.
    """
    limits = _limits(bounds)
    made = problem(robot, loop, N=N)
    from cnclik.problem.heading import robot_and_task, start_and_target
    from cnclik.tuning import tune

    if figures:
        load_ahead("cnclik.show.style")
    with output_folder(Path(out), overwrite=overwrite, files=["tuned.json", "error.png"]) as folder:
        begin = time.perf_counter()
        with progress.bar("evaluations") as report:
            asked = dict(over=over, bounds=limits, noise=made.drawn(), drive=made.drive, progress=report)
            loop_ = dict(Ts=made.Ts, N=made.N, method=made.method, stage=made.stage)
            found = tune(made.law, made.reference, made.q0, **loop_, **asked)
        seconds = time.perf_counter() - begin
        config = {"robot": robot, "N": made.N, "over": over, "bounds": limits} | numbers(loop)
        data = _plain(found, config)
        folder.write_text("tuned.json", json.dumps(data, indent=1, allow_nan=False) + "\n")
    print(f"{robot_and_task(made.name, made.tip, made.law.task)}, {made.method}, Ts {1e3 * made.Ts:g} ms, N {made.N}.")
    print(*start_and_target(made), found, sep="\n")
    print(f"{found.evaluations} evaluations in {seconds:.1f} s, compilation included.")
    about = {"Title": f"{made.name}: tuned", "Comment": json.dumps(data["config"])}
    drawn = {"error.png": (drawn_by("run", "tuned", found), about)} if figures else {}
    written = draw(drawn, out, overwrite=overwrite)
    print(f"Wrote {', '.join(sorted(folder.made + written))} to {out}/.")
    if not found.satisfied:
        sys.exit(1)


def _limits(words) -> dict:
    """`alpha=0.1,12` as a table."""
    made: dict = {}
    for word in words:
        key, _, text = word.partition("=")
        values = [quantities.number(part) for part in text.split(",")]
        if key in made or len(values) != 2 or None in values:
            raise errors.fail("bounds", "give NAME=LOWER,UPPER, each name once", f"is {' '.join(words)!r}")
        made[key] = tuple(values)
    return made


def _plain(found, config) -> dict:
    """The result as nested tables of plain numbers, lists and texts."""
    from cnclik.measure.files import plain

    allowed = found.advice.gains
    made = {"cnclik": __version__, "alpha": found.law.alpha}
    made |= {name: {p.name: getattr(p, name) for p in found.parameters} for name in ("start", "lower", "upper", "unit")}
    names = ("values", "loss", "losses", "speeds", "satisfied", "status", "why", "evaluations", "drive")
    made |= {name: getattr(found, name) for name in names} | {"response": found.advice.rates[0].response}
    made["gains"] = {k: getattr(allowed, k) for k in ("recommended", "without_overshoot", "largest_stable", "assumed")}
    return plain(made | {"config": config})
