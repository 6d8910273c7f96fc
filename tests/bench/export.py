"""`python -m tests.bench.export`: the exported step beside Pinocchio C++ and JAX, its worst call, its numbers on ARM.

Into results/export (a minute); its README shows the table. Needs g++ and the extra `bench`; the numbers on
ARM need arm-linux-gnueabihf-gcc and qemu-arm (aarch64 likewise), from Debian. `budget.py` has its size there.
Everything is measured in turn on one core: a ratio is taken within a round, and the median of the rounds is told.
"""

import argparse
import contextlib
import ctypes
import json
import os
import pathlib
import shutil
import statistics
import subprocess
import sys
import tempfile
import time

import jax
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik.measure.files import markdown
from cnclik.show import style
from cnclik.show.output import draw
from tests.bench import cases, document, peers
from tests.bench.pinocchio_cpp import PinocchioCpp
from tests.export.native import built, native

RESULTS = pathlib.Path(__file__).parents[2] / "results" / "export"
CALLS = 1_000_000
ROUNDS = 7
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


class Exported:
    """The Panda's pose step, damped, explicit Euler, exported and built."""

    def __init__(self, *, fixed=False):
        """fixed: the target is held still, and nothing else but it may be set."""
        case = cases.ROBOTS["panda"]()
        self.law = case.law
        self.given = [np.asarray(v[0]) for v in cases.inputs(case, 1, "float64").values()]
        reference = ck.hold(*self.given[1:]) if fixed else None
        begun = time.perf_counter()
        self.step = native(case.law, reference, method="EE", runtime=("position", "rotation") if fixed else None)
        self.built_s = time.perf_counter() - begun
        self.step(*self.given[: 1 if fixed else 3], Ts=cases.TS)
        with tempfile.TemporaryDirectory() as folder:
            source = pathlib.Path(folder, "harness.c")
            source.write_text(_HARNESS, encoding="utf-8")
            self._harness = built(source, "-D_POSIX_C_SOURCE=200809L")
        entry = ctypes.cast(self.step.function, ctypes.c_void_p)
        self._arguments = [entry, *map(ctypes.c_void_p, self.step.addresses)]

    def from_c(self, count=20_000) -> float:
        """Seconds of a step, called in a row from C."""
        return seconds(lambda: self._harness.in_a_row(ctypes.c_int64(count), *self._arguments)) / count

    def spread(self, count=CALLS):
        """Nanoseconds of each of many calls, the clock's own time in them."""
        found = np.zeros(count, np.int64)
        self._harness.one_by_one(ctypes.c_int64(count), *self._arguments, ctypes.c_void_p(found.ctypes.data))
        return found


def pinocchio():
    """A function that returns the seconds of a step, in a row, by Pinocchio C++."""
    solver, given = PinocchioCpp(*peers.panda(), "float64"), peers.given("float64")
    settings = dict(alpha=cases.ALPHA, Ts=cases.TS, damping=cases.DAMPING, M=None)
    return lambda count=4000: seconds(lambda: solver.run(*(v[:1] for v in given), N=count, **settings)) / count


def measure(rounds) -> dict:
    """Microseconds of a step, medians of rounds taken in turn."""
    with one_core(), jax.enable_x64(True):
        step, fixed = Exported(), Exported(fixed=True)
        q, position, rotation = (jax.numpy.asarray(v) for v in step.given)
        law, reference = jax.device_put((step.law, ck.hold(position, rotation)))

        def by_jax():
            return ck.step(law, reference, q, 0.0, cases.TS, "EE").q.block_until_ready()

        every = {
            "C from C": step.from_c,
            "C from C, parameters compiled in": fixed.from_c,
            "JAX step": lambda: seconds(by_jax, 200),
            "Pinocchio C++": pinocchio(),
        }
        by_jax()
        found = {name: [] for name in every}
        for _ in range(rounds):
            for name, timed in every.items():
                found[name].append(timed())
        calls = step.spread()
    median = {name: 1e6 * statistics.median(v) for name, v in found.items()}
    return {"dtype": "float64", "microseconds": median, "rounds": found, "built_s": step.built_s, "calls": calls}


def histogram(calls):
    """Time of each of many calls on one core."""
    calls = np.asarray(calls)
    fig, axes = plt.subplots(figsize=(style.PAGE, 2.4))
    edges = np.geomspace(max(calls.min(), 1) * 0.95, calls.max() * 1.05, 120)
    axes.hist(calls / 1e3, bins=edges / 1e3, color=style.BLUE)
    middle = np.median(calls) / 1e3
    marks = ((middle, "median", "right"), (np.percentile(calls, 99.9) / 1e3, "99.9 %", "left"))
    for value, word, side in (*marks, (calls.max() / 1e3, "worst", "right")):
        axes.axvline(value, **style.GUIDE)
        where = dict(xycoords=("data", "axes fraction"), va="bottom", ha=side)
        axes.annotate(f"{word} {value:.4g} µs", (value, 1.02), **where, **style.NOTE)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="time of a call, the clock's own in it [µs]",
        ylabel=f"calls of {len(calls):,}",
    )
    return fig


def on_arm(folder) -> dict:
    """Whether ARM gives the same numbers (under qemu)."""
    law, found = cases.ROBOTS["panda"]().law, {}
    for runtime, name in ((None, "all parameters at run time"), ((), "all compiled in")):
        at = ck.export.c(law, out=folder / f"arm{runtime is None}", method="EE", dtype="float", runtime=runtime)
        for cpu in ("arm-linux-gnueabihf", "aarch64-linux-gnu"):
            emulator = "qemu-" + cpu.split("-")[0]
            if shutil.which(f"{cpu}-gcc") and shutil.which(emulator):
                _run(f"{cpu}-gcc -std=c99 -O2 -ffp-contract=off -static clik_step.c example.c -lm -o {cpu}", at)
                found[f"{emulator}, {name}"] = {"example": _run(f"{emulator} {at / cpu}", at).strip()}
    return found


def _run(line, folder) -> str:
    done = subprocess.run(line, shell=True, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{line}: {done.stdout} {done.stderr}")
    return done.stdout


def table(found) -> str:
    """What was to be reached, and what was measured."""
    steps, us = found["steps"], found["steps"]["microseconds"]
    rounds = steps["rounds"]

    def ratio(a, b):
        return float(np.median(np.array(rounds[a]) / np.array(rounds[b])))

    rows = [
        ("Panda pose step, damped, EE, float64, from C, against Pinocchio C++", "at least 2.5×",
         f"{ratio('Pinocchio C++', 'C from C'):.3g}× ({us['C from C']:.3g} and {us['Pinocchio C++']:.3g} µs)"),
        ("the same with the gain and its like compiled in, and a target at rest", "",
         f"{ratio('Pinocchio C++', 'C from C, parameters compiled in'):.3g}×"),
        ("export and compile", "under 2 s", f"{steps['built_s']:.2g} s"),
    ]  # fmt: skip
    calls = np.asarray(found["calls"])
    worst = f"{calls.max() / np.median(calls):.3g}× ({calls.max() / 1e3:.3g} and {np.median(calls) / 1e3:.3g} µs)"
    rows.append(("worst of 1e6 calls over their median, on one core", "reported", worst))
    for name, value in found["arm"].items():
        rows.append((name, "reported", value["example"]))
    return markdown(("what", "to reach", "measured"), rows, left=3)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.export", description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--out", type=pathlib.Path, default=RESULTS)
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    found = {"steps": measure(args.rounds)}
    with tempfile.TemporaryDirectory() as folder:
        found["arm"] = on_arm(pathlib.Path(folder))
    calls = found["steps"].pop("calls")
    args.out.mkdir(parents=True, exist_ok=True)
    draw({"calls.png": (lambda: histogram(calls), {"Title": "time of each of many calls"})}, args.out)
    found |= {"machine": document.machine(), "measured": time.strftime("%Y-%m-%d"), "load": os.getloadavg()[0]}
    found["calls"] = [int(v) for v in np.percentile(calls, [*np.linspace(0, 100, 201), 99.9, 99.99])]
    (args.out / "export.json").write_text(json.dumps(found, indent=1) + "\n")
    text = table(found)
    page = f"# What the exported step does\n\n`python -m tests.bench.export` on {_machine(found)}:\n\n{text}\n"
    page += "![Time of each of a million calls](calls.png)\n"
    (args.out / "README.md").write_text(page, encoding="utf-8")
    print(text, file=sys.stderr)


def _machine(found) -> str:
    return "{processor}, {cores} cores, {vectors}, {system}, JAX {jax}, load {load}".format(**found["machine"])


if __name__ == "__main__":
    main()
