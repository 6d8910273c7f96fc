"""A command's output and its end: what can't be printed, for want of a reader, room or letters, costs no results."""

import contextlib
import io
import os
import signal
import sys
import threading

STOPS = {signal.SIGTERM: "Terminated", signal.SIGINT: "Interrupted"}


class _Stream:
    """A stream that takes no more, and remembers why, once a write has failed; letters that it lacks are "?"."""

    def __init__(self, stream):
        self.stream, self.problem = stream, None
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")

    def write(self, text):
        self._unless_failed(lambda: self.stream.write(text))
        return len(text)

    def flush(self):
        self._unless_failed(self.stream.flush)

    def _unless_failed(self, act):
        if self.problem is None:
            try:
                act()
            except (OSError, ValueError) as error:  # ValueError: it is closed
                self.problem = error

    def __getattr__(self, name):
        return getattr(self.stream, name)


@contextlib.contextmanager
def guarded(process: bool):
    """Context manager: a command's output, and its end by a signal, in order.

    A command goes on without output, to the end of its work. Then it leaves with exit code 141 where the reader, such
    as `head`, has left, as a shell has it, and otherwise with one line on stderr and exit code 1.

    Args:
      process: whether the command is all this process is for. Then SIGTERM and SIGINT end it at once, and when it
        leaves early it doesn't wait for threads that are still loading or compiling something, those of compiled code
        among them, of which Python doesn't know: it would wait, and may crash or hang on them.
    """
    own = sys.stdout, sys.stderr
    out, err = (_Stream(stream or io.StringIO()) for stream in own)  # none: it was closed from the beginning
    sys.stdout, sys.stderr = out, err
    leaving, before = None, _listen() if process else {}
    try:
        yield
    except SystemExit as ended:
        leaving = ended
    finally:
        for sent, handler in before.items():
            signal.signal(sent, handler)
        out.flush()
        err.flush()
        sys.stdout, sys.stderr = own
        for stream in (out, err):
            if stream.problem is not None:  # Python would fail on what it still holds when it ends
                with contextlib.suppress(OSError, ValueError):
                    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    if leaving is not None and (leaving.code or out.problem is None):
        if process and leaving.code and threading.active_count() > 1:
            os._exit(leaving.code if isinstance(leaving.code, int) else 1)
        raise leaving
    if isinstance(out.problem, BrokenPipeError):
        sys.exit(141)
    if out.problem is not None:
        from cnclik.errors import reason

        print(f"cnclik: The output could not be written ({reason(out.problem)}); the work was done.", file=sys.stderr)
        sys.exit(1)


def _listen() -> dict:
    """End the process at SIGTERM and SIGINT, wherever it is, but for those that a shell told it to ignore.

    Not by an exception, of which extensions that are being loaded make errors of their own, and which is dropped where
    compiled code calls Python back. Returns: {signal: what handled it before}.
    """
    if threading.current_thread() is not threading.main_thread():  # signals are for the main thread
        return {}
    heard = [sent for sent in STOPS if signal.getsignal(sent) not in (signal.SIG_IGN, None)]  # None: not of Python
    return {sent: signal.signal(sent, end) for sent in heard}


def end(sent, _) -> None:
    """What a signal does: nothing half-written stays, and one line is said."""
    from cnclik.writing import remove_begun

    remove_begun()
    with contextlib.suppress(OSError):
        bar = "\r\x1b[2K\x1b[?25h" if os.isatty(2) else ""  # its line goes, and the cursor that it hides comes back
        os.write(2, f"{bar}cnclik: {STOPS[sent]}; what was complete is kept.\n".encode())
    # What was printed before it, unless the signal came in the middle of that, or nobody reads on.
    with contextlib.suppress(OSError, ValueError, RuntimeError, AttributeError):
        sys.stdout.flush()
    os._exit(128 + sent)
