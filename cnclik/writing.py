"""Files of results: each is whole or not there, and a file that cnclik did not write stays."""

import contextlib
import os
import pathlib
import shutil
import tempfile
import time

from cnclik import errors

LIST = ".cnclik-files"  # in a folder of results: when cnclik wrote each file there, its size and name
_PARTIAL = ".partial-"
_begun: list[pathlib.Path] = []  # hidden folders that this process writes into


class Refused(errors.ArgumentError):
    """A folder does not take a file."""


def is_own(path: pathlib.Path) -> bool:
    """Whether cnclik wrote a file that nobody has changed since."""
    with contextlib.suppress(OSError):
        return _line(path, path.name) in (path.parent / LIST).read_bytes().splitlines()
    return False


def _line(path: pathlib.Path, name: str) -> bytes:
    """The line of the list for a file that is going to have this name: its time and size; a link has its own."""
    state = os.lstat(path)
    return b"%d %d %s" % (state.st_mtime_ns, state.st_size, os.fsencode(name))


def check_free(name: str, folder, files, *, overwrite=False) -> None:
    """Raise Refused where one of some files can't be written into a folder: before the work, and again after it."""
    for file in files:
        target, there = pathlib.Path(folder, file), "there is not cnclik's own (--overwrite writes over it)"
        if os.path.isdir(target):
            there = "is a folder there"
        elif overwrite or not os.path.lexists(target) or is_own(target):
            continue
        raise Refused(f"Argument `{name}` must be a folder that takes all files, but {file} {there}.")


class Folder:
    """A folder that takes files one by one: each is written into a hidden folder beside its place, and moved there."""

    def __init__(self, path: pathlib.Path, name: str, overwrite: bool):
        self.path, self.name, self.overwrite = path, name, overwrite

    def write(self, file: str, make) -> None:
        """Write a file by make(path). Raises: Refused where the folder doesn't take it; files before it are there."""
        target = self.path / file
        check_free(self.name, self.path, [file], overwrite=self.overwrite)
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            with hidden_folder(target.parent) as hidden:
                partial = hidden / target.name
                make(partial)
                with open(partial, "rb+") as whole:  # Windows syncs no file that is open to be read only
                    os.fsync(whole.fileno())  # some disks tell only now that they are full
                with open(target.parent / LIST, "ab") as names:  # others may write at once
                    names.write(_line(partial, target.name) + b"\n")
                os.replace(partial, target)
        except OSError as error:
            found = f"{str(self.path)[-80:]!r} does not: {errors.reason(error)} ({file}; files before it are kept)"
            raise Refused(f"Argument `{self.name}` must be a folder that takes all files, but {found}.") from error

    def write_text(self, file: str, text: str) -> None:
        """Write a text. Raises: as `write`."""
        self.write(file, lambda path: path.write_text(text, encoding="utf-8"))


@contextlib.contextmanager
def output_folder(path, *, name="out", overwrite=True, files=()):
    """A `Folder` that writes into `path`, which is created if need be, and found unwritable before any work is done.

    Args:
      path: where the results shall be. name: what the user calls it, for the message.
      overwrite: whether files that cnclik did not write may be written over.
      files: names of what is going to be written there, now or later: one in the way is refused at once.

    Raises: ArgumentError if `path` is not, and cannot become, a folder that can be written into.
    """
    path = errors.path(name, path)
    check_free(name, path, files, overwrite=overwrite)
    new = not os.path.exists(path)
    try:
        try:
            path.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=path).close()
            for left in path.glob(f"{_PARTIAL}*"):
                with contextlib.suppress(FileNotFoundError):  # another process may be at it
                    if time.time() - left.stat().st_mtime > 3600:
                        shutil.rmtree(left, ignore_errors=True)
        except (OSError, ValueError) as error:  # ValueError: a name with a NUL in it
            found = f"is {str(path)[-80:]!r} ({errors.reason(error)})"
            raise errors.fail(name, "be a folder that can be written into", found) from None
        yield Folder(path, name, overwrite)
    finally:
        if new:
            with contextlib.suppress(OSError, ValueError):  # it holds something, or never was
                path.rmdir()


@contextlib.contextmanager
def hidden_folder(path: pathlib.Path):
    """A new hidden folder inside `path`, to make in what is moved out when it is whole; removed at the end."""
    hidden = pathlib.Path(tempfile.mkdtemp(prefix=_PARTIAL, dir=path))
    _begun.append(hidden)
    try:
        yield hidden
    finally:
        _begun.remove(hidden)
        shutil.rmtree(hidden, ignore_errors=True)


def remove_begun() -> None:
    """Remove what this process has begun to write: before a signal ends it at once."""
    for hidden in _begun:
        shutil.rmtree(hidden, ignore_errors=True)
