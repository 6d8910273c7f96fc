"""A command's output and its end. Output that cannot be printed (no reader, room or letter) costs no results."""

import contextlib
import io
import os
import signal
import sys
import threading

STOPS = {signal.SIGTERM: "Terminated", signal.SIGINT: "Interrupted"}


class _Stream:
    """A stream that drops everything after a failed write, and remembers why; letters that it lacks become "?"."""

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
            except (OSError, ValueError) as error:  # ValueError: the stream is closed
                self.problem = error

    def __getattr__(self, name):
        return getattr(self.stream, name)


@contextlib.contextmanager
def guarded(process: bool):
    """Context manager that guards a command's output, and its end by a signal.

    If output fails, the command still finishes its work, and exits with code 141 if the reader, such as `head`, has
    left, else with one line on stderr and code 1.

    Args:
      process: whether this process only runs the command. Then SIGTERM and SIGINT end it at once, and an early end does
        not wait for threads that still load or compile: waiting for those of compiled code may hang or crash.
    """
    own = sys.stdout, sys.stderr
    out, err = (_Stream(stream or io.StringIO()) for stream in own)  # None: it was closed from the beginning
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
            if stream.problem is not None:  # at its end Python would fail to write the rest
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
    """End the process at SIGTERM and SIGINT, unless the shell had it ignore them. Returns: {signal: handler before}.

    An exception would not do: extensions that are being loaded turn it into another error, compiled code drops it.
    """
    if threading.current_thread() is not threading.main_thread():  # only the main thread may set handlers
        return {}
    heard = [sent for sent in STOPS if signal.getsignal(sent) not in (signal.SIG_IGN, None)]  # None: not set by Python
    return {sent: signal.signal(sent, end) for sent in heard}


def end(sent, _) -> None:
    """The handler of a signal: it removes half-written files and prints one line."""
    from cnclik.writing import remove_begun

    remove_begun()
    with contextlib.suppress(OSError):
        bar = "\r\x1b[2K\x1b[?25h" if os.isatty(2) else ""  # erases the bar's line, and shows the cursor again
        os.write(2, f"{bar}cnclik: {STOPS[sent]}; what was complete is kept.\n".encode())
    # Flush earlier output, unless the signal came in the middle of a write, or nobody reads it.
    with contextlib.suppress(OSError, ValueError, RuntimeError, AttributeError):
        sys.stdout.flush()
    os._exit(128 + sent)
