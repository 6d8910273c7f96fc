"""The paper's claims, judged by numbers: what `claims.json` holds.

(a) Case I: IE converges slowest, CN fastest.  (b) Case II: the tracking error is significantly lower with CN.
(c) The fixed-point iteration converges in 4 to 5 iterations.
"""

import numpy as np

from cnclik.paper import readings as paper
from cnclik.paper.data import UNDETERMINED

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
    for arm in trajectories.arm.values:
        for case in trajectories.case.values:
            for reading in trajectories.reading.values:
                at = trajectories.sel(arm=arm, case=case, reading=reading)
                mean, final = by_method(at.mean_error), by_method(at.final_error)
                found.append(
                    {
                        "arm": str(arm),
                        "case": str(case),
                        "reading": str(reading),
                        "mean_error": mean,
                        "final_error": final,
                        "claim": CLAIM[case],
                        "holds": bool(holds(case, mean)),
                    }
                )
    return found


def by_method(values) -> dict:
    """{"EE": ..., ...} of a variable that has only the dimension `method` left."""
    return {str(m): float(v) for m, v in zip(values.method.values, values.values, strict=True)}


def undetermined(trajectories) -> list:
    """(arm, reading, case, method) of the runs whose mean error rounding decides."""
    marked = trajectories.spread.where(trajectories.spread > UNDETERMINED, drop=True).stack(
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
    for arm in passes.arm.values:
        for case in passes.case.values:
            for reading in passes.reading.values:
                for method in passes.method.values:
                    # As a dict: `method` as a keyword of `sel` is xarray's own option.
                    at = passes.residual.sel({"arm": arm, "case": case, "reading": reading, "method": method})
                    residual = at.transpose("pass", "step").values
                    worst = residual.max(axis=1)
                    found.append(
                        {
                            "arm": str(arm),
                            "case": str(case),
                            "reading": str(reading),
                            "method": str(method),
                            "residual_max": worst[:11].tolist(),
                            "residual_median": np.median(residual, axis=1)[:11].tolist(),
                            "contraction": _contraction(residual),
                            "needed": {f"{tolerance:.0e}": _needed(worst, tolerance) for tolerance in TOLERANCES},
                            "claim": CLAIM["picard"],
                            "holds": bool(worst[paper.M] < SETTLED),
                        }
                    )
    return found


def in_full(judged) -> list:
    """(arm, reading) under which (a), (b) and (c), the last in both cases and for IE and CN, all hold."""
    held = {}
    for record in (*judged["rows"], *judged["picard"]):
        held.setdefault((record["arm"], record["reading"]), []).append(record["holds"])
    return [where for where, verdicts in held.items() if all(verdicts)]


def _needed(worst, tolerance):
    """First pass from which the residual stays within the tolerance."""
    above = np.flatnonzero(~(worst <= tolerance))
    first = 0 if above.size == 0 else int(above[-1]) + 1
    return first if first < worst.size else None


def _contraction(residual):
    before, after = residual[3:8], residual[4:9]
    meaningful = before > 1e-12
    return float(np.median(after[meaningful] / before[meaningful])) if meaningful.any() else None
