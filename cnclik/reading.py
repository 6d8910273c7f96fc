"""Files that a user names: read whole, if they are files of a sensible size. Loads neither JAX nor NumPy."""

import os
import pathlib
import stat

from cnclik import errors

MOST_BYTES = 100 << 20  # of a robot, a spec or a table


def read_bytes(argument: str, path, what: str) -> bytes:
    """What a file holds.

    Args:
      argument: what the user calls it, and `what` it must name, such as "a URDF file".

    Raises: ArgumentError, one line, for what is not there, no regular file, too large, or can't be read.
    """
    name = os.fspath(path)
    shown = pathlib.Path(name).name[:80] or name[:80]
    try:
        about = os.stat(name)
        if stat.S_ISDIR(about.st_mode):
            raise errors.fail(argument, f"name {what}", f"{name[:80]!r} is a folder")
        if not stat.S_ISREG(about.st_mode):
            raise errors.fail(argument, f"name {what}", f"{shown!r} is a device, pipe or socket")
        if about.st_size > MOST_BYTES:
            raise errors.fail(argument, f"name {what} of at most {MOST_BYTES >> 20} MiB", f"{shown!r} is larger")
        with open(name, "rb") as file:
            return file.read(MOST_BYTES + 1)
    except errors.ArgumentError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL in it
        raise errors.fail(argument, f"name {what} that can be read", f"{shown}: {errors.reason(error)}") from None
