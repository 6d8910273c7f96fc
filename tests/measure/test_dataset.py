"""Trajectories as labelled data."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import cnclik as ck
from cnclik.measure.dataset import to_dataset


@pytest.fixture(scope="module")
def scara():
    """One revolute and one prismatic joint, so that units differ."""
    chain = ck.from_screws([[0, 0, 0], [1, 0, 0]], [[0, 0, 1], [1, 0, 0]], [1.0, 0.0, 0.0], kinds="RP")
    return ck.Law(chain, ck.position("xy"), alpha=2.0)


def test_single_run(scara):
    run = ck.solve(scara, ck.hold([1.2, 0.3]), [0.0, 0.1], 0.1, 4, "EE")
    data = to_dataset(run, scara, config={"b": 1, "a": np.array([2])})
    assert data.q.dims == ("time", "joint") and data.qdot.dims == ("step", "joint")
    assert data.e.dims == ("time", "axis") and list(data.axis.values) == ["x", "y"]
    assert list(data.joint_unit.values) == ["rad", "m"] and data.q.units == "rad or m"
    np.testing.assert_array_equal(data.q.values, run.q)
    np.testing.assert_array_equal(data.time.values, run.t)
    assert int(data.evaluations) == 4
    assert json.loads(data.attrs["config"]) == {"a": [2], "b": 1}
    assert {"cnclik", "jax", "commit", "dtype", "device"} <= set(data.attrs)
    assert all(data[name].attrs.get("units") and data[name].attrs.get("long_name") for name in data.variables)


def test_batch_keeps_its_axes_and_clocks(scara, tmp_path):
    alphas, times = jnp.array([1.0, 2.0, 3.0]), jnp.array([0.1, 0.05])

    def one(alpha, Ts):
        return ck.solve(ck.replace(scara, alpha=alpha), ck.hold([1.2, 0.3]), [0.0, 0.1], Ts, 2, "EE")

    runs = jax.vmap(jax.vmap(one, (None, 0)), (0, None))(alphas, times)
    data = to_dataset(runs, scara, dims=("alpha", "Ts"), coords={"alpha": alphas, "Ts": times})
    assert dict(data.sizes) == {"alpha": 3, "Ts": 2, "time": 3, "joint": 2, "step": 2, "axis": 2}
    assert data.t.dims == ("alpha", "Ts", "time") and "time" not in data.coords  # each Ts has its own clock
    alone = one(2.0, 0.05)
    np.testing.assert_allclose(data.e.sel(alpha=2.0, Ts=0.05), alone.e, atol=1e-14)
    data.to_netcdf(tmp_path / "runs.nc", engine="h5netcdf")
    with xr.open_dataset(tmp_path / "runs.nc") as back:
        xr.testing.assert_identical(
            data.drop_vars(["joint_unit", "axis_unit"]), back.drop_vars(["joint_unit", "axis_unit"])
        )


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"run": 3}, "`run` must be a Trajectory, but is int"),
        ({"law": None}, "`law` must be a Law, but is NoneType"),
        (
            {"law": ck.Law(ck.planar_arm([1.0] * 3), ck.position("xy"), alpha=1.0)},
            "of 3 joints and 2 task coordinates, but is of 2 and 2",
        ),
        ({"config": 1j}, "`config` must be what JSON can write"),
        ({"dims": ("alpha",)}, "`dims` must name the 0 leading axes"),
    ],
)
def test_what_makes_no_dataset_is_named(scara, changes, told):
    given = {"run": ck.solve(scara, ck.hold([1.2, 0.3]), [0.0, 0.1], 0.1, 2, "EE"), "law": scara} | changes
    with pytest.raises(ck.ArgumentError, match=told) as caught:
        to_dataset(given.pop("run"), given.pop("law"), **given)
    assert "\n" not in str(caught.value)
