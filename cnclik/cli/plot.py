"""`cnclik plot DIR`: the figures of a sweep, drawn again from its data."""

from pathlib import Path
from typing import Literal

from cnclik.cli.common import prepare


def run(folder: str, *, format: Literal["png", "pdf", "svg"] = "png", overwrite: bool = False) -> None:
    """Draw the figures and print their names.

    Args:
      folder: folder of a finished sweep, which contains data.zarr.
      format: file format of the figures.
    """
    prepare()
    from cnclik.sweeps import store

    data = store.read(folder)
    if missing := store.blocks_missing(folder):
        print(f"{missing} blocks are not done yet, or damaged: the command that made the sweep goes on from there.")
    draw(data, Path(folder), form=format, overwrite=overwrite)


def draw(data, folder: Path, *, tables=None, form="png", overwrite=False) -> None:
    """Draw and write a sweep's figures, those of [[figure]] in its spec; one that fails does not stop the others.

    Args: tables: as [[figure]] in another spec.
    Raises: FigureError.
    """
    from cnclik.show import output, sweeps

    about, figures = {"Description": data.attrs.get("spec", "")}, sweeps.drawings(data, tables)
    made = {f"{name}.{form}": (make, {"Title": name} | about) for name, make in figures.items()}
    for file in output.draw(made, folder, name="folder", again=f"cnclik plot {folder}", overwrite=overwrite):
        print(f"Wrote {folder / file}")
