"""What a remedy costs: it makes neither errors worse nor joints go farther beyond their limits; see `trial`."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

import cnclik as ck
from cnclik.cli.solve import fastest, task_rows
from cnclik.stability import Behaviour, Remedy, verdict
from cnclik.stability.case import case_of
from cnclik.stability.trial import Trials

TS, N = 0.01, 400
HOW = ck.EE, ck.picard(5), ck.Drive()
Q = np.array([0.3, 0.9, 0.8, 0.7])


def arm(*velocity_limit):
    return ck.replace(ck.planar_arm([0.5] * len(velocity_limit)), velocity_limit=velocity_limit)


def inward(tip):
    """A circle from the tip towards the base, and back."""
    return ck.circle(tip * (1 - 0.1 / np.linalg.norm(tip)), 0.1, period=4.0, phase=float(np.arctan2(tip[1], tip[0])))


def circle(chain):
    tip = np.asarray(ck.forward(chain, Q[: chain.n]).position[:2])
    return inward(tip)


def judged(law, path, q=Q):
    run = ck.solve(law, path, q[: law.chain.n], TS, N, "EE")
    return run, verdict(law, path, run, Ts=TS, method="EE")


def late(run):
    return np.linalg.norm(run.e, axis=1)[-N // 4 :].max()


def changes(told, mends):
    return [one.change for one in told.remedies if one.mends == mends]


def test_one_slow_joint_does_not_slow_the_task():
    """All joints slowed for the first one: 99 mm of error in place of 0.75 mm, of two arms on a slow column."""
    law = ck.Law(arm(0.02, 3.0, 3.0, 3.0), ck.position("xy"), alpha=10.0)
    run, told = judged(law, circle(law.chain))
    assert told.kind == Behaviour.BEYOND_LIMITS and {"limits": "saturation"} in changes(told, "velocity"), told
    assert "velocity_scaling" not in told.sentence
    shared, _ = judged(ck.replace(law, limits=ck.saturation()), circle(law.chain))
    slowed, told = judged(ck.replace(law, limits=ck.velocity_scaling()), circle(law.chain))
    assert told.kind == Behaviour.AT_LIMIT and "q1 moves at its velocity limit" in told.sentence, told
    assert late(shared) < 2 * late(run) < 0.1 * late(slowed)
    assert np.all(np.abs(shared.qdot) <= np.array(law.chain.velocity_limit) + 1e-9)


def test_limits_that_cost_the_path_are_no_remedy():
    """Two joints have nothing to share: both ways to keep their velocity limits leave the path."""
    law = ck.Law(arm(0.1, 3.0), ck.position("xy"), alpha=10.0)
    _, told = judged(law, circle(law.chain))
    assert [list(one) for one in changes(told, "velocity")] == [["period", "N"]], told
    _, told = judged(law, circle(law.chain), Q + 0.2)  # off the path, and what is too fast is so by the error, too
    assert not changes(told, "velocity"), told
    assert "tried, but with a larger error: use limits=velocity_scaling(), use limits=saturation()" in told.sentence


def test_limits_of_joints_that_cost_the_target_are_no_remedy():
    chain = ck.replace(arm(9.0, 9.0), lower=(-3.0, 0.1), upper=(3.0, 1.0))
    goal = ck.hold(np.asarray(ck.forward(chain, [0.2, 1.6]).position[:2]))
    _, told = judged(ck.Law(chain, ck.position("xy"), alpha=5.0), goal, np.array([0.1, 0.9]))
    assert told.kind == Behaviour.BEYOND_LIMITS and not changes(told, "limits"), told
    assert "tried, but with a larger error: keep the joints inside" in told.sentence


@pytest.mark.parametrize(("limit", "raised"), [(9.0, True), (0.15, False)])
def test_more_gain_that_joints_are_too_slow_for_is_no_remedy(limit, raised):
    law = ck.Law(arm(*[limit] * 4), ck.position("xy"), alpha=0.3)
    goal = ck.hold(np.asarray(ck.forward(law.chain, Q).position[:2]) + 0.1)
    run = ck.solve(law, goal, Q, TS, N, "EE")
    case = case_of(law, goal, run, np.float64, TS, *HOW, pace=None, noise=None)
    found = Trials(case).vain(Remedy(change={"alpha": 3.0}, words="raise alpha"))
    assert found == ("" if raised else "but with joints farther beyond their limits")


def stack(limit):
    """Two arms on a trunk of one slow joint."""
    trunk, one = (
        ck.planar_arm([0.5], joint_names=["trunk"]),
        ck.planar_arm([0.4, 0.3, 0.3], joint_names=["1", "2", "3"]),
    )
    robot = ck.join(ck.join(trunk, one, prefix="left", keep=True), one, at="tip", prefix="right")
    tips, q = [tip.name for tip in robot.tips], np.array([0.0, 0.5, 0.6, 0.4, -0.5, -0.6, -0.4])
    task = ck.stack(left=ck.position("xy", tip=tips[0]), right=ck.position("xy", tip=tips[1]), rest=ck.joints())
    inverse = ck.levels(["left", "right"], ["rest"], damping=(0.01, 0.3))
    law = ck.Law(
        ck.replace(robot, velocity_limit=(limit, *[5.0] * 6)),
        task,
        alpha={"left": 10.0, "right": 10.0, "rest": 1.0},
        inverse=inverse,
    )
    places = [np.asarray(ck.forward(robot, q, tip=tip).position[:2]) for tip in tips]
    paths = {name: inward(at) for name, at in zip(("left", "right"), places, strict=True)}
    return law, ck.hold_at(law.chain, task, q, **paths), q


@pytest.mark.slow
def test_of_a_stack_each_task_counts_and_the_joint_that_holds_it_back_is_named():
    """It was "settled with lag", and for the posture that the loop began in."""
    law, paths, q = stack(0.02)
    _, told = judged(law, paths, q)
    assert changes(told, "velocity") == [{"limits": "saturation"}], told
    _, slowed = judged(ck.replace(law, limits=ck.velocity_scaling()), paths, q)
    assert slowed.kind == Behaviour.AT_LIMIT and "trunk moves at its velocity limit" in slowed.sentence, slowed
    assert {"limits": "saturation"} in changes(slowed, "error")


# --- in words -----------------------------------------------------------------------------------------


def test_every_joint_that_is_meant_is_named():
    """It was "joint q2, and 1 more"; the fastest joint's velocity stood beside the share of another's limit."""
    chain = ck.replace(arm(9.0, 9.0, 9.0, 0.5), lower=(-3.0, 0.0, 0.0, 0.0), upper=(3.0, 1.0, 0.9, 3.0))
    law = ck.Law(chain, ck.position("xy"), alpha=5.0)
    run, told = judged(law, ck.hold(0.5 * np.asarray(ck.forward(chain, Q).position[:2])))
    past = np.flatnonzero(np.asarray(run.q).max(0) > chain.upper)
    assert list(past) == [1, 2] and re.search(
        r"joint q[23] is up to [\d.]+ rad beyond its limit, and q[23] is beyond", told.sentence
    )
    assert "a joint's velocity limit, q4 with up to" in told.sentence, told
    column = ck.from_dh([0.0, 0.5], [0.0, 0.0], [0.0, 0.0], kinds="PR", velocity_limit=[0.01, 2.0])
    said = fastest(column, np.array([[0.05, 0.7], [0.02, -0.9]]))
    assert said == "up to 0.9 rad/s (q2); q1 up to 500 % of its limit"
    assert (
        fastest(ck.replace(column, velocity_limit=(9.0, 2.0)), np.full((3, 2), 0.5))
        == "up to 0.5 m/s (q1); q2 up to 25 % of its limit"
    )
    for lost in (np.nan, np.inf):  # a run that diverged, and a joint without a limit
        said = fastest(ck.replace(column, velocity_limit=(np.inf, 2.0)), np.array([[lost, 1.0]]))
        assert said == "up to inf m/s (q1); q2 up to 50 % of its limit"
    run = SimpleNamespace(e=np.ones((3, 2)), status=np.zeros(2, int))
    rows = [name for name, _ in task_rows("rest ", run, ck.joints(column.joint_names).on(column))]
    assert rows == ["rest prismatic joint error", "rest revolute joint error", "rest steps"]


def test_a_task_without_a_gain_leaves_nothing_to_settle():
    task = ck.stack(tip=ck.position("xy"), still=ck.joints(["q1"]))
    law = ck.Law(arm(9.0, 9.0, 9.0), task, alpha={"tip": 5.0, "still": 0.0}, inverse=ck.damped(0.05))
    there = ck.hold(np.asarray(ck.forward(law.chain, Q[:3]).position[:2]) + np.array([0.1, 0.2]))
    _, told = judged(law, ck.hold_at(law.chain, task, Q[:3], tip=there), Q[:3])
    assert told.kind == Behaviour.SETTLED and re.search(r"still [\d.]+ m?rad \(no gain\)", told.sentence), told


def test_a_path_that_waits_for_nobody_has_no_share_of_its_speed():
    """ "with the path at 1 of its speed": its times were rounded."""
    law = ck.Law(arm(0.1, 3.0), ck.position("xy"), alpha=10.0)
    path = circle(law.chain)
    run = ck.solve(law, path, Q[:2], TS, N, "EE")
    case = case_of(law, path, ck.replace(run, t=run.t.astype(np.float32)), np.float64, TS, *HOW, pace=None, noise=None)
    assert case.advance == 1.0
