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
    """Everything in `claims.json`: {"rows": [...], "picard": [...]}."""
    return {"rows": rows(trajectories), "picard": picard(passes)}


def holds(case: str, error: dict) -> bool:
    """Whether (a) or (b) holds for mean errors {"EE": ..., "IE": ..., "CN": ...}."""
    if case == "reach":
        return error["CN"] < error["EE"] < error["IE"]
    return error["CN"] <= SIGNIFICANT * min(error["EE"], error["IE"])


def rows(trajectories) -> list:
    """One record per arm, case and reading for (a) and (b)."""
    found = []
    for where in _places(trajectories, "arm", "case", "reading"):
        at = trajectories.sel(where)
        errors = {name: by_method(at[name]) for name in ("mean_error", "final_error")}
        verdict = holds(where["case"], errors["mean_error"])
        found.append(where | errors | {"claim": CLAIM[where["case"]], "holds": verdict})
    return found


def _places(data, *dims):
    """{dimension: label} for every combination of labels."""
    for labels in itertools.product(*(data[dim].values for dim in dims)):
        yield dict(zip(dims, map(str, labels), strict=True))


def by_method(values) -> dict:
    """{"EE": ..., ...} of a variable that has only the dimension `method` left."""
    return {str(m): float(v) for m, v in zip(values.method.values, values.values, strict=True)}


def undetermined(trajectories) -> list:
    """(arm, reading, case, method) of the runs whose mean error rounding decides."""
    marked = trajectories.spread.where(trajectories.spread > paper.UNDETERMINED, drop=True).stack(
        run=trajectories.spread.dims
    )
    return [tuple(map(str, run)) for run in marked.dropna("run").run.values]


def picard(passes) -> list:
    """One record per arm, case, reading and run (IE, CN) for (c).

    residual_max and residual_median: over the steps, after 0 … 10 passes [rad]. needed: for each tolerance
    [rad] the passes until no step of the run exceeds it again, null where 40 don't suffice. contraction:
    median factor per pass, over the steps and the passes 3 to 8 that are above rounding.
    """
    found = []
    for where in _places(passes, "arm", "case", "reading", "method"):
        residual = passes.residual.sel(where).transpose("pass", "step").values
        worst = residual.max(axis=1)
        about = {
            "residual_max": worst[:11].tolist(),
            "residual_median": np.median(residual, axis=1)[:11].tolist(),
            "contraction": _contraction(residual),
            "needed": {f"{tolerance:.0e}": _needed(worst, tolerance) for tolerance in TOLERANCES},
        }
        found.append(where | about | {"claim": CLAIM["picard"], "holds": bool(worst[paper.M] < SETTLED)})
    return found


def _needed(worst, tolerance):
    """First pass from which the residual stays within the tolerance."""
    above = np.flatnonzero(~(worst <= tolerance))
    first = int(above[-1]) + 1 if above.size else 0
    return first if first < worst.size else None


def _contraction(residual):
    before, after = residual[3:8], residual[4:9]
    meaningful = before > 1e-12
    return float(np.median(after[meaningful] / before[meaningful])) if meaningful.any() else None
