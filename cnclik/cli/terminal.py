"""A command's end: by an output that cannot be printed (no reader, room or character), or by a signal."""

import contextlib
import io
import os
import signal
import sys
import threading

STOPS = {signal.SIGTERM: "Terminated", signal.SIGINT: "Interrupted"}


@contextlib.contextmanager
def guarded(process: bool):
    """Context manager that guards a command's end.

    Where output fails the command exits with code 141 if the reader, such as `head`, has left, else with one line on
    stderr and code 1; files already written stay. Characters that the terminal cannot show become "?".

    Args:
      process: whether this process only runs the command. Then SIGTERM and SIGINT end it at once, and an early end does
        not wait for threads that still load or compile: waiting for those of compiled code may hang or crash.
    """
    for sent in STOPS if process else ():
        if signal.getsignal(sent) is not signal.SIG_IGN:  # as a shell has it for what runs behind `&`
            signal.signal(sent, end)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    code = 0
    try:
        try:
            yield
        except SystemExit as leaving:
            code = leaving.code if isinstance(leaving.code, int) else int(bool(leaving.code))
        print(end="", flush=True)
    except OSError as error:
        code = code or (141 if isinstance(error, BrokenPipeError) else 1)
        with contextlib.suppress(OSError, ValueError):  # at its end Python flushes once more
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            if code == 1:
                print(f"cnclik: {type(error).__name__}: {error}", file=sys.stderr)
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
