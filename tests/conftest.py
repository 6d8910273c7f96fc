"""The suite runs in float64; float32 has tests of its own with their own tolerances.

Programs are compiled once for all workers, and for the next run: in JAX's persistent cache, which keys them by their
content, compiler and flags.
"""

import importlib.metadata
import os
import pathlib
import tempfile

os.environ.setdefault("MPLBACKEND", "agg")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # NumPy's own threads: workers share few cores
os.environ.setdefault("JAX_PLATFORMS", "cpu")
# One thread per xdist worker, as several share few cores; and programs that run once are ready sooner less optimised,
# with XLA's older emitters where it still has them. CI runs a part of the suite with the defaults.
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_cpu_multi_thread_eigen=false --xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1"
    + " --xla_cpu_use_fusion_emitters=false" * importlib.metadata.version("jaxlib").startswith("0.10."),
)
# The same of C (the last optimisation of a line counts): less than half the time of -O2; and where LONG says that
# runs are long, -Og, which takes two thirds. (Clang's -Og is -O1.)
os.environ.setdefault("CFLAGS", "-O0")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", os.path.join(tempfile.gettempdir(), f"cnclik-tests-{os.getuid()}"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.2")
os.environ.setdefault("JAX_TRACEBACK_IN_LOCATIONS_LIMIT", "1")  # a tenth of the time of tracing goes into the rest

import gc

import jax
import pytest

from cnclik.cache import give_back

jax.config.update("jax_enable_x64", True)
gc.set_threshold(50_000, 20, 50)  # tracing makes millions of short-lived objects: seldom look for cycles among them
LONG = {"test_near", "test_search", "stress"}  # files and folders
LONGEST = [
    *("combinations", "docs", "several", "near", "native", "reach", "programs", "primitives", "tune", "gradients"),
    *("bounded", "step", "ending", "cli_solve", "walls", "inverse", "files", "store", "gains", "cli", "bank", "bases"),
]


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """The longest files first: no worker waits for one alone. Without workers the order is the user's."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return
    places = {f"test_{name}.py": i for i, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path.name, len(places)))


@pytest.fixture(autouse=True, scope="module")
def _forget_programs(request):
    """A module's big programs are of no use to the next: without this a worker keeps gigabytes of them."""
    gc.freeze()  # each sweep collects: what was there before is not looked through again, a seventh of the time
    with pytest.MonkeyPatch.context() as patch:
        if LONG & {request.path.stem, request.path.parent.name} and os.environ["CFLAGS"] == "-O0":
            patch.setenv("CFLAGS", "-Og")
        yield
    if _is_large():
        gc.unfreeze()
        jax.clear_caches()
        give_back()  # else the next module pays for it again


def _is_large() -> bool:
    """Whether this process holds 3 GB, or its share of half the memory; so where the system doesn't tell."""
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    try:
        held = int(pathlib.Path("/proc/self/statm").read_text().split()[1])
        return held > min((3 << 30) // os.sysconf("SC_PAGE_SIZE"), os.sysconf("SC_PHYS_PAGES") // (2 * workers))
    except (OSError, ValueError):
        return True
