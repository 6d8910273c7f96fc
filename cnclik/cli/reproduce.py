"""`cnclik reproduce`: the paper's experiments, with data, figures and a check of its claims."""

from dataclasses import dataclass
from pathlib import Path

from cnclik import paper
from cnclik.cli import progress
from cnclik.cli.common import ComputeOptions, print_table


@dataclass(kw_only=True)
class Args(ComputeOptions):
    """Run the experiments of Drexler (2016), Section V, under all eight readings of its text."""

    out: Path = Path("reproduced")
    """Folder for data, claims.json, claims.md and figures."""

    reading: str = str(paper.DEFAULT)
    """Reading of the paper that figures 1 to 12 show: on-path or printed / once or twice / consistent or printed."""


def run(args: Args) -> None:
    shown = str(paper.reading(args.reading))
    with progress.bar("done") as report:
        found = paper.reproduce(args.out, reading=shown, progress=report, overwrite=args.overwrite)
    _show(found)
    print(f"Wrote data, claims and figures to {args.out}/; read {args.out / 'claims.md'} first.")


def _show(found) -> None:
    """The tables of claims.md on the terminal."""
    import rich.box

    from cnclik.paper import claims, readings, tables

    judged = paper.judge(found.trajectories, found.passes)
    look = dict(box=rich.box.SIMPLE_HEAD, padding=(0, 1, 0, 0), style=lambda row: "green" if row[-1] == "yes" else None)
    for title, header, rows, left in (
        tables.claim_table(judged, claims.undetermined(found.trajectories)),
        tables.method_table(found.methods),
        tables.picard_table(judged),
    ):
        print_table(rows, header, title=title, left=left, **look)
    print(f"* decided by rounding: starts {readings.NUDGE:.0e} rad apart give other digits.\n")
