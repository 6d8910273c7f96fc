"""`cnclik plot DIR`: the figures of a finished sweep, drawn again."""

import dataclasses
import pathlib
from typing import Annotated, Literal

import tyro


@dataclasses.dataclass(kw_only=True)
class Args:
    folder: Annotated[pathlib.Path, tyro.conf.Positional]
    """Folder of a sweep, with its data.zarr."""
    spec: pathlib.Path | None = None
    """A spec whose [[figure]] tables to draw in place of those the sweep was run with."""
    format: Literal["png", "pdf", "svg"] = "png"
    """File format of the figures."""


def run(args: Args) -> None:
    """Draw, and say what."""
    from cnclik.show import sweeps
    from cnclik.show.output import output_folder
    from cnclik.sweeps import store

    data = store.read(args.folder)
    missing = store.blocks_missing(args.folder)
    if missing:
        print(f"{missing} blocks are not done yet: their cells stay empty.")
    figures = None
    if args.spec is not None:
        from cnclik.sweeps import spec

        figures = spec.read(args.spec).figures
    with output_folder(args.folder, name="folder") as folder:
        made = sweeps.draw(data, folder, figures=figures, form=args.format)
    for path in made:
        print(f"Wrote {args.folder / path.name}")
