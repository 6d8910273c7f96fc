"""The one progress bar: work done and time left; plain lines if there is no terminal."""

import contextlib
import sys
import time

_BETWEEN_LINES = 10.0  # [s] between plain lines


@contextlib.contextmanager
def bar(unit: str, quiet=False):
    """Yields report(done, total, note=""), the one form of progress in the library. Args: unit: what is counted."""
    last = time.perf_counter()

    def lines(done, total, note=""):
        nonlocal last
        if not quiet and time.perf_counter() - last >= _BETWEEN_LINES:
            last = time.perf_counter()
            print(words(unit, done, total, note), file=sys.stderr, flush=True)

    if quiet or not sys.stderr.isatty():
        yield lines
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task(words(unit, 0, None), total=None)
        yield lambda done, total, note="": shown.update(
            task, completed=done, total=total or None, description=escape(words(unit, done, total, note))
        )


def words(unit, done, total, note="") -> str:
    """The text of a report: "120 of 4,000 loops, EE"; before any work is done, programs compile."""
    counted = f"{done:,} of {total:,} {unit}" if total else f"{done:,} {unit}"
    return ", ".join(filter(None, (counted if done else "" if note else f"compiling, {unit}", note)))
