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
