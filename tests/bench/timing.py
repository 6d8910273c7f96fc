"""How the benches time: CPU seconds on one core, everything in turn, ratios within a round, medians."""

import importlib.metadata
import os
import platform
import resource
import statistics
import time

import jax


def spent() -> float:
    """CPU seconds of this process, and of those it has waited for, such as a compiler."""
    uses = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(use.ru_utime + use.ru_stime for use in uses)


def one_core() -> None:
    """Hold this process to one core; before JAX counts them, which is on first use."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def first(call) -> float:
    """CPU seconds of a first call, its compiler's in it."""
    begun = spent()
    jax.block_until_ready(call())
    return spent() - begun


def cpu(call, least=0.0, clock=time.process_time) -> float:
    """CPU seconds of a call: the median of those in so many seconds, at least one."""
    times, stop = [], time.perf_counter() + least
    while not times or time.perf_counter() < stop:
        begun = clock()
        jax.block_until_ready(call())
        times.append(clock() - begun)
    return statistics.median(times)


def in_turn(calls, rounds, least=0.0) -> dict:
    """{name: seconds of a call in each round} of calls {name: call}, each of which has run before."""
    times: dict = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            times[name].append(cpu(call, least))
    return times


def ratio(slow, fast) -> float:
    """How many times faster: the median of the ratios round by round."""
    return statistics.median(a / b for a, b in zip(slow, fast, strict=True))


def machine() -> dict:
    """What the numbers were measured on."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            info = file.read()
    except OSError:
        info = ""
    names = [line.split(":", 1)[1].strip() for line in info.splitlines() if line.startswith("model name")]
    vectors = next((name for flag, name in (("avx512f", "AVX-512"), ("avx2", "AVX2")) if flag in info), "unknown")
    return {
        "processor": names[0] if names else platform.processor(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "vectors": vectors,
        "system": platform.system(),
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in ("jax", "jaxlib")},
        "load": round(os.getloadavg()[0], 1),
    }


def on(found) -> str:
    """A machine in words."""
    return "{processor}, {cores} cores, {vectors}, {system}, Python {python}, JAX {jax}, load {load}".format(**found)
