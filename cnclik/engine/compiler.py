"""Compiler: the system's C compiler, or that of the Python package `ziglang` if it is installed."""

import _ctypes
import ctypes
import functools
import hashlib
import importlib.util
import os
import pathlib
import platform
import re
import shlex
import shutil
import signal
import subprocess
import tempfile
import threading
import time
import weakref

from cnclik import errors
from cnclik.engine.graph import SlowError, UnsupportedError

# As measured: -O3 gains nothing. Scheduling before register allocation gains 6 to 16 % up to
# some 2,000 operations without a branch; beyond, it loses up to 30 % with 16 registers. Contraction gains 7 % and is as
# accurate. Whole numbers wrap, as XLA's do. GCC before 12 needs -ftree-slp-vectorize for square roots.
LANES = (
    *("-std=gnu11", "-O2", "-march=native", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math", "-fwrapv"),
    *("-ftree-slp-vectorize", "-fno-strict-aliasing", "-fPIC", "-shared"),
)
SCHEDULED = "-fschedule-insns"
MOST_SCHEDULED = 2_000
# For long programs: how many stores GCC looks back at from each load, instead of 1,000. Compiling G1's clips takes
# 13.6 s instead of 20.8 s, and the result is the same, byte for byte.
SHORT_SEARCH = "--param=sccvn-max-alias-queries-per-access=100"
UNSAFE = (
    *("-Ofast", "-ffast-math", "-funsafe-math", "-ffinite-math", "-fassociative-math", "-freciprocal-math"),
    "-ffp-model",
)
LONG = 20_000  # lines
MOST_SECONDS = 120  # [s] time limit of the compiler: XLA can run the function instead


def _command() -> list | None:
    return _on_path(os.environ.get("CC", ""), os.environ.get("PATH")) or of_a_package()


@functools.lru_cache(maxsize=16)
def _on_path(cc, path) -> list | None:
    """The compiler that CC and PATH name. Cached, as each call of a program asks for it."""
    try:
        own = shlex.split(cc)
    except ValueError:  # an unmatched quotation mark
        own = [cc]
    several = (own, ["cc"], ["gcc"], ["clang"])
    found = next((words for words in several if words and shutil.which(words[0], path=path)), None)
    if own and found is not own:
        used = found[0] if found else "none of cc, gcc and clang"
        errors.remark(f"CC is {cc!r}, which names no program: {used} is used.")
    return found


@functools.cache
def of_a_package() -> list | None:
    found = importlib.util.find_spec("ziglang")
    places = [] if found is None else found.submodule_search_locations or []
    several = [shutil.which("zig", path=str(place)) for place in places]
    return next(([zig, "cc"] for zig in several if zig), None)


def can_build() -> bool:
    """Whether there is a C compiler whose libraries can be loaded."""
    return _command() is not None and hasattr(_ctypes, "dlclose")  # not on Windows


def command() -> list:
    """The words that call the C compiler: the environment's CC, otherwise cc, gcc, clang or zig.

    Raises: ArgumentError if there is none.
    """
    if found := _command():
        return found
    raise errors.fail("compiler", "be there to build the C code (cc, gcc, clang or that of CC)", "is not installed")


def build_text(text, folder, *, include=(), scheduled=True) -> tuple:
    """(shared library of the engine's C text, named by its content; whether it existed already)

    CFLAGS are respected, except those that would break NaN and infinity.

    Args: scheduled: whether the compiler may reorder the operations of a small program, which takes longer.
    Raises: UnsupportedError where the compiler refuses, SlowError where it takes too long.
    """
    straight = max(part.count("\n") for part in re.split(r"[{}]\n", text))
    order = [SCHEDULED] * (scheduled and straight <= MOST_SCHEDULED)
    order += [SHORT_SEARCH] * (text.count("\n") > LONG)
    own = [word for word in os.environ.get("CFLAGS", "").split() if not word.startswith(UNSAFE)]
    line, folder = [*command(), *LANES, *order, *(f"-I{path}" for path in include), *own], pathlib.Path(folder)
    key = "\0".join([*line, _processor()]).encode() + b"\0" + text.encode()
    name = f"lanes-{hashlib.sha256(key).hexdigest()[:32]}"
    folder.mkdir(parents=True, exist_ok=True)
    if (kept := next(filter(_whole, folder.glob(f"{name}-*.so")), None)) is not None:
        return kept, True
    with tempfile.TemporaryDirectory(prefix="cnclik-") as place:
        source = pathlib.Path(place, "lanes.c")
        source.write_text(text, encoding="utf-8")
        return _compiled(line, source, folder, name), False


def _compiled(line, source, folder, name):
    part = folder / f"{name}.{os.getpid()}.part"
    try:
        code, said = _run([*line, "-o", str(part), str(source), "-lm"], MOST_SECONDS)
        if code or not os.path.isfile(part):
            reason = next((w for w in said.splitlines() if "error" in w), said.strip()[:80] or "nothing")
            raise UnsupportedError(f"the C compiler failed: {reason}")
        library = folder / f"{name}-{_digest(part)}.so"
        part.replace(library)
    finally:
        part.unlink(missing_ok=True)
    return library


def _digest(library) -> str:
    with open(library, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


def _whole(library) -> bool:
    """Whether a library is complete: loading a truncated one would end the process."""
    return os.path.isfile(library) and library.stem.endswith(f"-{_digest(library)}")


def _run(line, limit):
    """(exit status, output) of a command, which is ended with all its children after `limit` seconds."""
    with tempfile.TemporaryFile() as said:  # no pipe: what the compiler leaves running may hold one open
        quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": said}
        with subprocess.Popen(line, **quiet, start_new_session=True) as process:
            begun, alarm = time.monotonic(), threading.Timer(limit, os.killpg, (process.pid, signal.SIGKILL))
            try:  # `wait` with a time limit would look only every 50 ms
                alarm.start()
                process.wait()
            finally:  # also after an interrupt
                alarm.cancel()
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGKILL)
            if process.returncode < 0 and time.monotonic() - begun >= limit:
                raise SlowError(f"the C compiler failed: nothing within {limit:g} s")
        said.seek(0)
        return process.returncode, said.read().decode(errors="replace")


@functools.cache
def _processor() -> str:
    """The processor features that compiled code depends on."""
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.startswith(("flags", "Features"))), platform.processor())


def opened(library):
    """The loaded library, closed once nothing refers to it; its functions alone do not keep it open."""
    found = ctypes.CDLL(str(library))
    weakref.finalize(found, _ctypes.dlclose, found._handle).atexit = False  # a thread may still run its code
    return found
