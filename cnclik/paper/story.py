"""`claims.md`: what of the paper holds, under which reading, and why.

Numbers and verdicts are read from the data, and so are the sentences that state them; what stands as it is written is
the paper's text and the theory that the numbers are compared with.
"""

from typing import NamedTuple

import numpy as np

from cnclik.measure.files import markdown
from cnclik.paper import claims
from cnclik.paper import readings as paper
from cnclik.paper.choices import DEFAULT
from cnclik.paper.readings import ARMS, BESIDE, EXPONENTIAL, NUDGE, PAPER, PASSES, TS, M, N
from cnclik.paper.tables import claim_table, method_table, own, picard_table, short
from cnclik.paper.words import by_reading, joined, listed, paragraph, ranked, under

Z = paper.ALPHA * TS
# What one step multiplies a small error by, a step being solved exactly.
FACTOR = {
    "EE": lambda z: 1 - z,
    "IE": lambda z: 1 / (1 + z),
    "CN": lambda z: (1 - z * z / 2) / (1 + z),
    f"IE with M = {M}": lambda z: sum((-z) ** i for i in range(M + 2)),
}


class Facts(NamedTuple):
    """What the sentences are made from."""

    judged: dict
    rows: dict  # {(arm, case, reading): record} for (a) and (b)
    passes: dict  # {(arm, case, reading, method): record} for (c)
    trajectories: object
    methods: object

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
    sections = (
        _head(),
        _in_short(facts),
        _choices(reading),
        _reaching(facts),
        _undetermined(facts),
        _tracking(facts),
        _iterating(facts),
        _beside(facts),
        _all_readings(facts),
        _files(captions),
    )
    return "\n\n".join(filter(None, sections)) + "\n"


# --- sections -----------------------------------------------------------------------------------------


def _head() -> str:
    sizes = joined([str(arm.n) for arm in ARMS.values()])
    return "# What of the paper holds\n\n" + paragraph(
        "D. A. Drexler, *Solution of the Closed-Loop Inverse Kinematics Algorithm Using the Crank-Nicolson Method*,"
        " SAMI 2016, Section V: explicit Euler (EE), implicit Euler (IE) and the mean of their increments (CN) on"
        f" planar arms with {sizes} joints; Ts = {TS:g} s, N = {N} steps, M = {M} passes, α = {paper.ALPHA:g} 1/s, so"
        f" z = α·Ts = {Z:g}.",
        "This page, `claims.json`, the figures and the data beside it are written by `cnclik reproduce`; all in"
        " float64.",
    )


def _in_short(facts) -> str:
    cases = {case: [r for r in facts.judged["rows"] if r["case"] == case] for case in paper.CASES}
    rankings = [ranked(facts.mean(arm, "reach")) for arm in ARMS]
    ends = {what: {r[i] for r in rankings} for what, i in (("slowest", -1), ("fastest", 0))}
    parts = [
        f"{method} {what}: {'yes' if ends[what] == {method} else f'no, {joined(sorted(ends[what]))}'}"
        for method, what in (("IE", "slowest"), ("CN", "fastest"))
    ]
    reach = f"On the path, {'; '.join(parts)}. In full {under(cases['reach'])}"
    gains = [_gain(r["mean_error"]) for r in cases["track"] if r["holds"]]
    times = f"{min(gains):.1f} to {max(gains):.1f} times, " if gains else ""
    track = f"{'Yes, ' if gains else 'No: '}{times}{under(cases['track'])}"
    shares = []
    for Ts in ("once", "twice"):
        runs = [r for r in facts.judged["picard"] if r["method"] == "CN" and own(r) and f"/{Ts}/" in r["reading"]]
        shares.append(f"with Ts {Ts} in {sum(r['holds'] for r in runs)} of {len(runs)} runs of CN")
    rows = [
        ["(a) Reaching a point: IE converges slowest, CN fastest", reach],
        ["(b) Tracking a line: the error is significantly lower with CN", track],
        ["(c) The fixed-point iteration converges in 4 to 5 iterations", f"Holds {' and '.join(shares)}"],
    ]
    full = [f"`{reading}` ({ARMS[arm]})" for arm, reading in claims.in_full(facts.judged)]
    supported = (
        f"(a), (b) and (c) hold together under {joined(full)}."
        if full
        else "No single reading of the text supports (a), (b) and (c) together on either arm."
    )
    table = markdown(["claim of the paper", "holds?"], rows, left=2)
    return f"## In short\n\n{table}\n{paragraph(supported, _to_use(facts))}"


def _to_use(facts) -> str:
    """What the paper found, what is true, and what to use."""
    rms, steps = _beside_cn(facts)
    price = {m: f"{steps[m]:.0f} evaluation{'s' * (steps[m] >= 1.5)} a step" for m in ("CN", *EXPONENTIAL)}
    worth = [f"{m} ({price[m]}) {_times_closer(rms, m)} times" for m in EXPONENTIAL]
    return (
        f"The paper found that CN tracks better than EE. That is true at the same Ts, for {price['CN']}."
        f" What to use is a step in which the error decays by its exact factor, so that no gain is too large:"
        f" {joined(worth)} closer to the path than CN, on the {joined([str(a) for a in ARMS.values()])} arm."
    )


def _gain(error) -> float:
    """How many times smaller CN's error is than the better of the others."""
    return min(error["EE"], error["IE"]) / error["CN"]


def _choices(reading) -> str:
    begins = joined([f"({arm.start[0]:g}, {arm.start[1]:g})" for arm in ARMS.values()])
    mirrored = joined([f"(−{arm.start[0]:g}, {arm.start[1]:g})" for arm in ARMS.values()])
    return f"""## Three places where the text leaves a choice

A reading is written rotation/Ts/feed-forward, such as `{DEFAULT}`.

1. **Rotation.** With right-handed rotation about +z ("printed") the tips start at {mirrored}, but the paths
   of Case II start at {begins}. With the opposite sense ("on-path") both arms start on their path.
2. **Ts.** Eqs. 6 and 8 put Ts into Δθ, and eq. 7 multiplies by Ts again. "once" agrees with eqs. 2-5; "twice" takes
   eq. 7 as printed.
3. **Feed-forward.** The path of Case II moves at −1/(N·Ts) = −1/{N * TS:g} m/s ("consistent"); eqs. 16 and 19 print −1
   ("printed").

The figures here use `{reading}`."""


def _reaching(facts) -> str:
    factors = {name: FACTOR[name](Z) for name in PAPER}
    runs = {arm: facts.mean(arm, "reach") for arm in ARMS}
    theory = ranked(factors)
    agree = all(ranked(values) == theory for values in runs.values())
    exact = np.exp(-Z)
    first = paragraph(
        "Near the target, one step multiplies the error by R(z): 1 − z for EE, 1/(1 + z) for IE, (1 − z²/2)/(1 + z) for"
        f" CN. At z = {Z:g} that is {listed(factors, '{:.3f}'.format)}: {theory[0]} is fastest and"
        f" {theory[-1]} slowest, and the runs {'agree' if agree else 'do not agree'} (mean ‖e‖,"
        f" {'; '.join(f'{ARMS[arm]}: {listed(values)}' for arm, values in runs.items())}).",
        "CN overtakes EE only for z > 2/√3 ≈ 1.155.",
        "A method that follows the differential equation more faithfully is not faster: the exact solution itself"
        f" shrinks the error only by exp(−z) = {exact:.3f} per step."
        if exact > min(map(abs, factors.values()))
        else "",
    )
    held = [
        _in_full(facts, record)
        for records in by_reading(r for r in facts.judged["rows"] if r["case"] == "reach").values()
        for record in records
    ]
    return "\n\n".join(["## (a) Reaching a point", first, *held])


def _in_full(facts, record) -> str:
    """Where (a) holds, and whether it still does at the end of the run."""
    last = ranked(record["final_error"])
    ends = "and so it ends" if last[0] == "CN" else f"a transient: in the end {last[0]} is ahead again"
    return paragraph(
        f"Under `{short(record)}` the claim holds in full on the {ARMS[record['arm']]} arm: mean ‖e‖"
        f" {listed(record['mean_error'])};",
        f"{ends} (final errors {listed(record['final_error'], '{:.1e}'.format)} m).",
        f"It starts {_away(facts, record):.1f} m from its target.",
    )


def _away(facts, record) -> float:
    where = {name: record[name] for name in ("arm", "case", "reading")}
    return float(facts.trajectories.error_norm.sel(where).isel(time=0, method=0))


def _undetermined(facts) -> str:
    """The runs whose digits mean nothing, and why."""
    found = {}
    for arm, reading, case, method in claims.undetermined(facts.trajectories):
        if own(facts.rows[arm, case, reading]):
            found.setdefault((arm, case, reading), []).append(method)
    paragraphs = []
    for (arm, case, reading), wild in found.items():
        at = facts.trajectories.sel({"arm": arm, "case": case, "reading": reading})
        spread = claims.by_method(at.spread)
        needed = facts.passes[arm, case, reading, "CN"]["needed"]["1e-03"]
        converges = f"needs {needed} passes to 1e-3 rad" if needed else f"does not converge within {PASSES} passes"
        # A planar arm of two joints is singular where sin q₂ = 0.
        near = f"comes within {np.abs(np.sin(at.q.sel(joint='q2'))).min().item():.1g} rad of its singularity, and"
        paragraphs.append(
            paragraph(
                f"Under `{short(facts.rows[arm, case, reading])}` the {ARMS[arm]} arm"
                f" {near if ARMS[arm].n == 2 else ''} its Picard iteration {converges}.",
                f"Mean ‖e‖ there is {listed(facts.mean(arm, case, reading))}, but **the digits of {joined(wild)} mean"
                f" nothing**: starts {NUDGE:.0e} rad apart give mean errors that differ by"
                f" {', '.join(f'{100 * v:.2g} % ({m})' for m, v in spread.items())}, and so do rounding, another"
                " processor, or another way to compute the pseudoinverse. Such numbers are marked * below; `spread` in"
                " `trajectories.nc` has it for every run.",
            )
        )
    return "\n\n".join(paragraphs)


def _tracking(facts) -> str:
    gains = joined([f"{_gain(facts.mean(arm, 'track')):.1f} times ({ARMS[arm]})" for arm in ARMS])
    first = f"Under `{DEFAULT}` the mean error of the better of EE and IE is {gains} that of CN."
    others = [paragraph(part(facts), bullet=True) for part in (_printed_feedforward, _twice, _printed_rotation)]
    return "\n".join(["## (b) Tracking a line", "", paragraph(first, _sides(facts)), "", *others])


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


def _printed_feedforward(facts) -> str:
    speed = 1 / (N * TS)
    finals = [facts.final(arm, "track", "on-path/once/printed")[method] for arm in ARMS for method in PAPER]
    return (
        f"**Printed feed-forward.** The loop is told −1 m/s for a path at −1/{N * TS:g} m/s. Whatever the method, the"
        f" error settles where feedback makes up for it, at (1 − 1/{N * TS:g})/α = {(1 - speed) / paper.ALPHA:.3f} m"
        f" (the runs end at {min(finals):.3f} to {max(finals):.3f} m): a better method has nothing left to gain."
    )


def _twice(facts) -> str:
    final = facts.final("2dof", "track", "on-path/twice/consistent")
    return (
        "**Ts twice.** The inner iteration then looks ahead by Ts² instead of Ts while its target is that of the next"
        f" sample: IE is led about one sample, |v|·Ts = {1 / N:.3f} m, ahead of the path, and CN half of that. They end"
        f" at {final['IE']:.3f} m and {final['CN']:.3f} m on the 2-dof arm; EE, which has no inner iteration, at"
        f" {final['EE']:.4f} m."
    )


def _printed_rotation(facts) -> str:
    reading = "printed/once/consistent"
    starts = joined([f"{_away(facts, facts.rows[arm, 'track', reading]):.0f} m ({ARMS[arm]})" for arm in ARMS])
    finals = facts.final("2dof", "track", reading)
    return (
        f"**Printed rotation.** The arm starts {starts} away from its path and the mean error is that of getting there."
        f" In the end {ranked(finals)[0]} is the nearest on the 2-dof arm (final errors"
        f" {listed(finals, '{:.1e}'.format)} m)."
    )


def _iterating(facts) -> str:
    once, twice = (facts.passes["5dof", "track", f"on-path/{Ts}/consistent", "CN"] for Ts in ("once", "twice"))
    reach = facts.passes["5dof", "reach", str(DEFAULT), "CN"]
    after = {name: record["residual_max"][M] for name, record in (("once", once), ("twice", twice), ("reach", reach))}
    limits = {name: _limit(FACTOR[name]) for name in ("EE", f"IE with M = {M}")}
    return "## (c) Four to five iterations\n\n" + paragraph(
        "Each pass of the iteration shrinks its error by about z if Ts enters once"
        f" ({Z:g}; measured {once['contraction']:.2f}) and by z·Ts if it enters twice"
        f" ({Z * TS:g}; measured {twice['contraction']:.3f}), 5-dof arm.",
        f"With Ts once, {M} passes of a tracking step leave a last change of {after['once']:.0e} rad, and"
        f" {_passes(once, '1e-06')} needed for 1e-6 rad; the first steps toward a far target still change by"
        f" {after['reach']:.2f} rad after {M} passes, and {_passes(reach, '1e-03')} needed for 1e-3 rad.",
        f"With Ts twice a tracking step is left with {after['twice']:.0e} rad, and {_passes(twice, '1e-06')} needed for"
        " 1e-6 rad.",
        'The paper\'s "4-5 iterations" are what eq. 7 as printed gives.' if _few(twice) and not _few(once) else "",
        f"With M = {M} the implicit stage is thus part of the method and not solved:"
        f" {joined([f'{name} is stable for z < {limit:.3g}' for name, limit in limits.items()])}.",
    )


def _passes(record, tolerance) -> str:
    """ "12 passes are", "more than 40 passes are"."""
    needed = record["needed"][tolerance]
    return f"more than {PASSES} passes are" if needed is None else f"{needed} passes are"


def _few(record) -> bool:
    needed = record["needed"]["1e-06"]
    return needed is not None and needed <= M


def _limit(factor) -> float:
    """Where |R(z)| first exceeds 1 [1]."""
    z = np.linspace(1e-4, 4, 40_000)
    return float(z[np.argmax(np.abs(factor(z)) > 1 + 1e-9)])


def _beside_cn(facts):
    """RMS tracking error by arm and method, and evaluations a step by method."""
    first = facts.methods.isel(Ts=0)
    rms = {arm: claims.by_method(first.rms_error.sel({"arm": arm, "case": "track"})) for arm in ARMS}
    return rms, {m: v / N for m, v in claims.by_method(first.evaluations.sel(arm="2dof", case="track")).items()}


def _times_closer(rms, method) -> str:
    return joined([f"{rms[arm]['CN'] / rms[arm][method]:.2g}" for arm in ARMS])


def _beside(facts) -> str:
    rms, steps = _beside_cn(facts)
    first = facts.methods.isel(Ts=0)
    mean = {arm: claims.by_method(first.mean_error.sel({"arm": arm, "case": "reach"})) for arm in ARMS}
    closer = [f"{_times_closer(rms, m)} for {m} ({steps[m]:.0f} evaluations)" for m in BESIDE]
    faster = [m for m in BESIDE if any(mean[arm][m] < mean[arm]["EE"] for arm in ARMS)]
    orders = facts.methods.order.Ts.values
    return "\n\n".join(
        [
            "## Beside the paper's methods",
            paragraph(
                "CN here is not the textbook Crank-Nicolson method: its second slope is taken at the end point of"
                " implicit Euler, not at its own, as the trapezoidal rule does.",
                f"CN needs {steps['CN']:.0f} evaluations per step; its RMS tracking error over that of the"
                f" others is {joined(closer)}, on the {joined([str(a) for a in ARMS.values()])} arm.",
                f"For reaching a fixed point {joined(faster) if faster else 'none of them'} beats EE.",
            ),
            method_table(facts.methods).markdown(),
            paragraph(
                f'RMS over t = {TS:g} … {N * TS:g} s. "converged": implicit stages solved to convergence instead of'
                f" M = {M}. Order: observed when Ts is halved, from {TS:g} s to {orders[1]:g} s … from"
                f" {orders[-2]:g} s to {orders[-1]:g} s, stages converged."
            ),
        ]
    )


def _all_readings(facts) -> str:
    return "\n\n".join(
        [
            "## All readings",
            claim_table(facts.judged, claims.undetermined(facts.trajectories)).markdown(),
            paragraph(
                f"Mean of ‖e[k]‖ over k = 0 … {N} [m]. (a) holds if IE has the largest and CN the smallest; (b) if CN"
                f" has at most {claims.SIGNIFICANT:g} times the mean error of EE and of IE. \\* decided by rounding."
                " Case I (reach) does not use the feed-forward."
            ),
            picard_table(facts.judged).markdown(),
            paragraph(
                "Passes until no step of CN's run changes by more than the tolerance [rad]. (c) holds if after"
                f" {M} passes no step changes by more than {claims.SETTLED:g} rad."
            ),
        ]
    )


def _files(captions) -> str:
    figures = "\n".join(f"- `{name}`: {caption}" for name, caption in captions.items())
    return f"""## Files

{figures}
- `claims.json`: every verdict with its numbers
- `trajectories.nc`, `methods.nc`, `passes.nc`: the data, with units and configuration (xarray, netCDF)"""
