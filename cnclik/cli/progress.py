"""The one progress bar: work done, rate, time left; plain lines if there is no terminal."""

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
    if quiet:
        yield lambda done, total, note="": None
    elif not sys.stderr.isatty():
        yield _Lines(unit)
    else:
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
            task, clock = shown.add_task(words(unit, 0, total, 0.0), total=total), _Clock()

            def report(done, total, note=""):
                text = words(unit, done, total, clock(done, total), note)
                shown.update(task, completed=done, total=total or None, description=text)

            yield report


def words(unit, done, total, rate, note="") -> str:
    """The text of a report: "120 of 4,000 loops, 60/s, EE"; before any work is done, programs compile."""
    counted = f"{done:,} of {total:,} {unit}" if total else f"{done:,} {unit}"
    parts = [counted if done else "" if note else f"compiling, {unit}"]
    if done and rate >= 1:
        parts.append(f"{rate:,.0f}/s")
    return ", ".join(part for part in (*parts, note) if part)


class _Clock:
    """The rate of work since the first report of it, before which programs compile. A new total begins a new phase."""

    def __init__(self):
        self.total = self.first = None

    def __call__(self, done, total) -> float:
        now = time.perf_counter()
        if total != self.total or not self.first:
            self.total, self.first = total, (done, now) if done else None
        count, begun = self.first or (0, now)
        return (done - count) / (now - begun) if now > begun else 0.0


class _Lines:
    """A line every ten seconds."""

    def __init__(self, unit):
        self.unit, self.clock, self.last = unit, _Clock(), time.perf_counter()

    def __call__(self, done, total, note=""):
        now, rate = time.perf_counter(), self.clock(done, total)
        if now - self.last < _BETWEEN_LINES:
            return
        self.last = now
        left = f", {(total - done) / rate:,.0f} s left" if total and rate else ""
        print(words(self.unit, done, total, rate, note) + left, file=sys.stderr, flush=True)
