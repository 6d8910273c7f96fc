"""Files of results: one way to write a dataset, a table, a Markdown table."""

import csv
import dataclasses
import enum
import math
import os
import pathlib

import numpy as np

from cnclik import errors


def save_netcdf(data, path) -> None:
    """An `xarray.Dataset` as compressed netCDF: made in memory, as HDF5 ends the process where a disk is full."""
    numbers = [name for name, values in data.variables.items() if values.dtype.kind in "fiub" and values.ndim]
    packed = {name: {"zlib": True, "complevel": 6} for name in numbers}
    pathlib.Path(path).write_bytes(data.to_netcdf(engine="h5netcdf", encoding=packed))


def save_csv(rows, path) -> None:
    """Rows as CSV, the first of them the names of the columns."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def markdown(header, rows, *, left=1) -> str:
    """A Markdown table; the first `left` columns are set left, the others right. Cells may hold any one-line text."""
    header, *rows = ([str(cell).replace("|", "\\|") for cell in row] for row in (header, *rows))
    rule = ["---" if i < left else "---:" for i in range(len(header))]
    return "".join(f"| {' | '.join(row)} |\n" for row in (header, rule, *rows))


def to_json(found, **about) -> dict:
    """An answer, such as advice, a diagnosis or a fitted drive, as nested tables of plain numbers, ready for `json`.

    What is not finite is null, a complex number the list of its parts. Left out are whole runs and recordings behind
    the numbers.

    Args:
      found: a record, such as `diagnose`, `fit_drive`, `recommend` or `stability.practice` return.
      about: further entries, such as the robot's name.
    """
    if not dataclasses.is_dataclass(found) or isinstance(found, type):
        raise errors.fail("found", "be an answer of this library", f"is {type(found).__name__}")
    return plain(about) | plain(found)


_BEHIND = ("run", "advice", "path", "modes")  # whole records, and recordings, that a record's numbers come from


def plain(value):
    """For JSON: nested tables, lists, numbers and texts; what is not finite is null, a record a table of its fields.

    A record's `_BEHIND` are left out.
    """
    if dataclasses.is_dataclass(value):
        kept = (f.name for f in dataclasses.fields(value) if f.name not in _BEHIND)
        value = {name: getattr(value, name) for name in kept}
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):
        return plain(np.asarray(value).tolist())
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (str, int)):
        return str(value) if isinstance(value, enum.StrEnum) else value
    return str(value)
