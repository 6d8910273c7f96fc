"""Tuning against known answers, and starts that must not end in a NaN."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.study import parameters as pm
from cnclik.study.descent import gradient_mode
from cnclik.study.tune import calibrate, make_objective, radius_bound, tune

ARM = ck.planar_arm([1.0, 1.0], clockwise=True)
Q0 = np.array([0.0, np.pi / 2])
HERE = np.array([1.0, 1.0])  # the tip at Q0
LAW = ck.Law(ARM, ck.position("xy"), alpha=5.0)
NEAR = ck.hold(HERE + [1e-4, -5e-5])  # so near that the loop is linear
LINE = ck.line([1.0, 1.0], [0.0, 1.0], duration=3.0)  # Case II of the paper, N = 30, Ts = 0.1


def finite(found):
    """Nothing in a result may be NaN."""
    leaves = jax.tree.leaves((found.values, found.loss_before, found.loss_after, found.radius, found.violation))
    leaves += [v for v in found.history.values()] + [np.asarray(found.z)]
    return not any(np.isnan(np.asarray(v, float)).any() for v in leaves)


def inside(found):
    for name, value in found.values.items():
        lower, upper = found.bounds[name]
        value = np.linalg.eigvalsh(value) if np.ndim(value) == 2 and np.ndim(lower) == 0 else value
        assert np.all(value >= lower * (1 - 1e-12)) and np.all(value <= upper * (1 + 1e-12)), (name, value)


# --- known answers ------------------------------------------------------------------------------------


def test_reach_with_explicit_euler_finds_the_dead_beat_gain():
    found = tune(LAW, NEAR, Q0, Ts=0.1, N=10, method="EE", steps=40)
    # R = 1 − z; what moves z off 1 is curvature, of the size of e0.
    assert abs(found.z - 1) < 1e-4
    assert found.satisfied and found.radius < 1e-3 and found.status == "converged"
    assert found.gradient.startswith("forward")


def test_reach_with_the_trapezoid_finds_two():
    found = tune(LAW, NEAR, Q0, Ts=0.1, N=10, method="TRAPEZOID", stage=ck.chord(3), steps=40)
    assert abs(found.z - 2) < 1e-3  # R = (1 − z/2)/(1 + z/2)
    assert found.satisfied


def test_the_papers_feedforward_is_three_times_too_large():
    printed = ck.with_feedforward(LINE, [-1.0, 0.0])
    found = tune(LAW, printed, Q0, Ts=0.1, N=30, over="feedforward", steps=40)
    # The path moves −1/(N·Ts) = −1/3 per second. The method's own error, O(Ts²), is what remains.
    assert abs(found.values["feedforward"] - 1 / 3) < 1e-3
    assert found.loss_after < 2.2e-4 < 0.1 < found.loss_before


def test_gain_under_measurement_noise_has_a_closed_form():
    """One step from e0 with noise: E e² = (1 − z)² e0² + z² σ², least at z = e0²/(e0² + σ²)."""
    sigma, draws = 5e-5, 64
    start = ck.hold(HERE + [1e-4, 0.0])
    law = LAW
    found = tune(law, start, Q0, Ts=0.1, N=2, method="EE", loss=first_error, noise=sigma, draws=draws, steps=30)
    drawn = np.asarray(make_objective(law, start, Q0, Ts=0.1, N=2, noise=sigma, draws=draws).scenarios.noise)[:, 0]
    e0 = np.array([1e-4, 0.0])
    measured = e0 + drawn  # e1 = e0 − z (e0 + w): a line fit through the draws
    best = np.sum(measured * e0) / np.sum(measured**2)
    assert abs(found.z - best) < 1e-3
    assert abs(best - 1e-8 / (1e-8 + 2 * sigma**2)) < 0.1  # and so for the expectation, 2 axes


def first_error(view):
    return jnp.sum(view.run.e[1] ** 2) * 1e8


def test_noise_loss_is_the_stationary_deviation():
    """e ← (1 − z) e − z w has the variance σ² z/(2 − z)."""
    for z in (0.2, 1.0, 1.7):
        objective = make_objective(LAW, NEAR, Q0, Ts=0.1, N=2, method="EE", loss="noise")
        value, _ = jax.jit(objective)((jnp.asarray(z / 0.1),))
        np.testing.assert_allclose(value, np.sqrt(z / (2 - z)), rtol=1e-9)


def test_link_lengths_from_twenty_poses():
    true = np.array([0.51, 0.37, 0.23])
    rng = np.random.default_rng(0)
    q = rng.uniform(-2, 2, (20, 3))
    measured = np.stack([ck.pose(ck.planar_arm(true), qk).position for qk in q])
    found = calibrate(ck.planar_arm, np.array([0.5, 0.4, 0.2]), q, measured)
    np.testing.assert_allclose(found.values[0], true, atol=1e-8)
    assert found.rms_after < 1e-8 < 1e-2 < found.rms_before


# --- constraints --------------------------------------------------------------------------------------


def test_margin_binds_and_is_kept():
    """The worst error on a line is least beyond z = 1.3: the margin of the radius |1 − z| ≤ 0.3 stops it there."""
    found = tune(LAW, LINE, Q0, Ts=0.1, N=30, method="EE", margin=0.3, steps=60)
    assert found.satisfied and 0.29 < found.radius <= 0.3 * (1 + 1e-9)
    assert 1.29 < found.z <= 1.3 + 1e-9


def test_joint_velocity_limit_binds_and_is_kept():
    target = ck.hold(HERE + [0.1, -0.1])
    free = tune(LAW, target, Q0, Ts=0.1, N=20, method="EE", steps=40)
    largest = np.abs(free.after.qdot).max()
    held = tune(LAW, target, Q0, Ts=0.1, N=20, method="EE", steps=60, velocity_limit=0.5 * float(largest))
    assert held.satisfied and np.abs(held.after.qdot).max() <= 0.5 * largest * (1 + 1e-9)
    assert held.speed > 0.98  # not merely slow
    assert held.z < free.z


def test_delay_is_in_the_margin():
    """With one sample of delay explicit Euler is stable to z = 1 only, critically damped at 1/4."""
    found = tune(LAW, NEAR, Q0, Ts=0.1, N=20, method="EE", delay=1, margin=0.6, steps=60)
    roots = np.abs(np.roots([1.0, -1.0, found.z]))
    np.testing.assert_allclose(found.radius, roots.max(), rtol=1e-6)
    assert found.satisfied and found.z < 0.37


@pytest.mark.parametrize("alpha", [1e3, 1e8, 1e200])
def test_starts_deep_in_the_unstable_region(alpha):
    found = tune(ck.replace(LAW, alpha=alpha), LINE, Q0, Ts=0.1, N=30, method="EE", margin=0.8, steps=60)
    assert finite(found) and found.satisfied
    inside(found)
    assert 1 < found.z < 1.81 and found.loss_after < 1e-3


def test_infeasible_margin_is_told():
    """Five Picard passes of implicit Euler have |R| ≥ 0.5 or so for every z."""
    found = tune(LAW, LINE, Q0, Ts=0.1, N=30, method="IE", margin=0.05, steps=40)
    assert found.status == "infeasible" and not found.satisfied and found.violation > 1
    assert "Exceeded by" in found.why and finite(found)
    inside(found)


def test_start_without_a_finite_run_is_told():
    never = ck.path(lambda t: (t / 0.0, 0.0 * t))
    found = tune(LAW, never, Q0, Ts=0.1, N=5, method="EE", steps=10)
    assert found.status == "non-finite" and not found.satisfied and finite(found)
    inside(found)


# --- what may be tuned --------------------------------------------------------------------------------


@pytest.mark.parametrize("alpha", [np.array([4.0, 6.0]), np.array([[5.0, 1.0], [1.0, 3.0]])])
def test_gains_per_axis_and_matrices(alpha):
    scalar = 0.000326587  # what one gain for both axes reaches on this line
    found = tune(ck.replace(LAW, alpha=alpha), LINE, Q0, Ts=0.1, N=30, method="EE", steps=80)
    assert found.values["alpha"].shape == alpha.shape and found.satisfied
    assert found.loss_after < scalar
    inside(found)


def test_many_starts_and_other_parameters():
    law = ck.replace(LAW, inverse=ck.damped(0.1))
    over = ("alpha", "damping", "feedforward")
    found = tune(law, LINE, Q0, Ts=0.1, N=30, method="EE", over=over, starts=3, steps=40)
    one = tune(law, LINE, Q0, Ts=0.1, N=30, method="EE", over=over, steps=40)
    assert found.starts.shape == (3,) and found.loss_after <= one.loss_after * (1 + 1e-6)
    assert set(found.values) == set(over) and found.satisfied
    inside(found)


def test_schedule_and_sampling_time():
    found = tune(LAW, NEAR, Q0, Ts=0.1, N=16, method="EE", over=("schedule", "Ts"), steps=40)
    assert found.values["schedule"].shape == (pm.KNOTS,) and 0.025 <= found.Ts <= 0.4
    assert found.satisfied and finite(found)


@pytest.mark.parametrize(
    "options, told",
    [
        ({"over": "gain"}, "over"),
        ({"over": "damping"}, "damping"),
        ({"over": ()}, "over"),
        ({"loss": "trakcing"}, "did you mean 'tracking'"),
        ({"margin": 1.5}, "margin"),
        ({"bounds": {"alpha": (5, 1)}}, "increase"),
        ({"bounds": {"Ts": (1, 2)}}, "bounds"),
        ({"velocity_limit": -1.0}, "velocity_limit"),
        ({"noise": -1.0}, "noise"),
        ({"steps": 1}, "steps"),
        ({"gradient": "sideways"}, "gradient"),
    ],
)
def test_what_does_not_fit_is_named(options, told):
    with pytest.raises(ck.ArgumentError, match=told):
        tune(LAW, LINE, Q0, **({"Ts": 0.1, "N": 30} | options))


# --- derivatives and bounds ---------------------------------------------------------------------------


def test_forward_reverse_and_finite_differences_agree():
    law = ck.replace(LAW, alpha=np.array([[5.0, 1.0], [1.0, 3.0]]))
    objective = make_objective(law, LINE, Q0, Ts=0.1, N=6, loss={"tracking": 1.0, "jerk": 1e-5, "noise": 1e-3})
    both = jax.jit(lambda u: jnp.append(*reversed(objective(pm.values_of(objective.parameters, u)))))
    u = jnp.asarray(pm.free_of(objective.parameters, [law.alpha]))
    forward, reverse = jax.jit(jax.jacfwd(both))(u), jax.jit(jax.jacrev(both))(u)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-12)
    h = 1e-5
    apart = np.stack([(both(u + h * d) - both(u - h * d)) / (2 * h) for d in np.eye(len(u))], axis=1)
    np.testing.assert_allclose(forward, apart, rtol=1e-5, atol=1e-8)


def test_gradient_mode_goes_by_number():
    assert (
        gradient_mode(3) == "forward" and gradient_mode(30) == "reverse" and gradient_mode(30, "forward") == "forward"
    )


def test_radius_bound_is_an_upper_bound_and_tight():
    rng = np.random.default_rng(1)
    for m in (1, 3, 6):
        a = rng.normal(size=(m, m)) / m
        rho = np.abs(np.linalg.eigvals(a)).max()
        bound = float(radius_bound(jnp.asarray(a)))
        assert rho * (1 - 1e-12) <= bound <= rho * 1.01
        assert abs(float(radius_bound(jnp.asarray(0.7 * np.eye(m)))) - 0.7) < 0.7 * 1e-3
        same = jax.grad(lambda s, m=m: radius_bound(s * jnp.eye(m)))(0.5)  # all eigenvalues at once
        np.testing.assert_allclose(same, 1.0, rtol=1e-3)
    assert float(radius_bound(jnp.zeros((2, 2)))) == 0


@pytest.mark.parametrize("far", [0.0, 3.0, 50.0, 1e3, 1e9])
def test_values_never_leave_their_bounds(far):
    rng = np.random.default_rng(2)
    box = pm.parameter("k", np.array([1.0, 2.0]), 0.5, 20.0, None)
    matrix = pm.parameter("K", np.diag([1.0, 2.0, 3.0]), 0.5, 20.0, None, kind=pm.SPD)
    for p in (box, matrix):
        np.testing.assert_allclose(pm.bounded(p, jnp.asarray(pm.free(p, p.start))), p.start, rtol=1e-9)
        value = np.asarray(pm.bounded(p, jnp.asarray(rng.normal(size=pm.size(p)) * far)))
        value = np.linalg.eigvalsh(value) if p is matrix else value
        assert np.all(value >= 0.5 - 1e-9) and np.all(value <= 20 + 1e-9)
