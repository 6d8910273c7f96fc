"""`cnclik tune`: the gain by gradient, below the one that the drives allow."""

import json
import sys
from pathlib import Path

from cnclik.cli import progress
from cnclik.cli.arguments import PROBLEM
from cnclik.cli.common import problem
from cnclik.problem.options import in_own_units
from cnclik.show.output import draw, drawn_by, load_ahead
from cnclik.version import __version__
from cnclik.writing import output_folder

TAKES = PROBLEM
FIELDS = ("values", "loss", "losses", "speeds", "satisfied", "status", "why", "evaluations", "drive")
GAINS = ("recommended", "without_overshoot", "largest_stable", "assumed")


def run(robot: str, *, N: int = 200, out: str = "tuned", figures: bool = True, overwrite: bool = False, **loop) -> None:
    """Tune alpha of the loop that these options describe, so that its RMS error is small. Writes tuned.json and a
    figure of the error before and after. The gain is at most the recommended one of `cnclik stability` for the same
    drives: without any option of the drives, 30 ms of dead time and a lag of 100 ms are assumed.

    Args:
      out: folder for tuned.json and the figure.
    """
    made = problem(robot, loop, N=N)
    from cnclik.measure.files import plain
    from cnclik.tuning import tune

    if figures:
        load_ahead("cnclik.show.style")
    with output_folder(Path(out), overwrite=overwrite, files=["tuned.json", "error.png"]) as folder:
        with progress.bar("evaluations") as report:
            how = dict(Ts=made.Ts, N=made.N, method=made.method, stage=made.stage, noise=made.drawn())
            found = tune(made.law, made.reference, made.q0, **how, drive=made.drive, progress=report)
        gains = {name: getattr(found.advice.gains, name) for name in GAINS}
        config = {"robot": robot, "N": made.N} | in_own_units(loop)[0]
        data = {"cnclik": __version__, "alpha": found.law.alpha} | {name: getattr(found, name) for name in FIELDS}
        data = plain(data | {"response": found.advice.rates[0].response, "gains": gains, "config": config})
        folder.write_text("tuned.json", json.dumps(data, indent=1, allow_nan=False) + "\n")
    print(made, found, f"{found.evaluations} evaluations.", sep="\n")
    about = {"Title": f"{made.name}: tuned", "Comment": json.dumps(data["config"])}
    drawn = {"error.png": (drawn_by("run", "tuned", found), about)} if figures else {}
    written = draw(drawn, out, overwrite=overwrite)
    print(f"Wrote {', '.join(sorted(folder.made + written))} to {out}/.")
    if not found.satisfied:
        sys.exit(1)
