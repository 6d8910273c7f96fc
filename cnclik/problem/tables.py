"""Tables: CSV files of numbers, as logs, waypoints and targets."""

import csv
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
    path, rows = pathlib.Path(file), read_rows(argument, file)
    numbers = [quantities.number(cell) for cell in rows[-1][0].split()] if rows else []
    if rows and (";" in rows[0][0] or (len(numbers) > 1 and None not in numbers)):
        raise errors.fail(argument, "have columns that are separated by commas", f"{path.name} holds {rows[0][0]!r}")
    if not rows:
        return (), np.zeros((0, 0))
    head = all(quantities.number(cell) is None for cell in rows[0])
    names = tuple(name.strip() for name in rows.pop(0)) if head else tuple(str(i + 1) for i in range(len(rows[0])))
    for k, row in enumerate(rows, 1):
        if len(row) != len(names):
            must = "hold numbers, as many in every row"
            raise errors.fail(argument, must, f"row {k} of {path.name} has {len(row)} of {len(names)}")
    columns = [[quantities.number(cell) for cell in column] for column in zip(*rows, strict=True)]
    meant = [any(value is not None for value in column) for column in columns]
    for k, row in enumerate(rows):
        for j, cell in enumerate(row):
            if columns[j][k] is None and meant[j] and cell.strip():
                found = f"row {k + 1} of {path.name} holds {cell!r}{quantities.hint(cell)}"
                raise errors.fail(argument, "hold numbers, as many in every row", found)
    return names, np.array(columns, float).T.reshape(-1, len(names))  # None becomes NaN


def read_rows(argument: str, file) -> list:
    """The texts of the rows of a CSV file, without empty lines and # comments. Raises: as `read_columns`."""
    path = pathlib.Path(file)
    try:
        text = read_bytes(argument, path, "a CSV file").decode("utf-8-sig")
        return list(csv.reader(line for line in text.splitlines() if line.strip() and not line.startswith("#")))
    except (UnicodeDecodeError, csv.Error) as error:
        reason = "is no text in UTF-8" if isinstance(error, UnicodeDecodeError) else error
        raise errors.fail(argument, "name a CSV file that can be read", f"{path.name}: {reason}") from None


def read_points(argument: str, file, task, *, timed=False) -> tuple:
    """(times [s] (k,) or None, points (k, d)) of a CSV file: positions [m], quaternions w x y z, or both, for a task.

    The columns have the names time, x, y, z, qw, qx, qy, qz, or without a header this order.

    Args: timed: whether there must be times.
    Raises: as `read_columns`, and for missing columns.
    """
    names, table = read_columns(argument, file)
    file, stamp = pathlib.Path(file).name, ("time",) * timed
    if names[:1] == ("1",):
        places = dict.fromkeys((task.position, POSITION)) if task.position else [()]
        turns = ((), QUATERNION) if task.orientation else ((),)
        orders = [(*stamp, *place, *turn) for place in places for turn in turns if place or turn]
        names = next((order for order in orders if len(order) == len(names)), names)
        if names not in orders:
            must = f"have columns {' '.join(orders[-1])}, in this order or by name"
            raise errors.fail(argument, must, f"{file} has {len(names)}")
    columns = dict(zip(names, table.T, strict=True))
    if len(columns) < len(names):
        raise errors.fail(argument, "name each column once", f"{file} has {' '.join(names)}")
    axes = () if not task.position else POSITION if set(POSITION) <= set(columns) else task.position
    turned = task.orientation and (not task.position or set(QUATERNION) & set(columns))
    needed = (*stamp, *axes, *QUATERNION * bool(turned))
    if not set(needed) <= set(columns):
        must = f"have columns {' '.join(needed)}" + ", or a --speed" * (timed and "time" not in columns)
        raise errors.fail(argument, must, f"{file} has {' '.join(columns) or 'none'}")
    return columns.get("time"), np.stack([columns[column] for column in needed[len(stamp) :]], 1)
