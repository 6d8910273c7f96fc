"""Metrics against plain NumPy, their derivatives against differences, and what they say of bad loops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.errors import ArgumentError
from cnclik.measure.metrics import METRICS, measure
from tests import plain

SCALARS = [n for n, m in METRICS.items() if not m.dims and n not in ("ending", "stable")]  # these: test_ending
ARM = ck.from_dh(
    [1.0, 0.8, 0.5], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], velocity_limit=[1.0, 2.0, 3.0], lower=[-3.0] * 3, upper=[2.5] * 3
)
Q0 = np.array([0.3, 0.9, -0.6])


def run_pose(alpha=4.0, Ts=0.1, method=ck.CN):
    law = ck.Law(ARM, ck.pose_task("xy", "z"), alpha=alpha)
    start, end = np.array([1.2, 1.5]), np.array([0.7, 1.7])
    half = np.array([np.cos(0.4), 0, 0, np.sin(0.4)])
    reference = ck.line(start, end, duration=0.8, rotation=half)
    tangent = (end - start) / np.linalg.norm(end - start)
    return ck.solve(law, reference, Q0, Ts, 12, method), law, reference, tangent


def test_every_scalar_metric_is_what_numpy_makes_of_the_trajectory():
    run, law, reference, direction = run_pose()
    moving = np.arange(13)[:, None] <= 8  # the line ends at step 8 and is held
    found = measure(run, law, reference, SCALARS, tolerance=0.02)
    wanted = plain.metrics(run, law, direction * moving, 0.02, [1.0, 2.0, 3.0], -3.0, 2.5)
    assert set(wanted) == set(SCALARS)
    for name, value in found.items():
        np.testing.assert_allclose(value, wanted[name], rtol=1e-12, atol=1e-14, err_msg=name)
    assert found.units["final_error"] == "m, rad" and found.units["max_qdot"] == "rad/s"
    assert found.final_error == found["final_error"]


def test_a_start_inside_the_tolerance():
    law = ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("xy"), alpha=1.0)
    at = np.asarray(ck.pose(law.chain, [0.2, 0.9]).position)
    run = ck.solve(law, ck.hold(at[:2]), [0.2, 0.9], 0.1, 3)
    m = measure(run, law, ck.hold(at[:2]), ["steps_to_tolerance", "settling_time", "converged", "overshoot", "rate"])
    assert [float(v) for _, v in m.items()][:4] == [0, 0, 1, 0]
    assert np.isnan(m.rate)


def test_a_loop_that_never_arrives_or_is_not_finite_is_infinite_never_small():
    law = ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("xy"), alpha=1.0)
    run = ck.solve(law, ck.hold([0.0, 5.0]), [0.2, 0.9], 0.1, 3)
    broken = ck.replace(run, e=run.e.at[2].set(jnp.nan), q=run.q.at[2].set(jnp.nan), qdot=run.qdot.at[1].set(jnp.inf))
    names = ["mean_error", "rms_error", "max_error", "steps_to_tolerance", "settling_time", "max_qdot", "path_length"]
    m = measure(broken, law, ck.hold([0.0, 5.0]), [*names, "converged", "limit_distance"])
    assert all(np.isposinf(m[n]) for n in names), m
    assert m.converged == 0 and m.limit_distance == -np.inf


LOSSES = ["final_error", "mean_error", "rms_error", "max_error", "rms_along", "rms_across", "rate", "max_qdot"]
LOSSES += ["rms_qdot", "rms_qddot", "path_length", "limit_distance", "least_singular_value", "overshoot"]


def test_derivatives_of_losses_are_those_of_finite_differences():
    def losses(alpha):
        run, law, reference, _ = run_pose(alpha, method=ck.HEUN)
        return jnp.stack([v for _, v in measure(run, law, reference, LOSSES).items()])

    h = 1e-6
    forward = jax.jit(jax.jacfwd(losses))(4.0)
    value = jax.jit(losses)
    difference = (value(4.0 + h) - value(4.0 - h)) / (2 * h)
    np.testing.assert_allclose(forward, difference, rtol=1e-6, atol=1e-8)
    assert np.count_nonzero(np.abs(difference) > 1e-9) >= 12  # else nothing was tested


def test_derivatives_are_finite_where_the_error_is_exactly_zero():
    law = ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("y"), alpha=1.0)

    def losses(q0):
        reference = ck.hold([2.0])  # the stretched arm is there, singular and at rest
        run = ck.solve(law, reference, q0, 0.1, 3)
        return jnp.stack([v for _, v in measure(run, law, reference, LOSSES).items()])

    with np.errstate(all="ignore"):
        slopes = jax.jacfwd(losses)(jnp.zeros(2))
    assert np.all(np.isfinite(np.delete(slopes, LOSSES.index("rate"), axis=0))), slopes


def test_unknown_metrics_and_metrics_of_other_tasks_are_refused():
    run, law, reference, _ = run_pose()
    with pytest.raises(ArgumentError, match="did you mean 'mean_error'"):
        measure(run, law, reference, ["mean_eror"])
    planar = ck.Law(ARM, ck.position("xy"), alpha=1.0)
    with pytest.raises(ArgumentError, match=r"ones of the task \(x, y\), but include 'rms_rotation_error'"):
        measure(run, planar, reference, ["rms_rotation_error"])
