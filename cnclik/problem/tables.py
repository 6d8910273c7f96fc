"""Files of numbers that a user brings: a CSV table, and targets in any of the forms they come in."""

import csv
import io
import pathlib

import numpy as np

from cnclik import errors, reading
from cnclik.reading import read_bytes


def read_csv(argument: str, file) -> np.ndarray:
    """The numbers (rows, columns) of a CSV file; a header and # comments are skipped.

    Raises: ArgumentError, naming the argument, for a file that can't be read, or rows that don't fit.
    """
    return read_columns(argument, file)[1]


def read_columns(argument: str, file, *, gaps=False) -> tuple:
    """Names of the columns, "1", "2", … where there is no header, and the numbers (rows, columns) of a CSV file.

    Args: gaps: whether cells may be empty; they are NaN.
    Raises: as `read_csv`.
    """
    path = pathlib.Path(file)
    try:
        text = read_bytes(argument, path, "a CSV file").decode("utf-8-sig")
        rows = list(csv.reader(line for line in text.splitlines() if line.strip() and not line.startswith("#")))
    except (UnicodeDecodeError, csv.Error) as error:
        reason = "is no text" if isinstance(error, UnicodeDecodeError) else error
        raise errors.fail(argument, "name a CSV file that can be read", f"{path.name}: {reason}") from None
    names = ()
    if rows and not any(map(_is_number, rows[0])):  # a header; a first row with a slip in it is none
        names, rows = tuple(name.strip() for name in rows[0]), rows[1:]
    if gaps:
        rows = [[cell if cell.strip() else "nan" for cell in row] for row in rows]
    for k, row in enumerate(rows):
        if len(row) != len(rows[0]) or not all(_is_number(x) for x in row):
            raise errors.fail(argument, "hold numbers, as many in every row", f"row {k + 1} of {path.name} does not")
    table = np.array(rows, float)
    width = table.shape[-1] if rows else len(names)
    return (names if len(names) == width else tuple(str(i + 1) for i in range(width))), table


def _is_number(text):
    try:
        float(text)
    except ValueError:
        return False
    return True


def read_targets(file, task) -> np.ndarray:
    """Targets of a file, as `cnclik.reach` takes them.

    A CSV file has a target per row: position [m] and, for a pose, a quaternion w x y z, or the 16 numbers of a 4×4
    transform row by row; a .npy file an array of such rows or of transforms; a .npz file has it under `targets`.
    """
    path = pathlib.Path(file)
    ending = errors.ending("TARGETS", path, ".csv", ".npy", ".npz")
    if ending == ".csv":
        found = read_csv("TARGETS", path)
    else:
        data = io.BytesIO(read_bytes("TARGETS", path, "a file of targets"))
        try:
            found = np.load(data, allow_pickle=False)
            if ending == ".npz":
                most = 8 * reading.MOST_BYTES
                if found.zip.getinfo("targets.npy").file_size > most:  # a few packed bytes may say so
                    words = f"name a file of at most {most >> 20} MiB when it is unpacked"
                    raise errors.fail("TARGETS", words, f"{path.name} is larger")
                found = found["targets"]
        except errors.ArgumentError:
            raise
        except Exception as error:  # whatever NumPy, zipfile and zlib make of damage
            lacking = isinstance(error, (KeyError, AttributeError))  # AttributeError: one array, under no name
            reason = getattr(error, "strerror", None) or ("holds no array `targets`" if lacking else "is damaged")
            raise errors.fail("TARGETS", "name a file that can be read", f"{path.name}: {reason}") from None
    if found.size == 0:
        raise errors.fail("TARGETS", "hold at least one target", f"{path.name} holds none")
    if found.ndim == 2 and found.shape[1] == 16:
        return found.reshape(-1, 4, 4)
    if found.ndim == 2 and found.shape[1] == 7 and not (task.position and task.orientation):
        return found[:, :3] if task.position else found[:, 3:]
    return found
