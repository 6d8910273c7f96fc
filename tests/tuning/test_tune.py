"""Tuning against known answers, and starts that must not end in a NaN."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.hints import quick_jit
from cnclik.tuning import parameters as pm
from cnclik.tuning.descent import gradient_mode
from cnclik.tuning.losses import LOSSES, View, terms
from cnclik.tuning.tune import calibrate, gradient_in_words, make_objective, radius_bound, tune

ARM = ck.planar_arm([1.0, 1.0], clockwise=True)
Q0 = np.array([0.0, np.pi / 2])  # the tip is at (1, 1)
LAW = ck.Law(ARM, ck.position("xy"), alpha=5.0)
# One shape for most tests, so that they share compiled programs: a target that holds still is a line of length 0.
LINE = ck.line([1.0, 1.0], [0.0, 1.0], duration=3.0)  # Case II of the paper
NEAR = ck.line([1.0001, 0.99995], [1.0001, 0.99995], duration=3.0)  # so near that the loop is linear
LOOP = {"Ts": 0.1, "N": 30, "method": "EE", "steps": 60, "velocity_limit": 1e6}


def at(reference=LINE, law=LAW, **options):
    return tune(law, reference, Q0, **(LOOP | options))


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


def test_public_names_are_loaded_on_use():
    assert ck.tune is tune and ck.calibrate is calibrate
    assert {"tune", "calibrate", "solve"} <= set(dir(ck))
    with pytest.raises(AttributeError, match="tuen"):
        ck.tuen  # a name that is not there


# --- known answers ------------------------------------------------------------------------------------


def test_reach_with_explicit_euler_finds_the_dead_beat_gain():
    found = at(NEAR)
    # R = 1 − z; what moves z off 1 is curvature, of the size of e0.
    assert abs(found.z - 1) < 1e-4
    assert found.satisfied and found.radius < 1e-3 and found.status == "converged"
    assert found.gradient.startswith("forward")


def test_reach_with_the_trapezoid_finds_two():
    found = at(NEAR, method="TRAPEZOID", stage=ck.chord(1))
    assert abs(found.z - 2) < 1e-3  # R = (1 − z/2)/(1 + z/2)
    assert found.satisfied


def test_the_papers_feedforward_is_three_times_too_large():
    printed = ck.with_feedforward(LINE, [-1.0, 0.0])
    found = at(printed, method="CN", over="feedforward")
    # The path moves −1/(N·Ts) = −1/3 per second. The method's own error, O(Ts²), is what remains.
    assert abs(found.values["feedforward"] - 1 / 3) < 1e-3
    assert found.loss_after < 2.2e-4 < 0.1 < found.loss_before


def first_error(view):
    return jnp.sum(view.run.e[1] ** 2) * 1e8


def test_gain_under_measurement_noise_has_a_closed_form():
    """One step of a linear loop leaves e0 − z (e0 + w): the best z is that of a line fitted through the draws."""
    sigma, e0 = 5e-5, np.array([1e-4, -5e-5])
    options = {"noise": sigma, "draws": 16}
    found = at(NEAR, loss=first_error, **options)
    drawn = make_objective(LAW, NEAR, Q0, **{k: v for k, v in (LOOP | options).items() if k != "steps"})
    told = e0 + np.asarray(drawn.scenarios.noise)[:, 0]
    assert abs(found.z - np.sum(told * e0) / np.sum(told**2)) < 1e-3
    # In expectation e0²/(e0² + 2σ²), two axes being noisy: not 1, which is right without noise.
    assert abs(found.z - 1.25e-8 / (1.25e-8 + 2 * sigma**2)) < 0.15


def test_noise_loss_is_the_stationary_deviation():
    """e ← (1 − z) e − z w has the variance σ² z/(2 − z)."""
    for z in (0.2, 1.0, 1.7):
        maps = (1 - z) * jnp.eye(2)[None]
        view = View(run=None, weight=None, Ts=0.1, horizon=1.0, tolerance=1e-3, maps=maps)
        np.testing.assert_allclose(LOSSES["noise"](view), np.sqrt(z / (2 - z)), rtol=1e-9)


def test_delay_loss_is_what_is_left_of_a_unit_error():
    """e[k+1] = e[k] − z e[k−1] from e = 1: Σ e² = (1 + z)/((1 − z) z (2 + z))."""
    for z in (0.1, 0.466, 0.8):
        view = View(None, None, 0.1, 1.0, 1e-3, maps=(1 - z) * jnp.eye(2)[None])
        e = [1.0, 1.0]
        for _ in range(2000):
            e.append(e[-1] - z * e[-2])
        np.testing.assert_allclose(LOSSES["delay"](view), np.sqrt(np.sum(np.square(e))), rtol=1e-9)
        np.testing.assert_allclose(LOSSES["delay"](view) ** 2, (1 + z) / ((1 - z) * z * (2 + z)), rtol=1e-9)
    unstable = View(None, None, 0.1, 1.0, 1e-3, maps=-0.2 * jnp.eye(2)[None])  # z = 1.2: late, it grows
    assert not np.isfinite(LOSSES["delay"](unstable))


class Run(NamedTuple):
    """As much of a `Trajectory` as losses look at."""

    e: jax.Array
    qdot: jax.Array


def test_losses_are_what_their_lines_say():
    rng = np.random.default_rng(3)
    e, qdot, N, Ts = rng.normal(size=(13, 2)), rng.normal(size=(12, 3)), 12, 0.1
    view = View(Run(jnp.asarray(e), jnp.asarray(qdot)), jnp.full(N, 1 / N), Ts, N * Ts, 0.5, maps=None)
    squares = np.sum(e[1:] ** 2, axis=1)
    jerks = np.sum((qdot[2:] - 2 * qdot[1:-1] + qdot[:-2]) ** 2, axis=1) / Ts**4
    wanted = {
        "tracking": np.sqrt(np.mean(squares)),
        "settling": Ts * np.sum(squares / (squares + 0.25)),
        "effort": np.sqrt(np.mean(np.sum(qdot**2, axis=1))),
        "jerk": np.sqrt(np.sum(jerks) / N),
    }
    for name, value in wanted.items():
        np.testing.assert_allclose(LOSSES[name](view), value, rtol=1e-12, err_msg=name)
    largest = np.sqrt(np.max(squares))
    assert largest <= LOSSES["worst"](view) <= largest * N ** (1 / 32)
    ((first, a), (second, b)) = terms({"tracking": 2.0, "jerk": 1e-3})
    total = 2 * wanted["tracking"] + 1e-3 * wanted["jerk"]
    np.testing.assert_allclose(a * first(view) + b * second(view), total, rtol=1e-12)
    # Times beyond the horizon do not count.
    half = view._replace(weight=jnp.asarray(np.repeat([1 / 6, 0.0], 6)))
    np.testing.assert_allclose(LOSSES["tracking"](half), np.sqrt(np.mean(squares[:6])), rtol=1e-12)


def null_distance(view):
    return jnp.sum((view.run.q[1] - jnp.asarray(POSTURE)) ** 2) * 1e4


POSTURE = np.array([0.4, 0.8, -0.5])


@pytest.mark.slow
def test_null_space_gain_is_dead_beat_too():
    """At rest a step takes 1 − gain·k·Ts of the way to a posture that lies in the null space: gain 1/(k Ts) = 4."""
    arm = ck.planar_arm([1.0, 0.8, 0.6])
    across = np.linalg.svd(np.asarray(ck.jacobian(arm, POSTURE))[:2])[2][-1]
    q0 = POSTURE + 1e-4 * across
    law = ck.Law(arm, ck.position("xy"), alpha=5.0, null_velocity=ck.posture(POSTURE, rate=2.5))
    place = np.asarray(ck.pose(arm, q0).position)[:2]
    still = ck.line(place, place, duration=3.0)
    found = tune(law, still, q0, **(LOOP | {"N": 2, "over": "null_gain", "loss": null_distance}))
    assert abs(found.values["null_gain"] - 4.0) < 1e-2 and found.satisfied


def test_every_parameter_goes_where_it_belongs():
    law = ck.replace(
        LAW, inverse=ck.damped(0.1), null_velocity=ck.posture([0.0, 1.0], rate=1.0), alpha=np.array([4.0, 6.0])
    )
    loop = pm.Loop(law=law, Ts=jnp.asarray(0.1))
    read = {
        "alpha": lambda made: made.law.alpha,
        "schedule": lambda made: made.schedule,
        "damping": lambda made: made.law.inverse.damping,
        "null_gain": lambda made: jnp.asarray(made.law.null_velocity((0.0, 0.0)))[1],
        "feedforward": lambda made: made.law.feedforward,
        "links": lambda made: ck.pose(made.law.chain, np.zeros(2)).position[1] / 2,
        "tool": lambda made: jnp.asarray(made.law.chain.tip.position),
        "Ts": lambda made: made.Ts,
    }
    assert set(read) == set(pm.NAMES)
    for name, of in read.items():
        p = pm.named(name, loop)
        value = np.asarray(p.start) * 1.1 + (1e-3 if name == "tool" else 0.0)
        np.testing.assert_allclose(pm.bounded(p, jnp.asarray(pm.free(p, value))), value, rtol=1e-9)
        got = of(pm.put(loop, (p,), (jnp.asarray(value),)))
        np.testing.assert_allclose(got, 1.1 if name == "links" else value, rtol=1e-12, err_msg=name)


def test_scaled_links_are_longer_links():
    q, f = np.array([0.3, -0.7]), np.array([1.0, 1.02, 0.97])
    scaled = ck.pose(pm.scaled_links(ARM, f), q).position
    np.testing.assert_allclose(scaled, ck.pose(ck.planar_arm(f[1:], clockwise=True), q).position, rtol=1e-14)


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
    """The error on the line is least at z = 1.888: a radius |1 − z| ≤ 0.3 allows 1.3."""
    found = at(margin=0.3)
    assert found.satisfied and 0.29 < found.radius <= 0.3 * (1 + 1e-9)
    assert 1.29 < found.z <= 1.3 + 1e-9


def test_joint_velocity_limit_binds_and_is_kept():
    far = ck.line([1.1, 0.9], [1.1, 0.9], duration=3.0)
    free = at(far)
    largest = float(np.abs(free.after.qdot).max())
    held = at(far, velocity_limit=0.5 * largest)
    assert held.satisfied and np.abs(held.after.qdot).max() <= 0.5 * largest * (1 + 1e-9)
    assert held.speed > 0.98  # not merely slow
    assert held.z < free.z


def test_noise_delay_and_wrong_lengths_run_as_in_plain_numpy():
    """Two paths, two starts, two draws each: the first run by hand, then tuned over all four.

    With one sample of delay the roots of λ² − λ + z count: a margin of 0.6 allows z = 0.24 to 0.36.
    """
    options = {"noise": 1e-3, "delay": 1, "model_error": 0.01, "draws": 2, "seed": 4}
    paths, starts = [LINE, NEAR], np.array([Q0, Q0 + 0.01])
    objective = make_objective(LAW, paths, starts, Ts=0.1, N=30, method="EE", velocity_limit=1e6, **options)
    scenarios = objective.scenarios
    assert scenarios.q0.shape == (4, 2)
    lengths = [float(o.position[1][0]) for o in (scenarios.plant.joints[1].origin, scenarios.plant.tip)]
    assert 0 < max(abs(np.array(lengths) - 1)) < 0.05

    def tip(q, lengths):  # clockwise, along +y at q = 0
        a = np.cumsum(q)
        return np.array([lengths @ np.sin(a), lengths @ np.cos(a)]), np.array(
            [[lengths @ np.cos(a), lengths[1] * np.cos(a[1])], [-lengths @ np.sin(a), -lengths[1] * np.sin(a[1])]]
        )

    q, errors = Q0.copy(), []
    for k in range(31):
        wanted = np.array([1 - 0.1 * k / 3, 1.0])
        errors.append(wanted - tip(q, np.array(lengths))[0])
        if k == 30:
            break
        told = errors[max(k - 1, 0)] + np.asarray(scenarios.noise)[0, k]
        q = q + 0.1 * np.linalg.solve(tip(q, np.ones(2))[1], np.array([-1 / 3, 0.0]) + 5.0 * told)
    found = tune(LAW, paths, starts, **(LOOP | options | {"starts": 2, "margin": 0.6}))
    np.testing.assert_allclose(found.before.e, errors, rtol=0, atol=1e-12)
    assert found.satisfied and finite(found) and found.starts.shape == (2,)
    assert found.radius_before > 0.6 and 0.24 - 1e-9 <= found.z <= 0.36 + 1e-9
    np.testing.assert_allclose(found.radius, np.abs(np.roots([1.0, -1.0, found.z])).max(), rtol=1e-6)


@pytest.mark.parametrize("alpha", [1e3, 1e8, 1e200])
def test_starts_deep_in_the_unstable_region(alpha):
    found = at(law=ck.replace(LAW, alpha=alpha), margin=0.8)
    assert finite(found) and found.satisfied
    inside(found)
    assert 1 < found.z < 1.81 and found.loss_after < 1e-3


def test_infeasible_margin_is_told():
    """A gain of at most 1/s leaves a radius of 0.9."""
    found = at(margin=0.5, bounds={"alpha": (0.1, 1.0)})
    assert found.status == "infeasible" and not found.satisfied
    assert abs(found.violation - 0.8) < 0.01  # 0.9/0.5 − 1: of all, the one that exceeds it least
    assert "Exceeded by" in found.why and finite(found)
    inside(found)


def test_start_without_a_finite_run_is_told():
    found = at(ck.line([1e308, 1e308], [1e308, 1e308], duration=3.0))
    assert found.status == "non-finite" and not found.satisfied and finite(found)
    inside(found)


def test_start_at_a_singularity_ends_with_a_status():
    """Stretched out, J has no inverse: no NaN comes of it."""
    away = ck.line([0.0, 2.0], [0.5, 1.5], duration=3.0)
    found = tune(LAW, away, np.zeros(2), **LOOP)
    assert found.status in ("converged", "steps", "stuck", "infeasible", "non-finite") and finite(found)
    assert found.satisfied == (found.status in ("converged", "steps", "stuck"))
    inside(found)


# --- what may be tuned --------------------------------------------------------------------------------


@pytest.mark.slow
def test_one_gain_per_axis_with_an_optimizer_of_optax():
    import optax

    found = at(NEAR, law=ck.replace(LAW, alpha=np.array([4.0, 6.0])), optimizer=optax.adam(0.1))
    np.testing.assert_allclose(found.values["alpha"] * 0.1, 1.0, atol=2e-2)
    assert found.satisfied


@pytest.mark.slow
def test_matrix_gain_is_better_than_one_number():
    alpha = np.array([[5.0, 1.0], [1.0, 3.0]])
    scalar = 0.000326587  # what one gain for both axes reaches on this line
    found = at(law=ck.replace(LAW, alpha=alpha), steps=80)
    assert found.values["alpha"].shape == alpha.shape and found.satisfied
    assert found.loss_after < scalar
    inside(found)


@pytest.mark.slow
def test_many_starts_and_other_parameters_in_reverse_mode():
    law = ck.replace(LAW, inverse=ck.damped(0.1))
    over = ("schedule", "Ts", "damping", "feedforward")
    found = at(law=law, over=over, starts=3, gradient="reverse")
    assert set(found.values) == set(over) and found.values["schedule"].shape == (pm.KNOTS,)
    assert found.starts.shape == (3,) and found.loss_after <= found.starts.min() * (1 + 1e-6)
    assert found.loss_after < 0.5 * found.loss_before and found.satisfied and finite(found)
    assert 0.025 <= found.Ts <= 0.4 and found.gradient.startswith("reverse mode, 8 free numbers")
    inside(found)


@pytest.mark.parametrize(
    "options, told",
    [
        ({"over": "gain"}, "over"),
        ({"over": "damping"}, "damping"),
        ({"over": ()}, "over"),
        ({"loss": "trakcing"}, "did you mean 'tracking'"),
        ({"loss": {"tracking": 0.0}}, "weight above 0"),
        ({"loss": {"tracking": -1.0}}, "weight of tracking"),
        ({"over": ("links", "tool")}, "links"),
        ({"over": "null_gain"}, "null_velocity"),
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
        at(**options)


# --- derivatives and bounds ---------------------------------------------------------------------------


@pytest.mark.parametrize("stage", [ck.picard(2), ck.chord(6, implicit=True)], ids=["unrolled", "implicit"])
def test_forward_reverse_and_finite_differences_agree(stage):
    law = ck.replace(LAW, alpha=np.array([[5.0, 1.0], [1.0, 3.0]]))
    losses = {"tracking": 1.0, "jerk": 1e-5, "noise": 1e-3, "delay": 1e-3}
    objective = make_objective(law, LINE, Q0, Ts=0.1, N=6, method="CN", stage=stage, loss=losses)
    quick = quick_jit
    raw = lambda u: jnp.append(*reversed(objective(pm.values_of(objective.parameters, u))))  # noqa: E731
    both = quick(raw)
    u = jnp.asarray(pm.free_of(objective.parameters, [law.alpha]))
    forward = quick(jax.jacfwd(raw))(u)
    # One row at a time in reverse: the loss and the first constraint, the way a descent asks for it.
    some = jnp.asarray([1.0, 0.1, *[0.0] * 8])
    reverse = quick(jax.grad(lambda u: some[: len(forward)] @ raw(u)))(u)
    np.testing.assert_allclose(some[: len(forward)] @ forward, reverse, rtol=1e-9, atol=1e-12)
    h = 1e-5
    apart = np.stack([(both(u + h * d) - both(u - h * d)) / (2 * h) for d in np.eye(len(u))], axis=1)
    np.testing.assert_allclose(forward, apart, rtol=1e-5, atol=1e-8)
    assert np.all(np.abs(forward).max(axis=0) > 1e-4)  # every number matters


def test_gradients_are_told_in_words():
    assert (gradient_mode(3), gradient_mode(30), gradient_mode(30, "forward")) == ("forward", "reverse", "forward")
    assert gradient_in_words(1, "auto", ck.EE, ck.picard(5)) == "forward mode, 1 free number, no implicit stages"
    assert gradient_in_words(30, "auto", ck.CN, ck.picard(5)).endswith("30 free numbers, stages unrolled, pass by pass")
    implicit = gradient_in_words(30, "auto", ck.CN, ck.chord(3, implicit=True))
    assert implicit.startswith("reverse") and implicit.endswith("implicit function theorem")


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
