"""`cnclik reproduce`: the paper's experiments, with data, figures and a check of its claims."""

from cnclik.cli import progress
from cnclik.cli.common import prepare, print_table


def run(*, out: str = "reproduced", overwrite: bool = False) -> None:
    """Run the experiments of Drexler (2016), Section V, under all eight readings of its text.

    Args:
      out: folder for data, claims.json, claims.md and figures.
    """
    prepare()
    import rich.box

    from cnclik import paper
    from cnclik.paper import claims, readings

    with progress.bar("done") as report:
        results = paper.reproduce(out, progress=report, overwrite=overwrite)
    look = dict(box=rich.box.SIMPLE_HEAD, padding=(0, 1, 0, 0), style=lambda row: "green" if row[-1] == "yes" else None)
    for title, header, rows, left in claims.tables(claims.judge(results.trajectories, results.passes), results):
        print_table(rows, header, title=title, left=left, **look)
    print(f"* decided by rounding: starts {readings.NUDGE:.0e} rad apart give other digits.\n")
    print(f"Wrote data, claims and figures to {out}/; read {out}/claims.md first.")
