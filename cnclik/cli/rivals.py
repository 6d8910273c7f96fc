"""`cnclik rivals`: tuning by gradient against what a user would do instead, as a table and a figure."""

import dataclasses
from pathlib import Path

from cnclik import errors


@dataclasses.dataclass(kw_only=True)
class Args:
    """Find gains by gradient, grid, Nelder-Mead and by hand on the paper's arms, Panda and UR5."""

    out: Path = Path("results/tuning")
    """Folder for rivals.md, rivals.csv and rivals.png."""
    cases: tuple[str, ...] = ()
    """Some of them, such as "2-dof line"; all four by default."""
    gains: tuple[str, ...] = ("scalar", "per-axis")
    """scalar, per-axis."""
    steps: int = 100
    """Evaluations each way may use."""
    margin: float = 0.9
    """Bound of the spectral radius along the path."""


def run(args: Args) -> None:
    from rich.console import Console

    from tests.bench import rivals

    for case in args.cases:
        errors.one_of("cases", case, rivals.CASES)
    for gain in args.gains:
        errors.one_of("gains", gain, rivals.GAINS)
    if not args.gains:
        raise errors.fail("gains", f"name some of {', '.join(rivals.GAINS)}", "is empty")

    from cnclik.show import style, tuning
    from cnclik.show.output import output_folder

    console, rows = Console(stderr=True), []
    with output_folder(args.out) as folder:
        for case in args.cases or rivals.CASES:
            for gain in args.gains:
                with console.status(f"{case}, {gain}") as status:
                    tell = lambda row: status.update(f"{row.case}, {row.gain}: {row.way} done")  # noqa: E731
                    rows += rivals.rivals(case, gain, margin=args.margin, steps=args.steps, progress=tell)
        (folder / "rivals.md").write_text(rivals.page(rows, args.margin, args.steps), encoding="utf-8")
        (folder / "rivals.csv").write_text(rivals.as_csv(rows), encoding="utf-8")
        with style.style():
            style.save(tuning.rivals(rows), folder / "rivals.png", {"Title": "Tuning against its rivals"})
    print(rivals.table(rows))
    print(f"Wrote rivals.csv, rivals.md and rivals.png to {args.out}/.")
