"""Files that a user names: read whole, if they are of a sensible size. Loads neither JAX nor NumPy."""

import os
import pathlib
import tomllib

from cnclik import errors

MOST_BYTES = 100 << 20  # of a robot, a spec or a table


def read_bytes(argument: str, path, what: str) -> bytes:
    """What a file holds.

    Args: argument: what the user calls it, and `what` it must name, such as "a URDF file".
    Raises: ArgumentError, one line, for what is not there, too large, or can't be read.
    """
    name = os.fsdecode(errors.kind(argument, path, (str, bytes, os.PathLike), f"name {what}"))
    shown = pathlib.Path(name).name[:80] or name[:80]
    try:
        with open(name, "rb") as file:
            text = file.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL in it
        raise errors.fail(argument, f"name {what} that can be read", f"{shown}: {errors.reason(error)}") from None
    if len(text) > MOST_BYTES:
        raise errors.fail(argument, f"name {what} of at most {MOST_BYTES >> 20} MiB", f"{shown!r} is larger")
    return text


def read_toml(argument: str, path) -> dict:
    """What a TOML file holds. Raises: as `read_bytes`, and for what is no TOML."""
    text = read_bytes(argument, path, "a TOML file")
    try:
        return tomllib.loads(text.decode())
    except (ValueError, RecursionError) as error:  # no TOML, no UTF-8, an integer of thousands of digits, or too deep
        raise errors.fail(argument, "be a TOML file", f"{os.fspath(path)!r} is not: {error}") from None
