"""Where a command's time goes: importing (until it begins), tracing, compiling, drawing; the rest is running."""

import contextlib
import time

from cnclik.show.output import DRAWING

EVENTS = {  # of jax.monitoring, which reports a beginning as a scalar and an end as a duration
    "/jax/core/compile/jaxpr_trace_duration": "tracing",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "tracing",
    "/jax/core/compile/backend_compile_duration": "compiling",
    DRAWING: "drawing",
}
_ORDER = ("compiling", "tracing", "importing", "drawing")  # if spans overlap, the first of these counts


class Spans:
    """Spans of time by kind of work; they may overlap in threads, and be nested."""

    def __init__(self, begun: float):
        self.begun, self.found, self.hits = begun, {name: [] for name in _ORDER}, 0

    def seconds(self, now=None) -> dict:
        """{kind of work: seconds}; each instant counts once, and the rest is "running"."""
        spans, before, made = [], 0.0, {}
        for name in _ORDER:
            spans += self.found[name]
            covered = length(spans)
            made[name], before = covered - before, covered
        whole = (time.time() if now is None else now) - self.begun
        return made | {"running": max(whole - before, 0.0)}

    def __str__(self):
        """ "Time 3.2 s: importing 1.1, tracing 0.3, compiling 1.2 (7 programs, 5 from the cache), …"."""
        found, programs = self.seconds(), len(self.found["compiling"])
        about = f" ({programs} program{'s' * (programs != 1)}, {self.hits} from the cache)"
        parts = [
            f"{name} {found[name]:.1f}" + about * (name == "compiling")
            for name in ("importing", "tracing", "compiling", "running", "drawing")
        ]
        return f"Time {sum(found.values()):.1f} s: {', '.join(parts)}."


def length(spans) -> float:
    """Length of the union of some spans."""
    total, reached = 0.0, float("-inf")
    for start, end in sorted(spans):
        total += max(end - max(start, reached), 0.0)
        reached = max(reached, end)
    return total


@contextlib.contextmanager
def watch(begun: float):
    """Context manager that yields the `Spans` of its body. The time from `begun` (`time.time()`) is importing."""
    from jax import monitoring

    spans = Spans(begun)
    spans.found["importing"].append((begun, time.time()))

    def span(event, start_time, end_time, **_):
        if event in EVENTS:
            spans.found[EVENTS[event]].append((start_time, end_time))

    def happened(event, **_):
        spans.hits += event == "/jax/compilation_cache/cache_hits"

    monitoring.register_event_time_span_listener(span)
    monitoring.register_event_listener(happened)
    try:
        yield spans
    finally:
        monitoring.unregister_event_time_span_listener(span)
        monitoring.unregister_event_listener(happened)
