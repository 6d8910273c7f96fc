"""What `cnclik reproduce` tells in words: the tables on the terminal and `claims.md`."""

import itertools

import numpy as np

from cnclik.paper import claims
from cnclik.paper import readings as paper

_ARM = {"2dof": "2-dof", "5dof": "5-dof"}
_SHOWN = (1e-3, 1e-4, 1e-6)  # of the tolerances in claims.json, those in the table [rad]


# --- tables: (title, header, rows of strings), shown on the terminal (80 columns) and in Markdown -----


def claim_table(judged, undetermined):
    """(a) and (b), one row per arm, case and reading."""
    rows = []
    for row in judged["rows"]:
        if not _own(row):
            continue
        wild = {m for arm, reading, case, m in undetermined if (arm, reading, case) == _where(row)}
        mean = [number(v) + ("*" if m in wild else "") for m, v in row["mean_error"].items()]
        claim = {"reach": "(a)", "track": "(b)"}[row["case"]]
        rows.append([f"{claim} {_ARM[row['arm']]} {row['case']}", _reading(row), *mean, verdict(row["holds"])])
    header = ["claim", "reading", *paper.PAPER, "holds"]
    return "Mean error ‖e‖ over k = 0 … 30 [m], and what becomes of the claims", header, rows


def method_table(methods):
    """All methods at Ts = 0.1 s, one row per arm and method."""
    rows = []
    for arm, method in itertools.product(methods.arm.values, methods.method.values):
        at = methods.sel({"arm": arm, "method": method})
        first = at.isel(Ts=0)
        order = at.order.dropna("Ts").values
        rows.append(
            [
                f"{_ARM[str(arm)]} {method}",
                f"{int(first.evaluations.sel(case='track'))}",
                number(first.mean_error.sel(case="reach")),
                number(first.rms_error.sel(case="track")),
                number(first.rms_converged),
                f"{order[0]:.2f} … {order[-1]:.2f}",
            ]
        )
    header = ["method", "evaluations", "reach: mean", "track: RMS", "converged", "order"]
    return "All methods at Ts = 0.1 s under on-path/once/consistent: errors ‖e‖ [m]", header, rows


def picard_table(judged):
    """(c): passes of the Picard iteration along CN's runs, one row per arm, case and reading."""
    rows = []
    for record in judged["picard"]:
        if record["method"] != "CN" or not _own(record):
            continue
        needed = [record["needed"][f"{t:.0e}"] for t in _SHOWN]
        needed = [str(v) if v is not None else f"> {paper.PASSES}" for v in needed]
        after = f"{record['residual_max'][paper.M]:.0e}"
        where = f"{_ARM[record['arm']]} {record['case']}"
        rows.append([where, _reading(record), after, *needed, verdict(record["holds"])])
    header = ["(c)", "reading", f"after {paper.M}", *(f"{t:.0e}".replace("e-0", "e-") for t in _SHOWN), "holds"]
    title = f"Worst last change after {paper.M} passes [rad], and passes needed to a tolerance"
    return title, header, rows


def _own(record) -> bool:
    """False for a repetition: Case I does not use the feed-forward."""
    return record["case"] == "track" or record["reading"].endswith("/consistent")


def _reading(record):
    return record["reading"] if record["case"] == "track" else record["reading"].rsplit("/", 1)[0]


def _where(row):
    return row["arm"], row["reading"], row["case"]


def number(value) -> str:
    """Three or four digits, as the paper's own tables would print them."""
    value = float(value)
    if not np.isfinite(value):
        return str(value)
    if value == 0 or 0.01 <= abs(value) < 100:
        return f"{value:.4f}"
    return f"{value:.2e}".replace("e-0", "e-").replace("e+0", "e+")


def verdict(holds) -> str:
    return "yes" if holds else "no"


def show(table, console) -> None:
    """A table on the terminal."""
    import rich.box
    from rich.table import Table
    from rich.text import Text

    title, header, rows = table
    drawn = Table(title=Text(title, style="bold"), title_justify="left", box=rich.box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for j, name in enumerate(header):
        numeric = all(row[j][:1].isdigit() or row[j][:1] == ">" for row in rows) and not rows[0][j].startswith("2-dof")
        drawn.add_column(name, justify="right" if numeric else "left", no_wrap=True)
    for row in rows:
        drawn.add_row(*row, style="green" if row[-1] == "yes" else None)
    console.print(drawn)


def markdown(table) -> str:
    """A table in Markdown, without its title."""
    _, header, rows = table
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


# --- claims.md ----------------------------------------------------------------------------------------


def story(judged, trajectories, methods, reading, captions) -> str:
    """`claims.md`: what of the paper holds, under which reading, and why. Every number is read from the data."""
    row = {(r["arm"], r["case"], r["reading"]): r for r in judged["rows"]}
    passes = {(r["arm"], r["case"], r["reading"], r["method"]): r for r in judged["picard"]}
    default = str(paper.DEFAULT)
    undetermined = claims.undetermined(trajectories)
    z = paper.ALPHA * paper.TS

    def mean(arm, case, method, reading=default):
        return row[arm, case, reading]["mean_error"][method]

    def final(arm, case, method, reading=default):
        return row[arm, case, reading]["final_error"][method]

    def gain(arm, reading=default):
        errors = row[arm, "track", reading]["mean_error"]
        return min(errors["EE"], errors["IE"]) / errors["CN"]

    def rms(arm, method):
        return float(methods.rms_error.sel({"arm": arm, "case": "track", "method": method}).isel(Ts=0))

    def holding(case):
        found = {}
        for r in judged["rows"]:
            if r["case"] == case and r["holds"] and _own(r):
                found.setdefault(_reading(r), []).append(_ARM[r["arm"]])
        return "; ".join(f"`{reading}` ({' and '.join(arms)})" for reading, arms in found.items()) or "none"

    wild = "printed/once/consistent"
    spread = trajectories.spread.sel({"arm": "2dof", "case": "reach", "reading": wild})
    wild_determined = float(spread.sel({"method": "EE"}))
    offset = (1 / (paper.N * paper.TS) - 1) / paper.ALPHA
    once, twice = passes["5dof", "track", default, "CN"], passes["5dof", "track", "on-path/twice/consistent", "CN"]
    reach = passes["5dof", "reach", default, "CN"]
    figures = "\n".join(f"- `{name}`: {caption}" for name, caption in captions.items())

    return f"""# What of the paper holds

D. A. Drexler, *Solution of the Closed-Loop Inverse Kinematics Algorithm Using the Crank-Nicolson Method*,
SAMI 2016, Section V: explicit Euler (EE), implicit Euler (IE) and the mean of their increments (CN) on planar
arms with 2 and 5 joints; Ts = {paper.TS:g} s, N = {paper.N} steps, M = {paper.M} passes, α = {paper.ALPHA:g} 1/s, so \
z = α·Ts = {z:g}. This page, `claims.json`,
the figures and the data beside it are written by `cnclik reproduce`; all in float64.

## In short

| claim of the paper | holds? |
| --- | --- |
| (a) Reaching a point: IE converges slowest, CN fastest | IE slowest: yes, on the path. CN fastest: no, EE is. \
In full only under {holding("reach")}, as a transient |
| (b) Tracking a line: the error is significantly lower with CN | Yes, about {gain("2dof"):.0f} times, \
but only under {holding("track")} |
| (c) The fixed-point iteration converges in 4 to 5 iterations | With Ts once: to drawing accuracy while tracking, \
not while reaching. With Ts twice: yes, away from singularities, but then (b) fails |

No single reading of the text supports (a), (b) and (c) together on either arm.

## Three places where the text leaves a choice

A reading is written rotation/Ts/feed-forward, such as `{default}`.

1. **Rotation.** With right-handed rotation about +z ("printed") the tips start at (−1, 1) and (−4, 1), but the paths
   of Case II start at (1, 1) and (4, 1). With the opposite sense ("on-path") both arms start on their path.
2. **Ts.** Eqs. 6 and 8 put Ts into Δθ, and eq. 7 multiplies by Ts again. "once" agrees with eqs. 2-5; "twice" takes
   eq. 7 as printed.
3. **Feed-forward.** The path of Case II moves at −1/(N·Ts) = −1/3 m/s ("consistent"); eqs. 16 and 19 print −1
   ("printed").

The figures here use `{reading}`.

## (a) Reaching a point

Near the target, one step multiplies the error by R(z): 1 − z for EE, 1/(1 + z) for IE, (1 − z²/2)/(1 + z) for CN.
At z = {z:g} that is {1 - z:.3f}, {1 / (1 + z):.3f} and {(1 - z * z / 2) / (1 + z):.3f}: EE is fastest and IE slowest, \
and the runs agree (mean ‖e‖, 2-dof: EE
{number(mean("2dof", "reach", "EE"))}, IE {number(mean("2dof", "reach", "IE"))}, \
CN {number(mean("2dof", "reach", "CN"))}; 5-dof: {number(mean("5dof", "reach", "EE"))}, \
{number(mean("5dof", "reach", "IE"))}, {number(mean("5dof", "reach", "CN"))}). CN overtakes EE only for
z > 2/√3 ≈ 1.155. A method that follows the differential equation more faithfully is not faster: the exact
solution itself shrinks the error only by exp(−z) = {np.exp(-z):.3f} per step.

With the printed rotation the 5-dof arm starts on the far side of its base, and under `{wild}` the claim
holds in full: EE {number(mean("5dof", "reach", "EE", wild))}, IE {number(mean("5dof", "reach", "IE", wild))}, \
CN {number(mean("5dof", "reach", "CN", wild))}. That is the transient of a large motion; once near the target EE
is again the fastest (final errors {final("5dof", "reach", "EE", wild):.1e}, {final("5dof", "reach", "IE", wild):.1e}, \
{final("5dof", "reach", "CN", wild):.1e} m).

With the printed rotation the 2-dof arm passes close by its singularity (the folded arm, q₂ = π), and under
`printed/once` the Picard iteration does not converge there. CN is then the worst of the three
({number(mean("2dof", "reach", "CN", wild))} against {number(mean("2dof", "reach", "EE", wild))} for EE), but \
**its digits mean nothing**: starts {paper.NUDGE:.0e} rad apart
give mean errors that differ by {100 * float(spread.sel({"method": "CN"})):.0f} % \
(IE {100 * float(spread.sel({"method": "IE"})):.2f} %, EE {wild_determined:.0e}), and so do rounding, another processor,
or another way to compute the pseudoinverse. Such numbers are marked * below; `spread` in `trajectories.nc` has it
for every run.

## (b) Tracking a line

Under `{default}` the mean error of CN is {gain("2dof"):.1f} times (2-dof) and {gain("5dof"):.1f} times (5-dof)
smaller than the better of EE and IE. The reason: EE and IE stray from the path by nearly the same amount to opposite
sides (see the x and y panels of `fig05.png` and `fig11.png`), and CN takes the mean of their increments.

- **Printed feed-forward.** The loop is told −1 m/s for a path at −1/3 m/s. Whatever the method, the error settles where
  feedback makes up for it, at (1 − 1/3)/α = {abs(offset):.3f} m; nothing is left for a better method to gain.
- **Ts twice.** The inner iteration then looks ahead by Ts² instead of Ts while its target is that of the next
  sample, so IE is led about one sample, |v|·Ts = {1 / paper.N:.3f} m, ahead of the path, and CN half of that. They
  settle at {final("2dof", "track", "IE", "on-path/twice/consistent"):.3f} m and \
{final("2dof", "track", "CN", "on-path/twice/consistent"):.3f} m on the 2-dof arm; EE, which has no inner iteration, at
  {final("2dof", "track", "EE", "on-path/twice/consistent"):.4f} m.
- **Printed rotation.** The arm starts 2 m (2-dof) or 8 m (5-dof) away from its path and the mean error is that of
  getting there. Once it has arrived, CN is the better here too: final error \
{final("2dof", "track", "CN", wild):.1e} m against {final("2dof", "track", "EE", wild):.1e} m (2-dof).

## (c) Four to five iterations

Each pass of the iteration shrinks its error by about z if Ts enters once (measured: {once["contraction"]:.2f}) and by \
z·Ts if it enters twice
({twice["contraction"]:.3f}). So with Ts once, 5 passes of a tracking step leave a last change of \
{once["residual_max"][paper.M]:.0e} rad, invisible in a figure, but
{once["needed"]["1e-06"]} passes are needed for 1e-6 rad; the first steps toward a far target still change by \
{reach["residual_max"][paper.M]:.2f} rad after 5 passes and need {reach["needed"]["1e-03"]} for 1e-3
rad. With Ts twice, {twice["needed"]["1e-06"]} passes reach 1e-6 rad: the paper's "4-5 iterations" are what eq. 7 as \
printed gives. With M = {paper.M} the implicit
stage is thus part of the method and not solved: IE with M = 5 is stable only for z < 1, where EE is stable for z < 2.

## Beside the paper's methods

CN here is not the textbook Crank-Nicolson method: its second slope is taken at the end point of implicit Euler, not at
its own. The trapezoidal rule takes it at its own, at the same {paper.M + 1} evaluations per step, and tracks \
{rms("2dof", "CN") / rms("2dof", "TRAPEZOID"):.0f} times closer (2-dof; 5-dof:
{rms("5dof", "CN") / rms("5dof", "TRAPEZOID"):.0f} times). The explicit midpoint rule tracks as well as CN for 2 \
evaluations instead of 6, and RK4 for 4 evaluations better than
either. For reaching a fixed point none of them beats EE.

{markdown(method_table(methods))}

RMS over t = 0.1 … 3 s. "converged": implicit stages solved to convergence instead of M = 5. Order: observed when Ts
is halved, from 0.1 s to 0.05 s … from 0.0125 s to 0.00625 s, stages converged.

## All readings

{markdown(claim_table(judged, undetermined))}

Mean of ‖e[k]‖ over k = 0 … {paper.N} [m]. (a) holds if IE has the largest and CN the smallest; (b) if CN has at most
half the mean error of EE and of IE. \\* decided by rounding. Case I (reach) does not use the feed-forward.

{markdown(picard_table(judged))}

Passes until no step of CN's run changes by more than the tolerance [rad]. (c) holds if after 5 passes no step changes
by more than 1e-3 rad.

## Files

{figures}
- `claims.json`: every verdict with its numbers
- `trajectories.nc`, `methods.nc`, `passes.nc`: the data, with units and configuration (xarray, netCDF)
"""
