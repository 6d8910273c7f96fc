"""Judge: one input drawn by its number, tried under limits of time and memory, and what came of it.

Success, or one refusing line of bounded length; everything else is a failure: another exception, a warning, words on
stderr, more than `MOST_SECONDS` of the processor or `MOST_BYTES` of memory.
"""

import contextlib
import dataclasses
import io
import pathlib
import re
import resource
import signal
import sys
import time
import traceback
import types
import warnings
import zlib

import numpy as np

from cnclik.errors import ArgumentError, Remark

MOST_SECONDS = 10.0  # of processor time that one input may take
MOST_WAIT = 120.0  # and of the clock, where it waits for something
MOST_BYTES = 1 << 30  # that the process may grow by
MOST_CHARACTERS = 1000  # of a refusing line
_PROGRESS = re.compile(r"[\d,]+ of [\d,]+ [^\n]*\n")  # a line of `cnclik.cli.progress`
_QUIET = (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning)  # which nobody gets to see


class Late(BaseException):
    """The time of an input is over; no `except Exception` holds it back."""


@dataclasses.dataclass(frozen=True)
class Verdict:
    """What came of one input."""

    room: str
    number: int
    outcome: str  # passed, refused or failed
    why: str
    seconds: float  # of the processor
    bytes: int  # by which the process grew at most


def name(room: types.ModuleType) -> str:
    return room.__name__.rpartition(".")[2]


def drawn(room, number: int, seed: int = 0):
    """An input by its number: the same on every machine, whatever was drawn before it."""
    return room.draw(np.random.default_rng((seed, zlib.crc32(name(room).encode()), number)))


def judge(room, number: int, folder: pathlib.Path, seed: int = 0) -> Verdict:
    """Try the input of this number, in a folder of its own that is empty."""
    made = drawn(room, number, seed)
    said, warned = io.StringIO(), []
    before, begun = _fresh_peak(), time.process_time()
    try:
        with _timed(), warnings.catch_warnings(record=True) as warned, contextlib.redirect_stderr(said):
            warnings.simplefilter("always")
            room.attempt(made, folder)
        outcome, why = "passed", ""
    except ArgumentError as error:
        outcome, why = "refused", str(error)
    except KeyboardInterrupt:
        raise
    except Late:
        outcome, why = "failed", f"takes longer than {MOST_SECONDS:g} s"
    except BaseException as error:
        outcome, why = "failed", "".join(traceback.format_exception(error)[-8:])
    seconds, grown = time.process_time() - begun, max(_peak() - before, 0)
    warned = [w for w in warned if not issubclass(w.category, _QUIET) and not is_remark(w)]
    if outcome != "failed":
        wrong = [f"warns: {w.category.__name__}: {w.message} ({w.filename}:{w.lineno})" for w in warned[:1]]
        wrong += [f"writes on stderr: {said.getvalue()[:500]!r}"] * bool(said.getvalue())
        wrong += [f"takes {grown >> 20} MiB"] * (grown > MOST_BYTES)
        wrong += [f"is told in {len(why)} characters: {why[:200]!r}"] * (len(why) > MOST_CHARACTERS)
        wrong += [f"is not told in one line: {why!r}"] * (len(why.splitlines()) > 1 or "\x1b" in why)
        outcome, why = ("failed", "; ".join(wrong)) if wrong else (outcome, why)
    return Verdict(name(room), number, outcome, why, seconds, grown)


def repeat(verdict: Verdict, seed: int = 0) -> str:
    """The command that tries an input again."""
    return f"python -m tests.stress.fuzz --only {verdict.room} --seed {seed} --number {verdict.number}"


def is_remark(warned) -> bool:
    """Whether a warning is a remark of ours, as it should be: short, and one line."""
    text = str(warned.message)
    return issubclass(warned.category, Remark) and len(text) <= MOST_CHARACTERS and text.isprintable()


def one_line(code, said: str) -> None:
    """Of a command that has left: raise ArgumentError for a refusal as it should be, AssertionError for another.

    Remarks, each a line, may stand before it, or alone; so may progress, which a slow machine is told of.
    """
    lines = [line for line in said.splitlines(keepends=True) if not _PROGRESS.match(line)]
    assert all(line.startswith("cnclik: ") and len(line) <= MOST_CHARACTERS for line in lines), f"{said!r} on stderr"
    if code in (0, None):
        return
    said = lines[-1] if lines else ""
    assert code == 2 and said.count("\n") == 1 and said.endswith("\n"), f"exit {code} with {said[-2000:]!r}"
    raise ArgumentError(said.strip())


@contextlib.contextmanager
def _timed():
    """Raise `Late` in the block when its time is over: of the processor, or of the clock."""

    def over(*_):
        raise Late

    clocks = ((signal.ITIMER_PROF, signal.SIGPROF, MOST_SECONDS), (signal.ITIMER_REAL, signal.SIGALRM, MOST_WAIT))
    old = [signal.signal(number, over) for _, number, _ in clocks]
    try:
        for clock, _, seconds in clocks:
            signal.setitimer(clock, seconds)
        yield
    finally:
        for (clock, number, _), handler in zip(clocks, old, strict=True):
            signal.setitimer(clock, 0)
            signal.signal(number, handler)


def _fresh_peak() -> int:
    """Memory held now [bytes]; the peak is counted from here on where the system lets us."""
    with contextlib.suppress(OSError):
        pathlib.Path("/proc/self/clear_refs").write_text("5")
    return _peak()


def _peak() -> int:
    """The most memory this process has held [bytes]."""
    with contextlib.suppress(OSError):
        if found := re.search(r"VmHWM:\s*(\d+) kB", pathlib.Path("/proc/self/status").read_text()):
            return int(found[1]) << 10
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most << 10
