"""Writing results so that nothing half-written looks whole."""

import contextlib
import os
import shutil
import tempfile
from pathlib import Path

from cnclik import errors

_PARTIAL = ".partial-"


@contextlib.contextmanager
def output_folder(path, *, name="out"):
    """A hidden folder inside `path` to write into; its files are moved into `path` when the block ends well.

    `path` is created if need be, and found unwritable before any work is done. On an error or an interrupt
    the hidden folder is removed and what `path` held before is untouched.

    Args:
      path: where the results shall be.
      name: what the user calls it, for the message.

    Yields: the folder (a `Path`) to write into.
    Raises: ArgumentError if `path` is not, and cannot become, a folder that can be written into.
    """
    path = Path(path)
    created = [p for p in (path, *path.parents) if not p.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=_PARTIAL, dir=path))
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise errors.fail(name, "be a folder that can be written into", f"is {str(path)!r} ({reason})") from None
    try:
        yield partial
        for file in sorted(p for p in partial.rglob("*") if p.is_file()):
            target = path / file.relative_to(partial)
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(file, target)
        created = []
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        for folder in created:  # deepest first; only what is still empty goes
            with contextlib.suppress(OSError):
                folder.rmdir()
