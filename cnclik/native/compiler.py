"""Compiler: the system's own, where it has one."""

import _ctypes
import ctypes
import hashlib
import os
import pathlib
import platform
import shutil
import signal
import subprocess
import tempfile
import weakref

from cnclik import errors

FLAGS = ("-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math", "-fPIC", "-shared")
UNSAFE = (
    "-Ofast",
    "-ffast-math",
    "-funsafe-math",
    "-ffinite-math",
    "-fassociative-math",
    "-freciprocal-math",
    "-ffp-model",
)
LIMIT = 300.0  # [s] that a compiler may take; the largest exports take half a minute
LONG = 20_000  # lines from which on a compiler is told to take less care: its time grows faster than they do


def _command() -> str | None:
    return next((name for name in (os.environ.get("CC"), "cc", "gcc", "clang") if name and shutil.which(name)), None)


def can_build() -> bool:
    """Whether there is a C compiler whose libraries can be opened."""
    return _command() is not None and hasattr(_ctypes, "dlclose")  # not on Windows


def command() -> str:
    """The C compiler: that of the environment's CC, else cc, gcc or clang. ArgumentError where there is none."""
    if found := _command():
        return found
    raise errors.fail("compiler", "be there to build the C code (cc, gcc, clang or that of CC)", "is not installed")


def build(sources, folder, *, flags=(), limit=None) -> pathlib.Path:
    """A shared library of some C files; the one that was built before where nothing has changed. CFLAGS are respected,
    but for those by which NaN and infinity would mean nothing.

    Args:
      sources: C files of one folder.
      folder: where it is kept; in the system's temporary files where that can't be written to.
      flags: further ones.
      limit: seconds that the compiler may take, `LIMIT` where nothing is said; then it is ended.
    """
    texts = [pathlib.Path(s).read_bytes() for s in sources]
    care = ["-O1"] if sum(t.count(b"\n") for t in texts) > LONG else []
    own = [word for word in os.environ.get("CFLAGS", "").split() if not word.startswith(UNSAFE)]
    line = [command(), "-std=c99", *FLAGS, *care, *flags, *own]
    headers = sorted(pathlib.Path(sources[0]).parent.glob("*.h"))
    key = hashlib.sha256(
        "\0".join([*line, _processor()]).encode() + b"\0".join(texts + [h.read_bytes() for h in headers])
    )
    name, folder = f"{pathlib.Path(sources[0]).stem}-{key.hexdigest()[:16]}", pathlib.Path(folder)
    library = next(filter(_whole, folder.glob(f"{name}-*.so")), None)
    if library is None:
        if not os.access(folder, os.W_OK):
            folder = pathlib.Path(tempfile.mkdtemp(prefix="cnclik-"))
        part = folder / f"{name}.{os.getpid()}.part"
        asked = [*line, "-o", str(part), *map(str, sources), "-lm"]
        code, said = _run(asked, limit or LIMIT)
        if code:
            said = next((w for w in said.splitlines() if "error" in w), said.strip()[:80])
            raise errors.fail("folder", "hold C code that compiles", f"{line[0]} says: {said}")
        library = folder / f"{name}-{_digest(part)}.so"
        part.replace(library)
    return library


def _digest(library) -> str:
    with open(library, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


def _whole(library) -> bool:
    """Whether a library is the one that was built: one that is cut off would end the process that loads it."""
    return os.path.isfile(library) and library.stem.endswith(f"-{_digest(library)}")


def _run(line, limit):
    """What a command returns and what it says; ended, with all that it has started, after so many seconds."""
    group = {"start_new_session": True} if hasattr(os, "killpg") else {}
    with subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, **group) as process:
        try:
            _, said = process.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            raise errors.fail("compiler", f"be done within {limit:g} s", f"{line[0]} is not") from None
        finally:  # an interrupt ends it, too
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL) if group else process.kill()
    return process.returncode, said


def _processor() -> str:
    """What code for this processor depends on."""
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.startswith(("flags", "Features"))), platform.processor())


def opened(library, *, lets_go=True):
    """The library; `lets_go` of Python's lock while it runs, for calls that take longer than a step."""
    return (ctypes.CDLL if lets_go else ctypes.PyDLL)(str(library))


def closed_after(library):
    """The library, which is closed when nothing holds it any more: its functions alone don't."""
    weakref.finalize(library, _ctypes.dlclose, library._handle).atexit = False  # a thread may still be at work in it
    return library
