"""The suite runs in float64; float32 has tests of its own with their own tolerances.

Programs are compiled once for all workers, and for the next run: in JAX's persistent cache, which keys them by their
content, compiler and flags.
"""

import importlib.metadata
import os
import pathlib
import tempfile

os.environ.setdefault("MPLBACKEND", "agg")
os.environ.setdefault("JAX_PLATFORMS", "cpu")
# One thread per xdist worker, as several share few cores; and programs that run once are ready sooner less optimised,
# with XLA's older emitters where it still has them. CI runs a part of the suite with the defaults.
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_cpu_multi_thread_eigen=false --xla_backend_optimization_level=0"
    + " --xla_cpu_use_fusion_emitters=false" * importlib.metadata.version("jaxlib").startswith("0.10."),
)
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", os.path.join(tempfile.gettempdir(), f"cnclik-tests-{os.getuid()}"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.2")

import gc

import jax
import pytest

from cnclik.hints import use_form

jax.config.update("jax_enable_x64", True)
MOST_MEMORY = 2 << 30


# Long ones whose meaning a sibling keeps in the quick suite (another size, method, task): `-m slow` runs them.
SLOW = frozenset(
    [
        "test_gradients.py::test_orientation_loop[ordinary]",
        "test_gradients.py::test_damped_loops[CN-ordinary]",
        "test_gradients.py::test_damped_loops[EE-ordinary]",
        "test_gradients.py::test_other_gains[per axis]",
        "test_solve.py::test_hints_change_nothing_but_speed",
        "test_implicit.py::test_unrolled_derivative_is_that_of_the_passes[stage0]",
        "test_implicit.py::test_implicit_derivative_is_that_of_the_root[newton]",
        "test_dense.py::test_against_numpy[(5, 6)]",
        "test_dense.py::test_against_numpy[(6, 6)]",
        "test_dense.py::test_least_singular_value[(6, 6)]",
        "test_dense.py::test_derivative_at_full_rank[(2, 5)]",
        "test_dense.py::test_the_quick_way_is_as_good_as_any[float64]",
        "test_limits.py::test_saturation_keeps_the_task_where_it_can_be_kept[6]",
        "test_timing.py::test_targets_can_be_reached_and_starts_differ[chain30]",
        "test_timing.py::test_final_is_the_end_of_solve[ur5-method1-stage1]",
        "test_metrics.py::test_a_float32_run_has_the_metrics_of_the_float64_one[position, redundant]",
        "test_real_robots.py::test_a_loop_of_500_steps_is_pinocchios[PR2 arm]",
        "test_store.py::test_two_kills",
        "test_sweep.py::test_long_histories_and_every_metric_of_them",
        "test_float32.py::test_advice_is_the_same[redundant position]",
        "test_cli_bench.py::test_json_is_all_there_is_on_stdout",
    ]
)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        if f"{item.path.name}::{item.name}" in SLOW:
            item.add_marker(pytest.mark.slow)
    items.sort(
        key=lambda item: item.path.name != "test_docs.py"
    )  # the longest file first: no worker waits for it alone


@pytest.fixture(autouse=True)
def _form(request):
    """Programs in the rolled form, which are soon ready, but where a test's module or mark says otherwise."""
    mark = request.node.get_closest_marker("form")
    with use_form(mark.args[0] if mark else "rolled"):
        yield


@pytest.fixture(autouse=True, scope="module")
def _forget_programs():
    """A module's big programs are of no use to the next: without this a worker keeps gigabytes of them."""
    yield
    if _memory() > MOST_MEMORY:
        jax.clear_caches()
        gc.collect()


def _memory():
    """Bytes that this process holds; infinite where the system doesn't tell."""
    try:
        return int(pathlib.Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError):
        return float("inf")
