"""`cnclik reproduce`: the paper's experiments, with data, figures and a check of its claims."""

from pathlib import Path

from cnclik.cli import progress
from cnclik.cli.common import prepare


def run(*, out: str = "reproduced", overwrite: bool = False) -> None:
    """Run the experiments of Drexler (2016), Section V, under all eight readings of its text.

    Args:
      out: folder for data, claims.json, claims.md and figures.
    """
    prepare()
    from cnclik import paper

    with progress.bar("done") as report:
        paper.reproduce(out, progress=report, overwrite=overwrite)
    print(Path(out, "claims.md").read_text(encoding="utf-8"))
    print(f"Wrote data, claims and figures to {out}/.")
