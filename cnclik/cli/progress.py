"""A progress bar with rate and time left; plain lines where there is no terminal."""

import contextlib
import sys
import time


@contextlib.contextmanager
def bar(unit: str, *, quiet=False):
    """Yields report(done, total, note=""), the one form of progress that every function of the library takes.

    Args: unit: what is counted.
    """
    if quiet:
        yield lambda done, total, note="": None
        return
    if not sys.stderr.isatty():
        yield _Lines(unit)
        return
    from rich import progress
    from rich.console import Console

    columns = (
        progress.BarColumn(bar_width=None),
        progress.TaskProgressColumn(),
        progress.TextColumn("{task.fields[rate]}"),
        progress.TimeRemainingColumn(),
    )
    with progress.Progress(*columns, console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task("", total=None, rate=f"compiling, {unit}")
        begun = None

        def report(done, total, note=""):
            nonlocal begun
            now = time.perf_counter()
            begun = now if begun is None else begun
            rate = f"{done / (now - begun):,.0f} {unit}/s" if done else f"compiling, {unit}"
            shown.update(task, completed=done, total=max(total, 1), rate=f"{rate}  {note}" if note else rate)

        yield report


class _Lines:
    """A line every ten seconds."""

    def __init__(self, unit):
        self.unit, self.begun, self.last = unit, time.perf_counter(), time.perf_counter()

    def __call__(self, done, total, note=""):
        now = time.perf_counter()
        if now - self.last < 10 or not total:
            return
        self.last = now
        rate = done / (now - self.begun)
        left = f", {(total - done) / rate:,.0f} s left" if rate else ""
        print(
            f"{done:,} of {total:,} {self.unit}, {rate:,.0f}/s{left}{f', {note}' if note else ''}",
            file=sys.stderr,
            flush=True,
        )
