"""`python -m tests.bench.export`: the exported step beside Pinocchio C++ and JAX, and its worst call (a minute).

In turn on one core; ratios are taken within a round. results/export has the table. Needs g++ and the extra `bench`.
`budget.py` has the step's size on a microcontroller.
"""

import ctypes
import functools
import pathlib
import statistics
import tempfile
import time

import jax
import numpy as np

import cnclik as ck
from cnclik.measure.files import markdown
from tests.bench import cases, timing
from tests.bench.pinocchio_cpp import PinocchioCpp
from tests.export.native import built, native

CALLS, ROUNDS, IN_A_ROW, FEW = 1_000_000, 7, 20_000, 200
HARNESS = """
#include <stdint.h>
#include <time.h>
typedef int32_t (*function)(const void *, const void *, void *);
static int64_t now(void)
{
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}
void calls(int64_t count, function step, const void *a, const void *b, void *out, int64_t *ns)
{
  int64_t k;
  for (k = 0; k < count; ++k) {
    const int64_t begun = ns ? now() : 0;
    step(a, b, out);
    if (ns) ns[k] = now() - begun;
  }
}
"""


def exported(given, fixed):
    """A Panda's pose step as C: (what calls it so many times from C, seconds of its export and compilation).

    fixed: the target is held still, and nothing else but it may be set.
    """
    begun = time.perf_counter()
    reference = ck.hold(*given[1:]) if fixed else None
    step = native(cases.case().law, reference, method="EE", runtime=("position", "rotation") if fixed else None)
    step(*given[: 1 if fixed else 3], Ts=cases.TS)
    seconds = time.perf_counter() - begun
    with tempfile.TemporaryDirectory() as folder:
        source = pathlib.Path(folder, "harness.c")
        source.write_text(HARNESS, encoding="utf-8")
        harness = built(source, "-D_POSIX_C_SOURCE=200809L")
    arguments = [ctypes.cast(step.function, ctypes.c_void_p), *map(ctypes.c_void_p, step.addresses)]

    def calls(count, ns=None, kept=step):  # which owns the memory of the arguments
        harness.calls(ctypes.c_int64(count), *arguments, ctypes.c_void_p(ns))

    return calls, seconds


def main():
    """Print the table."""
    given = [np.asarray(v[0]) for v in cases.inputs(cases.case(), 1, "float64").values()]
    (free, seconds), (fixed, _) = exported(given, False), exported(given, True)
    solver = PinocchioCpp(*cases.panda_matrices(), "float64")
    settings = dict(alpha=cases.ALPHA, Ts=cases.TS, damping=cases.DAMPING, M=None, N=IN_A_ROW)
    law, reference, q = *jax.device_put((cases.case().law, ck.hold(*given[1:]))), jax.numpy.asarray(given[0])

    def by_jax():
        for _ in range(FEW):
            ck.step(law, reference, q, 0.0, cases.TS, "EE").q.block_until_ready()

    calls = {
        "C from C": functools.partial(free, IN_A_ROW),
        "C from C, parameters compiled in": functools.partial(fixed, IN_A_ROW),
        "Pinocchio C++": lambda: solver.run(*(v[None] for v in given), **settings),
        "JAX step from Python": by_jax,
    }
    by_jax()
    times = timing.in_turn(calls, ROUNDS)
    rows = []
    for name, each in times.items():
        count = FEW if name.startswith("JAX") else IN_A_ROW
        ratio = timing.ratio([t / IN_A_ROW for t in times["Pinocchio C++"]], [t / count for t in each])
        rows.append((name, f"{1e6 * statistics.median(each) / count:.3g} µs", f"{ratio:.3g}×"))
    ns = np.zeros(CALLS, np.int64)
    free(CALLS, ns.ctypes.data)
    rows.append(
        (f"worst of {CALLS:,} calls", f"{ns.max() / 1e3:.3g} µs", f"{ns.max() / np.median(ns):.3g}× the median")
    )
    rows.append(("export and compile", f"{seconds:.2g} s", ""))
    print(timing.on(timing.machine()), markdown(("float64", "measured", "over Pinocchio"), rows), sep="\n\n")


if __name__ == "__main__":
    timing.one_core()
    jax.config.update("jax_enable_x64", True)
    main()
