"""Files of numbers that a user brings: a CSV table, and targets in any of the forms they come in."""

import csv
import io
import itertools
import pathlib
import re

import numpy as np

from cnclik import errors, quantities, reading
from cnclik.problem.columns import POSITION, QUATERNION, TRANSFORM, meanings, of_tip
from cnclik.reading import read_bytes


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


def read_poses(argument: str, file, by_place, tip=()) -> tuple:
    """({what: column (rows,)}, numbers (rows, columns)) of a table of poses; see `columns.meanings`.

    Without a header the columns are taken by their place, and a remark states that.

    Args:
      by_place: function from a number of columns to what they are, or None for a number that fits nothing.
      tip: names of the tip. If columns begin with one of them, such as left_hand.x, the others are ignored.
    Raises: as `read_columns`, and for unknown or repeated names.
    """
    names, rows = _cells(argument, file)
    if own := of_tip(names, tip):
        names, rows = tuple(own.values()), [[row[i] for i in own if i < len(row)] for row in rows]
    found = meanings(argument, pathlib.Path(file).name, names) if names else None
    table = _numbers(argument, file, rows)
    if found is None:
        order = by_place(table.shape[-1]) if rows else None
        if order is None:
            return {}, table
        errors.remark(f"{pathlib.Path(file).name} has no header; its columns were read as {' '.join(order)}.")
        found = [(what, 1.0) for what in order]
    elif rows and len(names) != table.shape[1]:
        shown = f"{pathlib.Path(file).name} has {len(names)} names and {table.shape[1]} columns"
        raise errors.fail(argument, "name every column", shown)
    table = table.reshape(len(rows), len(found))
    return {what: factor * table[:, i] for i, (what, factor) in enumerate(found)}, table


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
    if rows and not any(quantities.number(cell) is not None for cell in rows[0]) and not _is_slip(rows):
        return tuple(name.strip() for name in rows[0]), rows[1:]
    if rows and above and len(above[-1]) == len(rows[0]) > 1 and all(map(_is_name, above[-1])):
        return tuple(name.strip() for name in above[-1]), rows  # as NumPy's savetxt writes a header
    return (), rows


_NAME = re.compile(r"\s*[\w./-]+\s*([\[(][^\])]*[\])])?\s*")  # of a column: a word, perhaps with a unit


def _is_name(cell) -> bool:
    return _NAME.fullmatch(cell) is not None and quantities.number(cell) is None


def _is_slip(rows) -> bool:
    """Whether a first row without numbers was meant to have some, in other digits or with another separator."""
    return any(quantities.hint(cell) or ";" in cell for cell in rows[0])


def _is_meant(cell) -> bool:
    return bool(cell.strip()) and (quantities.number(cell) is not None or bool(quantities.hint(cell)))


def _numbers(argument, file, rows):
    table = []
    for k, row in enumerate(rows):
        values = [quantities.number(cell) for cell in row]
        if len(row) != len(rows[0]) or None in values:
            wrong = next((cell for cell, value in zip(row, values, strict=True) if value is None), None)
            why = f"has {len(row)} of {len(rows[0])}" if wrong is None else f"holds {wrong!r}{quantities.hint(wrong)}"
            why += ", and columns are separated by commas" if wrong is not None and ";" in wrong else ""
            found = f"row {k + 1} of {pathlib.Path(file).name} {why}"
            raise errors.fail(argument, "hold numbers, as many in every row", found)
        table.append(values)
    return np.array(table, float)


def read_targets(file, task, number=None, tip=()) -> np.ndarray:
    """Targets of a file for the task of one tip, as `cnclik.reach` takes them.

    A CSV file has a target per row, with columns by name (`cnclik.problem.columns`). Without a header the columns are
    the position [m] and, for a pose, a quaternion w x y z, or the 16 numbers of a 4×4 transform row by row. A .npy file
    has an array of such rows or of transforms, a .npz file has it under `targets`. For several tips the columns of a
    CSV file begin with a tip's name, such as left_hand.x; other files have transforms (targets, tips, 4, 4).

    Args: number, tip: the index of the tip, if there are several, and the names that it may have.
    """
    path = pathlib.Path(file)
    ending = errors.ending("TARGETS", path, ".csv", ".npy", ".npz")
    if ending == ".csv":
        found = _targets("TARGETS", path, task, tip)
    else:
        data = io.BytesIO(read_bytes("TARGETS", path, "a file of targets"))
        try:
            found = np.load(data, allow_pickle=False)
            if ending == ".npz":
                most = 8 * reading.MOST_BYTES
                if found.zip.getinfo("targets.npy").file_size > most:  # a few compressed bytes may expand to that
                    words = f"name a file of at most {most >> 20} MiB when it is unpacked"
                    raise errors.fail("TARGETS", words, f"{path.name} is larger")
                found = found["targets"]
        except errors.ArgumentError:
            raise
        except Exception as error:  # damaged files raise errors of many kinds in NumPy, zipfile and zlib
            lacking = isinstance(error, (KeyError, AttributeError))  # AttributeError: one array without a name
            reason = getattr(error, "strerror", None) or ("holds no array `targets`" if lacking else "is damaged")
            raise errors.fail("TARGETS", "name a file that can be read", f"{path.name}: {reason}") from None
        if number is not None:
            if found.ndim != 4 or number >= found.shape[1]:
                must = "hold transforms (targets, tips, 4, 4)"
                raise errors.fail("TARGETS", must, f"{path.name} holds {found.shape}")
            found = found[:, number]
    if found.size == 0:
        raise errors.fail("TARGETS", "hold at least one target", f"{path.name} holds none")
    if found.ndim == 2 and found.shape[1] == 16:
        return found.reshape(-1, 4, 4)
    return found


def _targets(argument, path, task, tip):
    """Rows of a CSV file as targets: positions, quaternions, both, or transforms."""
    sizes = {3: POSITION, 4: QUATERNION, 7: POSITION + QUATERNION, 16: TRANSFORM}
    if tip and not of_tip(_cells(argument, path)[0], tip):
        must = f"have columns for each tip, such as {tip[0]}.x"
        raise errors.fail(argument, must, f"{path.name} has none that begins so")
    columns, table = read_poses(argument, path, sizes.get, tip)
    if not columns:
        return table
    if TRANSFORM[0] in columns:
        return np.stack([columns[name] for name in TRANSFORM], 1)
    lacking = [axis for axis in task.position if axis not in columns]
    if lacking or (task.orientation and not task.position and "qw" not in columns):
        names = " ".join(lacking or QUATERNION)
        raise errors.fail(argument, f"have columns {names} for this task", f"{path.name} has {' '.join(columns)}")
    none = np.zeros(len(table))  # for coordinates that the task does not have
    parts = [columns.get(axis, none) for axis in POSITION] if task.position else []
    if task.orientation and "qw" in columns:
        parts += [columns[name] for name in QUATERNION]
    return np.stack(parts, 1)
