"""Tuning against known answers, and starts that must not end in a NaN."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.cache import bounded_jit
from cnclik.integrate.drive import Drive
from cnclik.integrate.method import DEFAULT
from cnclik.problem.build import problem_from
from cnclik.stability.spectrum import spectrum
from cnclik.threads import equations
from cnclik.tuning import Conditions, Descent, gradient_in_words, judge, loop_objective, to_json, tune
from cnclik.tuning import parameters as pm
from cnclik.tuning.conditions import rollout, scenarios
from cnclik.tuning.descent import gradient_mode

ARM = ck.planar_arm([1.0, 1.0], clockwise=True)
Q0 = np.array([0.0, np.pi / 2])  # the tip is at (1, 1)
LAW = ck.Law(ARM, ck.position("xy"), alpha=5.0)
# One shape for most tests, so that they share compiled programs: a target that holds still is a line of length 0.
LINE = ck.line([1.0, 1.0], [0.0, 1.0], duration=3.0)  # Case II of the paper
NEAR = ck.line([1.0001, 0.99995], [1.0001, 0.99995], duration=3.0)  # so near that the loop is linear
LOOP = {"Ts": 0.1, "N": 30, "velocity_limit": 1e6, "method": "EE", "delay_margin": 0.0, "noise_gain": 2.0}


def at(reference=LINE, law=LAW, steps=60, starts=1, optimizer=None, gradient="auto", **options):
    descent = Descent(steps=steps, starts=starts, optimizer=optimizer, gradient=gradient)
    return tune(law, reference, Q0, **(LOOP | options), descent=descent)


def finite(found):
    """Nothing in a result may be NaN."""
    numbers = [v for p in (found.before, found.after) for v in (p.loss, p.radius, p.null_radius, p.violation, p.z)]
    leaves = [*found.values.values(), *found.history.values(), found.starts, *numbers]
    return not any(np.isnan(np.asarray(v, float)).any() for v in leaves)


def inside(found):
    for p in found.parameters:
        value = found.values[p.name]
        assert np.all(value >= p.lower * (1 - 1e-12)) and np.all(value <= p.upper * (1 + 1e-12)), (p.name, value)


# --- known answers ------------------------------------------------------------------------------------


def test_reach_with_explicit_euler_finds_the_dead_beat_gain():
    found = at(NEAR)
    # R = 1 − z; what moves z off 1 is curvature, of the size of e0.
    assert abs(found.after.z - 1) < 1e-3 and abs(found.after.correction - 1) < 1e-3
    assert found.satisfied and found.after.radius < 1e-3 and found.status == "converged"
    assert found.gradient.startswith("forward")


def test_a_loop_without_an_error_keeps_its_gain():
    """Roundings prefer no gain: one that they chose would be an accident."""
    found = at(ck.line([1.0, 1.0], [1.0, 1.0], duration=3.0))
    assert found.status == "nothing" and found.values["alpha"] == pytest.approx(5.0, rel=1e-12) and found.satisfied
    assert found.why.startswith("Nothing to tune by: the loop begins at its targets")


@pytest.mark.slow
def test_reach_with_the_trapezoid_finds_two():
    found = at(NEAR, method="TRAPEZOID", stage=ck.chord(1))
    assert abs(found.after.z - 2) < 1e-3  # R = (1 − z/2)/(1 + z/2)
    assert found.satisfied


@pytest.mark.slow
def test_the_papers_feedforward_is_three_times_too_large():
    printed = ck.with_feedforward(LINE, [-1.0, 0.0])
    found = at(printed, method="CN", over="feedforward")
    # The path moves −1/(N·Ts) = −1/3 per second. The method's own error, O(Ts²), is what remains.
    assert abs(found.values["feedforward"] - 1 / 3) < 1e-3
    assert found.after.loss < 2.2e-4 < 0.1 < found.before.loss


def first_error(view):
    return jnp.sum(view.run.e[1] ** 2) * 1e8


@pytest.mark.slow
def test_gain_under_measurement_noise_has_a_closed_form():
    """One step of a linear loop leaves e0 − z (e0 + w): the best z is that of a line fitted through the draws."""
    sigma, e0 = 5e-5, np.array([1e-4, -5e-5])
    options = {"conditions": Conditions(noise=sigma, draws=16)}
    found = at(NEAR, loss=first_error, **options)
    drawn = loop_objective(LAW, NEAR, Q0, **LOOP, **options)
    told = e0 + np.asarray(drawn.scenarios.noise)[:, 0]
    assert abs(found.after.z - np.sum(told * e0) / np.sum(told**2)) < 1e-3
    # In expectation e0²/(e0² + 2σ²), two axes being noisy: not 1, which is right without noise.
    assert abs(found.after.z - 1.25e-8 / (1.25e-8 + 2 * sigma**2)) < 0.15


def null_distance(view):
    return jnp.sum((view.run.q[1] - jnp.asarray(POSTURE)) ** 2) * 1e4


POSTURE = np.array([0.4, 0.8, -0.5])


def test_the_null_space_is_judged_through_dead_time():
    """With 5 samples it is stable to κ Ts = 2 sin(π/22) = 0.285; without any it would be to 2."""
    arm = ck.planar_arm([1.0, 0.8, 0.6])
    place = np.asarray(ck.forward(arm, POSTURE).position)[:2]
    still, late = ck.line(place, place, duration=3.0), Conditions(drive=ck.Drive(delay=5))
    for share, kept in ((0.25, True), (0.3, False)):
        law = ck.Law(arm, ck.position("xy"), alpha=0.5, null_velocity=ck.posture(POSTURE, rate=share / 0.1))
        made = loop_objective(law, still, POSTURE, Ts=0.1, N=2, method="EE", conditions=late)
        (judged,) = judge(made, [(np.asarray(0.5),)])
        assert judged.feasible == kept == bool(judged.null_radius < 1)
        _, constraints = bounded_jit(lambda objective, values: objective(values))(made, (np.asarray(0.5),))
        assert len(constraints) == made.constraints and bool(np.max(constraints) <= 0) == kept
        most = np.pi / (4 * np.arcsin(share / 2)) - 0.5 - 5
        told = made.costs(float(judged.correction), float(judged.null_share))["delay_margin"]
        assert told == pytest.approx(most if kept else 0, abs=2e-2)


@pytest.mark.slow
def test_the_rate_of_a_posture_is_dead_beat_too():
    """At rest a step leaves 1 − rate·Ts of the way to a posture that lies in the null space: the rate is 1/Ts = 10."""
    arm = ck.planar_arm([1.0, 0.8, 0.6])
    across = np.linalg.svd(np.asarray(ck.jacobian(arm, POSTURE))[:2])[2][-1]
    q0 = POSTURE + 1e-4 * across
    law = ck.Law(arm, ck.position("xy"), alpha=5.0, null_velocity=ck.posture(POSTURE, rate=2.5))
    place = np.asarray(ck.forward(arm, q0).position)[:2]
    still = ck.line(place, place, duration=3.0)
    found = tune(law, still, q0, **(LOOP | {"N": 2, "over": "posture_rate", "loss": null_distance}))
    assert abs(found.values["posture_rate"] - 10.0) < 2.5e-2 and found.satisfied
    assert found.after.null_radius < 1e-2 < 0.5 < found.before.null_radius  # |1 − rate·Ts|


def test_a_posture_has_as_many_constraints_as_are_announced():
    law = ck.Law(ck.planar_arm([1.0, 0.8, 0.6]), ck.position("xy"), alpha=5.0, null_velocity=ck.posture(POSTURE, 0.3))
    objective = loop_objective(law, LINE, POSTURE, over="posture_rate", **LOOP)
    assert jax.eval_shape(objective, (jnp.array(1.0),))[1].shape == (objective.constraints,)


def test_what_was_tuned_is_what_solve_runs():
    """With nobody naming a method: `tune`, then `solve` with its defaults."""
    found = tune(LAW, LINE, Q0, Ts=0.1, N=30, velocity_limit=1e6, descent=Descent(steps=2, rounds=1))
    law, reference, q0, Ts, N, method, stage = found.loop
    run = ck.solve(law, reference, q0, Ts, N)
    np.testing.assert_allclose(run.q, found.after.run.q, rtol=0, atol=1e-12)
    assert (method, N, Ts) == (DEFAULT, 30, 0.1) and str(stage) == "picard(5)"


def test_float32_as_float64():
    """Python's default: the same program runs in float64, and what comes back is for any setting."""
    wide, told = at(), []
    with jax.enable_x64(False):
        reference = ck.line([1.0, 1.0], [0.0, 1.0], duration=3.0)
        law = ck.Law(ck.planar_arm([1.0, 1.0], clockwise=True), ck.position("xy"), alpha=5.0)
        descent = Descent(steps=60)
        found = tune(law, reference, Q0, **LOOP, descent=descent, progress=lambda *report: told.append(report))
        run = ck.solve(*found.loop)
        assert run.q.dtype == np.float32 and len(told) > 1
        json.dumps(to_json(found), allow_nan=False)
    np.testing.assert_allclose(found.after.z, wide.after.z, rtol=1e-9)
    np.testing.assert_allclose(found.after.loss, wide.after.loss, rtol=1e-9)
    assert found.after.run.q.dtype == np.float64 and found.satisfied
    np.testing.assert_allclose(run.q, found.after.run.q, rtol=0, atol=1e-5)


def test_values_found_in_other_ways_are_judged_in_float64():
    wide = judge(loop_objective(LAW, LINE, Q0, **LOOP), [(np.array(5.0),)])[0]
    with jax.enable_x64(False):
        found = judge(loop_objective(LAW, LINE, Q0, **LOOP), [(np.array(5.0),)])[0]
    assert found.loss.dtype == np.float64 and found.loss == wide.loss and found.radius == wide.radius


@pytest.mark.slow
def test_float32_as_float64_for_the_pose_of_a_redundant_arm():
    arm, q0 = ck.planar_arm([1.0, 0.8, 0.6]), POSTURE
    at_q0 = ck.forward(arm, q0)
    law = ck.Law(arm, ck.pose("y", "z"), alpha=3.0, null_velocity=ck.posture(q0, rate=1.0))
    target = ck.hold(np.asarray(at_q0.position)[1:2] + 1e-3, np.asarray(at_q0.rotation))

    def one():
        short = Descent(steps=10, rounds=2)
        return tune(law, target, q0, **LOOP | {"N": 3, "velocity_limit": None}, descent=short)

    wide = one()
    with jax.enable_x64(False):
        found = one()
    np.testing.assert_allclose(found.after.z, wide.after.z, rtol=1e-9)
    assert 0.8 < found.after.z <= 1 + 1e-7 and found.satisfied  # ten steps
    assert abs(found.after.null_radius - 0.9) < 1e-2  # 1 − rate·Ts


def test_no_two_batches_of_lapack_run_side_by_side():
    """They wait for each other's threads, for ever: `tune` hung where three batches of eigenvalues were due at once."""
    objective = loop_objective(LAW, LINE, Q0, **LOOP)
    traced = jax.make_jaxpr(jax.vmap(objective.observe))((np.full(4, 5.0),))
    names = [one.primitive.name for one in equations(traced.jaxpr)]
    assert names.count("svd") == 1 and not {"eig", "eigh", "lu", "cholesky", "triangular_solve"} & set(names)


# --- constraints --------------------------------------------------------------------------------------


def test_no_ringing_unless_asked_for():
    """On error alone this line asks for z = 1.888, with which an error changes its sign every step."""
    calm, ringing = at(), at(ringing=True)
    assert 1 - 1e-6 < calm.after.z <= 1 + 1e-7 and calm.satisfied and calm.after.correction <= 1 + 1e-7
    assert abs(ringing.after.z - 1.888) < 1e-2 and ringing.satisfied and ringing.after.radius > 0.88
    assert ringing.after.loss < calm.after.loss < calm.before.loss
    assert (calm.ringing, ringing.ringing) == (False, True)


def test_by_default_a_sample_of_dead_time_is_to_spare():
    """z = 1/4: with one sample more a step still doesn't overshoot, and noise of a measurement moves by 0.378 of it."""
    found = at(delay_margin=1.0, noise_gain=0.5)
    np.testing.assert_allclose(found.after.z, 0.25, rtol=1e-4)
    np.testing.assert_allclose(found.after.noise_gain, np.sqrt(0.25 / 1.75), rtol=1e-3)
    assert found.satisfied and 5.5 < found.after.delay_margin < 6 and "nearly zero" not in str(found)
    front = found.front
    kept = front["violation"] <= 1e-6
    assert kept.any() and (~kept).any() and front["z"][kept].max() <= 0.2501
    assert (np.diff(front["noise_gain"][kept]) > 0).all() and (np.diff(front["delay_margin"][kept]) < 0).all()
    tight = at(noise_gain=0.2)
    np.testing.assert_allclose(tight.after.noise_gain, 0.2, rtol=1e-3)


def test_margin_binds_and_is_kept():
    """The error on the line is least at z = 1.888: a radius |1 − z| ≤ 0.3 allows 1.3."""
    found = at(margin=0.3, ringing=True)
    assert found.satisfied and 0.29 < found.after.radius <= 0.3 * (1 + 1e-9)
    assert 1.29 < found.after.z <= 1.3 + 1e-9


def test_joint_velocity_limit_binds_and_is_kept():
    far = ck.line([1.1, 0.9], [1.1, 0.9], duration=3.0)
    free = at(far)
    largest = float(np.abs(free.after.run.qdot).max())
    held = at(far, velocity_limit=0.5 * largest)
    assert held.satisfied and np.abs(held.after.run.qdot).max() <= 0.5 * largest * (1 + 1e-9)
    assert held.after.speed > 0.98  # not merely slow
    assert held.after.z < free.after.z


@pytest.mark.slow
def test_a_null_direction_that_nothing_acts_on_keeps_its_constraint():
    """Two of them stay at exactly 1: ‖A^p‖^(1/p) is 2^(1/2p) > 1, which no gain would ever bring to 1."""
    arm, q = ck.planar_arm([1.0, 0.8, 0.6, 0.5]), np.array([0.4, 0.8, -0.5, 0.3])
    law = ck.Law(arm, ck.position("xy"), alpha=5.0, null_velocity=ck.posture(q, 1e-30))
    place = np.asarray(ck.forward(arm, q).position)[:2]
    objective = loop_objective(law, ck.hold(place), q, **LOOP | {"N": 2, "velocity_limit": None})
    _, constraints = bounded_jit(lambda objective, values: objective(values))(objective, (law.alpha,))
    assert float(np.max(constraints)) <= 0
    (judged,) = judge(objective, [(law.alpha,)], together=1)
    np.testing.assert_allclose(judged.null_radius, 1.0, rtol=1e-12)
    np.testing.assert_allclose(judged.radius, 0.5, rtol=1e-9)  # not the null space's
    assert judged.feasible and abs(judged.excess[2]) < 1e-12


LATE = Conditions(noise=1e-3, drive=Drive(delay=1), model_error=0.01, draws=2, seed=4)
PATHS, STARTS = [LINE, NEAR], np.array([Q0, Q0 + 0.01])


def test_noise_delay_and_wrong_lengths_run_as_in_plain_numpy():
    """Two paths, two starts, two draws each: the first run by hand."""
    objective = loop_objective(LAW, PATHS, STARTS, **LOOP, conditions=LATE)
    scenarios = objective.scenarios
    assert scenarios.q0.shape == (4, 2)
    lengths = [float(o.position[1][0]) for o in (scenarios.plant.joints[1].origin, scenarios.plant.tip)]
    assert 0 < max(abs(np.array(lengths) - 1)) < 0.05

    def tip(q, lengths):  # clockwise, along +y at q = 0
        a = np.cumsum(q)
        return np.array([lengths @ np.sin(a), lengths @ np.cos(a)]), np.array(
            [[lengths @ np.cos(a), lengths[1] * np.cos(a[1])], [-lengths @ np.sin(a), -lengths[1] * np.sin(a[1])]]
        )

    q, errors, asked = Q0.copy(), [], [np.zeros(2)]
    for k in range(31):
        wanted = np.array([1 - 0.1 * k / 3, 1.0])
        errors.append(wanted - tip(q, np.array(lengths))[0])
        if k == 30:
            break
        told = errors[k] + np.asarray(scenarios.noise)[0, k]
        asked.append(0.1 * np.linalg.solve(tip(q, np.ones(2))[1], np.array([-1 / 3, 0.0]) + 5.0 * told))
        q = q + asked[k]  # what was asked for a sample ago
    (judged,) = judge(objective, [(LAW.alpha,)], together=1)
    np.testing.assert_allclose(judged.run.e, errors, rtol=0, atol=1e-12)
    np.testing.assert_allclose(judged.radius, np.abs(np.roots([1.0, -1.0, 0.5])).max(), rtol=1e-9)
    np.testing.assert_allclose(judged.excess[1], 0.5 / 0.25 - 1, rtol=1e-6)  # it rings


@pytest.mark.slow
def test_each_draw_has_joint_noise_of_its_own():
    conditions = Conditions(drive=Drive(joint_noise=1e-3, seed=4), draws=3)
    drawn = scenarios(LAW, LINE, np.array([0.3, 1.2]), 5, conditions)
    loop = pm.Adjustable(law=LAW, Ts=0.1)
    runs = jax.vmap(lambda one: rollout(loop, one, 5, "EE", ck.picard(1), drive=conditions.drive).q)(drawn)
    assert drawn.seed[0] == 4
    for seed, q in zip(drawn.seed, runs, strict=True):
        own = ck.solve(LAW, LINE, [0.3, 1.2], 0.1, 5, "EE", drive=Drive(joint_noise=1e-3, seed=int(seed)))
        np.testing.assert_allclose(q, own.q, atol=1e-12)
    assert np.ptp(runs[:, -1], axis=0).min() > 1e-4
    other = ck.replace(conditions, drive=Drive(joint_noise=1e-3, seed=5))
    assert not set(drawn.seed.tolist()) & set(scenarios(LAW, LINE, np.array([0.3, 1.2]), 5, other).seed.tolist())


@pytest.mark.slow
def test_a_null_space_velocity_that_leaves_the_posture_is_no_fault_of_the_gain():
    """Along this run a motion of the null space grows by 2 % a step, whatever the gain: all others are kept to."""
    arm = ck.planar_arm([1.0, 0.8, 0.6, 0.5])
    q0 = np.array([-0.715, -0.605, 0.942, -1.224])
    tip = np.asarray(ck.forward(arm, q0).position)[:2]
    law = ck.Law(arm, ck.position("xy"), alpha=5.0, null_velocity=ck.posture(np.zeros(4), 2.0))
    assert spectrum(law, None, q0, 0.01, "EE").null_radius > 1.01
    found = tune(law, ck.line(tip, 0.9 * tip, duration=1.0), q0, Ts=0.01, N=100, method="EE", descent=Descent(steps=60))
    assert found.satisfied and found.after.z == pytest.approx(0.25, abs=0.01)
    assert found.after.null_radius == pytest.approx(1, abs=1e-9)


@pytest.mark.slow
def test_a_null_space_velocity_too_fast_for_the_step_is_to_blame():
    arm, q0 = ck.planar_arm([1.0, 0.8, 0.6]), np.array([-0.715, -0.605, 0.942])
    tip = np.asarray(ck.forward(arm, q0).position)[:2]
    fast = ck.Law(arm, ck.position("xy"), alpha=5.0, null_velocity=ck.posture(q0, 250.0))  # 1 − 2.5: by the step
    path = ck.line(tip, 0.99 * tip, duration=1.0)
    blamed = tune(fast, path, q0, Ts=0.01, N=20, method="EE", descent=Descent(steps=2))
    assert not blamed.satisfied and "null space" in blamed.why


@pytest.mark.slow
def test_a_gain_that_is_hardly_any_is_said_to_be():
    fast = problem_from("planar:1,0.8", reference="circle", radius=0.2, period=0.7)
    at = dict(Ts=0.01, N=60, method="EE", descent=Descent(steps=30))
    late = tune(fast.law, fast.reference, fast.q0, conditions=Conditions(drive=Drive(delay=3, lag=0.1)), **at)
    assert late.after.z * 60 < 1 and "nearly zero" in str(late) and "or bound alpha" in str(late)
    fast = ck.replace(late, after=ck.replace(late.after, speed=0.999))  # as where joint velocities hold it back
    assert "nearly zero" in fast.why and "bound on joint velocities" in fast.why and "drive" not in fast.why
    given = ck.replace(late, values={"links": np.ones(3)})  # as where something else was tuned
    assert "nearly zero" in given.why and "tune it too" in given.why and "bound alpha" not in given.why


def test_late_loops_are_tuned_by_their_own_roots():
    """With one sample of delay the roots of λ² − λ + z count: no ringing up to 1/4, a margin of 0.6 from 0.24 up."""
    found = tune(LAW, PATHS, STARTS, **LOOP, margin=0.6, conditions=LATE, descent=Descent(steps=60, starts=2))
    assert found.satisfied and finite(found) and found.starts.shape == (2,)
    assert found.before.radius > 0.6 and 0.24 - 1e-9 <= found.after.z <= 0.25 + 1e-9
    np.testing.assert_allclose(found.after.radius, np.abs(np.roots([1.0, -1.0, found.after.z])).max(), rtol=1e-6)
    assert isinstance(found.loop[1], ck.Reference) and found.loop[2].shape == (2,)


@pytest.mark.parametrize("alpha", [0.0, 1e3, 1e200])
def test_starts_at_rest_and_deep_in_the_unstable_region(alpha):
    found = at(law=ck.replace(LAW, alpha=alpha), margin=0.8)
    assert finite(found) and found.satisfied
    inside(found)
    assert 0.99 < found.after.z <= 1 + 1e-7 and found.after.loss < 1e-3


def test_infeasible_margin_is_told():
    """A gain of at most 1/s leaves a radius of 0.9."""
    found = at(margin=0.5, bounds={"alpha": (0.1, 1.0)})
    assert found.status == "infeasible" and not found.satisfied
    assert abs(found.after.violation - 0.8) < 0.01  # 0.9/0.5 − 1: of all, the one that exceeds it least
    assert "the bound on spectral radius is exceeded by 80" in found.why and finite(found)
    assert "NOT kept" in str(found)
    inside(found)


def test_start_without_a_finite_run_is_told():
    found = at(ck.line([1e308, 1e308], [1e308, 1e308], duration=3.0))
    assert found.status == "non-finite" and not found.satisfied and finite(found)
    assert found.evaluations == 0 and str(found)
    inside(found)


def test_start_at_a_singularity_ends_with_a_status():
    """Stretched out, J has no inverse: no NaN comes of it."""
    away = ck.line([0.0, 2.0], [0.5, 1.5], duration=3.0)
    found = tune(LAW, away, np.zeros(2), **LOOP, descent=Descent(steps=60))
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
def test_many_starts_and_other_parameters_in_reverse_mode():
    law = ck.replace(LAW, inverse=ck.damped(0.1))
    over = ("schedule", "Ts", "damping", "feedforward")
    found = at(law=law, over=over, starts=3, gradient="reverse", ringing=True)
    assert set(found.values) == set(over) and found.values["schedule"].shape == (pm.KNOTS,)
    assert found.starts.shape == (3,) and found.after.loss <= found.starts.min() * (1 + 1e-6)
    assert found.after.loss < 0.5 * found.before.loss and found.satisfied and finite(found)
    assert 0.025 <= found.Ts <= 0.4 and found.gradient.startswith("reverse mode, 8 free numbers")
    inside(found)


@pytest.mark.slow
def test_panda_on_a_circle_does_not_ring():
    from cnclik.problem.build import problem_from

    made = problem_from("panda", reference="circle", Ts=0.05, N=40, method="EE", damping=0.01)
    found = tune(made.law, made.reference, made.q0, Ts=made.Ts, N=made.N, method=made.method)
    assert found.satisfied and 0.2 < found.after.z <= 0.2501 and found.after.correction <= 0.25 + 1e-7


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
        ({"over": "posture_rate"}, "a law with a posture"),
        ({"margin": 1.5}, "margin"),
        *(({"ringing": value}, "`ringing` must be True or False") for value in (-1, 2, "no", None, [True])),
        ({"bounds": {"alpha": (5, 1)}}, "increase"),
        ({"bounds": {"Ts": (1, 2)}}, "bounds"),
        ({"bounds": {"alpha": 3}}, "lower, upper"),
        ({"bounds": {"alpha": ("a", 2)}}, "bounds of alpha"),
        ({"bounds": [1, 2]}, "bounds"),
        ({"over": 3}, "over"),
        ({"los": "worst"}, r"`goal` must be one of over, .* but is 'los' \(did you mean 'loss'\?\)"),
        ({"velocity_limit": -1.0}, "velocity_limit"),
        ({"conditions": {"noise": 0.1}}, "conditions"),
        ({"conditions": Conditions(noise=np.ones(3))}, "noise"),
    ],
)
def test_what_does_not_fit_is_named(options, told):
    with pytest.raises(ck.ArgumentError, match=told):
        at(**options)


@pytest.mark.parametrize("name, value", [("noise", -1.0), ("drive", 1), ("draws", 0), ("model_error", -0.1)])
def test_conditions_that_can_not_be_are_named(name, value):
    with pytest.raises(ck.ArgumentError, match=name):
        Conditions(**{name: value})


# --- derivatives --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "method, stage",
    [
        ("EE", None),
        pytest.param("CN", ck.picard(2), marks=pytest.mark.slow),
        pytest.param("CN", ck.chord(6, implicit=True), marks=pytest.mark.slow),
    ],
    ids=["explicit", "pass by pass", "implicit"],
)
def test_forward_reverse_and_finite_differences_agree(method, stage):
    law = ck.replace(LAW, alpha=np.array([5.0, 3.0]))
    losses = {"tracking": 1.0, "jerk": 1e-5, "noise": 1e-3, "delay": 1e-3}
    objective = loop_objective(law, LINE, Q0, Ts=0.1, N=4, method=method, stage=stage, loss=losses, margin=0.9)
    assert len(objective.postures) == 9

    def raw(u):
        loss, constraints = objective(pm.values_of(objective.parameters, u))
        return jnp.stack([loss, constraints[0], constraints[9]])  # one of each kind

    both = bounded_jit(raw)
    u = jnp.asarray(pm.free_of(objective.parameters, [law.alpha]))
    forward = bounded_jit(jax.jacfwd(raw))(u)
    if method != "EE":  # of explicit steps: integrate's own tests
        weights = jnp.asarray([1.0, 0.1, 0.2])  # one row at a time in reverse, the way a descent asks for it
        reverse = bounded_jit(jax.grad(lambda u: weights @ raw(u)))(u)
        np.testing.assert_allclose(weights @ forward, reverse, rtol=1e-9, atol=1e-12)
    h = 1e-5
    apart = np.stack([(both(u + h * d) - both(u - h * d)) / (2 * h) for d in np.eye(len(u))], axis=1)
    np.testing.assert_allclose(forward, apart, rtol=1e-5, atol=1e-8)
    assert np.all(np.abs(forward).max(axis=0) > 1e-4)  # every number matters


def test_gradients_are_told_in_words():
    assert (gradient_mode(3), gradient_mode(30), gradient_mode(30, "forward")) == ("forward", "reverse", "forward")
    assert gradient_in_words(1, "auto", ck.EE, ck.picard(5)) == "forward mode, 1 free number, no implicit stages"
    assert gradient_in_words(30, "auto", ck.CN, ck.picard(5)).endswith("30 free numbers, stages pass by pass")
    implicit = gradient_in_words(30, "auto", ck.CN, ck.chord(3, implicit=True))
    assert implicit.startswith("reverse") and implicit.endswith("implicit function theorem")
