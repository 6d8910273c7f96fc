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
        self.stream, self.problem = stream or io.StringIO(), None  # None: it was closed from the beginning
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")

    def write(self, text):
        self._unless_failed(self.stream.write, text)

    def flush(self):
        self._unless_failed(self.stream.flush)

    def _unless_failed(self, act, *words):
        try:
            if self.problem is None:
                act(*words)
        except (OSError, ValueError) as error:  # ValueError: the stream is closed
            self.problem = error
            with contextlib.suppress(OSError, ValueError):  # at its end Python would fail to write the rest
                os.dup2(os.open(os.devnull, os.O_WRONLY), self.stream.fileno())

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
    for sent in STOPS if process else ():
        if signal.getsignal(sent) is not signal.SIG_IGN:  # as a shell has it for what runs behind `&`
            signal.signal(sent, end)
    own, code = (sys.stdout, sys.stderr), 0
    out, _ = sys.stdout, sys.stderr = _Stream(own[0]), _Stream(own[1])
    try:
        yield
    except SystemExit as leaving:
        code = leaving.code if isinstance(leaving.code, int) else int(bool(leaving.code))
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        sys.stdout, sys.stderr = own
    if not code and out.problem is not None:
        code = 141 if isinstance(out.problem, BrokenPipeError) else 1
        if code == 1:
            reason = getattr(out.problem, "strerror", None) or out.problem
            print(f"cnclik: The output could not be written ({reason}); the work was done.", file=sys.stderr)
    if code and process and threading.active_count() > 1:
        os._exit(code)
    if code:
        sys.exit(code)


def end(sent, _) -> None:
    """Handle a signal: remove half-written files and print one line.

    An exception would not do: extensions that are being loaded turn it into another error, compiled code drops it.
    """
    from cnclik.writing import remove_begun

    remove_begun()
    bar = "\r\x1b[2K\x1b[?25h" * os.isatty(2)  # erases the bar's line, and shows the cursor again
    with contextlib.suppress(OSError, ValueError, RuntimeError, AttributeError):  # in the middle of a write, or unread
        os.write(2, f"{bar}cnclik: {STOPS[sent]}; what was complete is kept.\n".encode())
        sys.stdout.flush()
    os._exit(128 + sent)
