"""The one progress bar: work done and time left; plain lines if there is no terminal."""

import contextlib
import sys
import time

_BETWEEN_LINES = 10.0  # [s] between plain lines


@contextlib.contextmanager
def bar(unit: str, quiet=False):
    """Yields report(done, total, note=""), the one form of progress that every function of the library takes. Args:
    unit: the name of what is counted."""
    last = time.perf_counter()

    def lines(done, total, note=""):
        nonlocal last
        if not quiet and time.perf_counter() - last >= _BETWEEN_LINES:
            last = time.perf_counter()
            print(words(unit, done, total, note), file=sys.stderr, flush=True)

    if quiet or not sys.stderr.isatty():
        yield lines
        return
    from rich import progress
    from rich.console import Console

    columns = (
        progress.SpinnerColumn(),
        progress.BarColumn(),
        progress.TextColumn("{task.description}", markup=False),
        progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(elapsed_when_finished=True),
    )
    with progress.Progress(*columns, console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task(words(unit, 0, None), total=None)
        yield lambda done, total, note="": shown.update(
            task, completed=done, total=total or None, description=words(unit, done, total, note)
        )


def words(unit, done, total, note="") -> str:
    """The text of a report: "120 of 4,000 loops, EE"; before any work is done, programs compile."""
    counted = f"{done:,} of {total:,} {unit}" if total else f"{done:,} {unit}"
    return ", ".join(filter(None, (counted if done else "" if note else f"compiling, {unit}", note)))
