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
    if quiet or not sys.stderr.isatty():
        yield (lambda done, total, note="": None) if quiet else _Report(unit, _line)
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
        task = shown.add_task(words(unit, 0, total, 0.0), total=total)
        yield _Report(
            unit, lambda text, done, total, _: shown.update(task, completed=done, total=total or None, description=text)
        )


def words(unit, done, total, rate, note="") -> str:
    """The text of a report: "120 of 4,000 loops, 60/s, EE"; before any work is done, programs compile."""
    counted = f"{done:,} of {total:,} {unit}" if total else f"{done:,} {unit}"
    parts = [counted if done else "" if note else f"compiling, {unit}"]
    parts.append(f"{rate:,.0f}/s" if done and rate >= 1 else "")
    return ", ".join(part for part in (*parts, note) if part)


class _Report:
    """Shows each report with the rate of work since the first one, before which programs compile. Another total begins
    another phase."""

    def __init__(self, unit, show):
        self.unit, self.show, self.total, self.first, self.last = unit, show, None, None, time.perf_counter()

    def __call__(self, done, total, note=""):
        now = time.perf_counter()
        if total != self.total or not self.first:
            self.total, self.first = total, (done, now) if done else None
        count, begun = self.first or (0, now)
        rate = (done - count) / (now - begun) if now > begun else 0.0
        if self.show is not _line or now - self.last >= _BETWEEN_LINES:
            self.last = now
            self.show(words(self.unit, done, total, rate, note), done, total, rate)


def _line(text, done, total, rate) -> None:
    left = f", {(total - done) / rate:,.0f} s left" if total and rate else ""
    print(text + left, file=sys.stderr, flush=True)
