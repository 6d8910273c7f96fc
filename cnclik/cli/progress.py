"""The one progress bar: work done, rate, time left; plain lines if there is no terminal."""

import contextlib
import sys
import time

_EVENTS = {  # of jax.monitoring, which reports a beginning as a scalar and an end as a duration
    "/jax/core/compile/jaxpr_trace_duration": "tracing",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "tracing",
    "/jax/core/compile/backend_compile_duration": "compiling",
}
_BETWEEN_LINES = 10.0  # [s] between plain lines


@contextlib.contextmanager
def bar(unit: str, total=None, quiet=False):
    """Yields report(done, total, note=""), the one form of progress that every function of the library takes.

    Until the first report of work done, a terminal shows the phase (tracing, compiling, running) with its seconds, or
    the note.

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
            task, clock, last = shown.add_task(f"compiling, {unit}", total=total), _Clock(), [0, total]

            def report(done, total, note=""):
                last[:] = [done, total, note]
                text = words(unit, done, total, clock(done, total), note)
                shown.update(task, completed=done, total=total or None, description=text)

            def wait(phase):
                if not last[0]:
                    shown.update(task, description=words(unit, *last[:2], 0.0, *last[2:], phase=phase))

            with _phases(wait):
                yield report


@contextlib.contextmanager
def _phases(tell):
    """Call tell("tracing"), tell("compiling") and tell("running") when JAX begins each."""
    if "jax" not in sys.modules:  # without JAX nothing is compiled
        yield
        return
    from jax import monitoring

    def begun(event, value, **_):
        if event in _EVENTS:
            tell(_EVENTS[event])

    def ended(event, start, end, **_):
        if _EVENTS.get(event) == "compiling":
            tell("running")

    monitoring.register_scalar_listener(begun)
    monitoring.register_event_time_span_listener(ended)
    try:
        yield
    finally:
        monitoring.unregister_scalar_listener(begun)
        monitoring.unregister_event_time_span_listener(ended)


def words(unit, done, total, rate, note="", phase="compiling") -> str:
    """The text of a report: "120 of 4,000 loops, 60/s, EE"."""
    counted = f"{done:,} of {total:,} {unit}" if total else f"{done:,} {unit}"
    parts = [counted if done else "" if note else f"{phase}, {unit}"]
    if done and rate >= 1:
        parts.append(f"{rate:,.0f}/s")
    return ", ".join(part for part in (*parts, note) if part)


class _Clock:
    """The rate of work since the first report of it, before which programs compile.

    A new total begins a new phase.
    """

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
