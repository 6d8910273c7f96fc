"""How fast this machine runs the loop: compile time, evaluations per second, memory, cost of a gradient.

One `Line` is one measurement, taken by `measure` in a process of its own (`measure_apart`), so that neither
memory nor warm caches of one line show in the next. Many loops run side by side, each from its own start
to its own target, and are reduced to their final error as they go: no trajectory is stored.
"""

import dataclasses
import functools
import json
import os
import statistics
import subprocess
import sys
import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik.integrate.lanes import lanes
from cnclik.integrate.method import METHODS, evaluations_per_step
from cnclik.problem.names import stage_from
from cnclik.threads import cores
from tests.bench.cases import ALPHA, ROBOTS, inputs, loop, tracking_loss
from tests.bench.lines import Line

STEPS, LEAST_STEPS, STEPS_OF_GRADIENT = 50, 25, 20  # the end is looked at too: of few steps a large share
EVALUATIONS = 10_000_000  # per run, about: a large batch takes fewer steps
LANES_OF_GRADIENT = 4096  # at most; reverse mode keeps what every step computed


class Timing(NamedTuple):
    """Seconds of one run: median and quartiles of `runs` runs."""

    median: float
    low: float
    high: float
    runs: int

    @property
    def spread(self) -> float:
        """Distance of the quartiles over the median."""
        return (self.high - self.low) / self.median


def timing(durations) -> Timing:
    """Median and quartiles of some durations [s]."""
    durations = list(durations)
    if len(durations) == 1:
        return Timing(*durations * 3, 1)
    low, median, high = statistics.quantiles(durations, n=4, method="inclusive")
    return Timing(median, low, high, len(durations))


def clock(call, wait=jax.block_until_ready) -> float:
    """Seconds of one call, results ready."""
    start = time.perf_counter()
    wait(call())
    return time.perf_counter() - start


def repeat(call, seconds: float, at_least=3, wait=jax.block_until_ready) -> Timing:
    """A warm call again and again for about so many seconds, after one more as a warm-up."""
    clock(call, wait)
    durations, end = [], time.perf_counter() + seconds
    while len(durations) < at_least or time.perf_counter() < end:
        durations.append(clock(call, wait))
    return timing(durations)


def steps_for(line: Line, per_step: int) -> int:
    """50 steps, fewer for batches so large that a run would take long."""
    return line.N or min(max(EVALUATIONS // (line.batch * per_step), LEAST_STEPS), STEPS)


def measure(line: Line, seconds: float = 1.0) -> dict:
    """Measure one line in this process: first the loop, then, if asked for, value and gradient.

    Returns the line's fields, and:
      device, jax: what it ran on; N and cores as run.
      evaluations_per_second: of f(q, t), each a forward kinematics, Jacobian, error and inverse.
      run_s, spread, runs: median time of one run, distance of its quartiles over it, number of runs [s].
      compile_s: the first call less one run: tracing and compiling [s].
      peak_mib, base_mib: largest memory, after the runs and before the first; on a GPU, of the device [MiB].
      error: mean of the lanes' final ‖e‖.
      gradient_over_forward: None, or what `gradients` tells.
    """
    case, method, stage = ROBOTS[line.robot](), METHODS[line.method], stage_from(line.stage, line.M)
    per_step = evaluations_per_step(method, stage, case.law.chain.n)
    N = steps_for(line, per_step)
    named = inputs(case, line.batch, line.dtype)
    base = peak_mib()
    end = loop(case, N, method, stage)
    run = functools.partial(lanes(lambda *lane: end(*lane)[1], cores=line.cores), *named.values())
    first, run_s = clock(run), repeat(run, seconds)
    record = dataclasses.asdict(line) | {
        "N": N,
        "cores": line.cores or cores(),
        "device": device(),
        "jax": jax.__version__,
        "evaluations_per_second": line.batch * N * per_step / run_s.median,
        "run_s": run_s.median,
        "spread": run_s.spread,
        "runs": run_s.runs,
        "compile_s": max(first - run_s.median, 0.0),
        "peak_mib": peak_mib(),
        "base_mib": base,
        "error": float(np.mean(run())),
        "gradient_over_forward": None,
    }
    return record | (gradients(line, case, method, stage, named, seconds) if line.gradient else {})


def gradients(line, case, method, stage, named, seconds) -> dict:
    """Times [s] of the tracking loss and of loss and gradient, all as `jit(vmap(...))`; ratios; compile times."""
    N = min(steps_for(line, evaluations_per_step(method, stage, case.law.chain.n)), STEPS_OF_GRADIENT)
    some = {name: value[:LANES_OF_GRADIENT] for name, value in named.items()}
    loss, alpha = tracking_loss(case, N, method, stage), jnp.asarray(ALPHA, line.dtype)

    def value(*lane):
        return loss(alpha, *lane)

    def reverse(*lane):
        return jax.value_and_grad(value)(*lane)

    def forward(*lane):
        return jax.jvp(lambda a: loss(a, *lane), (alpha,), (jnp.ones_like(alpha),))

    out = {"gradient_batch": len(some["q0"]), "gradient_N": N}
    for name, fn in {"forward": value, "gradient": reverse, "alpha_gradient": forward}.items():
        # Not `lanes`: a gradient compiled as one function per tile takes a minute to compile.
        run = functools.partial(jax.jit(jax.vmap(fn)), *some.values())
        first, run_s = clock(run), repeat(run, seconds)
        out |= {f"{name}_s": run_s.median, f"{name}_compile_s": max(first - run_s.median, 0.0)}
    ratios = {f"{name}_over_forward": out[f"{name}_s"] / out["forward_s"] for name in ("gradient", "alpha_gradient")}
    return out | ratios


def peak_mib() -> float:
    """Largest memory so far: of the device where it keeps count, else of this process [MiB]."""
    counted = jax.local_devices()[0].memory_stats() or {}
    if "peak_bytes_in_use" in counted:
        return counted["peak_bytes_in_use"] / 2**20
    try:
        # Not resource.getrusage alone: what it tells starts from the peak of the process that started this one.
        with open("/proc/self/status") as status:
            return next(int(row.split()[1]) for row in status if row.startswith("VmHWM")) / 2**10
    except (OSError, StopIteration):
        import resource

        unit = 2**20 if sys.platform == "darwin" else 2**10
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def device() -> str:
    """Name of what the loops run on."""
    first = jax.local_devices()[0]
    return processor() if first.platform == "cpu" else first.device_kind


def processor() -> str:
    """Name of the processor."""
    import platform

    try:
        with open("/proc/cpuinfo") as info:
            return next(row.split(":", 1)[1].strip() for row in info if row.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def hold_to(count: int) -> None:
    """Hold this process to so many cores, the last of those it may use, where the system can.

    Before JAX starts its threads, which is on first use: it makes as many as there are cores.
    """
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-count:])


# --- a process per line -------------------------------------------------------------------------------


class LineError(RuntimeError):
    """A line that could not be measured; the message is its process's last word."""


def measure_apart(line: Line, seconds: float = 1.0, *, cache: str | None = None) -> dict:
    """`measure` in a fresh process that is held to `line.cores` cores.

    Args:
      seconds: time for the repeated runs of each program.
      cache: folder for JAX's persistent compilation cache; None: none is used.
    Raises: LineError if the process fails.
    """
    environment = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
    if cache is not None:
        environment |= {
            "JAX_COMPILATION_CACHE_DIR": cache,
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
            "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
        }
    task = json.dumps({"line": dataclasses.asdict(line), "seconds": seconds})
    command = [sys.executable, "-c", "from tests.bench.timing import child; child()", task]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if done.returncode != 0:
        said = done.stderr.strip().splitlines() or [f"ended with {done.returncode}"]
        raise LineError(said[-1])
    return json.loads(done.stdout.splitlines()[-1])


def child() -> None:
    """What that process does: its task is its argument, and what it prints last is the record."""
    task = json.loads(sys.argv[1])
    line = Line(**task["line"])
    if line.cores is not None:
        hold_to(line.cores)
    jax.config.update("jax_enable_x64", line.dtype == "float64")
    print(json.dumps(measure(line, task["seconds"])))
