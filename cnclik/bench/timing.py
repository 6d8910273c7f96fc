"""How fast this machine runs the loop: compile time, evaluations per second, memory, cost of a gradient.

One `Line` is one measurement, taken by `measure` in a process of its own (`measure_apart`), so that neither
memory nor warm caches of one line show in the next. Many loops run side by side, each from its own start
to its own target, and are reduced to their final error as they go: no trajectory is stored.
"""

import dataclasses
import functools
import json
import math
import os
import statistics
import subprocess
import sys
import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.hints import one_function
from cnclik.integrate.lanes import lanes
from cnclik.integrate.method import METHODS
from cnclik.integrate.solve import advance, cast, evaluations_per_step, solve
from cnclik.integrate.stage import chord, newton, picard
from cnclik.law import reference as ref
from cnclik.law.inverse import damped, pseudoinverse
from cnclik.law.law import Law, evaluate
from cnclik.law.task import pose as pose_task
from cnclik.law.task import position
from cnclik.robot import spatial as sp
from cnclik.robot.builtin import panda, ur5
from cnclik.robot.chain import Chain, from_dh, planar_arm
from cnclik.robot.kinematics import pose

ALPHA, TS = 5.0, 0.1  # the paper's: z = 0.5
DAMPING = 0.1
STEPS, STEPS_OF_GRADIENT = 50, 20
EVALUATIONS = 10_000_000  # per run, about: a large batch takes fewer steps
LANES_OF_GRADIENT = 4096  # at most; reverse mode keeps what every step computed


@dataclasses.dataclass(frozen=True, kw_only=True)
class Line:
    """What one line of the table measures. `cores` None: all this process may use; `N` None: chosen by cost."""

    robot: str
    method: str
    stage: str
    M: int = 5
    dtype: str = "float32"
    batch: int = 4096
    cores: int | None = None
    N: int | None = None
    gradient: bool = False

    def __post_init__(self):
        errors.one_of("robot", self.robot, ROBOTS)
        errors.one_of("method", self.method, METHODS)
        errors.one_of("stage", self.stage, STAGES)
        errors.one_of("dtype", self.dtype, ("float32", "float64"))
        errors.integer("M", self.M, at_least=0)
        errors.integer("batch", self.batch, at_least=1)
        if self.N is not None:
            errors.integer("N", self.N, at_least=1)
        if self.cores is not None:
            errors.integer("cores", self.cores, at_least=1)
            if self.cores > len(cores_here()):
                raise errors.fail("cores", f"be at most {len(cores_here())} on this machine", f"is {self.cores}")


# --- the loops that are timed -------------------------------------------------------------------------


class Case(NamedTuple):
    """A robot's law, and the posture around which loops start and targets lie."""

    law: Law
    posture: tuple
    spread: float  # [rad] of both


def chain_of_30() -> Chain:
    """30 revolute joints, neighbours' axes at right angles, links of 0.1 m: a snake arm of 3 m."""
    turns = [math.pi / 2 if i % 2 == 0 else -math.pi / 2 for i in range(30)]
    return from_dh(a=[0.1] * 30, alpha=turns, d=[0.0] * 30)


def _planar(n):
    law = Law(planar_arm([1.0] * n, clockwise=True), position("xy"), alpha=ALPHA, inverse=pseudoinverse())
    return Case(law, (0.0, math.pi / 2, *[0.0] * (n - 2)), 0.2)


def _spatial(chain, posture):
    return Case(Law(chain, pose_task(), alpha=ALPHA, inverse=damped(DAMPING)), posture, 0.2)


# The paper's arms on their position with J#, the others on their whole pose with damped least squares.
ROBOTS = {
    "planar2": lambda: _planar(2),
    "planar5": lambda: _planar(5),
    "panda": lambda: _spatial(panda(), (0.0, -math.pi / 4, 0.0, -3 * math.pi / 4, 0.0, math.pi / 2, math.pi / 4)),
    "ur5": lambda: _spatial(ur5(), (0.0, -1.2, 1.8, -2.2, -math.pi / 2, 0.0)),
    "chain30": lambda: _spatial(chain_of_30(), (0.3,) * 30),
}
STAGES = {"picard": picard, "chord": chord, "newton": newton}
STAGE_OF = {"TRAPEZOID": "chord"}  # others: picard, as in the paper


def inputs(case: Case, batch: int, dtype) -> dict:
    """Starts q0 (batch, n) and targets, each lane its own: position (batch, 3), rotation (batch, 3, 3).

    Targets are poses of nearby joint values, so that all can be reached; there are at most 4096 different ones.
    """
    draw = np.random.default_rng(0)
    n, few = len(case.posture), min(batch, 4096)
    q0 = case.posture + case.spread * draw.uniform(-1, 1, (batch, n))
    goals = case.posture + case.spread * draw.uniform(-1, 1, (few, n))
    with jax.enable_x64(True):
        at = jax.jit(jax.vmap(lambda q: pose(case.law.chain, q)))(goals)
    named = {"q0": q0, "position": np.resize(at.position, (batch, 3))}
    if case.law.task.orientation:
        named["rotation"] = np.resize(at.rotation, (batch, 3, 3))
    return {name: np.asarray(value, dtype) for name, value in named.items()}


def final(law, reference, q0, Ts, N, method, stage):
    """The end of a loop of N steps, none of it stored: (q (n,), ‖e‖)."""
    law, reference = cast((law, reference), q0.dtype)
    k = jnp.arange(N + 1).astype(q0.dtype)

    @one_function
    def march(law, reference, q0, Ts, stage, k):
        one = lambda q, k: (advance(law, reference, q, k * Ts, Ts, method, stage).q, None)  # noqa: E731
        q, _ = lax.scan(one, tuple(q0), k[:-1])
        return q, evaluate(law, reference, k[-1] * Ts, q).e

    q, e = march(law, reference, q0, jnp.asarray(Ts, q0.dtype), stage, k)
    return jnp.stack(q), jnp.sqrt(sp.dot(e, e))


def loop(case: Case, N: int, method, stage):
    """`final` as a function of one lane's start and target."""

    def one(q0, position, rotation=None):
        return final(case.law, ref.hold(position, rotation), q0, TS, N, method, stage)

    return one


def tracking_loss(case: Case, N: int, method, stage):
    """Mean of ‖e‖² over a loop's N + 1 instants, as a function of alpha and one lane's start and target."""

    def loss(alpha, q0, position, rotation=None):
        law = dataclasses.replace(case.law, alpha=alpha)
        e = solve(law, ref.hold(position, rotation), q0, TS, N, method, stage).e
        return jnp.mean(jnp.sum(e * e, axis=1))

    return loss


# --- measuring ----------------------------------------------------------------------------------------


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


def clock(call) -> float:
    """Seconds of one call, results ready."""
    start = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - start


def repeat(call, seconds: float, at_least=3) -> Timing:
    """A warm call again and again for about so many seconds, after one more as a warm-up."""
    clock(call)
    durations, end = [], time.perf_counter() + seconds
    while len(durations) < at_least or time.perf_counter() < end:
        durations.append(clock(call))
    return timing(durations)


def steps_for(line: Line, per_step: int) -> int:
    """50 steps, fewer for batches so large that a run would take long."""
    return line.N or min(max(EVALUATIONS // (line.batch * per_step), 3), STEPS)


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
    case, method = ROBOTS[line.robot](), METHODS[line.method]
    stage = STAGES[line.stage](line.M)
    per_step = evaluations_per_step(method, stage, case.law.chain.n)
    N = steps_for(line, per_step)
    named = inputs(case, line.batch, line.dtype)
    base = peak_mib()
    end = loop(case, N, method, stage)
    run = functools.partial(lanes(lambda *lane: end(*lane)[1], cores=line.cores), *named.values())
    first = clock(run)
    run_s = repeat(run, seconds)
    record = dataclasses.asdict(line) | {
        "N": N,
        "cores": line.cores or len(cores_here()),
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

    found, out = {}, {"gradient_batch": len(some["q0"]), "gradient_N": N}
    for name, fn in {"forward": value, "gradient": reverse, "alpha_gradient": forward}.items():
        # Not `lanes`: a gradient compiled as one function per tile takes a minute to compile.
        run = functools.partial(jax.jit(jax.vmap(fn)), *some.values())
        first, run_s = clock(run), repeat(run, seconds)
        found[name] = run_s.median
        out |= {f"{name}_s": run_s.median, f"{name}_compile_s": max(first - run_s.median, 0.0)}
    return out | {f"{name}_over_forward": found[name] / found["forward"] for name in ("gradient", "alpha_gradient")}


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


def cores_here() -> list:
    """The cores that this process may use."""
    try:
        return sorted(os.sched_getaffinity(0))
    except AttributeError:  # not Linux
        return list(range(os.cpu_count() or 1))


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
    environment = dict(os.environ)
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    if cache is not None:
        environment |= {
            "JAX_COMPILATION_CACHE_DIR": cache,
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
            "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
        }
    task = json.dumps({"line": dataclasses.asdict(line), "seconds": seconds})
    command = [sys.executable, "-m", "cnclik.bench.timing", task]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if done.returncode != 0:
        said = done.stderr.strip().splitlines() or [f"ended with {done.returncode}"]
        raise LineError(said[-1])
    return json.loads(done.stdout.splitlines()[-1])


def _child(task: str) -> None:
    task = json.loads(task)
    line = Line(**task["line"])
    # Before JAX starts its threads: it makes as many as there are cores it may use.
    if line.cores is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores_here()[-line.cores :])
    jax.config.update("jax_enable_x64", line.dtype == "float64")
    print(json.dumps(measure(line, task["seconds"])))


if __name__ == "__main__":
    _child(sys.argv[1])
