"""Rivals: what a user would do instead of a gradient, given as many evaluations.

The paper's arms, Panda and UR5, one gain and one per axis; a grid by `sweep`, scipy's Nelder-Mead, the hand-picked
alpha = 5 of the paper, and `tune`. All are judged alike, by measured spectral radius and joint velocities along their
runs. `cnclik rivals` writes the whole table.
"""

import csv
import io
import json
import math
import time
from typing import NamedTuple

import jax
import numpy as np

from cnclik import errors
from cnclik.integrate.solve import solve
from cnclik.measure.metrics import measure_run
from cnclik.problem.build import problem_from
from cnclik.record import replace
from cnclik.sweeps.sweep import sweep
from cnclik.tuning import parameters as pm
from cnclik.tuning import tune as tuning

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
    errors.integer("steps", steps, at_least=2)
    made = problem_from(robot, method=method, alpha=HAND, **options)
    law = made.law
    if gain == "per-axis":
        law = replace(law, alpha=np.full(law.task.m, HAND))
    loop = dict(Ts=made.Ts, N=made.N, method=made.method, stage=made.stage, margin=margin)
    objective = tuning.make_objective(law, made.reference, made.q0, **loop)
    p = objective.parameters[0]

    def look(alphas):
        return tuning._look(objective, [(np.asarray(a, float),) for a in alphas])

    def by_tune():
        found = tuning.tune(law, made.reference, made.q0, steps=steps, **loop)
        return found.law.alpha, found.evaluations

    ways = {
        "hand-picked α = 5": lambda: (law.alpha, 1),
        "grid": lambda: _by_grid(look, p, made, law, steps),
        "Nelder-Mead": lambda: _by_simplex(look, p, law.alpha, steps),
        "gradient": by_tune,
    }
    rows = []
    for way, search in ways.items():
        jax.clear_caches()  # each way pays for its own programs
        (alpha, evaluations), seconds = _timed(search)
        again = _timed(search)[1]
        seen = look([alpha])
        numbers = (float(v[0]) for v in (seen.radius, seen.speed))
        alpha = np.atleast_1d(np.asarray(alpha, float)).tolist()
        kept = bool(seen.violation[0] <= tuning._KEPT)
        rows.append(Row(case, gain, way, float(seen.loss[0]), kept, *numbers, evaluations, seconds, again, alpha))
        if progress is not None:
            progress(rows[-1])
    return rows


def _timed(search):
    begin = time.process_time()
    found = search()
    return found, time.process_time() - begin


def _by_grid(look, p, made, law, steps):
    """The best point of a `sweep` that keeps the constraints: RMS errors first, stability of the best ones after."""
    points = grid_of(p, steps)

    def study(alpha):
        mine = replace(law, alpha=alpha)
        run = solve(mine, made.reference, made.q0, made.Ts, made.N, made.method, made.stage)
        return measure_run(run, mine, made.reference, ("rms_error", "velocity_ratio"))

    found = sweep(study, alpha=points)
    order = np.argsort(np.where(found.velocity_ratio > 1, np.inf, found.rms_error), kind="stable")
    for i in range(0, len(order), tuning._LANES):
        few = order[i : i + tuning._LANES]
        kept = np.flatnonzero(look(points[few]).violation <= tuning._KEPT)
        if kept.size:
            return points[few[kept[0]]], len(points)
    return points[order[0]], len(points)


def grid_of(p, steps):
    """At most `steps` gains (S, ...) of a `Parameter`, evenly spread in the logarithm, and at least two per axis.

    Over the bounds' inside where explicit Euler can be stable, z = 0.01 to 2.5 for the default ones.
    """
    count = int(np.prod(np.shape(p.start), dtype=int))
    each = max(2, int(steps ** (1 / count) + 1e-9))
    axis = np.geomspace(np.max(p.lower) * 10, np.max(p.upper) / 4, each)
    return np.stack(np.meshgrid(*[axis] * count), -1).reshape(-1, *np.shape(p.start))


def _by_simplex(look, p, start, steps):
    """scipy's Nelder-Mead on the free numbers, values that break a constraint counted as worse than any that don't."""
    from scipy.optimize import minimize

    used = 0

    def cost(u):
        nonlocal used
        used += 1
        seen = look([np.asarray(pm.bounded(p, u))])
        violation = float(min(seen.violation[0], 1e6))
        return float(seen.loss[0]) if violation <= tuning._KEPT else 1e3 * (1 + violation)

    options = {"maxfev": steps, "xatol": 1e-6, "fatol": 0}
    found = minimize(cost, pm.free(p, start), method="Nelder-Mead", options=options)
    return np.asarray(pm.bounded(p, found.x)), used


def table(rows) -> str:
    """The rows as a Markdown table."""
    lines = [
        "| case | gain | way | RMS error | kept | radius | evaluations | CPU seconds | again |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for r in rows:
        loss = f"{r.loss:.5g}" if math.isfinite(r.loss) else "not finite"
        kept = "yes" if r.satisfied else "NO"
        cells = (r.case, r.gain, r.way, loss, kept, f"{r.radius:.3f}", r.evaluations, f"{r.seconds:.1f}")
        lines.append(f"| {' | '.join(map(str, cells))} | {r.again:.2f} |")
    return "\n".join(lines) + "\n"


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
        "# Tuning against what one would do instead\n\n"
        f"Explicit Euler, loss RMS error, margin {margin:g}, at most {steps} evaluations each (a gradient evaluation "
        "counts as one). Seconds are CPU time, tracing and compilation included; again: the same search once more in "
        "the same process.\n\n" + table(rows)
    )
