"""Tuning against known answers: its parameters, bounds and constraints, starts that must not end in a NaN, descent."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import cnclik as ck
from cnclik.integrate.method import DEFAULT
from cnclik.record import record
from cnclik.robot.rotations import safe_norm
from cnclik.tuning import Parameter, tracking, tune
from cnclik.tuning import parameters as pm
from cnclik.tuning.descent import Bounds, descend, evaluate
from cnclik.tuning.parameters import chosen, ends
from cnclik.tuning.tune import objective_of
from tests.bank import told
from tests.refusals import refusals

ARM = ck.planar_arm([1.0, 1.0], clockwise=True)
Q0 = np.array([0.0, np.pi / 2])  # the tip is at (1, 1)
LAW = ck.Law(ARM, ck.position("xy"), alpha=5.0)
# One shape for most tests, so that they share compiled programs: a target that holds still is a line of length 0.
LINE = ck.line([1.0, 1.0], [0.0, 1.0], duration=3.0)  # Case II of the paper
NEAR = ck.line([1.0001, 0.99995], [1.0001, 0.99995], duration=3.0)  # so near that the loop is linear
FREE = {"bounds": {"alpha": (0.1, 19.99)}}  # up to the largest stable gain of explicit Euler, z = 2


def at(reference=LINE, law=LAW, q0=Q0, **options):
    loop = {"Ts": 0.1, "N": 30, "method": "EE", "drive": ck.Drive()}
    return tune(law, reference, q0, **(loop | options))


# --- known answers ------------------------------------------------------------------------------------


def test_reach_with_explicit_euler_finds_the_dead_beat_gain():
    found = at(NEAR, **FREE)
    assert abs(found.values["alpha"] - 10) < 1e-2  # R = 1 − z; what moves z off 1 is curvature, of the size of e0
    assert found.status == "converged" and "recommended gain: alpha" in found.why


def test_the_papers_feedforward_is_three_times_too_large():
    found = at(told(LINE, np.array([-1.0, 0.0])), method="CN", over="feedforward")
    # The path moves −1/(N·Ts) = −1/3 per second. The method's own error, O(Ts²), is what remains.
    assert abs(found.values["feedforward"] - 1 / 3) < 1e-3 and found.losses[1] < 2.2e-4 < 0.1 < found.losses[0]


def first_error(run):
    return jnp.sum(run.e[1] ** 2) * 1e8


def test_gain_under_measurement_noise_has_a_closed_form():
    """One step of a linear loop leaves e0 − z (e0 + w): the best z is that of a line fitted through the draws."""
    e0, noise = np.array([1e-4, -5e-5]), 5e-5 * np.random.default_rng(0).standard_normal((16, 30, 2))
    found, measured = at(NEAR, loss=first_error, noise=noise, **FREE), e0 + noise[:, 0]
    assert abs(0.1 * found.values["alpha"] - np.sum(measured * e0) / np.sum(measured**2)) < 1e-3
    assert found.loss == "first_error"


POSTURE = np.array([0.4, 0.8, -0.5])


def null_distance(run):
    return jnp.sum((run.q[1] - jnp.asarray(POSTURE)) ** 2) * 1e4


def test_the_posture_rate_is_dead_beat_too():
    """At rest a step takes rate·Ts of the way to a posture that lies in the null space."""
    arm = ck.planar_arm([1.0, 0.8, 0.6])
    q0 = POSTURE + 1e-4 * np.linalg.svd(np.asarray(ck.jacobian(arm, POSTURE))[:2])[2][-1]
    law = ck.Law(arm, ck.position("xy"), alpha=2.0, null_velocity=ck.posture(POSTURE, rate=2.0))
    with jax.enable_x64(True):
        still = ck.hold(ck.forward(arm, q0).position[:2])
    free = {"over": "posture_rate", "bounds": {"posture_rate": (0.1, 15.0)}}
    assert abs(at(still, law, q0, N=3, loss=null_distance, **free).values["posture_rate"] - 10.0) < 1e-2
    bound = at(still, law, q0, N=3, loss=null_distance, over="posture_rate")
    assert bound.values["posture_rate"] == pytest.approx(2.5) and "At the upper bound: posture_rate" in bound.why


def test_by_default_a_sample_of_dead_time_is_to_spare():
    """On error alone this line asks for z = 1.888, with which an error changes its sign every step."""
    found, ringing = at(), at(**FREE)
    assert 0.1 * found.values["alpha"] == pytest.approx(1 / 4, rel=1e-6)
    assert found.values["alpha"] == found.advice.gains.recommended and not found.advice.above
    assert found.why.endswith("At the upper bound: alpha.") and found.evaluations < 10
    assert abs(0.1 * ringing.values["alpha"] - 1.888) < 1e-2 and ringing.losses[1] < found.losses[1]


# --- what comes back ----------------------------------------------------------------------------------


def test_what_was_tuned_is_what_solve_runs():
    """With nobody naming a method: `tune`, then `solve` with its defaults."""
    with jax.enable_x64(True):
        found = tune(LAW, LINE, Q0, Ts=0.1, N=30, steps=4)  # and drives that are assumed slow
        law, reference, q0, Ts, N, method, stage = found.loop
        run = ck.solve(law, reference, q0, Ts, N, drive=found.drive)
    np.testing.assert_allclose(run.q, found.after.q, rtol=0, atol=1e-12)
    assert (method, N, Ts) == (DEFAULT, 30, 0.1) and str(stage) == "picard(5)"
    assert found.advice.gains.assumed and found.drive.lag == 0.1
    assert found.losses[1] == pytest.approx(np.sqrt(np.mean(np.sum(run.e[1:] ** 2, -1))))


def test_float32_as_float64():
    """Python's default: the same program runs in float64, and what comes back is for any setting."""
    reports = []
    with jax.enable_x64(True):
        wide = at(**FREE)
    with jax.enable_x64(False):
        found = at(**FREE, progress=lambda *report: reports.append(report))
        assert ck.solve(*found.loop).q.dtype == np.float32 and len(reports) > 1 and found.after.q.dtype == np.float64
    np.testing.assert_allclose([found.values["alpha"], *found.losses], [wide.values["alpha"], *wide.losses], rtol=1e-6)


def test_a_loop_without_an_error_keeps_its_gain():
    """Roundings prefer no gain: one that they chose would be an accident."""
    found = at(ck.line([1.0, 1.0], [1.0, 1.0], duration=3.0), law=ck.replace(LAW, alpha=2.0))
    assert found.status == "nothing" and found.values["alpha"] == pytest.approx(2.0)


def test_the_loss_is_the_mean_over_paths_and_starts():
    paths, starts = [LINE, NEAR], np.array([Q0, Q0 + 0.01])
    both = at(paths, q0=starts, steps=3)
    apart = [at(path, q0=q0, steps=3).losses[0] for path, q0 in zip(paths, starts, strict=True)]
    assert both.losses[0] == pytest.approx(np.mean(apart)) and both.loop[1] == LINE
    np.testing.assert_array_equal(both.loop[2], Q0)


def test_a_parameter_and_an_optimizer_of_your_own():
    def put(law, share):
        return ck.replace(law, alpha=jnp.array([1.0, 0.5]) * share)

    share = Parameter(name="share", start=5.0, lower=1.0, upper=15.0, put=put, unit="1/s")
    found = at(NEAR, over=share, optimizer=optax.adam(0.2))
    x, y = 1e-4 * (1 - 0.1 * found.values["share"]), 5e-5 * (1 - 0.05 * found.values["share"])
    assert found.law.alpha[0] == found.values["share"] and abs(x) < 5e-5 and abs(y) < 5e-5
    assert "share = " in str(found) and "1/s (from 5)" in str(found)


TASK = ck.stack(hand=ck.position("xy"), rest=ck.joints(weights=0.1))
HAND = ck.planar_arm([0.5, 0.4, 0.3])
REST = np.array([0.4, 0.8, -0.5])
LEVELS = ck.levels(["hand"], ["rest"], damping=(1e-3, 0.05))
STACK = ck.Law(HAND, TASK, alpha={"hand": 8.0, "rest": 40.0}, inverse=LEVELS)


def test_a_stack_is_tuned_for_its_hands_and_a_gain_above_is_named():
    """The posture never arrives, so that in a loss it would outweigh the hand."""
    aims = ck.hold_at(HAND, TASK, REST, hand=ck.hold(ck.forward(HAND, REST).position + np.array([0.05, 0.05, 0.0])))
    found = at(aims, STACK, REST, Ts=0.02, drive=ck.Drive(delay=1))
    assert found.values == {"hand.alpha": pytest.approx(50 * 4 / 27)}  # as for one task
    hand = [np.sqrt((run["hand"].e[1:] ** 2).sum(1).mean()) for run in (found.before, found.after)]
    assert found.losses == pytest.approx(hand, rel=1e-6)
    assert f"RMS error of hand: {hand[0]:.4g} -> {hand[1]:.4g}\n" in str(found)
    assert found.advice.above == ("rest",) and "Above the recommended gain: rest." in found.why


# --- constraints --------------------------------------------------------------------------------------

FAR = ck.line([1.1, 0.9], [1.1, 0.9], duration=3.0)


def test_joint_velocity_limit_binds_and_is_kept():
    free = at(FAR, velocity_limit=1e6, **FREE)
    largest = np.abs(free.after.qdot).max()
    held = at(FAR, velocity_limit=0.5 * largest, **FREE)
    assert held.status in ("converged", "steps") and 0.98 < held.speeds[1] <= 1 + 1e-9  # not merely slow
    assert np.abs(held.after.qdot).max() == pytest.approx(held.speeds[1] * 0.5 * largest)
    assert held.values["alpha"] < free.values["alpha"] and "% of the limit" in str(held)


def test_a_path_that_no_gain_makes_slow_enough_and_runs_that_are_not_finite_are_told():
    found = at(velocity_limit=0.05)
    assert found.status == "infeasible" and found.speeds[1] > 5
    assert at(loss=lambda run: jnp.nan * run.e[1, 0]).status == "non-finite"


RUNS_AWAY = ck.Drive(delay=4, natural_frequency=10.0, damping_ratio=0.2, command="position", feedback="rebased")


test_what_does_not_fit_is_refused = refusals(
    ({"loss": "tracking"}, "`loss` must be a function"),
    ({"velocity_limit": -1.0}, "velocity_limit"),
    ({"noise": np.ones((30, 3))}, r"`noise` must have shape \(30, 2\) or \(n, 30, 2\)"),
    ({"reference": [LINE] * 2, "q0": np.ones((3, 2))}, "`reference` must be one, or one for each of 3 runs"),
    ({"reference": [LINE, ck.hold([1.0, 1.0])]}, "`reference` must be paths of one kind"),
    ({"reference": [ck.path(lambda t, k=k: (1 - k * t, 1.0)) for k in (0, 1)]}, "be paths of one kind"),
    ({"progress": 5}, "`progress` must be a function or None"),
    ({"N": 2}, "`N` must be at least 3"),
    (
        {"law": ck.replace(LAW, alpha=[5.0, 5.0]), "drive": ck.Drive(lag=[0.05, 0.2])},
        "be the same for all joints where gains differ",
    ),
    ({"drive": RUNS_AWAY}, "`drive` must allow a gain, but each position command starts at the measured joints"),
    of=at,
)


# --- runs and derivatives -----------------------------------------------------------------------------


LINKS = Parameter(
    name="links",
    start=np.ones(3),
    lower=0.5,
    upper=2.0,
    put=lambda law, v: ck.replace(law, chain=ck.planar_arm(v, clockwise=True)),
)


def with_jerk(run):
    return tracking(run) + 1e-5 * safe_norm(jnp.diff(run.qdot, n=2, axis=0).ravel()) / (run.t[1] - run.t[0]) ** 2


def test_derivatives_in_reverse_mode_are_those_of_differences(monkeypatch):
    monkeypatch.setattr("cnclik.tuning.descent.FORWARD_UP_TO", 5)
    with jax.enable_x64(True):
        arm, q0 = ck.planar_arm([1.0] * 3, clockwise=True), np.array([0.0, 1.2, 0.3])
        law = ck.Law(arm, ck.position("xy"), alpha=np.array([5.0, 3.0]))
        path = ck.line((tip := np.asarray(ck.forward(arm, q0).position)[:2]) + 0.05, tip - 0.2, duration=3.0)
        found = chosen(("alpha", LINKS, "feedforward"), law, {}, ck.gains(Ts=0.05, drive=ck.Drive(), method="EE"))
        how = 4, ck.METHODS["EE"], ck.picard(5)
        objective = objective_of(law, found, [path], q0, 0.05, how, loss=with_jerk, drive=ck.Drive(), limit=1e6)
        lower, upper, start = ends(found)
        bounds = Bounds(lower, upper)
        u, h = bounds.free(start) - 0.1, 1e-6
        fastest = 1e6 * (1 + evaluate(objective, bounds, u).excess)
        objective = ck.replace(objective, limits=np.full(3, 0.98 * fastest))  # exceeded: the penalty counts
        slope = evaluate(objective, bounds, u).slope
        apart = [
            evaluate(objective, bounds, u + h * d).merit - evaluate(objective, bounds, u - h * d).merit
            for d in np.eye(len(u))
        ]
    assert len(u) == 6
    np.testing.assert_allclose(slope, np.array(apart) / (2 * h), rtol=2e-5, atol=1e-7 * np.abs(slope).max())


PARTS_LAW = ck.Law(
    ARM, ck.position("xy"), alpha=[4.0, 6.0], inverse=ck.damped(0.1), null_velocity=ck.posture([0.0, 1.0])
)
GAINS = ck.gains(Ts=0.02, drive=ck.Drive(delay=1), method="EE")  # z = 4/27 at most


def test_a_damping_is_a_parameter():
    (p,) = pm.chosen("damping", PARTS_LAW, {}, GAINS)
    assert p.start == 0.1 and pm.put(PARTS_LAW, (p,), np.array([0.05])).inverse.damping == 0.05


PARTS_TASK = ck.stack(hand=ck.position("xy"), turn=ck.orientation("z"), rest=ck.joints(weights=[0.1] * 4))
PARTS = ck.Law(
    ck.planar_arm([0.5, 0.4, 0.3, 0.3]),
    PARTS_TASK,
    alpha={"hand": 8.0, "turn": 4.0, "rest": 1.0},
    inverse=ck.levels(["hand"], ["turn", "rest"], damping=(0.01, 0.1)),
    null_velocity=ck.posture(np.zeros(4)),
)


def test_alpha_of_a_stack_is_a_gain_for_each_task_but_postures():
    chosen = pm.chosen(("alpha", "rest.alpha", "posture_rate"), PARTS, {"rest.alpha": (0.5, 2.0)}, GAINS)
    assert [p.name for p in chosen] == ["hand.alpha", "turn.alpha", "rest.alpha", "posture_rate"]
    assert [float(p.upper) for p in chosen] == [GAINS.recommended] * 2 + [2.0, GAINS.recommended]
    made = pm.put(PARTS, chosen, np.array([1.0, 2.0, 3.0, 4.0]))
    np.testing.assert_array_equal(made.alpha, [1, 1, 2, 3, 3, 3, 3])
    assert made.null_velocity.rate == 4
    idle = ck.replace(PARTS, alpha={"hand": 8.0, "turn": 0.0, "rest": 1.0})
    assert [p.name for p in pm.chosen("alpha", idle, {}, GAINS)] == ["hand.alpha"]  # a gain of 0 stays
    (all_tasks,) = pm.chosen("alpha", ck.replace(PARTS, alpha=5.0), {}, GAINS)
    assert all_tasks.name == "alpha" and all_tasks.start.shape == ()
    axes = ck.replace(PARTS, alpha={"hand": [8.0, 7.0], "turn": 4.0, "rest": 1.0})
    assert [p.start.tolist() for p in pm.chosen("alpha", axes, {}, GAINS)] == [[8.0, 7.0], 4.0]


OWN = pm.Parameter(name="mine", start=1.0, lower=0.1, upper=2.0, put=lambda law, value: law)
test_parameters_that_do_not_fit_are_named = refusals(
    ((PARTS, "hnad.alpha", {}), r"one of hand, turn, rest, but is 'hnad' \(did you mean 'hand'"),
    ((PARTS, "damping", {}), "name damping for a law that has it"),
    ((ck.replace(PARTS_LAW, null_velocity=None), "posture_rate", {}), "name posture_rate for a law that has it"),
    ((PARTS_LAW, "gain", {}), "`over` must be one of alpha, .* but is 'gain'"),
    ((PARTS_LAW, (), {}), "name something"),
    ((PARTS_LAW, ("alpha", "alpha"), {}), "each once"),
    ((PARTS_LAW, "alpha", {"alpha": (5, 1)}), "bounds of alpha` must increase"),
    ((PARTS_LAW, "alpha", {"alpha": 3}), r"be \(lower, upper\)"),
    ((PARTS_LAW, "alpha", {"alpha": (0.0, 2)}), "be above 0"),
    ((PARTS_LAW, "alpha", {"alpha": (1, 60)}), "at most the largest stable gain, 50 1/s, but are 1 and 60"),
    ((PARTS_LAW, "alpha", {"damping": (1, 2)}), "`bounds` must be one of alpha"),
    ((PARTS_LAW, ("alpha", OWN), {"mine": (1, 2)}), "`bounds` must leave out a Parameter, which has its own"),
    of=lambda case: pm.chosen(case[1], case[0], case[2], GAINS),
)


@record
class Bowl:
    """w·(x − centre)² with a·x ≤ b, not a number where x[0] > wall."""

    w: object
    centre: object
    a: object
    b: object
    wall: object

    def __call__(self, x):
        loss = jnp.sum(self.w * (x - self.centre) ** 2)
        return jnp.where(x[0] > self.wall, jnp.nan, loss), jnp.atleast_1d(self.a @ x - self.b), x


TARGETS = {  # w, centre, a, b, wall: minimum
    "free": ([1, 1], [1, 2], [0, 0], 1, 9, [1, 2]),
    "badly scaled": ([1, 1e4], [1, 2], [0, 0], 1, 9, [1, 2]),
    "constraint not met at the minimum": ([1, 2], [1, 2], [1, 1], 2, 9, [1 / 3, 5 / 3]),
    "constraint without a say": ([1, 2], [1, 2], [1, 1], 4, 9, [1, 2]),
    "bound of one number": ([1, 1], [1, 7], [0, 0], 1, 9, [1, 5]),
    "wall behind the minimum": ([1, 1], [2, 2], [0, 0], 1, 2.1, [2, 2]),
    "constraint in front of a wall": ([1, 1], [3, 0], [1, 0], 1.5, 1.6, [1.5, 0]),
}
SQUARE = Bounds(np.full(2, -5.0), np.full(2, 5.0))


def minimum(target, **options):
    w, centre, a, b, wall, _ = (np.asarray(v, float) for v in TARGETS[target])
    bowl = Bowl(w=w, centre=centre, a=a, b=b, wall=wall)
    with jax.enable_x64(True):
        best, count, status = descend(bowl, SQUARE, np.array([-2.0, -1.0]), **options)
    assert count <= options.get("steps", 100) and best.excess <= 1e-9
    np.testing.assert_array_equal(best.seen, SQUARE.values(best.u))
    return best, status


@pytest.mark.parametrize("target", TARGETS)
def test_minima_known_on_paper(target):
    best, status = minimum(target)
    w, centre, *_, wanted = map(np.asarray, TARGETS[target])
    assert best.loss == pytest.approx(np.sum(w * (wanted - centre) ** 2), rel=1e-2, abs=1e-8)  # a penalty spares 0.5 %
    np.testing.assert_allclose(best.u, wanted, atol=5e-2 if "constraint" in target else 1e-4)
    assert status == "converged"


def test_progress_and_an_end():
    reports = []
    _, status = minimum("badly scaled", steps=5, progress=lambda *report: reports.append(report))
    assert status == "steps" and [report[:2] for report in reports] == [(k, 5) for k in range(3, 6)]
    assert reports[-1][2].startswith("loss ")
