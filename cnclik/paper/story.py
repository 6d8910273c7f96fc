"""`claims.md`: what of the paper holds, under which reading, and why.

The page is the template beside this file. What is in it is the paper's text and the theory that numbers are compared
with; numbers, verdicts, and the words that depend on them, are read from the data here.
"""

import pathlib
from typing import Any, NamedTuple

import numpy as np

from cnclik.paper import claims
from cnclik.paper import readings as paper
from cnclik.paper.choices import DEFAULT
from cnclik.paper.readings import ARMS, BESIDE, EXPONENTIAL, NUDGE, PAPER, PASSES, TS, M, N
from cnclik.paper.tables import claim_table, method_table, own, picard_table, short
from cnclik.paper.words import by_reading, filled, joined, listed, ranked, under

Z = paper.ALPHA * TS
# What one step multiplies a small error by, a step being solved exactly.
FACTOR = {"EE": lambda z: 1 - z, "IE": lambda z: 1 / (1 + z), "CN": lambda z: (1 - z * z / 2) / (1 + z)}
ALL = joined([str(arm) for arm in ARMS.values()])


class Facts(NamedTuple):
    """What the page is made from."""

    judged: dict
    rows: dict  # {(arm, case, reading): record} for (a) and (b)
    passes: dict  # {(arm, case, reading, method): record} for (c)
    trajectories: Any
    methods: Any

    def mean(self, arm, case, reading=str(DEFAULT)):
        return self.rows[arm, case, reading]["mean_error"]

    def final(self, arm, case, reading=str(DEFAULT)):
        return self.rows[arm, case, reading]["final_error"]


def story(judged, trajectories, methods, reading, captions) -> str:
    """The page. `reading` is that of the figures, `captions` what they show, by file name."""
    facts = Facts(
        judged,
        {(r["arm"], r["case"], r["reading"]): r for r in judged["rows"]},
        {(r["arm"], r["case"], r["reading"], r["method"]): r for r in judged["picard"]},
        trajectories,
        methods,
    )
    fields = dict(
        sizes=joined([str(arm.n) for arm in ARMS.values()]), Ts=TS, N=N, T=N * TS, M=M, alpha=paper.ALPHA, z=Z,
        z_Ts=Z * TS, default=DEFAULT, reading=reading, arms=ALL, significant=claims.SIGNIFICANT, settled=claims.SETTLED,
        begins=joined([f"({arm.start[0]:g}, {arm.start[1]:g})" for arm in ARMS.values()]),
        mirrored=joined([f"(−{arm.start[0]:g}, {arm.start[1]:g})" for arm in ARMS.values()]),
        method_table=method_table(methods).markdown(),
        claim_table=claim_table(judged, claims.undetermined(trajectories)).markdown(),
        picard_table=picard_table(judged).markdown(),
        figures="\n".join(f"- `{name}`: {caption}" for name, caption in captions.items()),
    )  # fmt: skip
    parts = (_in_short, _reaching, _undetermined, _tracking, _iterating, _beside)
    fields |= {name: value for part in parts for name, value in part(facts).items()}
    return filled(pathlib.Path(__file__).with_name("claims.md.in").read_text(encoding="utf-8"), fields)


# --- fields, section by section ------------------------------------------------------------------------


def _in_short(facts) -> dict:
    cases = {case: [r for r in facts.judged["rows"] if r["case"] == case] for case in paper.CASES}
    rankings = [ranked(facts.mean(arm, "reach")) for arm in ARMS]
    ends = {what: {r[i] for r in rankings} for what, i in (("slowest", -1), ("fastest", 0))}
    on_path = [
        f"{method} {what}: {'yes' if ends[what] == {method} else f'no, {joined(sorted(ends[what]))}'}"
        for method, what in (("IE", "slowest"), ("CN", "fastest"))
    ]
    gains = [_gain(r["mean_error"]) for r in cases["track"] if r["holds"]]
    runs = {Ts: [r for r in facts.judged["picard"] if _is_cn(r) and f"/{Ts}/" in r["reading"]] for Ts in _TIMES}
    full = [f"`{reading}` ({ARMS[arm]})" for arm, reading in claims.in_full(facts.judged)]
    together = f"(a), (b) and (c) hold together under {joined(full)}." if full else _NEVER
    return {
        "on_path": "; ".join(on_path),
        "reach_under": under(cases["reach"]),
        "track_gain": f"Yes, {min(gains):.1f} to {max(gains):.1f} times, " if gains else "No: ",
        "track_under": under(cases["track"]),
        "shares": " and ".join(
            f"with Ts {Ts} in {sum(r['holds'] for r in found)} of {len(found)} runs of CN" for Ts, found in runs.items()
        ),
        "together": together,
    }


_TIMES = ("once", "twice")
_NEVER = "No single reading of the text supports (a), (b) and (c) together on either arm."


def _is_cn(record) -> bool:
    return record["method"] == "CN" and own(record)


def _gain(error) -> float:
    """How many times smaller CN's error is than the better of the others."""
    return min(error["EE"], error["IE"]) / error["CN"]


def _reaching(facts) -> dict:
    factors = {name: FACTOR[name](Z) for name in PAPER}
    runs = {arm: facts.mean(arm, "reach") for arm in ARMS}
    held = by_reading(r for r in facts.judged["rows"] if r["case"] == "reach").values()
    return {
        "factors": listed(factors, "{:.3f}".format),
        "theory": ranked(factors),
        "agree": "agree" if all(ranked(v) == ranked(factors) for v in runs.values()) else "do not agree",
        "reach_means": "; ".join(f"{ARMS[arm]}: {listed(values)}" for arm, values in runs.items()),
        "exact": np.exp(-Z),
        "in_full": "\n\n".join(_in_full(facts, record) for records in held for record in records),
    }


def _in_full(facts, record) -> str:
    """Where (a) holds, and whether it still does at the end of the run."""
    last = ranked(record["final_error"])
    ends = "and so it ends" if last[0] == "CN" else f"a transient: in the end {last[0]} is ahead again"
    return (
        f"Under `{short(record)}` the claim holds in full on the {ARMS[record['arm']]} arm: mean ‖e‖"
        f" {listed(record['mean_error'])}; {ends} (final errors {listed(record['final_error'], '{:.1e}'.format)} m)."
        f" It starts {_away(facts, record):.1f} m from its target."
    )


def _away(facts, record) -> float:
    where = {name: record[name] for name in ("arm", "case", "reading")}
    return float(facts.trajectories.error_norm.sel(where).isel(time=0, method=0))


def _undetermined(facts) -> dict:
    """The runs whose digits mean nothing, and why."""
    found = {}
    for arm, reading, case, method in claims.undetermined(facts.trajectories):
        if own(facts.rows[arm, case, reading]):
            found.setdefault((arm, case, reading), []).append(method)
    paragraphs = []
    for (arm, case, reading), wild in found.items():
        at = facts.trajectories.sel({"arm": arm, "case": case, "reading": reading})
        needed = facts.passes[arm, case, reading, "CN"]["needed"]["1e-03"]
        converges = f"needs {needed} passes to 1e-3 rad" if needed else f"does not converge within {PASSES} passes"
        # A planar arm of two joints is singular where sin q₂ = 0.
        near = f"comes within {np.abs(np.sin(at.q.sel(joint='q2'))).min().item():.1g} rad of its singularity, and"
        spread = ", ".join(f"{100 * v:.2g} % ({m})" for m, v in claims.by_method(at.spread).items())
        paragraphs.append(
            f"Under `{short(facts.rows[arm, case, reading])}` the {ARMS[arm]} arm {near if ARMS[arm].n == 2 else ''}"
            f" its Picard iteration {converges}. Mean ‖e‖ there is {listed(facts.mean(arm, case, reading))}, but **the"
            f" digits of {joined(wild)} mean nothing**: starts {NUDGE:.0e} rad apart give mean errors that differ by"
            f" {spread}, and so do rounding, another processor, or another way to compute the pseudoinverse. Such"
            " numbers are marked * below; `spread` in `trajectories.nc` has it for every run."
        )
    return {"undetermined": "\n\n".join(paragraphs)}


def _tracking(facts) -> dict:
    printed, twice = "printed/once/consistent", "on-path/twice/consistent"
    off = [facts.final(arm, "track", "on-path/once/printed")[method] for arm in ARMS for method in PAPER]
    away = {arm: _away(facts, facts.rows[arm, "track", printed]) for arm in ARMS}
    finals = facts.final("2dof", "track", printed)
    return {
        "gains": joined([f"{_gain(facts.mean(arm, 'track')):.1f} times ({ARMS[arm]})" for arm in ARMS]),
        "sides": _sides(facts),
        "off": (1 - 1 / (N * TS)) / paper.ALPHA,
        "off_least": min(off),
        "off_most": max(off),
        "sample": 1 / N,
        "twice": facts.final("2dof", "track", twice),
        "away": joined([f"{distance:.0f} m ({ARMS[arm]})" for arm, distance in away.items()]),
        "nearest": ranked(finals)[0],
        "finals": listed(finals, "{:.1e}".format),
    }


def _sides(facts) -> str:
    """To which sides of the path EE and IE stray."""
    e = facts.trajectories.e.sel({"case": "track", "reading": str(DEFAULT)})
    one, other = (e.sel({"method": name}).transpose("arm", ...).values.reshape(len(ARMS), -1) for name in ("EE", "IE"))
    sizes = [np.linalg.norm(errors, axis=1) for errors in (one, other)]
    cosines = np.sum(one * other, axis=1) / sizes[0] / sizes[1]
    cosine, ratio = (joined([f"{value:.2f}" for value in values]) for values in (cosines, sizes[1] / sizes[0]))
    angles = f"cosine between their errors {cosine}, ratio {ratio}"
    if max(cosines) < -0.9:
        return (
            f"The reason: EE and IE stray from the path by nearly the same amount to opposite sides ({angles}; see"
            " the x and y panels of `fig05.png` and `fig11.png`), and CN takes the mean of their increments."
        )
    return f"EE and IE do not stray to opposite sides of the path ({angles})."


def _iterating(facts) -> dict:
    tracking = {Ts: facts.passes["5dof", "track", f"on-path/{Ts}/consistent", "CN"] for Ts in _TIMES}
    return {
        "once": _passes(tracking["once"]),
        "again": _passes(tracking["twice"]),
        "first": _passes(facts.passes["5dof", "reach", str(DEFAULT), "CN"]),
        "limit_EE": _limit(FACTOR["EE"]),
        "limit_IE": _limit(lambda z: sum((-z) ** i for i in range(M + 2))),
    }


def _passes(record) -> dict:
    """How fast a run's iteration converges, with "12 passes are" or "more than 40 passes are" to a tolerance."""
    count = {name: f"more than {PASSES}" if v is None else str(v) for name, v in record["needed"].items()}
    needed = {f"to_1e_{int(name[-1])}": f"{passes} passes are" for name, passes in count.items()}
    return {"contraction": record["contraction"], "left": record["residual_max"][M], **needed}


def _limit(factor) -> float:
    """Where |R(z)| first exceeds 1 [1]."""
    z = np.linspace(1e-4, 4, 40_000)
    return float(z[np.argmax(np.abs(factor(z)) > 1 + 1e-9)])


def _beside(facts) -> dict:
    first = facts.methods.isel(Ts=0)
    rms = {arm: claims.by_method(first.rms_error.sel({"arm": arm, "case": "track"})) for arm in ARMS}
    mean = {arm: claims.by_method(first.mean_error.sel({"arm": arm, "case": "reach"})) for arm in ARMS}
    count = {m: round(v / N) for m, v in claims.by_method(first.evaluations.sel(arm="2dof", case="track")).items()}
    steps = {m: f"{v} evaluation{'s' * (v > 1)}" for m, v in count.items()}
    closer = {m: joined([f"{rms[arm]['CN'] / rms[arm][m]:.2g}" for arm in ARMS]) for m in BESIDE}
    faster = [m for m in BESIDE if any(mean[arm][m] < mean[arm]["EE"] for arm in ARMS)]
    return {
        "steps": steps,
        "worth": joined([f"{m} ({steps[m]} a step) {closer[m]} times" for m in EXPONENTIAL]),
        "closer": joined([f"{closer[m]} for {m} ({steps[m]})" for m in BESIDE]),
        "faster": joined(faster) if faster else "none of them",
        "orders": facts.methods.order.Ts.values[[1, -2, -1]],
    }
