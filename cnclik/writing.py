"""Files of results: nothing half-written looks whole, what was computed is not lost where it can't be written, and
what others wrote stays.
"""

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
    ".json": rb'\A\{\s*("digest": "[^"]*",.*)?"cnclik": "\d+\.',
    ".nc": rb"\0cnclik\0|orientation_error.{,40}least_singular_value",
    ".csv": rb"position_error,orientation_error,least_singular_value,",
    ".npz": rb"least_singular_value\.npy",
    ".html": rb'<meta name="generator" content="cnclik">',
}
_PARTIAL = ".partial-"
_ROOM = 1 << 16  # bytes that a folder must have room for before anything is computed


def checked_file(name, file, *endings, overwrite=True) -> pathlib.Path:
    """The path of a file to write; raises ArgumentError unless it has one of the endings, in a folder that is there.

    Args: overwrite: whether it may be there, and not be cnclik's.
    """
    file = errors.path(name, file)
    errors.ending(name, file, *endings)
    size = len(file.name.encode(errors="replace"))
    if size > 250:
        raise errors.fail(name, "have a name of at most 250 bytes", f"has {size}")
    fits = False
    with contextlib.suppress(OSError, ValueError):
        fits = os.path.isdir(file.parent) and not os.path.isdir(file)
    if not fits:
        raise errors.fail(name, "name a file in a folder that is there", f"is {str(file)!r}")
    if is_input(file):
        raise errors.fail(name, "be another file than what is read", f"is {file.name[:60]!r}")
    if os.path.lexists(file) and not (overwrite or _is_own(file)):
        raise errors.fail(name, "be a new file, or one of cnclik's own", f"{file.name[:60]!r} is not ({_OVERWRITE})")
    return file


def checked_folder(name, path, *, overwrite=True, files=()) -> None:
    """Raise ArgumentError unless `path` is, or can become, a folder that takes files; nothing is left there."""
    with output_folder(path, name=name, overwrite=overwrite, files=files):
        pass


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
            _check_target(pathlib.Path(folder) / file, overwrite=False)
    except OSError as error:
        raise _refused(name, folder, errors.reason(error)) from None


def _check_target(target, *, overwrite) -> None:
    """Raise OSError where a file can't take this place."""
    if os.path.isdir(target):
        raise IsADirectoryError(errno.EISDIR, f"{target.name} is a folder there")
    if is_input(target):
        raise FileExistsError(errno.EEXIST, f"{target.name} there is what the command reads")
    if os.path.lexists(target) and not (overwrite or _is_own(target)):
        raise FileExistsError(errno.EEXIST, f"{target.name} there is not cnclik's own ({_OVERWRITE})")


def _refused(name, folder, reason):
    found = f"{str(folder)[-80:]!r} does not: {reason}"
    return errors.ArgumentError(f"Argument `{name}` must be a folder that takes all files, but {found}.")


def _is_own(path) -> bool:
    """Whether cnclik wrote a file, or a sweep's store: it says so, or is as its folder's list has it."""
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
    """A hidden folder to write into, whose files are moved to their place when all is well.

    Where the disk does not take a file (full, over quota, gone) all files go to a folder for temporary files instead,
    and the computation goes on; `finish` says so at the end.
    """

    def __init__(self, out: pathlib.Path, hidden: pathlib.Path, name: str, overwrite: bool, replaces=()):
        self.out, self.path, self.name, self.overwrite, self.problem = out, hidden, name, overwrite, None
        self.replaces = replaces
        self.told = False  # whether a message says where the files are

    def write(self, file: str, make) -> None:
        """Write a file by make(path). Raises: ArgumentError where no folder for temporary files takes it either."""
        try:
            _write(self.path / file, make)
        except Exception as error:
            with contextlib.suppress(OSError):
                (self.path / file).unlink()
            if not isinstance(error, OSError):
                raise
            self._elsewhere(error, lambda path: _write(path / file, make))

    def write_text(self, file: str, text: str) -> None:
        """Write a text. Raises: as `write`."""
        self.write(file, lambda path: path.write_text(text, encoding="utf-8"))

    def finish(self) -> None:
        """Move all files to their place. Raises: ArgumentError that tells where they are, if they are not there."""
        if not self.problem:
            made = {p: self.out / p.relative_to(self.path) for p in sorted(self.path.rglob("*")) if os.path.isfile(p)}
            try:
                for target in made.values():
                    target.parent.mkdir(parents=True, exist_ok=True)
                    _check_target(target, overwrite=self.overwrite)
                _list(made)
                for file, target in made.items():
                    os.replace(file, target)
                self._remove_earlier(made.values())
            except OSError as error:
                self._beside(error)
        if self.problem:
            self.told = True
            reason = f"{errors.reason(self.problem)}; the files are kept in {self.path}"
            raise _refused(self.name, self.out, reason) from self.problem

    def _remove_earlier(self, made):
        """Remove what an earlier run of the command left and this one did not make: it is of another result."""
        for target in (self.out / file for file in self.replaces):
            if target not in made and not is_input(target) and os.path.isfile(target) and _is_own(target):
                target.unlink()

    def _beside(self, problem):
        """Keep files that can't be moved where they are, no longer hidden."""
        seen = self.out / self.path.name.replace(_PARTIAL, "kept-")
        try:
            self.path.rename(seen)
        except OSError:
            self._elsewhere(problem)
        else:
            self.path, self.problem = seen, problem

    def _elsewhere(self, problem, write=lambda path: None):
        """Copy all files to the first folder for temporary files that has room, and write there from now on."""
        for place in _places():
            path = None
            try:
                path = pathlib.Path(tempfile.mkdtemp(prefix="cnclik-", dir=place))
                shutil.copytree(self.path, path, dirs_exist_ok=True)
                write(path)
            except OSError:
                if path is not None:
                    shutil.rmtree(path, ignore_errors=True)
            else:
                self.discard()  # of an earlier place, that is full too
                self.path, self.problem = path, self.problem or problem
                return
        self.told = self.problem is not None
        kept = f"; the files before it are kept in {self.path}" if self.told else ""
        reason = f"{errors.reason(problem)}, nor is there room anywhere else{kept}"
        raise _refused(self.name, self.out, reason) from problem

    def discard(self) -> None:
        """Remove files that went elsewhere, unless a message says where they are."""
        if self.problem and not self.told:
            shutil.rmtree(self.path, ignore_errors=True)


def _list(made) -> None:
    """Add to the lists of the folders that files are about to move into, {file: where to}. Raises OSError.

    Lines stay, so that an earlier file is known until the move, and others may write at once.
    """
    for file, target in made.items():
        if not _says_so(file):
            known, own = target.parent / LIST, _checksum(file)
            if own not in _ends(known):
                with open(known, "ab") as lines:
                    lines.write(own + b"  " + os.fsencode(target.name) + b"\n")


def _places():
    """Folders for temporary files."""
    for place in (tempfile.gettempdir, pathlib.Path.home):
        with contextlib.suppress(OSError, RuntimeError):  # no folder takes a byte; a user without a home
            yield place()
    yield "/dev/shm"


def _write(path, make):
    path.parent.mkdir(parents=True, exist_ok=True)
    make(path)
    with open(path, "rb+") as file:  # Windows syncs no file that is open to be read only
        os.fsync(file.fileno())  # some disks tell only now that they are full


@contextlib.contextmanager
def output_folder(path, *, name="out", overwrite=True, files=(), replaces=()):
    """A `Folder` whose files are moved into `path` when the block ends well.

    `path` is created if need be, and found unwritable before any work is done. On an error or an interrupt
    all that was written is removed and what `path` held before is untouched.

    Args:
      path: where the results shall be.
      name: what the user calls it, for the message.
      overwrite: whether it may hold files, and none of cnclik's, and whether these are written over. What the command
        reads is not.
      files: names of what is going to be written there, now or later: one in the way is refused at once.
      replaces: names that the same command may have written before: those of cnclik's own that it doesn't write this
        time are removed at the end, so that the folder holds one result.

    Yields: the `Folder`, with `write(file, make)`.
    Raises: ArgumentError if `path` is not, and cannot become, a folder that can be written into, or is one of others;
      and at the end where it did not take all, naming the folder that the files are kept in.
    """
    path = errors.path(name, path)
    if not overwrite:
        check_own(name, path)
        check_free(name, path, files)
    with contextlib.ExitStack() as stack:
        try:
            created = [p for p in (path, *path.parents) if not os.path.exists(p)]
            stack.callback(_remove_empty, created)
            path.mkdir(parents=True, exist_ok=True)
            hidden = stack.enter_context(hidden_folder(path))
            _write(hidden / "room", lambda file: file.write_bytes(bytes(_ROOM)))
            (hidden / "room").unlink()
        except (OSError, ValueError) as error:  # ValueError: a name with a NUL in it
            found = f"is {str(path)[-80:]!r} ({errors.reason(error)})"
            raise errors.fail(name, "be a folder that can be written into", found) from None
        folder = Folder(path, hidden, name, overwrite, replaces)
        stack.callback(folder.discard)
        yield folder
        folder.finish()


def _remove_empty(folders):
    for folder in folders:  # deepest first; what holds something stays
        with contextlib.suppress(OSError):
            folder.rmdir()


# --- hidden folders -----------------------------------------------------------------------------------


@contextlib.contextmanager
def hidden_folder(path: pathlib.Path):
    """A new hidden folder inside `path`, to make something in that is moved out when it is whole; removed at the end.

    It is locked for as long as this process lives, and those that killed processes have left are removed first.
    """
    for left in path.glob(f"{_PARTIAL}*"):
        with contextlib.suppress(OSError, ImportError):
            if abandoned(left):  # else perhaps just made, and about to be locked
                opened = _lock(left)
                shutil.rmtree(left, ignore_errors=True)
                os.close(opened)
    hidden = pathlib.Path(tempfile.mkdtemp(prefix=_PARTIAL, dir=path))
    opened = None
    try:
        with contextlib.suppress(OSError, ImportError):
            opened = _lock(hidden)
        yield hidden
    finally:
        shutil.rmtree(hidden, ignore_errors=True)
        if opened is not None:
            os.close(opened)


def abandoned(path: pathlib.Path) -> bool:
    """Whether nobody has written there for a minute: else perhaps another process is at it. Raises OSError."""
    return abs(time.time() - path.stat().st_mtime) > 60


def _lock(folder):
    """A descriptor that holds the folder's lock. Raises OSError where another process has it or there are no locks."""
    import fcntl

    opened = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(opened)
        raise
    return opened
