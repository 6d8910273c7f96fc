"""The paper's claims, judged by numbers: what `claims.json` holds.

(a) Case I: IE converges slowest, CN fastest.  (b) Case II: the tracking error is significantly lower with CN.
(c) The fixed-point iteration converges in 4 to 5 iterations.
"""

import itertools

import numpy as np

from cnclik.paper import readings as paper

CLAIM = {
    "reach": "(a) IE converges slowest and CN fastest: IE has the largest mean error, CN the smallest",
    "track": "(b) tracking error significantly lower with CN: at most half the mean error of EE and of IE",
    "picard": "(c) the fixed-point iteration converges in 4 to 5 iterations: after 5 its last change is below 1e-3 rad "
    "in every step",
}
SIGNIFICANT = 0.5  # "significantly lower" in (b)
SETTLED = 1e-3  # [rad] "converged" in (c), the default tolerance of `picard`
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-6, 1e-8)  # [rad]


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
    for where, at in _each(trajectories, "arm", "case", "reading"):
        errors = {name: by_method(at[name]) for name in ("mean_error", "final_error")}
        verdict = holds(where["case"], errors["mean_error"])
        records.append(where | errors | {"claim": CLAIM[where["case"]], "holds": verdict})
    return records


def _each(data, *dims):
    """Yield ({dimension: label}, the data there) for every combination of labels."""
    for labels in itertools.product(*(data[dim].values for dim in dims)):
        where = dict(zip(dims, map(str, labels), strict=True))
        yield where, data.sel(where)


def by_method(values) -> dict:
    """Return {"EE": ..., ...} of a variable that has only the dimension `method` left."""
    return {str(m): float(v) for m, v in zip(values.method.values, values.values, strict=True)}


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
    for where, at in _each(passes, "arm", "case", "reading", "method"):
        residual = at.residual.transpose("pass", "step").values
        worst, before = residual.max(axis=1), residual[3:8]
        ratios = residual[4:9][before > 1e-12] / before[before > 1e-12]
        about = {
            "residual_max": worst[:11].tolist(),
            "residual_median": np.median(residual, axis=1)[:11].tolist(),
            "contraction": float(np.median(ratios)) if ratios.size else None,
            "needed": {f"{tolerance:.0e}": _needed(worst, tolerance) for tolerance in TOLERANCES},
        }
        records.append(where | about | {"claim": CLAIM["picard"], "holds": bool(worst[paper.M] < SETTLED)})
    return records


def _needed(worst, tolerance):
    """Return the first pass from which the residual stays within the tolerance; None without one."""
    passes = len(worst) - int(np.argmax(~(worst[::-1] <= tolerance))) if not np.all(worst <= tolerance) else 0
    return passes if passes < len(worst) else None
