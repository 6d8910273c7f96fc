"""Files of results: each is whole or not there, and what others wrote stays."""

import contextlib
import errno
import hashlib
import os
import pathlib
import re
import shutil
import tempfile
import time

from cnclik import errors
from cnclik.reading import is_input

OWN = ".cnclik"  # a file in each store of a sweep
LIST = ".cnclik-files"  # in a folder of results: checksums and names of files that do not say who wrote them
_SIGNS = {  # what files of each kind have in them that say so: others are known by the list
    ".png": rb"Software\0cnclik",
    ".json": rb'\A\{\s*"cnclik": "\d+\.',
    ".nc": rb"\0cnclik\0|orientation_error.{,40}least_singular_value",
    ".csv": rb"position_error,orientation_error,least_singular_value,",
    ".npz": rb"least_singular_value\.npy",
}
_PARTIAL = ".partial-"
_ROOM = 1 << 16  # bytes that a folder must have room for before anything is computed
_begun = []  # hidden folders that this process writes into, and new ones that may yet hold nothing


def checked_file(name, file, *endings, overwrite=True) -> pathlib.Path:
    """The path of a file to write; raises ArgumentError unless it has one of the endings, in a folder that is there.

    Args: overwrite: whether it may be there, and not be cnclik's.
    """
    file = errors.path(name, file)
    errors.ending(name, file, *endings)
    size = len(file.name.encode(errors="replace"))
    if size > 250:
        raise errors.fail(name, "have a name of at most 250 bytes", f"has {size}")
    if os.path.isdir(file) or not os.path.isdir(file.parent):
        raise errors.fail(name, "name a file in a folder that is there", f"is {str(file)!r}")
    if is_input(file):
        raise errors.fail(name, "be another file than what is read", f"is {file.name[:60]!r}")
    if os.path.lexists(file) and not (overwrite or _is_own(file)):
        raise errors.fail(name, "be a new file, or one of cnclik's own", f"{file.name[:60]!r} is not ({_OVERWRITE})")
    return file


_OVERWRITE = "--overwrite writes there all the same"


def check_own(name, folder, of="cnclik's own") -> None:
    """Raise ArgumentError for a folder with files, none of which cnclik wrote, apart from what the command reads.

    Args: of: what it may be, in words.
    """
    there = []
    with contextlib.suppress(OSError):
        seen = sorted(file for file in pathlib.Path(folder).iterdir() if not file.name.startswith("."))
        there = [file for file in seen if not is_input(file)]
    if there and not any(map(_is_own, there)):
        found = f"{there[0].name[:30]} in {str(folder)[-40:]!r} is not ({_OVERWRITE})"
        raise errors.fail(name, f"be a new folder, or one of {of}", found)


def check_free(name, folder, files) -> None:
    """Raise ArgumentError where one of some files, by their names, can't be written into a folder: said before work."""
    try:
        for file in files:
            check_target(pathlib.Path(folder) / file, overwrite=False)
    except OSError as error:
        raise _refused(name, folder, errors.reason(error)) from None


def check_target(target, *, overwrite) -> None:
    """Raise OSError where a file can't take this place."""
    if os.path.isdir(target):
        raise IsADirectoryError(errno.EISDIR, f"{target.name} is a folder there")
    if is_input(target):
        raise FileExistsError(errno.EEXIST, f"{target.name} there is what the command reads")
    if os.path.lexists(target) and not (overwrite or _is_own(target)):
        raise FileExistsError(errno.EEXIST, f"{target.name} there is not cnclik's own ({_OVERWRITE})")


class Refused(errors.ArgumentError):
    """A folder does not take a file."""


def _refused(name, folder, reason):
    found = f"{str(folder)[-80:]!r} does not: {reason}"
    return Refused(f"Argument `{name}` must be a folder that takes all files, but {found}.")


def _is_own(path) -> bool:
    """Whether cnclik wrote a file, or a sweep's store: the file states it, or its folder's list has its checksum."""
    if os.path.isdir(path):
        return os.path.isfile(path / OWN)
    with contextlib.suppress(OSError):
        return os.path.isfile(path) and (_says_so(path) or _checksum(path) in _ends(path.parent / LIST))
    return False


def _says_so(path) -> bool:
    """Whether a file has the sign of its kind. Raises OSError."""
    sign = _SIGNS.get(path.suffix.lower())
    return sign is not None and re.search(sign, _ends(path), re.DOTALL) is not None


def _ends(path, most=1 << 20) -> bytes:
    """The first and the last MiB of a file, nothing where there is none. Raises OSError."""
    if not os.path.isfile(path):
        return b""
    with open(path, "rb") as file:
        text = file.read(most)
        file.seek(max(os.path.getsize(path) - most, 0))
        return text + file.read(most)


def _checksum(path) -> bytes:
    """Of a file, as `sha256sum` has it. Raises OSError."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest().encode()


class Folder:
    """A folder that takes files one by one: each is written into a hidden folder beside its place, and moved there."""

    def __init__(self, path: pathlib.Path, name: str, overwrite: bool):
        self.path, self.name, self.overwrite, self.made = path, name, overwrite, []

    def write(self, file: str, make) -> None:
        """Write a file by make(path). Raises: Refused where the folder doesn't take it; files before it are there."""
        target = self.path / file
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            with hidden_folder(target.parent) as hidden:
                partial = hidden / target.name
                make(partial)
                with open(partial, "rb+") as whole:  # Windows syncs no file that is open to be read only
                    os.fsync(whole.fileno())  # some disks tell only now that they are full
                check_target(target, overwrite=self.overwrite)
                _list(partial, target)
                os.replace(partial, target)
        except OSError as error:
            reason = f"{errors.reason(error)} ({file}; files before it are kept)"
            raise _refused(self.name, self.path, reason) from error
        self.made.append(file)

    def write_text(self, file: str, text: str) -> None:
        """Write a text. Raises: as `write`."""
        self.write(file, lambda path: path.write_text(text, encoding="utf-8"))


def _list(file, target) -> None:
    """Add a file that doesn't say who wrote it to the list of the folder that it is about to move into."""
    if not _says_so(file):
        known, own = target.parent / LIST, _checksum(file)
        if own not in _ends(known):
            with open(known, "ab") as lines:  # an earlier file is known until the move, and others may write at once
                lines.write(own + b"  " + os.fsencode(target.name) + b"\n")


@contextlib.contextmanager
def output_folder(path, *, name="out", overwrite=True, files=(), replaces=()):
    """A `Folder` that writes into `path`, which is created if need be, and found unwritable before any work is done.

    Args:
      path: where the results shall be.
      name: what the user calls it, for the message.
      overwrite: whether it may hold files, and none of cnclik's, and whether these are written over. What the command
        reads is not.
      files: names of what is going to be written there, now or later: one in the way is refused at once.
      replaces: names that the same command may have written before: those of cnclik's own that it doesn't write this
        time are removed when the block ends well, so that the folder holds one result.

    Yields: the `Folder`, with `write(file, make)`.
    Raises: ArgumentError if `path` is not, and cannot become, a folder that can be written into, or is one of others.
    """
    path = errors.path(name, path)
    if not overwrite:
        check_own(name, path)
        check_free(name, path, files)
    created = [p for p in (*reversed(path.parents), path) if not os.path.exists(p)]
    _begun.extend(created)
    try:
        try:
            path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=path) as room:
                room.write(bytes(_ROOM))
            remove_abandoned(path.glob(f"{_PARTIAL}*"))
        except (OSError, ValueError) as error:  # ValueError: a name with a NUL in it
            found = f"is {str(path)[-80:]!r} ({errors.reason(error)})"
            raise errors.fail(name, "be a folder that can be written into", found) from None
        folder = Folder(path, name, overwrite)
        yield folder
        for target in (path / file for file in replaces if file not in folder.made):
            if not is_input(target) and os.path.isfile(target) and _is_own(target):
                target.unlink()  # of an earlier result
    finally:
        for new in reversed(created):
            _begun.remove(new)
            _remove(new)


@contextlib.contextmanager
def hidden_folder(path: pathlib.Path):
    """A new hidden folder inside `path`, to make in what is moved out when it is whole; removed at the end."""
    hidden = pathlib.Path(tempfile.mkdtemp(prefix=_PARTIAL, dir=path))
    _begun.append(hidden)
    try:
        yield hidden
    finally:
        _begun.remove(hidden)
        _remove(hidden)


def remove_begun() -> None:
    """Remove what this process has begun to write: before a signal ends it at once."""
    for path in reversed(_begun):
        _remove(path)


def remove_abandoned(paths) -> None:
    """Remove files, or hidden folders, that nobody has written into for an hour: else another process may be at it."""
    for path in paths:
        with contextlib.suppress(OSError):
            if abs(time.time() - path.stat().st_mtime) > 3600:
                path.unlink() if os.path.isfile(path) else _remove(path)


def _remove(folder) -> None:
    """Remove a hidden folder with all that is in it, and another one where it is empty."""
    if folder.name.startswith(_PARTIAL):
        shutil.rmtree(folder, ignore_errors=True)
    with contextlib.suppress(OSError):
        folder.rmdir()
