"""`cnclik trouble`: damping and limit methods on real robots near trouble, as a table."""

import dataclasses
import json
from pathlib import Path

from cnclik import errors


@dataclasses.dataclass(kw_only=True)
class Args:
    """Run real robots through a singularity, along a joint limit and towards a target out of reach."""

    out: Path = Path("results/robots")
    """Folder for trouble.md and trouble.json."""
    robots: tuple[str, ...] = ()
    """Names of the robots to run, all eight by default."""
    folder: Path | None = None
    """Folder with the robots' URDF files; that of the installed example-robot-data wheel by default."""


def run(args: Args) -> None:
    from rich.console import Console
    from rich.progress import track

    from cnclik.show.output import output_folder
    from cnclik.sweeps import trouble

    for name in args.robots:
        errors.one_of("robots", name, trouble.ROBOTS)
    console = Console(stderr=True)
    with output_folder(args.out) as folder:
        rows = trouble.run(
            args.folder, args.robots or None, lambda tasks: track(tasks, "Robots and methods", console=console)
        )
        (folder / "trouble.md").write_text(trouble.page(rows), encoding="utf-8")
        (folder / "trouble.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    print(f"Wrote trouble.md and trouble.json to {args.out}/.")
