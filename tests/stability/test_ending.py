"""How runs ended, in a sentence: loops whose ending is known, and whether the remedy mends them."""

import re

import jax
import numpy as np
import pytest

import cnclik as ck
from cnclik.errors import ArgumentError
from cnclik.integrate.drive import Drive
from cnclik.stability.ending import Behaviour, verdict

FIVE = ck.planar_arm([1.0] * 5, clockwise=True)
Q5 = np.array([0.3, 0.5, -0.4, 0.6, 0.2])
XY = ck.position("xy")
TIP = np.asarray(ck.forward(FIVE, Q5).position[:2])
NEAR = ck.hold(TIP + np.array([-0.1, 0.1]))
THREE = ck.replace(ck.planar_arm([1.0, 0.8, 0.6]), lower=(-3.0,) * 3, upper=(3.0,) * 3, velocity_limit=(2.0,) * 3)
Q3 = np.array([0.3, 0.7, 0.6])
P3 = np.asarray(ck.forward(THREE, Q3).position[:2])
CIRCLE = ck.circle(P3 - np.array([0, 0.08]), 0.08, period=4.0)


def first(N, run):
    """The first N steps of a run."""
    rest = len(run.qdot) - N
    return jax.tree.map(lambda v: np.asarray(v)[: len(v) - rest] if np.ndim(v) else v, run)


def judge(law, reference, q, Ts, N, method="EE", drive=None, of=None):
    """The verdict on the first N steps of a run. of: its steps, where runs of several lengths share a program."""
    run = first(N, ck.solve(law, reference, q, Ts, of or N, method, drive=drive))
    return verdict(law, reference, run, method=method, drive=drive)


def planar(alpha, **options):
    return ck.Law(FIVE, XY, alpha=alpha, **options)


@pytest.mark.parametrize(
    ("alpha", "delay", "N", "kind"),
    [(5.0, 0, 60, "settled"), (1.0, 0, 20, "too short to tell"), (19.8, 0, 60, "swinging"), (20.5, 0, 60, "growing"),
     (30.0, 0, 60, "growing"), (0.0, 0, 60, "held back"), (6.0, 2, 40, "too short to tell"),
     (0.1, 0, 60, "too short to tell"), (0.01, 0, 60, "too short to tell")],
)  # fmt: skip
def test_a_held_target(alpha, delay, N, kind):  # one swings in ten steps a period: that is no shaking
    said = judge(planar(alpha), NEAR, Q5, 0.1, N, drive=Drive(delay=delay), of=60)
    assert said.kind == kind and (alpha != 1 or "59 % of that in the quarter before" in said.sentence), said  # 0.9⁵
    if kind in ("swinging", "growing"):
        again = judge(planar(said.change["alpha"]), NEAR, Q5, 0.1, 60, drive=Drive())
        assert again.kind == "settled", again


@pytest.mark.parametrize("factor", [0.9, 1.3])
@pytest.mark.parametrize("drive", [Drive(delay=5), Drive(delay=2, lag=0.08)], ids=["dead time", "lag"])
def test_a_loop_through_drives(factor, drive):
    limit = ck.gains(Ts=0.02, drive=drive).largest_stable
    said = judge(planar(factor * limit), NEAR, Q5, 0.02, 600, "EXP-MIDPOINT", drive)
    assert (said.kind in ("swinging", "growing")) == (factor > 1), said
    if factor > 1:
        assert said.change == {"alpha": ck.gains(Ts=0.02, drive=drive).recommended}


def test_fewer_than_two_swings_in_a_quarter_are_neither_a_swing_nor_rest():
    """Just above the largest stable gain; in a run a little longer a quarter has its fourth reversal."""
    drive = Drive(delay=3)
    alpha = 1.02 * ck.gains(Ts=0.02, drive=drive).largest_stable
    short, long = (judge(planar(alpha), NEAR, Q5, 0.02, N, "EXP-MIDPOINT", drive, of=160) for N in (144, 160))
    assert (short.kind, long.kind) == ("too short to tell", "swinging") and "and still changes" in short.sentence
    assert short.change["alpha"] == pytest.approx(long.change["alpha"], rel=1e-9)


FAST = ck.circle(P3 - np.array([0, 0.1]), 0.1, period=4.0)
ASIDE, FAR = ck.hold(P3 - [0.05, -0.05]), ck.hold(P3 - [0.9, 1.1])  # 83 mm out of reach
QUICK = ck.circle(P3 - np.array([0, 0.3]), 0.3, period=1.5)
SLOW, LATE, FILTERED = Drive(delay=1, lag=0.1), Drive(delay=2.5), Drive(lag=0.05, smoothing=0.8)


@pytest.mark.parametrize(
    ("drive", "factor", "reference", "limits", "sigma", "N", "kind"),
    [
        (SLOW, 0.6, ck.hold(P3), None, 1e-3, 480, "settled"),  # noise alone: its first error is none
        (SLOW, 0.6, ASIDE, None, 1e-3, 480, "settled"),  # 1.2 times the errors of the quarter before
        (LATE, 1.03, FAST, None, 0.0, 480, "growing"),  # to 0.8 m beside a circle of 0.1 m
        (LATE, 1.5, ck.hold(P3 + 0.05), ck.velocity_scaling(), 0.0, 480, "growing"),  # the velocity limit acts for long
        (LATE, 1.03, FAR, None, 0.0, 480, "growing"),  # to 4 m
        (LATE, 1.5, QUICK, None, 0.0, 40, "too short to tell"),  # it does not follow, and has not grown yet
        (FILTERED, 0.1, ASIDE, None, 0.0, 40, "too short to tell"),  # it passes its target once
        (LATE, 0.3, FAR, ck.bounded(), 0.0, 480, "held back"),
    ],
)
def test_an_unstable_gain_comes_before_limits_and_reach_and_noise_is_no_growth(
    drive, factor, reference, limits, sigma, N, kind
):
    gains = ck.gains(Ts=0.02, drive=drive)
    law = ck.Law(THREE, XY, alpha=factor * gains.largest_stable, inverse=ck.damped(0.05), limits=limits)
    noise = sigma * np.random.default_rng(0).standard_normal((480, 2))
    run = first(N, ck.solve(law, reference, Q3, 0.02, 480, drive=drive, noise=noise))
    said = verdict(law, reference, run, drive=drive, noise=sigma)
    assert said.kind == kind and (kind != "growing" or said.change == {"alpha": gains.recommended}), said


def test_a_swing_that_comes_to_rest_names_what_is_out_of_reach_too():
    law = ck.Law(THREE, XY, alpha=97.0, inverse=ck.damped(0.05), limits=ck.velocity_scaling())
    said = judge(law, FAR, Q3, 0.02, 40, "EXP-MIDPOINT")
    assert said.kind == "swinging" and "83.2 mm away" in said.sentence


@pytest.mark.parametrize("moves", [False, True])
def test_a_task_that_gives_way_to_a_posture_is_not_growing(moves):
    """From 0 to 0.3 m, and there the joints rest."""
    law = ck.Law(THREE, ck.stack(hand=XY, rest=ck.joints()), alpha=5.0, inverse=ck.damped(0.05))
    hand = ck.line(P3, P3 + np.array([0.02, 0]), duration=1.0) if moves else ck.hold(P3 + 0.01)
    said = judge(law, ck.references(hand=hand, rest=ck.hold(values=Q3 - 0.5)), Q3, 0.02, 200)
    assert said.kind == ("following" if moves else "held back"), said
    assert ("its tasks contradict each other there" in said.sentence) != moves and not said.remedy


def test_a_stable_loop_that_a_velocity_limit_leaves_behind_is_not_growing():
    slow = ck.replace(THREE, velocity_limit=(0.5,) * 3)
    alpha = 0.3 * ck.gains(Ts=0.02, drive=LATE).largest_stable
    law = ck.Law(slow, XY, alpha=alpha, inverse=ck.damped(0.05), limits=ck.velocity_scaling())
    path = ck.path(lambda t: (P3[0] - 0.15 * t**2, P3[1] - 0.15 * t**2))
    said = judge(law, path, Q3, 0.02, 110, "EXP-MIDPOINT", LATE)
    assert said.kind == "held back" and "q1 was at its velocity limit in 30 of 110 steps" in said.sentence


@pytest.mark.parametrize(
    ("period", "N", "kind"), [(40.0, 200, "following"), (40.0, 20, "held back"), (4.0, 200, "held back")]
)
def test_a_velocity_limit_on_the_way_to_a_path_is_left_behind(period, N, kind):
    """0.45 m at the limit in the first 16 steps, and no more, or once more on a faster path."""
    law = ck.Law(THREE, XY, alpha=20.0, inverse=ck.damped(0.01), limits=ck.velocity_scaling())
    said = judge(law, ck.circle(P3 - np.array([0.5, 0.2]), 0.1, period=period), Q3, 0.01, N, "EXP-MIDPOINT", of=200)
    assert said.kind == kind, said


def test_a_wall_comes_before_anything_else():
    """The wall holds in 157 of 400 steps, and lets the tip go again before the end."""
    wall = ck.wall(ck.position("y"), below=float(P3[1]) - 0.05, name="ceiling")
    law = ck.Law(THREE, XY, alpha=5.0, inverse=ck.damped(0.01), limits=ck.bounded(walls=[wall]))
    said = judge(law, ck.circle(P3 - np.array([0, 0.08]), 0.08, period=4.0), Q3, 0.01, 400, "EXP-MIDPOINT")
    assert said.kind == Behaviour.HELD_BACK and "wall ceiling held in" in str(said) and "of 400 steps" in str(said)
    assert not said.remedy


def test_following_names_a_lag_only_where_one_explains_the_error():
    pure = ck.Law(THREE, XY, alpha=5.0, feedforward=0.0)
    run = ck.solve(pure, CIRCLE, Q3, 0.01, 400, "EXP-MIDPOINT")
    said = verdict(pure, CIRCLE, ck.replace(run, t=run.t + 4.0))  # a period later
    assert "as a lag of 18" in str(said) and "ms explains" in str(said), said  # alpha/(alpha² + ω²)
    for wide in (True, False):  # a run in float32 is judged in float64
        with jax.enable_x64(wide):
            corners = ck.waypoints(np.arange(4.0), P3 + np.array([[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]]))
            loop = ck.Law(THREE, XY, alpha=2.0), corners, Q3, 0.004, 750, "EXP-MIDPOINT"
            said = judge(*loop, Drive(delay=13))
        assert said.kind == Behaviour.FOLLOWING and "lag" not in str(said) and not said.remedy, said
    law, path = ck.Law(FIVE, ck.joints(), alpha=2.0, feedforward=0.0), ck.path(lambda t: jax.numpy.full(5, 0.3) * t)
    assert "nan" not in str(judge(law, path, np.zeros(5), 0.1, 40))  # angles have no lag of lengths


def test_sliding_joints_of_a_posture_do_not_count():
    """0.5 m off without a gain, beside a path of 0.1 m."""
    arm, start = ck.from_dh([0.0, 1.0, 0.8, 0.6], [0.0] * 4, [0.0] * 4, kinds="PRRR"), np.array([0.0, 0.3, 0.7, 0.6])
    task = ck.stack(hand=XY, rest=ck.joints(weights=0.1))
    place = np.asarray(ck.forward(arm, start).position)[:2]
    paths = ck.references(
        hand=ck.line(place, place - [0.1, 0.0], duration=2.0), rest=ck.hold(values=start + np.array([0.5, 0, 0, 0]))
    )
    law = ck.Law(arm, task, alpha={"hand": 10.0, "rest": 0.0}, inverse=ck.damped(1e-3), feedforward=0.0)
    said = judge(law, paths, start, 0.01, 200)
    assert said.kind == "following" and "as a lag of 101 ms explains" in said.sentence, said


def test_rounding_is_that_of_the_run_and_an_axis_without_gain_is_named():
    arm, q0, target = ck.planar_arm([1.0, 1.0, 0.5]), np.array([0.3, -0.5, 0.4]), np.array([0.5, 1.8])
    law = ck.Law(arm, XY, alpha=2.0)
    with jax.enable_x64(False):  # 15 nm in float32
        start = ck.hold(np.array(ck.forward(arm, q0).position)[:2])
        assert judge(law, start, q0, 0.05, 400).kind == Behaviour.SETTLED
    said = judge(ck.replace(law, alpha=[2.0, 0.0]), ck.hold(target), q0, 0.05, 400)
    assert said.kind == Behaviour.HELD_BACK and "the gain is 0" in said.sentence


def test_an_arm_at_the_end_of_its_reach():
    """Out of reach by the distance that `reach` finds; it swings with little damping, and the remedy calms it."""
    far, limits = ck.hold(1.6 * P3), ck.bounded()

    def law(damping, alpha=(20.0, 60.0)):
        return ck.Law(THREE, XY, alpha=alpha, inverse=ck.damped(damping), limits=limits)

    said = judge(law(0.2), far, Q3, 1 / 60, 600, "EXP-MIDPOINT")
    nearest = ck.reach(THREE, 1.6 * P3, task=XY)
    assert said.kind == Behaviour.HELD_BACK and "out of reach" in str(said) and "swings" in str(said), said
    assert f"{1e3 * float(nearest.position_error):.3g} mm away" in str(said)
    assert said.change["damping"] == pytest.approx((said.error * 2.4 / 2) ** 0.5, abs=0.01)  # alpha Ts ‖e‖ c/2
    for calm in (law(said.change["damping"]), law(0.2, (10.0, 10.0))):
        said = judge(calm, far, Q3, 1 / 60, 600, "EXP-MIDPOINT")
        assert said.kind == Behaviour.HELD_BACK and "swings" not in str(said), said
    two = ck.replace(ck.planar_arm([1.0, 1.0]), lower=(-0.4, -3.0), upper=(0.4, 3.0))
    law = ck.Law(two, XY, alpha=5.0, inverse=ck.damped(0.05), limits=limits)
    for q in np.array([[0.8, 0.5], [-0.8, -0.5]]):
        said = judge(law, ck.hold(np.asarray(ck.forward(two, q).position[:2])), q / 4, 0.02, 200)
        assert "found within the joint limits" in str(said) and "joint q1 was at a limit" in str(said), said


def test_a_path_out_of_reach():
    """Two links of 1 m after a circle of 0.2 m about a point 3 m away: 0.8 to 1.2 m are missing."""
    law = ck.Law(ck.planar_arm([1.0, 1.0]), XY, alpha=5.0, inverse=ck.damped(0.1), error_clamp=(0.1, 0.1))
    said = judge(law, ck.circle([3.0, 0.0], 0.2, period=2.0), np.array([0.3, 0.5]), 0.02, 200)
    assert said.kind == "held back" and re.search(r"of reach at t = \S+ s: .* is 8\d\d mm away", said.sentence), said
    assert f"the error is at most {said.error:.3g} m" in said.sentence
    law = ck.replace(law, error_clamp=None)  # where it ends it can be reached, at t = 4 s 0.7 m are missing
    said = judge(law, ck.circle([1.5, 0.0], 1.2, period=2.0), np.array([0.3, 0.5]), 0.02, 225)
    assert said.kind == "held back" and re.search(r"out of reach at t = (3.9|4|4.0)\d* s", said.sentence), said


def test_each_task_of_a_stack_has_its_line():
    tasks = ck.stack(hand=XY, rest=ck.joints())
    levels = ck.levels(["hand"], ["rest"], damping=(1e-3, 0.1))
    law = ck.Law(THREE, tasks, alpha={"hand": 5.0, "rest": 1.0}, inverse=levels)
    away = ck.hold_at(THREE, tasks, Q3, hand=ck.hold(P3 + np.array([0.1, 0])))
    said = judge(law, away, Q3, 0.01, 600)
    assert said.kind == Behaviour.SETTLED and "(settled)" in said.tasks["hand"], said  # a posture yields: no error
    short = judge(law, ck.hold_at(THREE, tasks, Q3), Q3 + 0.05, 0.005, 600)  # the hand's error falls as exp(-15)
    assert "(settled)" in short.tasks["hand"] and "(still falls)" in short.tasks["rest"], short
    law = ck.Law(THREE, tasks, alpha=5.0, inverse=ck.damped(0.1))
    said = judge(law, away, Q3, 0.01, 600)
    assert said.kind == Behaviour.HELD_BACK and "contradict" in str(said) and "(stays)" in said.tasks["hand"], said


@pytest.mark.parametrize(("alpha", "kind"), [(24.0, "growing"), (1.0, "too short to tell")])
def test_no_task_of_a_run_that_grows_or_still_moves_stays_or_follows(alpha, kind):
    tasks = ck.stack(hand=XY, rest=ck.joints())
    law = ck.Law(FIVE, tasks, alpha=alpha, inverse=ck.levels(["hand"], ["rest"], damping=(1e-3, 0.1)))
    said = judge(law, ck.hold_at(FIVE, tasks, Q5, hand=NEAR), Q5, 0.1, 20)
    assert said.kind == kind and "stays" not in str(said) and "following" not in str(said), said


def test_noise_is_no_swing():
    rng = np.random.default_rng(5)
    law, N, sigma = planar(5.0), 400, 1e-3
    run = ck.solve(law, NEAR, Q5, 0.02, N)
    noisy = ck.replace(run, e=np.asarray(run.e) + sigma * rng.standard_normal(np.shape(run.e)))
    assert verdict(law, NEAR, noisy, noise=sigma).kind == Behaviour.SETTLED
    fast = ck.replace(law, chain=ck.replace(FIVE, velocity_limit=(2.0,) * 5))  # lost, and near no singularity
    lost = verdict(fast, NEAR, ck.replace(run, e=np.nan * noisy.e))
    assert lost.kind == Behaviour.GROWING and "not finite" in str(lost) and not lost.remedy
    law = ck.Law(ck.replace(FIVE, velocity_limit=(2.0, 2.0, 1.0, 2.0, 2.0)), XY, alpha=[5.0, 2.0])
    run = ck.solve(law, ck.hold([0.2, 4.0]), np.zeros(5), 0.02, N)  # stretched: v = (1, -2), for at most 1 rad/s
    lost = verdict(law, NEAR, ck.replace(run, e=np.where(np.arange(N + 1)[:, None] < 9, run.e, np.nan)))
    assert lost.change == {"damping": float(f"{np.hypot(1, 2) / 2:.1g}")}, lost


def test_a_gain_above_the_largest_stable_one_is_said_of_a_calm_run():
    law = planar(19.9)
    run = ck.solve(law, ck.hold(TIP), Q5, 0.1, 60, "EE")
    wrong = ck.replace(run, e=np.full_like(run.e, 0.1))  # its error stays, and nothing shows why
    for each, kind in ((run, "settled"), (wrong, "held back")):
        said = verdict(law, ck.hold(TIP), each, method="EE", drive=Drive(delay=1))
        assert "above the largest stable gain" in str(said) and said.change["alpha"] < 10 and said.kind == kind


def test_runs_of_others_are_refused():
    law, run = planar(5.0), ck.solve(planar(5.0), NEAR, Q5, 0.02, 400)
    with pytest.raises(ArgumentError, match="`run` must be a Trajectory of this law"):
        verdict(ck.Law(THREE, XY, alpha=5.0), ck.hold(P3), run)
    with pytest.raises(ArgumentError, match="`noise` must be at least 0, but is -1"):
        verdict(law, NEAR, run, noise=[1e-3, -1.0])
    with pytest.raises(ArgumentError, match="at least one step"):
        verdict(law, NEAR, first(0, run))
