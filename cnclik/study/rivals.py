"""Rivals: what a user would do instead of a gradient, given as many evaluations.

`python -m cnclik.study.rivals --out FOLDER` makes the whole table: the paper's arms, Panda and UR5, one gain and one
per axis; grid search, Nelder-Mead, the hand-picked alpha = 5 of the paper, and `tune`. All are judged alike, by
measured spectral radius and joint velocities along their runs.
"""

import argparse
import csv
import json
import math
import pathlib
import time
from typing import NamedTuple

import numpy as np

from cnclik.record import replace
from cnclik.study import parameters as pm
from cnclik.study import tune as tuning
from cnclik.study.problem import problem_from

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


class Row(NamedTuple):
    """One way to find a gain, and what it found."""

    case: str
    gain: str
    way: str
    loss: float
    satisfied: bool
    radius: float
    speed: float
    evaluations: int
    seconds: float  # evaluations only, programs compiled before
    alpha: list


def rivals(case: str, shape: str, *, method="EE", margin=0.9, steps=100, progress=None) -> list:
    """Rows for one robot and one shape of gain ("scalar", "per-axis").

    Args:
      case: one of `CASES`. method: as for `solve`. margin: as for `tune`. steps: evaluations each way may use.
    """
    robot, options = CASES[case]
    made = problem_from(robot, method=method, alpha=HAND, **options)
    law = made.law
    if shape == "per-axis":
        law = replace(law, alpha=np.full(law.task.m, HAND))
    common = dict(Ts=made.Ts, N=made.N, method=made.method, stage=made.stage, margin=margin)
    objective = tuning.make_objective(law, made.reference, made.q0, **common)
    look = lambda alphas: tuning._look(objective, [(np.asarray(a, float),) for a in alphas])  # noqa: E731
    first = look([law.alpha])
    rows = []

    def add(way, alpha, seen, evaluations, seconds):
        kept = bool(seen.violation <= tuning._KEPT)
        rows.append(
            Row(case, shape, way, float(seen.loss), kept, float(seen.radius), float(seen.speed), evaluations, seconds,
                np.atleast_1d(np.asarray(alpha, float)).tolist())
        )  # fmt: skip
        if progress is not None:
            progress(rows[-1])

    pick = lambda seen, i: seen._replace(run=None, **{k: getattr(seen, k)[i] for k in _NUMBERS})  # noqa: E731
    add("hand-picked α = 5", law.alpha, pick(first, 0), 1, 0.0)

    p = objective.parameters[0]
    points = _grid(p, steps)
    begin = time.perf_counter()
    seen = look(points)
    seconds = time.perf_counter() - begin
    best = int(np.argmin(np.where(seen.violation <= tuning._KEPT, seen.loss, np.inf)))
    add("grid", points[best], pick(seen, best), len(points), seconds)

    begin = time.perf_counter()
    alpha, used = _simplex(look, p, law.alpha, steps)
    seconds = time.perf_counter() - begin
    add("Nelder-Mead", alpha, pick(look([alpha]), 0), used, seconds)

    options = dict(common, steps=steps, rounds=5)
    found = tuning.tune(law, made.reference, made.q0, **options)  # compiles
    begin = time.perf_counter()
    found = tuning.tune(law, made.reference, made.q0, **options)
    seconds = time.perf_counter() - begin
    tuned = first._replace(
        loss=found.loss_after, radius=found.radius, speed=found.speed, violation=found.violation, run=None
    )
    add("gradient", found.law.alpha, tuned, found.evaluations, seconds)
    return rows


_NUMBERS = ("loss", "radius", "speed", "violation")


def _grid(p, steps):
    """At most `steps` gains, evenly spread in the logarithm over the bounds where explicit Euler can be stable."""
    shape = np.shape(p.start)
    count = int(np.prod(shape, dtype=int))
    each = max(2, round(steps ** (1 / count) - 0.5 + 1e-9)) if count > 1 else steps
    axis = np.geomspace(np.max(p.lower) * 10, np.max(p.upper) / 4, each)
    return [np.reshape(v, shape) for v in np.stack(np.meshgrid(*[axis] * count), -1).reshape(-1, count)]


def _simplex(look, p, start, steps):
    """scipy's Nelder-Mead on the free numbers, values that break a constraint counted as worse than any that don't."""
    from scipy.optimize import minimize

    used = 0

    def cost(u):
        nonlocal used
        used += 1
        seen = look([np.asarray(pm.bounded(p, u))])
        violation = float(min(seen.violation[0], 1e6))
        return float(seen.loss[0]) if violation <= tuning._KEPT else 1e3 * (1 + violation)

    found = minimize(
        cost, pm.free(p, start), method="Nelder-Mead", options={"maxfev": steps, "xatol": 1e-6, "fatol": 0}
    )
    return np.asarray(pm.bounded(p, found.x)), used


def table(rows) -> str:
    """The rows as a Markdown table."""
    lines = [
        "| case | gain | way | loss (RMS error) | kept | radius | evaluations | seconds |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for r in rows:
        loss = f"{r.loss:.5g}" if math.isfinite(r.loss) else "not finite"
        kept = "yes" if r.satisfied else "NO"
        lines.append(
            f"| {r.case} | {r.gain} | {r.way} | {loss} | {kept} | {r.radius:.3f} | {r.evaluations} | {r.seconds:.2f} |"
        )
    return "\n".join(lines) + "\n"


def main(argv=None):
    """Entry point of `python -m cnclik.study.rivals`."""
    import jax

    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(prog="python -m cnclik.study.rivals", description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("results/tuning"))
    parser.add_argument("--cases", nargs="*", choices=CASES, default=list(CASES))
    parser.add_argument("--gains", nargs="*", choices=("scalar", "per-axis"), default=["scalar", "per-axis"])
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--margin", type=float, default=0.9)
    args = parser.parse_args(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for case in args.cases:
        for gain in args.gains:
            rows += rivals(
                case, gain, margin=args.margin, steps=args.steps, progress=lambda row: print(row, flush=True)
            )
            _write(args, rows)


def _write(args, rows):
    with (args.out / "rivals.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(Row._fields)
        for row in rows:
            writer.writerow([*row[:-1], json.dumps(row.alpha)])
    text = "# Tuning against what one would do instead\n\n"
    text += f"Explicit Euler, loss RMS error, margin {args.margin:g}, at most {args.steps} evaluations each "
    text += "(a gradient evaluation counts as one; seconds without compilation, on a shared two-core machine).\n\n"
    (args.out / "rivals.md").write_text(text + table(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
