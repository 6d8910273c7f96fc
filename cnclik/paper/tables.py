"""The tables of `cnclik reproduce`, for the terminal (80 columns) and for the page `claims.md`."""

import itertools
import pathlib
from typing import NamedTuple

from cnclik.measure import files
from cnclik.paper import claims
from cnclik.paper import readings as paper
from cnclik.paper.readings import ARMS, DEFAULT

_SHOWN = (1e-3, 1e-4, 1e-6)  # of the tolerances in claims.json, those in the table [rad]


class Table(NamedTuple):
    """Rows of text; the first `left` columns are set left."""

    title: str
    header: list
    rows: list
    left: int = 1

    def markdown(self) -> str:
        """The table without its title."""
        return files.markdown(self.header, self.rows, left=self.left).strip()


def page(judged, found, reading, captions) -> str:
    """`claims.md`: the explanation beside this file, with the tables of a run.

    Args: found: the run's data. reading: that of the figures. captions: {file: what it shows}.
    """
    text = pathlib.Path(__file__).with_name("claims.md.in").read_text(encoding="utf-8")
    return text.format(
        reading=reading,
        method_table=method_table(found.methods).markdown(),
        claim_table=claim_table(judged, claims.undetermined(found.trajectories)).markdown(),
        picard_table=picard_table(judged).markdown(),
        figures="\n".join(f"- `{name}`: {caption}" for name, caption in captions.items()),
    )


def claim_table(judged, undetermined) -> Table:
    """(a) and (b), one row per arm, case and reading."""
    rows = []
    for row in filter(own, judged["rows"]):
        where = row["arm"], row["reading"], row["case"]
        mean = [number(v) + ("*" if (*where, m) in undetermined else "") for m, v in row["mean_error"].items()]
        claim = {"reach": "(a)", "track": "(b)"}[row["case"]]
        rows.append([f"{claim} {ARMS[row['arm']]} {row['case']}", short(row), *mean, verdict(row["holds"])])
    header = ["claim", "reading", *paper.PAPER, "holds"]
    title = f"Mean error ‖e‖ over k = 0 … {paper.N} [m], and what becomes of the claims"
    return Table(title, header, rows, left=2)


def method_table(methods) -> Table:
    """All methods at the paper's Ts, one row per arm and method."""
    rows = []
    for arm, method in itertools.product(methods.arm.values, methods.method.values):
        at = methods.sel({"arm": arm, "method": method})
        first = at.isel(Ts=0)
        order = at.order.dropna("Ts").values
        errors = first.mean_error.sel(case="reach"), first.rms_error.sel(case="track"), first.rms_converged
        count = int(first.evaluations.sel(case="track"))
        orders = f"{order[0]:.2f} … {order[-1]:.2f}"
        rows.append([f"{ARMS[str(arm)]} {method}", str(count), *map(number, errors), orders])
    header = ["method", "evaluations", "reach: mean", "track: RMS", "converged", "order"]
    return Table(f"All methods at Ts = {paper.TS:g} s under {DEFAULT}: errors ‖e‖ [m]", header, rows)


def picard_table(judged) -> Table:
    """(c): passes of the Picard iteration along CN's runs, one row per arm, case and reading."""
    rows = []
    for record in filter(own, judged["picard"]):
        if record["method"] != "CN":
            continue
        needed = [record["needed"][f"{t:.0e}"] for t in _SHOWN]
        needed = [f"> {paper.PASSES}" if v is None else str(v) for v in needed]
        after = f"{record['residual_max'][paper.M]:.0e}"
        where = f"{ARMS[record['arm']]} {record['case']}"
        rows.append([where, short(record), after, *needed, verdict(record["holds"])])
    header = ["(c)", "reading", f"after {paper.M}", *(f"{t:.0e}".replace("e-0", "e-") for t in _SHOWN), "holds"]
    title = f"Worst last change after {paper.M} passes [rad], and passes needed to a tolerance"
    return Table(title, header, rows, left=2)


def own(record) -> bool:
    """Return False for a repetition: Case I does not use the feed-forward."""
    return record["case"] == "track" or record["reading"].endswith("/consistent")


def short(record) -> str:
    """Return the reading, as far as the case uses it."""
    return record["reading"] if record["case"] == "track" else record["reading"].rsplit("/", 1)[0]


def number(value) -> str:
    """Return three or four digits, as the paper's own tables would print them."""
    value = float(value)
    plain = value == 0 or 0.01 <= abs(value) < 100
    return f"{value:.4f}" if plain else f"{value:.2e}".replace("e-0", "e-").replace("e+0", "e+")


def verdict(holds) -> str:
    return "yes" if holds else "no"
