"""Tables: CSV files of numbers, as logs, waypoints and targets."""

import csv
import itertools
import pathlib

import numpy as np

from cnclik import errors, quantities
from cnclik.reading import read_bytes

POSITION, QUATERNION = ("x", "y", "z"), ("qw", "qx", "qy", "qz")


def read_columns(argument: str, file) -> tuple:
    """Names of the columns ("1", "2", … without a header) and numbers (rows, columns) of a CSV file.

    A header and # comments are no rows. Empty cells and columns of texts become NaN.

    Raises: ArgumentError, naming the argument, for a file that cannot be read, or rows that do not fit.
    """
    names, rows = _cells(argument, file)
    if rows and all(len(row) == 1 and ";" in row[0] for row in rows):
        found = f"{pathlib.Path(file).name} holds {rows[0][0]!r}"
        raise errors.fail(argument, "have columns that are separated by commas", found)
    meant = {j for row in rows for j, cell in enumerate(row) if _is_meant(cell)}
    rows = [[cell if j in meant and cell.strip() else "nan" for j, cell in enumerate(row)] for row in rows]
    table = _numbers(argument, file, rows)
    width = table.shape[-1] if rows else len(names)
    return (names if len(names) == width else tuple(str(i + 1) for i in range(width))), table


def read_points(argument: str, file, task, *, timed=False, tip="") -> tuple:
    """(times [s] (k,) or None, points (k, d)) of a CSV file: positions [m], quaternions w x y z, or both, for a task.

    The columns have the names time, x, y, z, qw, qx, qy, qz, or without a header this order.

    Args: timed: whether there must be times. tip: where names begin with it, as in left.x, those columns are read.
    Raises: as `read_columns`, and for unknown, repeated or missing columns.
    """
    names, rows = _cells(argument, file)
    name, known = pathlib.Path(file).name, ("time", *POSITION, *QUATERNION)
    table = _numbers(argument, file, rows) if rows else np.zeros((0, len(names)))
    if not names and rows:
        names = _in_order(table.shape[1], task, timed)
        if len(names) != table.shape[1]:
            must = f"have columns {' '.join(names)}, in this order or by name"
            raise errors.fail(argument, must, f"{name} has {table.shape[1]}")
    if rows and len(names) != table.shape[1]:
        found = f"{name} has {len(names)} names and {table.shape[1]} columns"
        raise errors.fail(argument, "have a name for each column", found)
    if len(set(names)) < len(names):
        raise errors.fail(argument, "name each column once", f"{name} has {' '.join(names)}")
    columns = dict(zip(names, table.T, strict=False)) if rows else dict.fromkeys(names or known, np.zeros(0))
    if tip and any(column.startswith(f"{tip}.") for column in columns):
        columns = {key.removeprefix(f"{tip}."): v for key, v in columns.items() if key.startswith(f"{tip}.")}
    for column in columns:
        if column not in known:
            found = f"{name} has {column!r}{errors.nearest(column, known)}"
            raise errors.fail(argument, f"have columns {' '.join(known)}", found)
    axes = () if not task.position else POSITION if set(POSITION) <= set(columns) else task.position
    turns = QUATERNION if task.orientation and (set(QUATERNION) & set(columns) or not task.position) else ()
    needed = (*("time",) * timed, *axes, *turns)
    if lacking := [column for column in needed if column not in columns]:
        instead = ", or a --speed" * ("time" in lacking)
        raise errors.fail(argument, f"have columns {' '.join(needed)}{instead}", f"{name} lacks {' '.join(lacking)}")
    return columns.get("time"), np.stack([columns[column] for column in (*axes, *turns)], 1)


def _in_order(width, task, timed) -> tuple:
    """The names of so many columns of a file without a header; the longest ones where there is no such number."""
    places = (task.position, task.position and POSITION)
    turns = ((), QUATERNION) if task.orientation else ((),)
    orders = [(*("time",) * timed, *place, *turn) for place in places for turn in turns if place or turn]
    return next((names for names in orders if len(names) == width), orders[-1])


def _cells(argument, file) -> tuple:
    """(names of a header, () without one; rows of texts) of a CSV file."""
    path = pathlib.Path(file)
    try:
        text = read_bytes(argument, path, "a CSV file").decode("utf-8-sig")
        lines = [line for line in text.splitlines() if line.strip()]
        rows = list(csv.reader(line for line in lines if not line.startswith("#")))
        above = list(csv.reader(line.lstrip("# ") for line in itertools.takewhile(lambda x: x.startswith("#"), lines)))
    except (UnicodeDecodeError, csv.Error) as error:
        reason = "is no text in UTF-8" if isinstance(error, UnicodeDecodeError) else error
        raise errors.fail(argument, "name a CSV file that can be read", f"{path.name}: {reason}") from None
    if rows and not any(_is_meant(cell) or ";" in cell for cell in rows[0]):
        return tuple(name.strip() for name in rows[0]), rows[1:]
    if rows and above and len(above[-1]) == len(rows[0]) > 1 and not any(map(_is_meant, above[-1])):
        return tuple(name.strip() for name in above[-1]), rows  # as NumPy's savetxt writes a header
    return (), rows


def _is_meant(cell) -> bool:
    """Whether a cell is a number, or was meant to be one, in other digits or with another point."""
    return quantities.number(cell) is not None or bool(quantities.hint(cell))


def _numbers(argument, file, rows):
    table, name = [], pathlib.Path(file).name
    for k, row in enumerate(rows, 1):
        values = [quantities.number(cell) for cell in row]
        if None in values:
            wrong = row[values.index(None)]
            why = f"holds {wrong!r}{quantities.hint(wrong)}" + ", and columns are separated by commas" * (";" in wrong)
        else:
            why = f"has {len(row)} of {len(rows[0])}" * (len(row) != len(rows[0]))
        if why:
            raise errors.fail(argument, "hold numbers, as many in every row", f"row {k} of {name} {why}")
        table.append(values)
    return np.array(table, float)
