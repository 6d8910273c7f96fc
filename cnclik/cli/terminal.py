"""A command's output: what can't be printed, for want of a reader, room or letters, costs no results."""

import contextlib
import io
import os
import signal
import sys
import unicodedata

# Letters of ours that an encoding may lack.
_PLAIN = str.maketrans(
    {
        "µ": "u",
        "·": "*",
        "²": "^2",
        "−": "-",
        "–": "-",
        "…": "...",
        "×": "x",
        "°": "deg",
        "≤": "<=",
        "≥": ">=",
        "→": "->",
    }
    | {
        "α": "alpha",
        "ω": "omega",
        "σ": "sigma",
        "τ": "tau",
        "ζ": "zeta",
        "π": "pi",
        "∞": "inf",
        "±": "+-",
        "√": "sqrt ",
    }
)


class Terminated(BaseException):
    """SIGTERM, so that what must be cleaned up is."""


class _Stream:
    """A stream that takes no more, and remembers why, once a write has failed."""

    def __init__(self, stream):
        self.stream, self.problem = stream, None

    def write(self, text):
        if self.problem is None:
            try:
                try:
                    self.stream.write(text)
                except UnicodeEncodeError:
                    self.stream.write(_in_letters_of(self.stream.encoding, text))
            except (OSError, ValueError) as error:  # ValueError: it is closed
                self.problem = error
        return len(text)

    def flush(self):
        if self.problem is None:
            try:
                self.stream.flush()
            except (OSError, ValueError) as error:
                self.problem = error

    def __getattr__(self, name):
        return getattr(self.stream, name)


def _in_letters_of(encoding, text):
    text = unicodedata.normalize("NFC", text).translate(_PLAIN)
    return text.encode(encoding, "replace").decode(encoding)


@contextlib.contextmanager
def guarded():
    """Context manager: a command's output, and an end by SIGTERM, in order.

    A command goes on without output, to the end of its work. Then it leaves with exit code 141 where the reader, such
    as `head`, has left, as a shell has it, and otherwise with one line on stderr and exit code 1.
    """
    own = sys.stdout, sys.stderr
    out, err = (_Stream(stream or io.StringIO()) for stream in own)  # none: it was closed from the beginning
    sys.stdout, sys.stderr = out, err
    leaving = None
    try:
        with _terminable():
            yield
    except SystemExit as ended:
        leaving = ended
    finally:
        out.flush()
        err.flush()
        sys.stdout, sys.stderr = own
        for stream in (out, err):
            if stream.problem is not None:  # Python would fail on what it still holds when it ends
                with contextlib.suppress(OSError, ValueError):
                    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    if leaving is not None and (leaving.code or out.problem is None):
        raise leaving
    if isinstance(out.problem, BrokenPipeError):
        sys.exit(141)
    if out.problem is not None:
        reason = getattr(out.problem, "strerror", None) or out.problem
        print(f"cnclik: The output could not be written ({reason}); the work was done.", file=sys.stderr)
        sys.exit(1)


@contextlib.contextmanager
def _terminable():
    """SIGTERM as an exception, where this is the main thread."""

    def end(*_):
        raise Terminated

    try:
        before = signal.signal(signal.SIGTERM, end)
    except ValueError:  # signals are for the main thread
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
