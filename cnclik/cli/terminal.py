"""A command's output: what can't be printed, for want of a reader, room or letters, costs no results."""

import _thread
import contextlib
import faulthandler
import io
import os
import signal
import sys
import threading
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


STOPS = {signal.SIGTERM: Terminated, signal.SIGINT: KeyboardInterrupt}
_WORDS = {signal.SIGTERM: "Terminated", signal.SIGINT: "Interrupted"}
heard_now = []  # signals that a command was sent: extensions that are being loaded make errors of their own of them
_PATIENCE = 30.0  # [s] that cleaning up may take after a signal


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
def guarded(process: bool):
    """Context manager: a command's output, and its end by a signal, in order.

    A command goes on without output, to the end of its work. Then it leaves with exit code 141 where the reader, such
    as `head`, has left, as a shell has it, and otherwise with one line on stderr and exit code 1.

    Args:
      process: whether the command is all this process is for. Then it doesn't wait, when it leaves early, for threads
        that are still loading or compiling something, those of compiled code among them, of which Python doesn't know:
        it would wait, and may crash or hang on them.
    """
    own = sys.stdout, sys.stderr
    out, err = (_Stream(stream or io.StringIO()) for stream in own)  # none: it was closed from the beginning
    sys.stdout, sys.stderr = out, err
    leaving = None
    try:
        with _stoppable(process):
            yield
    except SystemExit as ended:
        leaving = ended
    except tuple(STOPS.values()) as stopped:
        sent = next(sent for sent, kind in STOPS.items() if isinstance(stopped, kind))
        print(f"cnclik: {_WORDS[sent]}; what was complete is kept.", file=sys.stderr)
        leaving = SystemExit(128 + sent)
    finally:
        out.flush()
        err.flush()
        sys.stdout, sys.stderr = own
        for stream in (out, err):
            if stream.problem is not None:  # Python would fail on what it still holds when it ends
                with contextlib.suppress(OSError, ValueError):
                    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    if leaving is not None and (leaving.code or out.problem is None):
        if process and leaving.code and (heard_now or threading.active_count() > 1):
            os._exit(leaving.code)
        raise leaving
    if isinstance(out.problem, BrokenPipeError):
        sys.exit(141)
    if out.problem is not None:
        from cnclik.errors import reason

        print(f"cnclik: The output could not be written ({reason(out.problem)}); the work was done.", file=sys.stderr)
        sys.exit(1)


@contextlib.contextmanager
def whole():
    """Context manager: signals wait for its end; JAX's modules, interrupted while they are loaded, end the process."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _stoppable(process):
    """SIGTERM and SIGINT as exceptions, where this is the main thread; and neither gets lost.

    What is raised while compiled code calls Python back, such as JAX when memory is collected, is dropped with a
    remark: then the signal is sent once more. And where compiled code that was interrupted blocks all threads, as
    LAPACK's first use in JAX does, the process ends after all. A signal that a shell has told this process to ignore,
    as SIGINT behind `&` in a script, stays ignored.
    """

    heard_now.clear()

    def end(sent, _):
        heard_now.append(sent)
        if process:
            faulthandler.dump_traceback_later(_PATIENCE, exit=True, file=nowhere)
        raise STOPS[sent]

    def dropped(unraisable):
        for sent, kind in STOPS.items():
            if isinstance(unraisable.exc_value, kind):
                threading.Timer(0.05, _thread.interrupt_main, [sent]).start()
                return
        hook(unraisable)

    if threading.current_thread() is not threading.main_thread():  # signals are for the main thread
        yield
        return
    hook = sys.unraisablehook
    heard = [sent for sent in STOPS if signal.getsignal(sent) not in (signal.SIG_IGN, None)]  # None: not of Python
    before = {sent: signal.signal(sent, end) for sent in heard}
    sys.unraisablehook = dropped
    with open(os.devnull, "w") as nowhere:
        try:
            yield
        finally:
            if process:
                faulthandler.cancel_dump_traceback_later()
            sys.unraisablehook = hook
            for sent, handler in before.items():
                signal.signal(sent, signal.SIG_IGN if process and heard_now else handler)  # once is enough
