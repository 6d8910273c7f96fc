"""Metrics against plain NumPy, their derivatives against differences, and what they say of bad loops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.errors import ArgumentError
from cnclik.measure.metrics import METRICS, chatter, measure_run
from tests import plain

SCALARS = [n for n in METRICS if n not in ("ending", "stable")]  # these are in test_ending
ARM = ck.from_dh(
    [1.0, 0.8, 0.5], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], velocity_limit=[1.0, 2.0, 3.0], lower=[-3.0] * 3, upper=[2.5] * 3
)
Q0 = np.array([0.3, 0.9, -0.6])


def run_pose(alpha=4.0, Ts=0.1, method=ck.CN, N=12):
    law = ck.Law(ARM, ck.pose("xy", "z"), alpha=alpha)
    start, end = np.array([1.2, 1.5]), np.array([0.7, 1.7])
    half = np.array([np.cos(0.4), 0, 0, np.sin(0.4)])
    reference = ck.line(start, end, duration=0.8, rotation=half)
    tangent = (end - start) / np.linalg.norm(end - start)
    return ck.solve(law, reference, Q0, Ts, N, method), law, reference, tangent


def test_every_scalar_metric_is_what_numpy_makes_of_the_trajectory():
    run, law, reference, direction = run_pose()
    moving = np.arange(13)[:, None] <= 8  # the line ends at step 8 and is held
    found = jax.jit(lambda run: measure_run(run, law, reference, SCALARS, tolerance=0.02))(run)
    wanted = plain.metrics(run, law, direction * moving, 0.02, [1.0, 2.0, 3.0], -3.0, 2.5)
    assert set(wanted) == set(SCALARS)
    for name, value in found.items():
        np.testing.assert_allclose(value, wanted[name], rtol=1e-12, atol=1e-14, err_msg=name)
    assert found.units["final_error"] == "m, rad" and found.units["max_qdot"] == "rad/s"
    assert found.final_error == found["final_error"]


def test_a_start_inside_the_tolerance():
    law = ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("xy"), alpha=1.0)
    at = np.asarray(ck.forward(law.chain, [0.2, 0.9]).position)
    run = ck.solve(law, ck.hold(at[:2]), [0.2, 0.9], 0.1, 3)
    m = measure_run(run, law, ck.hold(at[:2]), ["steps_to_tolerance", "settling_time", "converged", "rate"])
    assert [float(v) for _, v in m.items()][:3] == [0, 0, 1]
    assert np.isnan(m.rate)


def test_a_loop_that_never_arrives_or_is_not_finite_is_infinite_never_small():
    law = ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("xy"), alpha=1.0)
    run = ck.solve(law, ck.hold([0.0, 5.0]), jnp.array([0.2, 0.9]), 0.1, 3)
    broken = ck.replace(run, e=run.e.at[2].set(jnp.nan), q=run.q.at[2].set(jnp.nan), qdot=run.qdot.at[1].set(jnp.inf))
    names = ["mean_error", "rms_error", "max_error", "steps_to_tolerance", "settling_time", "max_qdot", "path_length"]
    m = measure_run(broken, law, ck.hold([0.0, 5.0]), [*names, "converged", "past_limit"])
    assert all(np.isposinf(m[n]) for n in names), m
    assert m.converged == 0 and m.past_limit == np.inf
    nowhere = ck.replace(run, e=jnp.full_like(run.e, jnp.nan))
    m = measure_run(nowhere, law, ck.hold([0.0, 5.0]), ["rate", "stable"])
    assert [float(v) for _, v in m.items()] == [np.inf, 0.0]


FLAT, GOAL = ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("xy"), alpha=1.0), ck.hold([0.0, 1.0])


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"run": "run"}, "`run` must be a Trajectory, but is str"),
        ({"run": "batch"}, "`run` must be one lane, but has 1 leading axes"),
        ({"names": ["mean_eror"]}, "did you mean 'mean_error'"),
        ({"names": ["rms_rotation_error"]}, r"ones of the task \(x, y\), but include 'rms_rotation_error'"),
        ({"law": 3}, "`law` must be a Law, but is int"),
        ({"reference": [0.0, 1.0]}, r"`reference` must be a Reference such as hold\(\.\.\.\), .* but is list"),
        ({"law": ck.Law(ck.planar_arm([1.0] * 3), ck.position("xy"), alpha=1.0)}, "of 3 joints and 2 task coordinates"),
    ],
)
def test_what_was_not_run_is_refused(changes, told):
    run = ck.solve(FLAT, GOAL, [0.2, 0.9], 0.1, 3)
    if changes.get("run") == "batch":
        changes = {"run": jax.tree.map(lambda v: np.stack([v, v]), run)}
    given = {"run": run, "law": FLAT, "reference": GOAL} | changes
    with pytest.raises(ArgumentError, match=told):
        measure_run(**given)


LOSSES = ["final_error", "mean_error", "rms_error", "max_error", "rms_along", "rms_across", "rate", "max_qdot"]
LOSSES += ["rms_qddot", "path_length", "least_singular_value"]


def test_derivatives_of_losses_are_those_of_finite_differences():
    def losses(alpha):
        run, law, reference, _ = run_pose(alpha, method=ck.EE)
        return jnp.stack([v for _, v in measure_run(run, law, reference, LOSSES).items()])

    h = 1e-6
    forward = jax.jit(jax.jacfwd(losses))(4.0)
    value = jax.jit(losses)
    difference = (value(4.0 + h) - value(4.0 - h)) / (2 * h)
    np.testing.assert_allclose(forward, difference, rtol=1e-6, atol=1e-8)
    assert np.count_nonzero(np.abs(difference) > 1e-9) >= 9  # else nothing was tested


def test_derivatives_are_finite_where_the_error_is_exactly_zero():
    law = ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("y"), alpha=1.0)

    def losses(q0):
        reference = ck.hold([2.0])  # the stretched arm is there, singular and at rest
        run = ck.solve(law, reference, q0, 0.1, 3)
        return jnp.stack([v for _, v in measure_run(run, law, reference, LOSSES).items()])

    with np.errstate(all="ignore"):
        slopes = jax.jit(jax.jacfwd(losses))(jnp.zeros(2))
    assert np.all(np.isfinite(np.delete(slopes, LOSSES.index("rate"), axis=0))), slopes


def test_chatter_counts_what_is_taken_back():
    alternating = 0.5 * (-1.0) ** np.arange(40)[:, None]
    assert chatter(alternating) == pytest.approx(0.5, rel=1e-12)
    assert chatter(np.exp(-0.5 * np.arange(40))[:, None]) == 0  # slowing down, however hard
    assert chatter(np.where(np.arange(40)[:, None] < 20, alternating, 1.0)) == 0  # over in the first half
    assert chatter(np.ones((1, 3))) == 0
    assert chatter(np.where(np.arange(40)[:, None] == 39, np.nan, alternating)) == np.inf


def test_every_bit_of_the_status_is_counted():
    bits = [bit for bit in ck.Status if bit]
    run, law, reference, _ = run_pose(method=ck.EE)
    marked = ck.replace(run, status=np.array([sum(bits), *[bits[0]] * 3, *[0] * 8], np.int32))
    names = ["ok", *(bit.name.lower() for bit in bits)]
    found = measure_run(marked, law, reference, names)
    assert [int(found[n]) for n in names] == [8, 4, *[1] * (len(bits) - 1)]


def test_a_float32_run_has_the_metrics_of_the_float64_one():
    def metrics():
        run, law, reference, _ = run_pose(method=ck.EXP_MIDPOINT, N=10)
        return measure_run(run, law, reference, SCALARS, tolerance=0.02)

    wanted = jax.jit(metrics)()
    with jax.enable_x64(False):
        found = jax.jit(metrics)()
    for name, value in found.items():
        assert value.dtype in (np.float32, np.int32), name
        unit = found.units[name]
        atol = 1e-5 / 0.1**2 if "/s²" in unit else 2e-5 if "/s" in unit else 3e-6  # roundings over Ts, Ts²
        np.testing.assert_allclose(value, wanted[name], rtol=1e-5, atol=atol, err_msg=name)
