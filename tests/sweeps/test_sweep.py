"""Sweeps against a plain Python loop over `solve`: labels, traces, blocks, refusals; their summaries against NumPy."""

import csv
import itertools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray

import cnclik as ck
from cnclik.measure.metrics import Metrics, measure_run
from cnclik.sweeps import grid as programs
from cnclik.sweeps import summarize, summary
from cnclik.sweeps.axes import axis
from cnclik.sweeps.grid import Grid
from cnclik.sweeps.sweep import sweep
from cnclik.writing import output_folder
from tests.refusals import refusals

ARM = ck.planar_arm([1.0, 1.0], clockwise=True)
Q0 = np.array([0.0, np.pi / 2])
PATH = ck.line([1.0, 1.0], [0.0, 1.0], duration=0.6)
METRICS = ["final_error", "rms_along", "max_qdot", "evaluations"]  # all of them are in tests/measure
N = 8


def loop(alpha, Ts, M, method):
    law = ck.Law(ARM, ck.position("xy"), alpha=alpha)
    return law, ck.solve(law, PATH, Q0, Ts, N, method, ck.picard(M, maximum=3))


def test_a_sweep_is_a_plain_double_loop_over_solve():
    traces = []

    def study(alpha, Ts, M, method):
        traces.append(method)
        law, run = loop(alpha, Ts, M, method)
        return measure_run(run, law, PATH, METRICS, tolerance=0.01)

    axes = {
        "method": [ck.METHODS["EE"], ck.METHODS["CN"]],
        "alpha": [2.0, 5.0, 12.0],
        "Ts": jnp.array([0.05, 0.1]),
        "M": np.array([0, 3]),
    }
    # Blocks of four of the twelve points: several of them, the last of each program padded or not.
    found = sweep(study, lanes=5, **axes)
    assert traces == [ck.METHODS["EE"], ck.METHODS["CN"]]  # one trace per program
    assert found.final_error.dims == tuple(axes)
    for place in itertools.product(*(range(len(values)) for values in axes.values())):
        at = dict(zip(axes, place, strict=True))
        method, alpha, Ts, M = (values[i] for values, i in zip(axes.values(), place, strict=True))
        law, run = loop(alpha, float(Ts), np.array(int(M)), method)
        wanted = measure_run(run, law, PATH, METRICS, tolerance=0.01)
        for name in METRICS:
            np.testing.assert_allclose(found[name].isel(at), wanted[name], rtol=1e-9, atol=1e-11, err_msg=name)


def cheap(alpha, Ts=1.0):
    return {"z": alpha * Ts, "history": alpha * jnp.arange(3.0)}


def test_coordinates_units_and_configuration_are_labelled():
    found = sweep(cheap, alpha=[1.0, 2.0], Ts=np.array([0.1, 0.2, 0.3]))
    assert dict(found.sizes) == {"alpha": 2, "Ts": 3, "history_0": 3}
    units = {"alpha": "1/s", "Ts": "s", "history": "", "z": "1"}
    assert {name: variable.attrs["units"] for name, variable in found.variables.items()} == units
    assert float(found.z.sel(alpha=2.0, Ts=0.3)) == pytest.approx(0.6, rel=1e-15)
    either = sweep(lambda unit: Metrics([jnp.ones(())], {"ok": unit}), unit={"a": "m", "b": "rad", "c": "m"})
    assert either.ok.units == "m or rad"
    assert found.attrs["jax"] == jax.__version__
    assert json.loads(found.attrs["config"])["axes"]["Ts"] == [0.1, 0.2, 0.3]


def test_axes_of_vectors_objects_and_labelled_values():
    target = np.array([[1.0, 5.0], [2.0, 6.0], [3.0, 7.0]])
    found = sweep(
        lambda arm, target, M, gain: {"value": arm * target[0] + M + gain.sum()},
        **{"arm": {"short": 1.0, "long": 2.0}, "target": target, "M": [1, 2], "gain": [[1.0, 1.0], [2.0, 2.0]]},
    )
    assert list(found.arm.values) == ["short", "long"] and list(found.target.values) == [0, 1, 2]
    np.testing.assert_array_equal(found.target_value, target)
    assert float(found.value.sel({"arm": "long", "target": 2, "M": 2, "gain": 1})) == 2 * 3 + 2 + 4


def test_a_record_is_its_fields_whatever_it_remembers():
    """Such as how it was taken apart, and its hash."""

    def study(pull):
        made = ck.posture([0.1, 0.2], pull)
        assert jax.tree.leaves(made) and hash(made)
        return made

    data = ck.sweep(study, pull=[0.5, 1.0])
    assert set(data.data_vars) == {"rest", "rate"} and np.array_equal(data.rate, [0.5, 1.0])


def test_numbers_in_a_list_are_one_program_and_N_is_compiled_in():
    traces = []

    def study(alpha, M, N, k):
        traces.append(N)
        return {"alpha_": alpha + 0.5, "M_": M + jnp.zeros(N, int).sum(), "k_": k}

    found = sweep(study, N=[2, 4], alpha=[1, 5, 10], M=[1, 3], k=range(3))
    assert traces == [2, 4] and found.alpha.dtype == found.alpha_.dtype == float  # not 1 + 0.5 = 1
    assert found.M_.dtype == found.k_.dtype == int and found.M.values.tolist() == [1, 3]
    labelled = sweep(lambda M: {"power": jnp.asarray(2.0) ** M}, M={"one": 1, "three": 3})
    assert labelled.power.values.tolist() == [2, 8] and list(labelled.M.values) == ["one", "three"]


def test_the_float64_answer_whatever_the_default():
    given = ck.Law(ARM, ck.position("xy"), alpha=1.0)

    def study(alpha, Ts):
        law = ck.replace(given, alpha=alpha)
        run = ck.solve(law, PATH, Q0, Ts, 12, "EE")
        return measure_run(run, law, PATH, ["final_error"])

    axes = {"alpha": [5, 10], "Ts": np.array([0.02, 0.1])}
    wide = sweep(study, lanes=2, **axes)
    with jax.enable_x64(False):
        own = jax.jit(lambda q: ck.solve(given, PATH, q, 0.1, 12, "EE").e[-1])  # the caller's own, of the same law
        assert own(Q0).dtype == np.float32
        found = sweep(study, lanes=2, **axes)
        twice = sweep(lambda alpha: {"twice": 2 * alpha}, alpha=jnp.array([0.5, 1.5]))
        narrow = jnp.asarray(0.1)
        single = sweep(lambda alpha: {"sum": narrow + 0 * alpha.astype(narrow.dtype)}, alpha=[1.0])
    xarray.testing.assert_identical(found, wide)
    assert found.dtype == "float64" and found.final_error.dtype == np.float64
    assert twice.twice.dtype == np.float64 and twice.alpha.dtype == np.float64
    assert single.attrs["dtype"] == "float32"  # an array of the caller's own keeps its precision, and the data show it


def test_blocks_tile_any_grid_once_and_have_one_shape():
    axes = {"a": np.arange(5.0), "m": {1: 1, 2: 2}, "b": np.arange(3.0), "c": np.arange(4.0)}
    for lanes in (1, 4, 7, 1000):
        of = Grid(tuple(axis(*each) for each in axes.items()), lanes)
        assert np.prod(of.block) <= max(lanes, 1)
        seen = np.zeros(of.shape, int)
        for block in of.blocks():
            seen[block.region] += 1
            values = of.lane_values(block)
            assert all(len(v) == np.prod(of.block) for v in values.values())
            np.testing.assert_array_equal(of.cut(block, values["b"])[0, 0, :, 0], np.arange(3.0)[block.region[2]])
            assert block.program == block.region[1].start
        assert (seen == 1).all()


def test_a_block_that_needs_too_much_memory_is_cut():
    grid = Grid((axis("alpha", np.arange(4096.0)),), 4096)
    of, program = programs.fit(lambda alpha: {"long": jnp.sin(alpha + jnp.arange(20.0))}, grid, memory=2**17)
    assert program.memory <= 2**17 and 1 < of.lanes < 4096


test_what_is_no_sweep_is_refused = refusals(
    ((3, {"alpha": [1.0]}), "be a function"),
    ((cheap, {}), "hold at least one axis"),
    ((cheap, {"alpha": 3.0}), "Argument `alpha` must be an axis"),
    ((cheap, {"alpha": []}), "hold at least one value, but is empty"),
    ((cheap, {"alpha": [1.0, np.nan]}), "hold finite values"),
    ((cheap, {"alpha": [object()]}), "be a dict"),
    ((cheap, {"alpha": [[1.0], [1.0, 2.0]]}), "hold values of one shape"),
    ((lambda value: value, {"value": [1.0]}), "names of their own, but 'value' is in the results"),
    ((lambda value_0: jnp.stack([value_0]), {"value_0": [1.0]}), "names of their own, but 'value_0' is in"),
    ((lambda N, a: {"x": jnp.zeros(N) + a}, {"N": [2, 3], "a": [1.0]}), "same names and shapes everywhere"),
    of=lambda case: sweep(case[0], **case[1]),
)


CASES = ["plain", "with, comma", 'with "quotes"', "two\nlines"]


def test_statistics_are_numpys_and_read_back_whatever_the_names(tmp_path):
    rng = np.random.default_rng(3)
    error = rng.random((4, 2, 10, 5))
    error[0, 0, 0, :2] = np.inf
    error[0, 0, 1, 0] = np.nan
    dims = ("case", "M", "alpha", "q0")
    coords = {"case": CASES, "M": [1, 5], "alpha": np.linspace(1, 2, 10), "q0": np.arange(5)}
    coords["q0_value"] = (("q0", "q0_0"), rng.random((5, 2)))
    about = {"spec": "{}", "config": json.dumps({"lanes": 8}), "question": "?", "expectation": "!"}
    histories = {"error": ((*dims, "time"), np.zeros((4, 2, 10, 5, 3)))}  # have no statistics
    data = xarray.Dataset({"final_error": (dims, error, {"units": "m"})} | histories, coords, attrs=about)
    rows = summarize(data)
    assert len(rows) == 4 * 2
    first, whole, values = rows[0], rows[-1], error[0, 0].ravel()
    finite, ranked = values[np.isfinite(values)], np.sort(values[~np.isnan(values)])
    assert (first["case"], first["M"], first["metric"], first["units"]) == ("plain", 1, "final_error", "m")
    assert first["finite"] == pytest.approx(47 / 50) and first["mean"] == pytest.approx(finite.mean())
    assert (first["min"], first["median"], first["max"]) == (finite.min(), ranked[24], np.inf)
    assert whole["median"] == np.quantile(error[3, 1], 0.5, method="lower") and whole["finite"] == 1
    assert len(summarize(data.isel(case=0, M=0, drop=True))) == 1
    labelled = summarize(data.isel(alpha=2, q0=0, drop=True))  # without an axis of numbers each loop has a row
    assert [row["max"] for row in labelled] == error[:, :, 2, 0].ravel().tolist()
    with output_folder(tmp_path) as folder:
        summary.write(data, folder)
    with (tmp_path / "summary.csv").open(newline="") as file:
        read = list(csv.DictReader(file))
    assert list(read[0]) == ["case", "M", "metric", "units", "min", "q10", "median", "q90", "max", "mean", "finite"]
    assert [row["case"] for row in read[::2]] == CASES
    np.testing.assert_allclose([float(row["median"]) for row in read], [row["median"] for row in rows], rtol=1e-5)
    assert json.loads((tmp_path / "config.json").read_text()) == {"spec": {}, "config": {"lanes": 8}}


SHAPE = (2, 2, 2, 2)
ERROR = np.arange(16.0).reshape(SHAPE)


def judged(**changes):
    """Errors of two cases over two starts, two gains and two sampling times; the first start is the easier one."""
    dims = ("case", "q0", "alpha", "Ts")
    fields = {"final_error": ERROR + 1, "over_velocity": np.zeros(SHAPE, int), "stable": np.ones(SHAPE)} | changes
    coords = {"case": ["a", "b"], "q0": [0, 1], "alpha": [2.0, 5.0], "Ts": [0.01, 0.1], "limit": np.inf}
    coords["alpha_Ts"] = (("alpha", "Ts"), np.outer(coords["alpha"], coords["Ts"]))
    data = xarray.Dataset({name: (dims, value) for name, value in fields.items()}, coords)
    data = data.assign_coords(q0_value=(("q0", "q0_0"), np.zeros((2, 3))))
    data.final_error.attrs["units"], data.alpha.attrs["units"], data.Ts.attrs["units"] = "m", "1/s", "s"
    return data


def test_the_best_loop_is_safe_and_judged_by_its_worst_start():
    fast = np.zeros(SHAPE, int)
    fast[0, 1, 0, 0] = fast[1] = 3  # of case a one start of one loop; of case b every loop
    assert summary.best(judged(over_velocity=fast)) == [
        "Case a: 3 of 4 loops are safe, the best by final_error (6 m): alpha 2 1/s, Ts 0.1 s.",
        "Case b: none of 4 loops is safe.",
    ]
    assert summary.best(judged(stable=np.full(SHAPE, np.nan)))[1].startswith("Case b: 4 of 4")  # of moving targets
    lost = judged(final_error=np.full(SHAPE, np.nan), stable=np.zeros(SHAPE))
    assert summary.best(lost)[0] == "Case a: none of 4 loops is safe."
    ties = "(1 m; 4 loops tie): alpha 2 or 5 1/s, Ts 0.01 or 0.1 s."
    same = summary.best(judged(final_error=np.ones(SHAPE)).isel(case=0, drop=True))
    assert same == [f"4 of 4 loops are safe, the best by final_error {ties}"]
    clamped = judged(over_velocity=fast).rename(q0="error_clamp", q0_value="error_clamp_value", q0_0="error_clamp_0")
    assert summary.best(clamped)[0].startswith("Case a: 7 of 8 loops are safe")  # clamps are a choice, as gains are
    assert summary.best(judged().drop_vars("final_error")) == []


@pytest.mark.filterwarnings("error")
def test_what_is_defined_nowhere_has_statistics_without_a_warning():
    rows = summarize(judged(stable=np.full(SHAPE, np.nan)))  # of moving targets
    assert np.isnan([row["median"] for row in rows if row["metric"] == "stable"]).all() and len(rows) == 6


def test_a_loop_beyond_the_linear_limit_is_not_safe():
    """Of a sweep that measures an error alone, a short run may end before it shows that it diverges."""
    data = judged(final_error=16.0 - ERROR).drop_vars(["over_velocity", "stable"])
    data = data.isel(case=0, drop=True).assign_coords(limit=0.3)
    (line,) = summary.best(data)
    assert line.startswith("3 of 4 loops are safe, ") and "alpha 5 1/s, Ts 0.01 s" in line
    assert summary.best(data.isel(Ts=1, drop=True))[0].startswith("1 of 2 loops is safe, ")
    assert summary.best(data.drop_vars("limit"))[1] == "No loop was compared with the linear limit."
    (unlimited,) = summary.best(data.assign_coords(limit=np.inf))
    assert unlimited.startswith("4 of 4 loops are safe") and unlimited.endswith("alpha 5 1/s, Ts 0.1 s.")
