"""Export timed: the step as C from C and from Python, its worst of many calls, and whole batches beside `lanes`.

Everything is measured in turn on one core: a ratio is taken within a round, and the median of the rounds is told.
"""

import contextlib
import ctypes
import functools
import os
import pathlib
import statistics
import tempfile
import time

import jax
import numpy as np

from cnclik.engine.compiler import build, opened
from cnclik.export.library import load
from cnclik.export.write import c
from cnclik.integrate.lanes import lanes
from cnclik.integrate.method import EE
from cnclik.integrate.solve import step as jax_step
from cnclik.integrate.stage import picard
from cnclik.law.paths import hold
from cnclik.record import on_device
from tests.bench import cases

CALLS = 1_000_000
ROUNDS = 7
BATCH, STEPS = 65_536, 50
_HARNESS = """
#include <stdint.h>
#include <time.h>
typedef int32_t (*function)(const void *, const void *, void *);
static int64_t now(void)
{
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}
void in_a_row(int64_t count, function step, const void *a, const void *b, void *out)
{
  int64_t k;
  for (k = 0; k < count; ++k) step(a, b, out);
}
void one_by_one(int64_t count, function step, const void *a, const void *b, void *out, int64_t *ns)
{
  int64_t k;
  for (k = 0; k < count; ++k) {
    const int64_t begun = now();
    step(a, b, out);
    ns[k] = now() - begun;
  }
}
"""


@contextlib.contextmanager
def one_core():
    """Context manager: this process on one core alone, where the system can do that."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def seconds(fn, times=1) -> float:
    """Time of one of several calls."""
    begun = time.perf_counter()
    for _ in range(times):
        fn()
    return (time.perf_counter() - begun) / times


class Native:
    """The Panda's pose step, damped, explicit Euler, exported and built."""

    def __init__(self, folder, dtype, *, fixed=False):
        """fixed: the target is held still, and nothing else but it may be set."""
        case = cases.ROBOTS["panda"]()
        self.dtype, self.law = np.dtype(dtype), case.law
        self.given = [np.asarray(v[0]) for v in cases.inputs(case, 1, self.dtype).values()]
        begun = time.perf_counter()
        options = dict(reference=hold(*self.given[1:]), runtime=("position", "rotation")) if fixed else {}
        c(case.law, out=folder, method=EE, dtype=self.dtype, **options)
        self.exported_s = time.perf_counter() - begun
        self.step = load(folder)
        self.built_s = time.perf_counter() - begun - self.exported_s
        told = (*self.given[1:], np.zeros(6, self.dtype), cases.TS)
        self.call = functools.partial(self.step, self.given[0], *((0.0, cases.TS) if fixed else told))
        self.call()
        source = pathlib.Path(folder) / "harness.c"
        source.write_text(_HARNESS, encoding="utf-8")
        self._harness = opened(build([source], folder, flags=["-D_POSIX_C_SOURCE=200809L"]))
        entry = ctypes.cast(getattr(opened(self.step.library), self.step.manifest["name"]), ctypes.c_void_p)
        places = [ctypes.c_void_p(self.step.buffers[g].address) for g in ("parameters", "input", "output")]
        self._arguments = [entry, *places]

    def from_c(self, count=20_000) -> float:
        """Seconds of a step, called in a row from C."""
        self.call()
        return seconds(lambda: self._harness.in_a_row(ctypes.c_int64(count), *self._arguments)) / count

    def spread(self, count=CALLS):
        """Nanoseconds of each of many calls, the clock's own time in them."""
        found = np.zeros(count, np.int64)
        self._harness.one_by_one(ctypes.c_int64(count), *self._arguments, ctypes.c_void_p(found.ctypes.data))
        return found


def steps(folder, dtype="float64", rounds=ROUNDS, others=None) -> dict:
    """Microseconds of a step from C, from Python, and by JAX, medians of rounds taken in turn.

    Args:
      others: {name: function that takes a step's worth of work and returns seconds}, run in the same rounds.
    """
    with one_core(), jax.enable_x64(dtype == "float64"):
        native, fixed = Native(folder, dtype), Native(folder / "fixed", dtype, fixed=True)
        q, position, rotation = (jax.numpy.asarray(v) for v in native.given)
        law, reference, stage = on_device(native.law), on_device(hold(position, rotation)), picard(5)

        def by_jax():
            return jax_step(law, reference, q, 0.0, cases.TS, EE, stage).q.block_until_ready()

        every = {
            "C from C": native.from_c,
            "C from C, parameters compiled in": fixed.from_c,
            "C from Python": lambda: seconds(native.call, 2000),
            "C from Python, joints alone": lambda: seconds(lambda: native.step(native.given[0]), 2000),
            "JAX step": lambda: seconds(by_jax, 200),
        } | (others or {})
        by_jax()
        found = {name: [] for name in every}
        for _ in range(rounds):
            for name, measure in every.items():
                found[name].append(measure())
        calls = native.spread()
    return {
        "dtype": dtype,
        "microseconds": {name: 1e6 * statistics.median(v) for name, v in found.items()},
        "rounds": found,
        "export_s": native.exported_s,
        "compile_s": native.built_s,
        "calls": calls,
    }


def batches(folder, dtype, rounds=ROUNDS, batch=BATCH, N=STEPS, others=None) -> dict:
    """Seconds of a batch of loops by the exported C and by `lanes`, both on one core, in turn."""
    case = cases.ROBOTS["panda"]()
    q, position, rotation = cases.inputs(case, batch, dtype).values()
    with one_core(), jax.enable_x64(dtype == "float64"):
        begun = time.perf_counter()
        c(case.law, hold(position[0], rotation[0]), out=folder, method=EE, dtype=dtype, batch=("q", "e"))
        exported = time.perf_counter() - begun
        native = load(folder)
        begun = time.perf_counter()

        def by_c():
            return native.batch(q, position=position, rotation=rotation, Ts=cases.TS, N=N, cores=1)

        native.batch(q[:1], position=position[:1], rotation=rotation[:1], Ts=cases.TS, N=0)
        built = time.perf_counter() - begun
        fn = lanes(cases.loop(case, N, EE, picard(5)), cores=1)

        def by_lanes():
            return jax.block_until_ready(fn(q, position, rotation))

        begun = time.perf_counter()
        wanted = np.asarray(by_lanes()[0])
        compiled = time.perf_counter() - begun
        off = float(np.max(np.abs(by_c()["q"] - wanted)))
        found = {"C": [], "lanes": []} | {name: [] for name in others or {}}
        for _ in range(rounds):
            for name, run in ({"C": by_c, "lanes": by_lanes} | (others or {})).items():
                found[name].append(seconds(run) if name in ("C", "lanes") else run())
    ratios = {n: statistics.median(a / b for a, b in zip(v, found["C"], strict=True)) for n, v in found.items()}
    return {
        "dtype": dtype,
        "steps_per_second": {name: batch * N / statistics.median(v) for name, v in found.items()},
        "times_as_fast": {name: ratio for name, ratio in ratios.items() if name != "C"},
        "differs": off,
        "export_s": exported,
        "compile_s": built,
        "lanes_compile_s": compiled,
    }


def measure(rounds=ROUNDS, batch=BATCH, others=None) -> dict:
    """All of it."""
    with tempfile.TemporaryDirectory() as folder:
        found = {"steps": steps(pathlib.Path(folder) / "step", rounds=rounds, others=(others or {}).get("step"))}
        found["batches"] = [
            batches(pathlib.Path(folder) / dtype, dtype, rounds, batch, others=(others or {}).get(dtype))
            for dtype in ("float32", "float64")
        ]
    return found


def page(found) -> str:
    """The figures as a Markdown table."""
    from cnclik.measure.files import markdown

    one, rows = found["steps"], []
    for name, us in one["microseconds"].items():
        rows.append((f"Panda pose step, {one['dtype']}: {name}", f"{us:.3g} µs"))
    calls = one["calls"]
    worst, middle = np.max(calls), np.median(calls)
    rows.append((f"worst of {len(calls):,} calls over their median", f"{worst / middle:.3g} ({worst / 1e3:.3g} µs)"))
    rows.append(("99.9 % of them within", f"{np.percentile(calls, 99.9) / middle:.3g} × the median"))
    rows.append(("export, then compile", f"{one['export_s']:.2g} s, {one['compile_s']:.2g} s"))
    for b in found["batches"]:
        speeds = ", ".join(f"{name} {v / 1e6:.3g} M/s" for name, v in b["steps_per_second"].items())
        times = ", ".join(f"{v:.3g} × {name}" for name, v in b["times_as_fast"].items())
        rows.append((f"batch of loops, {b['dtype']}", f"{times} ({speeds}; differs by {b['differs']:.1g})"))
        rows.append((f"its export and compile, {b['dtype']}", f"{b['export_s']:.2g} s, {b['compile_s']:.2g} s"))
    return markdown(("what", "measured"), rows)
