"""Verdicts of runs at a pace: the path waits for the robot, whose joints can't reverse in a step."""

import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.problem.build import problem_from
from cnclik.stability import Behaviour, Remedy, verdict
from cnclik.stability.case import case_of
from cnclik.stability.trial import Trials

CIRCLE = dict(reference="circle", method="EE", max_acceleration=5.0, max_jerk=300.0)
SHAKES = CIRCLE | dict(alpha=60.0, delay=3.0)


def asked(made):
    how = dict(Ts=made.Ts, method=made.method, stage=made.stage, drive=made.drive or ck.Drive())
    return how | dict(pace=made.pace, noise=made.noise)


def judge(made):
    return verdict(made.law, made.reference, made.run(), **asked(made))


@pytest.mark.parametrize(
    "table",
    [
        pytest.param(dict(N=4000), marks=pytest.mark.slow),  # "diverging: the error has grown to 1.52 mm"
        dict(N=4000, period=4.0),  # "no better", 13 s of the path behind
        dict(N=400, radius=0.2),  # "no better", 1.3 s behind
    ],
)
def test_a_loop_that_shakes_at_a_pace_crawls_and_its_gain_is_named(table):
    made = problem_from("panda", **SHAKES | table)
    told = judge(made)
    assert told.kind == Behaviour.SHAKING and "with the path at 0." in told.sentence, told.sentence
    (one,) = told.remedies
    mended = problem_from("panda", **SHAKES | table | one.change)
    assert mended.run().path_time[-1] > 1.1 * made.run().path_time[-1]
    assert "it follows;" in judge(mended).sentence  # with N = 400, of 98 % of the path, which was too little to tell


@pytest.mark.parametrize("mends", ["error", "motion"])
def test_what_gets_farther_along_a_path_that_waits_is_better(mends):
    """The error of a loop that crawls is small, whatever it does."""

    def better(gain, other):
        made = problem_from("planar:1,1", **SHAKES | dict(N=400, radius=0.2, alpha=gain))
        case = case_of(made.law, made.reference, made.run(), np.float64, **asked(made))
        return not Trials(case).vain(Remedy(change={"alpha": other}, words="", mends=mends))

    assert better(60.0, 10.5) and not better(10.5, 60.0)


def test_a_trial_is_run_once(monkeypatch):
    """The gain of a remedy was run to see whether it is the path that turns the joints, and once more to try it."""
    runs, run = [], Trials._run
    kept = lambda self, made, steps: runs.append((float(made.law.alpha), steps)) or run(self, made, steps)  # noqa: E731
    monkeypatch.setattr(Trials, "_run", kept)
    assert judge(problem_from("planar:1,1", **SHAKES | dict(N=400, radius=0.2))).remedies
    assert len(runs) == len(set(runs)) > 1


@pytest.mark.slow
def test_a_loop_that_is_unstable_only_at_rest_is_calm_at_its_pace():
    """It makes 0.35 of each step, was said to shake, and its remedies to be no better. That the arm wanders, and after
    800 steps comes next to a singularity, is told."""
    made = problem_from("panda", **CIRCLE | dict(alpha=300.0, N=800, period=1.0))
    told = judge(made)
    assert "it follows;" in told.sentence and told.radius > 1.9, told.sentence
    assert "at rest is 2, and 0." in told.sentence and not told.remedies
    assert told.kind == Behaviour.UNDECIDED and "4096 steps in all, the error gets as large as" in told.sentence


@pytest.mark.slow
def test_joints_that_the_path_turns_do_not_shake():
    """A lissajous figure has as much of its joint speed off the mean with any gain: it was said to shake."""
    slow = dict(reference="lissajous", period=3.0, N=600, Ts=0.01, method="EE", max_acceleration=3.0, max_jerk=60.0)
    told = judge(problem_from("ur5", alpha=210.0, **slow))
    assert told.kind == Behaviour.SETTLED and told.radius > 1.05, told.sentence
    assert "of a step that the pace makes" in told.sentence and not told.remedies


def test_what_shakes_at_a_target_within_a_pace_does_not_diverge():
    """Joints that go back and forth by less than is seen: "at rest, but any disturbance grows"."""
    made = problem_from("ur5", reference="hold", method="EE", alpha=300.0, N=800, max_acceleration=3.0, max_jerk=100.0)
    told = judge(made)
    assert told.kind == Behaviour.SHAKING, told.sentence
    assert told.remedies[0].change["alpha"] == pytest.approx(100.0, rel=0.02)


@pytest.mark.parametrize(
    ("robot", "alpha"),
    [*(pytest.param("panda", a, marks=pytest.mark.slow) for a in (105.0, 120.0, 150.0)), ("planar:1,1", 150.0)],
)
def test_what_a_pace_bounds_does_not_diverge(robot, alpha):
    """A loop that is unstable at rest and calm so far was "diverging"; one that is restless was "settled"."""
    table = dict(reference="circle", period=3.0, method="AB2", N=600, max_acceleration=3.0, max_jerk=60.0)
    told = judge(problem_from(robot, **table, alpha=alpha))
    assert told.kind != Behaviour.DIVERGING, told.sentence
    if alpha > 105.0:
        assert told.kind == Behaviour.SHAKING, told.sentence
        assert told.remedies[0].change["alpha"] == pytest.approx(66.7, rel=0.02)


def test_a_joint_past_its_limits_at_a_pace_is_named():
    """One that can hardly brake went past what the law keeps; one that no law keeps inside is told how."""
    arm = ck.planar_arm([1.0, 0.8, 0.6])
    arm = ck.replace(arm, lower=(-2.0, -1.0, -1.0), upper=(2.0, 1.3, 1.0))
    law = ck.Law(arm, ck.position("xy"), alpha=21.2, inverse=ck.damped(0.02), limits=ck.weighted_least_norm())
    pace = ck.Pace(velocity=4.06, acceleration=4.74, jerk=3.6)
    goal, q0, how = ck.hold([-0.563, -1.254]), np.array([-1.442, 1.179, -0.413]), dict(Ts=0.02, method="EE")
    free = ck.replace(law, limits=None)
    near = ck.hold(np.asarray(ck.forward(arm, np.array([-1.7, 1.2, 0.9])).position[:2]))  # which joints can have
    run = ck.solve(free, near, q0, 0.02, 300, "EE", pace=pace)
    past = float(np.max([arm.lower - run.q.min(0), run.q.max(0) - arm.upper]))
    told = verdict(free, near, run, pace=pace, **how)
    assert past > 0.01 and f"is up to {past:.3g} rad beyond its limit" in told.sentence, told.sentence
    (change,) = (one.change for one in told.remedies if one.mends == "limits")
    assert change == {"limits": "saturation"} and "Keep the joints inside" in told.sentence
    for limits in (ck.saturation(), law.limits):
        q = np.asarray(ck.solve(ck.replace(law, limits=limits), goal, q0, 0.02, 300, "EE", pace=pace).q)
        assert np.all(q >= arm.lower) and np.all(q <= arm.upper)
    kept = ck.solve(law, goal, q0, 0.02, 300, "EE")
    assert "beyond" not in verdict(law, goal, kept, **how).sentence
    outside = ck.solve(law, goal, np.array([-2.2, 1.2, 0.3]), 0.02, 300, "EE")  # began there, and came back
    assert "beyond" not in verdict(law, goal, outside, **how).sentence


@pytest.mark.parametrize("goal", [ck.hold([1.0, 0.7]), ck.circle([1.2, 1.0], 0.2, period=2.0)])
def test_a_run_whose_path_has_no_time_any_more(goal):
    """ "not finite from t = nan s on" it was, or a ValueError."""

    def lost(q):
        return jnp.where(q[1] > 1.21, jnp.nan, 1.0) * jnp.array([0.0, 0.1, 0.0])

    law = ck.Law(ck.planar_arm([1.0, 0.8, 0.6]), ck.position("xy"), alpha=5.0, null_velocity=lost)
    pace = ck.Pace(velocity=2.0, acceleration=9.0)
    run = ck.solve(law, goal, np.array([0.3, 1.2, 0.9]), 0.01, 200, "EE", pace=pace)
    bad = int(np.argmin(np.isfinite(run.q).all(1)))
    told = verdict(law, goal, run, Ts=0.01, method="EE", pace=pace)
    assert told.sentence.startswith(f"diverging: not finite from t = {0.01 * bad:.4g} s on (step {bad})"), told.sentence


@pytest.mark.slow
def test_a_loop_that_rings_at_a_pace_crawls_too():
    """Less gain was "no better": in the end, after 4,096 steps, its lag is larger."""
    made = problem_from("panda", **CIRCLE | dict(method="EXP-MIDPOINT", alpha=30.0, N=1000, delay=4.0, lag=0.02))
    told = judge(made)
    assert told.kind == Behaviour.RINGING and told.remedies[0].change["alpha"] < 12.0, told.sentence


PLANAR = dict(robot="planar:1,0.8,0.6", reference="circle", method="EE", radius=0.2, N=800)


@pytest.mark.slow
def test_the_cause_of_a_lag_at_a_pace_is_named():
    """A target that goes on by its own clock is too fast for the pace: "raise alpha" was all that was tried. And a path
    that is cut is gone along sooner than one that is followed."""
    stream = problem_from(**PLANAR | dict(future="unknown", period=2.0, alpha=10.0, max_acceleration=1.0))
    told = judge(stream)
    assert told.kind == Behaviour.LAGGING and "speed" not in told.sentence, told.sentence
    (one,) = [one for one in told.remedies if "period" in one.change]
    slower = judge(problem_from(**PLANAR | dict(future="unknown", alpha=10.0, max_acceleration=1.0) | one.change))
    assert slower.error < 0.1 * told.error
    cut = problem_from(**PLANAR | dict(feedforward=0.0, period=2.0, alpha=5.0, max_acceleration=1.0))
    told = judge(cut)
    assert told.kind == Behaviour.LAGGING and told.remedies[0].change == {"feedforward": 1.0}, told.sentence


def test_an_error_that_is_noise_is_settled():
    """After the end of its line: "no progress: 55.5 µm and stays", and to start elsewhere was tried."""
    for more in (dict(reference="hold"), dict(reference="line", period=4.0, max_acceleration=5.0, max_jerk=300.0)):
        told = judge(problem_from("planar:1,0.8,0.6", alpha=5.0, N=800, noise=1e-4, **more))
        assert told.kind == Behaviour.SETTLED and not told.remedies, told.sentence
