"""`cnclik compare`: the methods on Panda and UR5, error against work."""

import dataclasses
from pathlib import Path


@dataclasses.dataclass(kw_only=True)
class Args:
    """Track a pose on Panda and UR5 with every method over a range of sampling times."""

    out: Path = Path("results/robots")
    """Folder for methods.nc, methods.md and methods.png."""


def run(args: Args) -> None:
    from rich.console import Console
    from rich.progress import track

    from cnclik.show import run as pictures
    from cnclik.show import style
    from cnclik.show.output import output_folder
    from cnclik.study import compare

    console = Console(stderr=True)
    with output_folder(args.out) as folder:
        data = compare.run(lambda tasks: track(tasks, "Robots and methods", console=console))
        data.to_netcdf(folder / "methods.nc", engine="h5netcdf")
        (folder / "methods.md").write_text(compare.table(data), encoding="utf-8")
        with style.style():
            style.save(pictures.work(data), folder / "methods.png", {"Comment": data.attrs["config"]})
    print(f"Wrote methods.nc, methods.md and methods.png to {args.out}/.")
