"""Compiler: the system's own C compiler, or that of the Python package `ziglang`, where there is one."""

import _ctypes
import ctypes
import functools
import hashlib
import importlib.util
import os
import pathlib
import platform
import shlex
import shutil
import subprocess
import tempfile
import weakref

from cnclik import errors

FLAGS = ("-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math", "-fPIC", "-shared")
# Of the engine's programs, as measured: -O3 gains nothing, and scheduling before registers are allocated 6 to 16 %, up
# to some 3,000 operations (it loses beyond). Contraction gains 7 % and is as accurate as none.
LANES = (
    *("-std=gnu11", "-O2", "-march=native", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math"),
    *("-fno-strict-aliasing", "-fPIC", "-shared"),
)
SCHEDULED = "-fschedule-insns"
MOST_SCHEDULED = 3_000
UNSAFE = (
    "-Ofast",
    "-ffast-math",
    "-funsafe-math",
    "-ffinite-math",
    "-fassociative-math",
    "-freciprocal-math",
    "-ffp-model",
)
LONG = 20_000  # lines from which on a compiler is told to take less care: its time grows faster than they do
MOST_SECONDS = 120  # that a compiler may take


class CompilerError(Exception):
    """The compiler refused, or took too long."""


def _command() -> list | None:
    for words in (shlex.split(os.environ.get("CC", "")), ["cc"], ["gcc"], ["clang"]):
        if words and shutil.which(words[0]):
            return words
    return _of_a_package()


@functools.cache
def _of_a_package() -> list | None:
    found = importlib.util.find_spec("ziglang")
    places = [] if found is None else found.submodule_search_locations or []
    several = [shutil.which("zig", path=str(place)) for place in places]
    return next(([zig, "cc"] for zig in several if zig), None)


def can_build() -> bool:
    """Whether there is a C compiler whose libraries can be opened."""
    return _command() is not None and hasattr(_ctypes, "dlclose")  # not on Windows


def command() -> list:
    """The words that call the C compiler: that of the environment's CC, else cc, gcc, clang or zig. ArgumentError where
    there is none."""
    if found := _command():
        return found
    raise errors.fail("compiler", "be there to build the C code (cc, gcc, clang or that of CC)", "is not installed")


def build(sources, folder, *, flags=(), keep=True) -> pathlib.Path:
    """A shared library of some C files; the one that was built before where nothing has changed. CFLAGS are respected,
    but for those by which NaN and infinity would mean nothing.

    Args:
      sources: C files of one folder.
      folder: where it is kept; in the system's temporary files where that can't be written to.
      flags: further ones.
    """
    texts = [pathlib.Path(s).read_bytes() for s in sources]
    care = ["-O1"] if sum(t.count(b"\n") for t in texts) > LONG else []
    line = [*command(), "-std=c99", *FLAGS, *care, *flags, *_own_flags()]
    headers = sorted(pathlib.Path(sources[0]).parent.glob("*.h"))
    name = f"{pathlib.Path(sources[0]).stem}-{_key(line, texts + [h.read_bytes() for h in headers])}.so"
    folder = pathlib.Path(folder)
    if not os.access(folder, os.W_OK):
        folder = pathlib.Path(tempfile.mkdtemp(prefix="cnclik-"))
    library = folder / name
    if not os.path.exists(library):
        try:
            _compile(line, sources, library)
        except CompilerError as error:
            raise errors.fail("folder", "hold C code that compiles", f"{line[0]} says: {error}") from None
    return library


def build_text(text, operations, folder, *, include=()) -> pathlib.Path:
    """A shared library of the engine's C text, named by its content; the one that is there already if there is one.

    Raises: CompilerError.
    """
    flags = [*LANES, *[SCHEDULED] * (operations <= MOST_SCHEDULED), *(f"-I{path}" for path in include), *_own_flags()]
    line = [*command(), *flags]
    library = pathlib.Path(folder) / f"lanes-{_key(line, [text.encode()])}.so"
    if not os.path.exists(library):
        with tempfile.TemporaryDirectory(prefix="cnclik-") as own:
            source = pathlib.Path(own, "lanes.c")
            source.write_text(text, encoding="utf-8")
            _compile(line, [source], library)
    return library


def _own_flags():
    return [word for word in os.environ.get("CFLAGS", "").split() if not word.startswith(UNSAFE)]


def _key(line, texts) -> str:
    return hashlib.sha256("\0".join([*line, _processor()]).encode() + b"\0".join(texts)).hexdigest()[:32]


def _compile(line, sources, library):
    part = library.with_name(f"{library.name}.{os.getpid()}.part")
    asked = [*line, "-o", str(part), *map(str, sources), "-lm"]
    try:
        done = subprocess.run(asked, capture_output=True, text=True, timeout=MOST_SECONDS)
        if done.returncode:
            words = done.stderr.splitlines()
            raise CompilerError(next((w for w in words if "error" in w), done.stderr.strip()[:80]))
        os.replace(part, library)
    except subprocess.TimeoutExpired:
        raise CompilerError(f"nothing within {MOST_SECONDS} s") from None
    except OSError as error:
        raise CompilerError(str(error)) from None
    finally:
        part.unlink(missing_ok=True)


@functools.cache
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
