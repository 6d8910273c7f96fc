"""`python -m tests.bench.rivals`: what a user would do instead of a gradient, given as many evaluations.

The paper's arms, Panda and UR5, one gain and one per axis; a grid by `sweep`, scipy's Nelder-Mead, the hand-picked
alpha = 5 of the paper, and `tune`. Gains may ring here (z beyond 1): the question is who finds the least error under a
margin. Each way pays for what it asks: Nelder-Mead evaluates the objective that `tune` descends, one point at a time in
a program of one lane. What they find is judged alike, by measured spectral radius and joint velocities along the runs.

    python -m tests.bench.rivals                          # all, into results/tuning: minutes
    python -m tests.bench.rivals --cases "2-dof line"     # some
"""

import argparse
import csv
import io
import json
import math
import pathlib
import time
from typing import NamedTuple

import jax
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter

from cnclik import errors, markup
from cnclik.integrate.solve import solve
from cnclik.measure.files import markdown
from cnclik.measure.metrics import measure_run
from cnclik.problem.build import problem_from
from cnclik.record import replace
from cnclik.show import style
from cnclik.sweeps.sweep import sweep
from cnclik.tuning import Descent, judge, loop_objective, tune
from cnclik.tuning import parameters as pm

RESULTS = pathlib.Path(__file__).parents[2] / "results" / "tuning"
HAND = 5.0  # [1/s], Drexler (2016), Section V

_LINE2 = dict(reference="line", q0=[0.0, math.pi / 2], **{"from": [1.0, 1.0], "to": [0.0, 1.0]})
_LINE5 = dict(reference="line", q0=[0.0, math.pi / 2, 0.0, 0.0, 0.0], **{"from": [4.0, 1.0], "to": [3.0, 1.0]})
_PAPER = dict(Ts=0.1, N=30)
_REAL = dict(reference="circle", Ts=0.05, N=100, damping=0.01)
CASES = {
    "2-dof line": ("planar-clockwise:1,1", _PAPER | _LINE2),
    "5-dof line": ("planar-clockwise:1,1,1,1,1", _PAPER | _LINE5),
    "Panda circle": ("panda", _REAL),
    "UR5 circle": ("ur5", _REAL),
}
GAINS = ("scalar", "per-axis")


class Row(NamedTuple):
    """One way to find a gain, and what it found."""

    case: str
    gain: str
    way: str
    loss: float  # RMS error [m, rad], e[0] left out; inf for a run that is not finite
    satisfied: bool
    radius: float
    speed: float
    evaluations: int
    seconds: float  # CPU time from nothing: tracing and compilation included
    again: float  # the same once more in the same process
    alpha: list


def rivals(case: str, gain: str, *, method="EE", margin=0.9, steps=100, progress=None) -> list:
    """Rows for one robot and one shape of gain.

    Args:
      case: one of `CASES`. gain: "scalar" or "per-axis". method: as for `solve`. margin: as for `tune`.
      steps: evaluations each way may use.
      progress: called with each `Row`, or None.
    Raises: ArgumentError for unknown names and what `tune` refuses.
    """
    robot, options = CASES[errors.one_of("case", case, CASES)]
    errors.one_of("gain", gain, GAINS)
    made = problem_from(robot, method=method, alpha=HAND, **options)
    law = made.law
    if gain == "per-axis":
        law = replace(law, alpha=np.full(law.task.m, HAND))
    loop = dict(Ts=made.Ts, N=made.N, method=made.method, stage=made.stage, margin=margin, ringing=True)
    objective = loop_objective(law, made.reference, made.q0, **loop)
    (by_hand,) = judge(objective, [(law.alpha,)])
    descent = Descent(steps=steps)

    def by_tune():
        found = tune(law, made.reference, made.q0, descent=descent, **loop)
        return found.law.alpha, found.evaluations

    ways = {
        "hand-picked α = 5": lambda: (law.alpha, 1),
        "grid": lambda: _by_grid(objective, made, law, steps),
        "Nelder-Mead": lambda: _by_simplex(replace(objective, postures=by_hand.postures), law.alpha, steps),
        "gradient": by_tune,
    }
    rows = []
    for way, search in ways.items():
        jax.clear_caches()  # each way pays for its own programs
        (alpha, evaluations), seconds = _timed(search)
        again = _timed(search)[1]
        (seen,) = judge(objective, [(np.asarray(alpha, float),)])
        numbers = float(seen.radius), float(seen.speed)
        alpha = np.atleast_1d(np.asarray(alpha, float)).tolist()
        rows.append(Row(case, gain, way, float(seen.loss), seen.feasible, *numbers, evaluations, seconds, again, alpha))
        if progress is not None:
            progress(rows[-1])
    return rows


def _timed(search):
    begin = time.process_time()
    found = search()
    return found, time.process_time() - begin


def _by_grid(objective, made, law, steps):
    """The best point of a `sweep` that keeps the constraints: RMS errors first, stability of the best ones after."""
    points = grid_of(objective.parameters[0], steps)

    def study(alpha):
        mine = replace(law, alpha=alpha)
        run = solve(mine, made.reference, made.q0, made.Ts, made.N, made.method, made.stage)
        return measure_run(run, mine, made.reference, ("rms_error", "velocity_ratio"))

    found = sweep(study, alpha=points)
    order = np.argsort(np.where(found.velocity_ratio > 1, np.inf, found.rms_error), kind="stable")
    for i in range(0, len(order), 16):
        few = points[order[i : i + 16]]
        kept = [alpha for alpha, seen in zip(few, judge(objective, [(a,) for a in few]), strict=True) if seen.feasible]
        if kept:
            return kept[0], len(points)
    return points[order[0]], len(points)


def grid_of(p, steps):
    """At most `steps` gains (S, ...) of a `Parameter`, evenly spread in the logarithm, and at least two per axis.

    Over the bounds' inside where explicit Euler can be stable, z = 0.01 to 2.5 for the default ones.
    """
    count = int(np.prod(np.shape(p.start), dtype=int))
    each = max(2, int(steps ** (1 / count) + 1e-9))
    axis = np.geomspace(np.max(p.lower) * 10, np.max(p.upper) / 4, each)
    return np.stack(np.meshgrid(*[axis] * count), -1).reshape(-1, *np.shape(p.start))


@jax.jit
def _evaluate(objective, values):
    return objective(values)


def _by_simplex(objective, start, steps):
    """scipy's Nelder-Mead on the free numbers, values that break a constraint counted as worse than any that don't."""
    from scipy.optimize import minimize

    (p,) = objective.parameters
    used = 0

    def cost(u):
        nonlocal used
        used += 1
        loss, constraints = _evaluate(objective, (np.asarray(pm.bounded(p, u)),))
        violation = float(np.max(constraints))
        if not (np.isfinite(violation) and np.isfinite(loss)):
            return 1e9
        return float(loss) if violation <= 0 else 1e3 * (1 + min(violation, 1e5))

    options = {"maxfev": steps, "xatol": 1e-6, "fatol": 0}
    found = minimize(cost, pm.free(p, start), method="Nelder-Mead", options=options)
    return np.asarray(pm.bounded(p, found.x)), used


def table(rows) -> str:
    """The rows as a Markdown table."""
    header = ("case", "gain", "way", "RMS error", "kept", "radius", "evaluations", "CPU seconds", "again")
    lines = []
    for r in rows:
        loss = f"{r.loss:.5g}" if math.isfinite(r.loss) else "not finite"
        kept = "yes" if r.satisfied else "NO"
        cells = (r.case, r.gain, r.way, loss, kept, f"{r.radius:.3f}", r.evaluations)
        times = [f"{t:.{digits}f}" if math.isfinite(t) else "–" for t, digits in ((r.seconds, 1), (r.again, 2))]
        lines.append((*cells, *times))
    return markdown(header, lines, left=3)


def as_csv(rows) -> str:
    """The rows as a CSV file, gains as JSON lists."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(Row._fields)
    for row in rows:
        writer.writerow([*row[:-1], json.dumps(row.alpha)])
    return file.getvalue()


def page(rows, margin, steps) -> str:
    """The table with a line on how it was made."""
    return (
        "# Is tuning by gradient better than a grid or Nelder-Mead? The table\n\n"
        f"Explicit Euler, loss RMS error, margin {margin:g}, gains that ring allowed, at most {steps} evaluations each "
        "(a gradient evaluation counts as one). Seconds are CPU time, tracing and compilation included; again: the "
        "same search once more in the same process.\n\n" + table(rows)
    )


_WAYS = {
    "hand": ("0.45", "s"),
    "grid": (style.ORANGE, "^"),
    "Nelder": (style.GREEN, "v"),
    "gradient": (markup.BLUE, "D"),
}


def picture(rows):
    """What each way to find a gain reached, and how long it took.

    Args:
      rows: `Row`s. Hollow where a constraint is broken.
    """
    places = list(dict.fromkeys((r.case, r.gain) for r in rows))
    figure, panels = plt.subplots(1, 2, figsize=(style.PAGE, 0.9 + 0.3 * len(places)), sharey=True)
    for panel, value, label in (
        (panels[0], lambda r: r.loss, "RMS error [m, rad]"),
        (panels[1], lambda r: r.seconds if r.evaluations > 1 else 0.0, "CPU time, compilation included [s]"),
    ):
        for name, (color, marker) in _WAYS.items():
            for r in (r for r in rows if r.way.startswith(name) and value(r) > 0 and np.isfinite(value(r))):
                y = places.index((r.case, r.gain)) + 0.16 * (list(_WAYS).index(name) - 1.5)
                face = color if r.satisfied else "white"
                panel.plot(value(r), y, marker, color=color, markerfacecolor=face, markersize=4.5)
        panel.set_xscale("log")
        panel.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        panel.xaxis.set_major_formatter("{x:g}")
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.set_xlabel(label)
        for y in range(1, len(places)):
            panel.axhline(y - 0.5, color="0.9", linewidth=0.5, zorder=0)
        panel.grid(False, axis="y")
    panels[0].set_yticks(range(len(places)), [f"{case}, {gain}" for case, gain in places])
    panels[0].set_ylim(len(places) - 0.5, -0.5)
    named = {name: next((r.way for r in rows if r.way.startswith(name)), None) for name in _WAYS}
    for name, (color, marker) in _WAYS.items():
        if named[name]:
            panels[0].plot([], [], marker, color=color, markersize=4.5, label=named[name])
    if not all(r.satisfied for r in rows):
        panels[0].plot([], [], "o", color="0.3", markerfacecolor="white", markersize=4.5, label="constraint broken")
    figure.legend(*panels[0].get_legend_handles_labels(), ncols=5, loc="outside upper center")
    return figure


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--gains", nargs="+", choices=GAINS, default=list(GAINS))
    parser.add_argument("--steps", type=int, default=100, help="evaluations each way may use")
    parser.add_argument("--margin", type=float, default=0.9, help="bound of the spectral radius along the path")
    parser.add_argument("--out", type=pathlib.Path, default=RESULTS, help="folder for rivals.md, .csv and .png")
    args = parser.parse_args(argv)
    rows = []
    args.out.mkdir(parents=True, exist_ok=True)
    for case in args.cases:
        for gain in args.gains:
            rows += rivals(case, gain, margin=args.margin, steps=args.steps, progress=lambda row: print(*row[:3]))
            (args.out / "rivals.csv").write_text(as_csv(rows), encoding="utf-8")
    (args.out / "rivals.md").write_text(page(rows, args.margin, args.steps), encoding="utf-8")
    with style.style():
        style.save(picture(rows), args.out / "rivals.png", {"Title": "Tuning against its rivals"})
    print(table(rows))


if __name__ == "__main__":
    plt.switch_backend("agg")
    jax.config.update("jax_enable_x64", True)
    main()
