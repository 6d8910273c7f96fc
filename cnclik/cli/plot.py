"""`cnclik plot DIR`: the figures of a sweep, drawn again from its data."""

import dataclasses
import pathlib
from typing import Literal

from cnclik.cli.arguments import option
from cnclik.cli.common import ComputeOptions


@dataclasses.dataclass(kw_only=True)
class Args(ComputeOptions):
    folder: pathlib.Path = option(positional=True)
    """Folder of a finished sweep, which contains data.zarr."""
    spec: pathlib.Path | None = None
    """Spec whose [[figure]] tables are drawn instead of those of the sweep's own spec."""
    format: Literal["png", "pdf", "svg"] = "png"
    """File format of the figures."""


def run(args: Args) -> None:
    """Draw the figures and print their names."""
    from cnclik.sweeps import spec, store

    data = store.read(args.folder)
    if missing := store.blocks_missing(args.folder):
        print(f"{missing} blocks are not done yet, or damaged: the command that made the sweep goes on from there.")
    tables = None if args.spec is None else spec.read(args.spec).figures
    draw(data, args.folder, tables=tables, form=args.format, overwrite=args.overwrite)


def draw(data, folder: pathlib.Path, *, tables=None, form="png", overwrite=False) -> None:
    """Draw and write the figures; one that cannot be drawn does not stop the others.

    Args:
      data: of a sweep.
      folder: where to put them.
      tables: as [[figure]] in a spec; by default those of the data's own spec.
      form: "png", "pdf" or "svg".
      overwrite: also over files that cnclik did not write.

    Raises: FigureError.
    """
    from cnclik.show import output, sweeps

    about = {"Description": data.attrs.get("spec", "")}
    made = {f"{name}.{form}": (make, {"Title": name} | about) for name, make in sweeps.drawings(data, tables).items()}
    written = []
    try:
        again = f"cnclik plot {folder}"
        written = output.draw(made, folder, name="folder", again=again, overwrite=overwrite)
    except output.FigureError as error:
        written = error.written
        raise
    finally:
        for file in written:
            print(f"Wrote {folder / file}")
