"""Metrics against plain NumPy, their derivatives against differences; trajectories as labelled data, and files."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

import cnclik as ck
from cnclik.measure import to_dataset
from cnclik.measure.files import markdown, save_netcdf
from cnclik.measure.metrics import METRICS, chatter, measure_run
from tests import plain
from tests.bank import screws
from tests.refusals import refusals

SCALARS = [n for n in METRICS if n not in ("ending", "stable")]  # these are in test_outcome
ARM = ck.from_dh(
    [1.0, 0.8, 0.5], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], velocity_limit=[1.0, 2.0, 3.0], lower=[-3.0] * 3, upper=[2.5] * 3
)
Q0 = np.array([0.3, 0.9, -0.6])
START, END, HALF = np.array([1.2, 1.5]), np.array([0.7, 1.7]), np.array([np.cos(0.4), 0, 0, np.sin(0.4)])


def run_pose(alpha=4.0, q0=Q0, start=START, end=END, half=HALF, method="CN"):
    law = ck.Law(ARM, ck.pose("xy", "z"), alpha=alpha)
    reference = ck.line(start, end, duration=0.8, rotation=half)
    return ck.solve(law, reference, q0, 0.1, 12, method), law, reference


def test_every_scalar_metric_is_what_numpy_makes_of_the_trajectory():
    def measured():
        return jax.jit(lambda: (*(run := run_pose())[:2], measure_run(*run, SCALARS, tolerance=0.02)))()

    run, law, found = measured()
    tangent = (END - START) / np.linalg.norm(END - START) * (np.arange(13)[:, None] <= 8)  # then the line is held
    wanted = plain.metrics(run, law, tangent, 0.02, [1.0, 2.0, 3.0], -3.0, 2.5)
    assert set(wanted) == set(SCALARS)
    for name, value in found.items():
        np.testing.assert_allclose(value, wanted[name], rtol=1e-9, atol=1e-12, err_msg=name)
    assert found.units["final_error"] == "m, rad" and found.units["max_qdot"] == "rad/s"
    with jax.enable_x64(False):
        *_, found = measured()
    for name, value in found.items():
        assert value.dtype in (np.float32, np.int32), name
        unit = found.units[name]
        atol = 2e-5 if "/s" in unit else 3e-6  # roundings over Ts
        np.testing.assert_allclose(value, wanted[name], rtol=2e-5, atol=atol, err_msg=name)


LAW, GOAL = ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("xy"), alpha=1.0), ck.hold([0.0, 5.0])
RUN = ck.solve(LAW, GOAL, jnp.array([0.2, 0.9]), 0.1, 3)


def test_a_path_that_allows_no_batch_is_measured():
    shape = jax.ShapeDtypeStruct((2,), RUN.q.dtype)
    place = jax.custom_jvp(lambda t: jax.pure_callback(lambda t: np.array([t, 5.0]), shape, t))
    place.defjvp(lambda t, dt: (place(*t), dt[0] * jnp.array([1.0, 0.0])))
    assert measure_run(RUN, LAW, ck.path(place), ["final_along"])["final_along"] == RUN.e[-1, 0]


def test_a_start_inside_the_tolerance():
    found = measure_run(ck.replace(RUN, e=0 * RUN.e), LAW, GOAL, ["steps_to_tolerance", "converged"])
    assert [*found.values()] == [0, 1]


def test_a_loop_that_never_arrives_or_is_not_finite_is_infinite_never_small():
    third, gone = np.arange(4)[:, None] == 2, {"qdot": np.where(np.arange(3)[:, None] == 1, np.inf, RUN.qdot)}
    names = ["mean_error", "rms_error", "max_error", "steps_to_tolerance", "max_qdot", "past_limit", "converged"]
    found = jax.jit(lambda run: measure_run(run, LAW, GOAL, [*names, "stable"]))
    for e in (np.where(third, np.nan, RUN.e), np.full_like(RUN.e, np.nan)):
        broken = ck.replace(RUN, e=e, q=np.where(third, np.nan, RUN.q), **gone)
        assert [*found(broken).values()] == [np.inf] * 6 + [0, 0]


test_what_was_not_run_is_refused = refusals(
    ({"run": "run"}, "`run` must be a Trajectory, but is str"),
    ({"run": jax.tree.map(lambda v: np.stack([v, v]), RUN)}, "`run` must be one lane, but has 1 leading axes"),
    ({"names": None}, "`metrics` must be a list of names, but is NoneType"),
    ({"names": ["mean_eror"]}, "did you mean 'mean_error'"),
    ({"names": ["rms_rotation_error"]}, r"ones of the task \(x, y\), but include 'rms_rotation_error'"),
    ({"law": 3}, "`law` must be a Law, but is int"),
    ({"reference": [0.0, 1.0]}, r"`reference` must be a Reference such as hold\(\.\.\.\), .* but is list"),
    ({"law": ck.Law(ck.planar_arm([1.0] * 3), ck.position("xy"), alpha=1.0)}, "of 3 joints and 2 task coordinates"),
    of=lambda **changes: measure_run(**({"run": RUN, "law": LAW, "reference": GOAL} | changes)),
)


LOSSES = ["final_error", "mean_error", "rms_error", "max_error", "rms_along", "rms_across", "max_qdot"]
LOSSES += ["least_singular_value"]


def test_derivatives_of_losses_are_those_of_differences_and_finite_without_an_error():
    def losses(alpha, q0, start, end, half):
        made = measure_run(*run_pose(alpha, q0, start, end, half, "EE"), LOSSES)
        return (values := jnp.stack([*made.values()])), values

    derivatives = jax.jit(jax.jacfwd(losses, argnums=(0, 1), has_aux=True))
    h = 1e-6
    (slope, _), _ = derivatives(4.0, Q0, START, END, HALF)
    above, below = (derivatives(4.0 + side, Q0, START, END, HALF)[1] for side in (h, -h))
    difference = (above - below) / (2 * h)
    np.testing.assert_allclose(slope, difference, rtol=1e-6, atol=1e-8)
    assert np.count_nonzero(np.abs(difference) > 1e-9) >= 6  # else nothing was tested
    here = np.array([2.3, 0.0])  # of the stretched arm, which is singular and at rest
    with np.errstate(all="ignore"):
        (_, slopes), values = derivatives(4.0, np.zeros(3), here, here, np.array([1.0, 0, 0, 0]))
    assert values[0] == 0
    assert np.all(np.isfinite(slopes)), slopes


def test_chatter_counts_what_is_reversed():
    alternating, k = 0.5 * (-1.0) ** np.arange(40)[:, None], np.arange(40)[:, None]
    for qdot, wanted in (
        (alternating, 0.5),
        (np.exp(-0.5 * k), 0),  # slowing down, however hard
        (np.where(k < 20, alternating, 1.0), 0),  # over in the first half
        (np.ones((1, 3)), 0),
        (np.where(k == 39, np.nan, alternating), np.inf),
    ):
        np.testing.assert_allclose(jax.jit(chatter)(qdot), wanted, rtol=1e-12)


def test_every_bit_of_the_status_is_counted():
    bits = [bit for bit in ck.Status if bit]
    status = np.array([sum(bits), bits[0], 0], np.int32)
    found = measure_run(ck.replace(RUN, status=status), LAW, GOAL, ["ok", *(bit.name.lower() for bit in bits)])
    assert [*found.values()] == [1, 2, *[1] * (len(bits) - 1)]


CHAIN = screws([[0, 0, 0], [1, 0, 0]], [[0, 0, 1], [1, 0, 0]], [1.0, 0.0, 0.0], kinds="RP")  # units differ
DATA_LAW = ck.Law(CHAIN, ck.position("xy"), alpha=2.0)
TARGET, DATA_Q0 = ck.hold([1.2, 0.3]), np.array([0.0, 0.1])
DATA_RUN = ck.solve(DATA_LAW, TARGET, DATA_Q0, 0.1, 4, "EE")


def test_a_run_is_labelled():
    data = to_dataset(DATA_RUN, DATA_LAW, config={"b": 1, "a": np.array([2])})
    assert data.q.dims == ("time", "joint") and data.qdot.dims == ("step", "joint")
    assert data.e.dims == ("time", "axis") and list(data.axis.values) == ["x", "y"]
    assert list(data.joint_unit.values) == ["rad", "m"] and data.q.units == "rad or m"
    np.testing.assert_array_equal(data.q.values, DATA_RUN.q)
    np.testing.assert_array_equal(data.time.values, DATA_RUN.t)
    assert int(data.evaluations) == 4
    assert json.loads(data.attrs["config"]) == {"a": [2], "b": 1}
    assert {"cnclik", "jax", "dtype", "device"} <= set(data.attrs)
    assert all(data[name].attrs.get("units") and data[name].attrs.get("long_name") for name in data.variables)


def test_a_batch_keeps_its_axes_and_clocks_and_comes_back_packed(tmp_path):
    alphas, times = jnp.array([1.0, 2.0, 3.0]), jnp.array([0.1, 0.05])

    def solved(alpha, Ts):
        return ck.solve(ck.replace(DATA_LAW, alpha=alpha), TARGET, DATA_Q0, Ts, 2, "EE")

    runs = jax.jit(jax.vmap(jax.vmap(solved, (None, 0)), (0, None)))(alphas, times)
    data = to_dataset(runs, DATA_LAW, dims=("alpha", "Ts"), coords={"alpha": alphas, "Ts": times})
    assert dict(data.sizes) == {"alpha": 3, "Ts": 2, "time": 3, "joint": 2, "step": 2, "axis": 2}
    assert data.t.dims == ("alpha", "Ts", "time") and "time" not in data.coords  # each Ts has its own clock
    np.testing.assert_array_equal(data.e.sel(alpha=2.0, Ts=0.05), runs.e[1, 1])
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
    of=lambda **changes: to_dataset(**({"run": DATA_RUN, "law": DATA_LAW} | changes)),
)


def test_markdown_escapes_what_would_end_a_cell():
    text = markdown(["|e|", "n"], [["a|b", 1], ["c", 2.5]])
    assert text == "| \\|e\\| | n |\n| --- | ---: |\n| a\\|b | 1 |\n| c | 2.5 |\n"
    assert markdown(["a", "b"], [], left=2) == "| a | b |\n| --- | --- |\n"
