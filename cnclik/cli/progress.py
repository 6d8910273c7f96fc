"""The one progress bar: work done and time left; plain lines if there is no terminal."""

import contextlib
import sys
import time

_BETWEEN_LINES = 10.0  # [s] between plain lines


@contextlib.contextmanager
def bar(unit: str, total=None, quiet=False):
    """Yields report(done, total, note=""), the one form of progress that every function of the library takes.

    Args:
      unit: the name of what is counted.
      total: their number, if it is known before the first report.
      quiet: whether to show nothing.
    """
    if quiet or not sys.stderr.isatty():
        yield (lambda done, total, note="": None) if quiet else _lines(unit)
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
        task = shown.add_task(words(unit, 0, total), total=total)
        yield lambda done, total, note="": shown.update(
            task, completed=done, total=total or None, description=words(unit, done, total, note)
        )


def words(unit, done, total, note="") -> str:
    """The text of a report: "120 of 4,000 loops, EE"; before any work is done, programs compile."""
    counted = f"{done:,} of {total:,} {unit}" if total else f"{done:,} {unit}"
    return ", ".join(filter(None, (counted if done else "" if note else f"compiling, {unit}", note)))


def _lines(unit):
    """A report that prints a line at most every 10 s. Time left counts from the first work, before which programs
    compile; another total begins another phase."""
    phase, first, last = None, (0, 0.0), time.perf_counter()

    def report(done, total, note=""):
        nonlocal phase, first, last
        now = time.perf_counter()
        if total != phase or not first[0]:
            phase, first = total, (done, now)
        if now - last >= _BETWEEN_LINES:
            worked = (now - first[1]) / (done - first[0]) if done > first[0] else 0.0  # [s] each
            left = f", {(total - done) * worked:,.0f} s left" * bool(total and worked)
            print(words(unit, done, total, note) + left, file=sys.stderr, flush=True)
            last = now

    return report
