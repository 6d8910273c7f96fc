"""`cnclik plot DIR`: the figures of a sweep, drawn again from its data."""

import dataclasses
import pathlib
import sys
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
    from cnclik.sweeps import store

    data = store.read(args.folder)
    missing = store.blocks_missing(args.folder)
    if missing:
        print(f"{missing} blocks are not done yet, or damaged: the command that made the sweep goes on from there.")
    tables = None
    if args.spec is not None:
        from cnclik.sweeps import spec

        tables = spec.read(args.spec).figures
    draw(data, args.folder, tables=tables, form=args.format)


def draw(data, folder: pathlib.Path, *, tables=None, form="png") -> None:
    """Draw and write the figures. One that can't be drawn costs nothing but itself: a line on stderr, exit code 1.

    Args:
      data: of a sweep.
      folder: where to put them.
      tables: as [[figure]] in a spec; by default those of the data's own spec.
      form: "png", "pdf" or "svg".
    """
    from cnclik.show import style, sweeps
    from cnclik.show.output import output_folder

    failed, written = [], []

    def miss(name, error):
        failed.append(f"{name} ({_reason(error)})")

    with style.style(), output_folder(folder, name="folder") as new:
        for name, figure in sweeps.figures(data, tables, failed=miss).items():
            path = new / f"{name}.{form}"
            try:
                if form == "png":
                    style.save(figure, path, {"Title": name, "Description": data.attrs.get("spec", "")})
                else:
                    figure.savefig(path)
                written.append(path.name)
            except Exception as error:  # some mistakes, as in a title's mathematics, show only here
                miss(name, error)
                path.unlink(missing_ok=True)
    for name in written:
        print(f"Wrote {folder / name}")
    if failed:
        what = ", ".join(failed)
        print(f"cnclik: Not drawn: {what}; the data are kept, `cnclik plot {folder}` draws again.", file=sys.stderr)
        sys.exit(1)


def _reason(error) -> str:
    text = " ".join(str(error).split())
    return text if len(text) <= 200 else text[:199] + "…"
