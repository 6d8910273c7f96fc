"""Files that a user names: read whole, if they are files of a sensible size. Loads neither JAX nor NumPy."""

import os
import pathlib
import re
import stat
import tomllib

from cnclik import errors

MOST_BYTES = 100 << 20  # of a robot, a spec or a table


def read_bytes(argument: str, path, what: str, *, most: int | None = None) -> bytes:
    """What a file holds.

    Args:
      argument: what the user calls it, and `what` it must name, such as "a URDF file".
      most: bytes that it may have, whole MiB; 100 MiB by default.

    Raises: ArgumentError, one line, for what is not there, no regular file, too large, or can't be read.
    """
    if not isinstance(path, (str, bytes, os.PathLike)):
        raise errors.fail(argument, f"name {what}", f"is {path!r}")
    name, most = os.fsdecode(path), most or MOST_BYTES
    shown, text = pathlib.Path(name).name[:80] or name[:80], b""
    try:
        mode = os.stat(name).st_mode
        if stat.S_ISREG(mode):
            with open(name, "rb") as file:
                text = file.read(most + 1)
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL in it
        raise errors.fail(argument, f"name {what} that can be read", f"{shown}: {errors.reason(error)}") from None
    if stat.S_ISDIR(mode):
        raise errors.fail(argument, f"name {what}", f"{name[:80]!r} is a folder")
    if not stat.S_ISREG(mode):
        raise errors.fail(argument, f"name {what}", f"{shown!r} is a device, pipe or socket")
    if len(text) > most:
        raise errors.fail(argument, f"name {what} of at most {most >> 20} MiB", f"{shown!r} is larger")
    return text


def read_toml(argument: str, path) -> dict:
    """What a TOML file holds. Raises: as `read_bytes`, and for what is no TOML or is nested too deeply to be read."""
    text = read_bytes(argument, path, "a TOML file", most=1 << 20)
    try:
        return toml(text.decode())
    except (ValueError, RecursionError) as error:  # no TOML, no UTF-8, or an integer of thousands of digits
        why = "it is nested too deeply to be read" if isinstance(error, RecursionError) else error
        raise errors.fail(argument, "be a TOML file", f"{os.fspath(path)!r} is not: {why}") from None


def toml(text: str) -> dict:
    """What a TOML text holds. Raises: ValueError where it holds nothing, or would take the reader minutes."""
    if _LONG_KEY.search(text):  # the reader's time grows with the square of a key's parts
        raise ValueError("a key has too many parts")
    return tomllib.loads(text)


_LONG_KEY = re.compile(r"""(\.\s*[\w"'-][^.,\n\[\]]*){64}""")
