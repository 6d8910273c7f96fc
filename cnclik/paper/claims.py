"""The paper's claims, judged by numbers: what `claims.json` holds, and the tables of `claims.md`.

(a) Case I: IE converges slowest, CN fastest.  (b) Case II: the tracking error is significantly lower with CN.
(c) The fixed-point iteration converges in 4 to 5 iterations.
"""

import itertools
import pathlib

import numpy as np

from cnclik.measure.files import markdown
from cnclik.paper import readings as paper
from cnclik.paper.readings import ARMS

CLAIM = {
    "reach": "(a) IE converges slowest and CN fastest: IE has the largest mean error, CN the smallest",
    "track": "(b) tracking error significantly lower with CN: at most half the mean error of EE and of IE",
    "picard": "(c) the fixed-point iteration converges in 4 to 5 iterations: after 5 its last change is below 1e-3 rad "
    "in every step",
}
SIGNIFICANT = 0.5  # "significantly lower" in (b)
SETTLED = 1e-3  # [rad] "converged" in (c), the default tolerance of `picard`
TOLERANCES = ("1e-02", "1e-03", "1e-04", "1e-06", "1e-08")  # [rad]
_SHOWN = TOLERANCES[1:4]  # those in the table


def judge(trajectories, passes) -> dict:
    """Return everything in `claims.json`: {"rows": [...], "picard": [...]}."""
    return {"rows": rows(trajectories), "picard": picard(passes)}


def holds(case: str, error: dict) -> bool:
    """Return whether (a) or (b) holds for mean errors {"EE": ..., "IE": ..., "CN": ...}."""
    if case == "reach":
        return error["CN"] < error["EE"] < error["IE"]
    return error["CN"] <= SIGNIFICANT * min(error["EE"], error["IE"])


def rows(trajectories) -> list:
    """Return one record per arm, case and reading for (a) and (b)."""
    records = []
    for where, run in _each(trajectories, "arm", "case", "reading"):
        errors = {name: run[name].to_series().to_dict() for name in ("mean_error", "final_error")}
        verdict = holds(where["case"], errors["mean_error"])
        records.append(where | errors | {"claim": CLAIM[where["case"]], "holds": verdict})
    return records


def _each(data, *dims):
    """Yield ({dimension: label}, the data there) for every combination of labels."""
    for labels in itertools.product(*(data[dim].values for dim in dims)):
        where = dict(zip(dims, map(str, labels), strict=True))
        yield where, data.sel(where)


def undetermined(trajectories) -> list:
    """Return (arm, reading, case, method) of the runs whose mean error rounding decides."""
    spread = trajectories.spread.stack(run=trajectories.spread.dims)
    return [tuple(map(str, run)) for run in spread[spread > paper.UNDETERMINED].run.values]


def picard(passes) -> list:
    """Return one record per arm, case, reading and run (IE, CN) for (c).

    residual_max and residual_median: over the steps, after 0 … 10 passes [rad]. needed: for each tolerance
    [rad] the passes until no step of the run exceeds it again, null where 40 don't suffice. contraction:
    median factor per pass, over the steps and the passes 3 to 8 that are above rounding.
    """
    records = []
    for where, run in _each(passes, "arm", "case", "reading", "method"):
        residual = run.residual.transpose("pass", "step").values
        worst, before = residual.max(axis=1), residual[3:8]
        ratios = residual[4:9][before > 1e-12] / before[before > 1e-12]
        about = {
            "residual_max": worst[:11].tolist(),
            "residual_median": np.median(residual, axis=1)[:11].tolist(),
            "contraction": float(np.median(ratios)) if ratios.size else None,
            "needed": {tolerance: _needed(worst, float(tolerance)) for tolerance in TOLERANCES},
        }
        records.append(where | about | {"claim": CLAIM["picard"], "holds": bool(worst[paper.M] < SETTLED)})
    return records


def _needed(worst, tolerance):
    """Return the first pass from which the residual stays within the tolerance; None without one."""
    above = np.flatnonzero(~(worst <= tolerance))
    needed = int(above[-1]) + 1 if above.size else 0
    return needed if needed < len(worst) else None


def page(judged, results) -> str:
    """Return `claims.md`: the explanation beside this file, with the tables of a run."""
    unsure = undetermined(results.trajectories)
    claims, passes, methods = [], [], []
    for row in filter(_own, judged["rows"]):
        run = row["arm"], row["reading"], row["case"]
        mean = [number(v) + "*" * ((*run, m) in unsure) for m, v in row["mean_error"].items()]
        claim = {"reach": "(a)", "track": "(b)"}[row["case"]]
        claims.append([f"{claim} {ARMS[row['arm']]} {row['case']}", _short(row), *mean, _verdict(row)])
    for where, at in _each(results.methods, "arm", "method"):
        first, order = at.isel(Ts=0), at.order.dropna("Ts").values
        errors = first.mean_error.sel(case="reach"), first.rms_error.sel(case="track"), first.rms_converged
        count, orders = int(first.evaluations.sel(case="track")), f"{order[0]:.2f} … {order[-1]:.2f}"
        methods.append([f"{ARMS[where['arm']]} {where['method']}", str(count), *map(number, errors), orders])
    for row in (row for row in judged["picard"] if row["method"] == "CN" and _own(row)):
        needed = [f"> {paper.PASSES}" if (v := row["needed"][t]) is None else str(v) for t in _SHOWN]
        after = f"{row['residual_max'][paper.M]:.0e}"
        passes.append([f"{ARMS[row['arm']]} {row['case']}", _short(row), after, *needed, _verdict(row)])
    heads = (
        ("claim_table", ["claim", "reading", *paper.PAPER, "holds"], claims, 2),
        ("method_table", ["method", "evaluations", "reach: mean", "track: RMS", "converged", "order"], methods, 1),
        ("picard_table", ["(c)", "reading", f"after {paper.M}", "1e-3", "1e-4", "1e-6", "holds"], passes, 2),
    )
    text = pathlib.Path(__file__).with_name("claims.md.in").read_text(encoding="utf-8")
    return text.format(**{name: markdown(head, table, left=left).strip() for name, head, table, left in heads})


def _own(record) -> bool:
    """Return False for a repetition: Case I does not use the feed-forward."""
    return record["case"] == "track" or record["reading"].endswith("/consistent")


def _short(record) -> str:
    """Return the reading, as far as the case uses it."""
    return record["reading"] if record["case"] == "track" else record["reading"].rsplit("/", 1)[0]


def number(value) -> str:
    """Return three or four digits, as the paper's own tables would print them."""
    value = float(value)
    plain = value == 0 or 0.01 <= abs(value) < 100
    return f"{value:.4f}" if plain else f"{value:.2e}".replace("e-0", "e-").replace("e+0", "e+")


def _verdict(record) -> str:
    return "yes" if record["holds"] else "no"
