"""Trajectories as labelled data, and files that hold them."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

import cnclik as ck
from cnclik.measure import to_dataset
from cnclik.measure.files import markdown, save_netcdf
from tests.bank import screws
from tests.refusals import refusals

CHAIN = screws([[0, 0, 0], [1, 0, 0]], [[0, 0, 1], [1, 0, 0]], [1.0, 0.0, 0.0], kinds="RP")  # units differ
LAW = ck.Law(CHAIN, ck.position("xy"), alpha=2.0)
TARGET, Q0 = ck.hold([1.2, 0.3]), np.array([0.0, 0.1])
RUN = ck.solve(LAW, TARGET, Q0, 0.1, 4, "EE")


def test_a_run_is_labelled():
    data = to_dataset(RUN, LAW, config={"b": 1, "a": np.array([2])})
    assert data.q.dims == ("time", "joint") and data.qdot.dims == ("step", "joint")
    assert data.e.dims == ("time", "axis") and list(data.axis.values) == ["x", "y"]
    assert list(data.joint_unit.values) == ["rad", "m"] and data.q.units == "rad or m"
    np.testing.assert_array_equal(data.q.values, RUN.q)
    np.testing.assert_array_equal(data.time.values, RUN.t)
    assert int(data.evaluations) == 4
    assert json.loads(data.attrs["config"]) == {"a": [2], "b": 1}
    assert {"cnclik", "jax", "dtype", "device"} <= set(data.attrs)
    assert all(data[name].attrs.get("units") and data[name].attrs.get("long_name") for name in data.variables)


def test_a_batch_keeps_its_axes_and_clocks_and_comes_back_packed(tmp_path):
    alphas, times = jnp.array([1.0, 2.0, 3.0]), jnp.array([0.1, 0.05])

    def solved(alpha, Ts):
        return ck.solve(ck.replace(LAW, alpha=alpha), TARGET, Q0, Ts, 2, "EE")

    runs = jax.vmap(jax.vmap(solved, (None, 0)), (0, None))(alphas, times)
    data = to_dataset(runs, LAW, dims=("alpha", "Ts"), coords={"alpha": alphas, "Ts": times})
    assert dict(data.sizes) == {"alpha": 3, "Ts": 2, "time": 3, "joint": 2, "step": 2, "axis": 2}
    assert data.t.dims == ("alpha", "Ts", "time") and "time" not in data.coords  # each Ts has its own clock
    np.testing.assert_allclose(data.e.sel(alpha=2.0, Ts=0.05), solved(2.0, 0.05).e, atol=1e-14)
    data = data.assign(zeros=("k", np.zeros(10_000)))
    save_netcdf(data, tmp_path / "runs.nc")
    assert (tmp_path / "runs.nc").stat().st_size < 80_000  # and not 80 kB more
    with xr.open_dataset(tmp_path / "runs.nc") as back:
        xr.testing.assert_equal(back.load(), data)


test_what_makes_no_dataset_is_refused = refusals(
    ({"run": 3}, "`run` must be a Trajectory, but is int"),
    ({"law": None}, "`law` must be a Law, but is NoneType"),
    ({"law": ck.Law(ck.planar_arm([1.0] * 3), ck.position("xy"), alpha=1.0)}, "of 3 joints and 2 task coordinates"),
    ({"dims": ("alpha",)}, "`dims` must name the 0 leading axes"),
    of=lambda **changes: to_dataset(**({"run": RUN, "law": LAW} | changes)),
)


def test_markdown_escapes_what_would_end_a_cell():
    text = markdown(["|e|", "n"], [["a|b", 1], ["c", 2.5]])
    assert text == "| \\|e\\| | n |\n| --- | ---: |\n| a\\|b | 1 |\n| c | 2.5 |\n"
    assert markdown(["a", "b"], [], left=2) == "| a | b |\n| --- | --- |\n"
