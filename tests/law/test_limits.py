"""Limits kept by whole loops, and what moves in the null space."""

import numpy as np
import pytest

import cnclik as ck

# --- loops --------------------------------------------------------------------------------------------


def redundant(limits, **more):
    """Three links whose middle joint may open to 0.4 rad only; the line needs more unless the others help."""
    arm = ck.replace(
        ck.planar_arm([1.0, 1.0, 1.0]), lower=(-3.0, -2.0, -3.0), upper=(3.0, 0.9, 3.0), velocity_limit=(2.0, 2.0, 2.0)
    )
    law = ck.Law(arm, ck.position("xy"), alpha=5.0, inverse=ck.damped(1e-3), limits=limits, **more)
    q0 = np.array([0.5, 0.5, 0.5])
    start = ck.forward(arm, q0).position[:2]
    return arm, law, ck.line(start, [-0.6, 0.9], duration=3.0), q0


def test_a_redundant_arm_tracks_within_limits():
    arm, law, reference, q0 = redundant(ck.bounded())
    run = ck.solve(law, reference, q0, 0.01, 400)
    free = ck.solve(ck.replace(law, limits=None), reference, q0, 0.01, 400)
    assert np.asarray(free.q).max(0)[1] > arm.upper[1] + 0.2  # left alone it goes past the limit
    assert (np.asarray(run.q) <= np.array(arm.upper) + 1e-6).all()
    assert np.abs(run.e[-1]).max() < 2e-3 and np.abs(run.e).max() < 2e-2
    assert np.any(np.asarray(run.status) & ck.Status.AT_LIMIT)


def test_a_start_outside_comes_back_while_the_task_goes_on():
    arm, law, _, q0 = redundant(ck.bounded(2.0))
    q0 = np.array([0.5, 1.0, 0.5])
    hold = ck.hold(ck.forward(arm, q0).position[:2])
    run = ck.solve(law, hold, q0, 0.01, 800)
    assert run.status[0] & ck.Status.AT_LIMIT
    assert run.q[-1][1] < arm.upper[1] + 1e-3
    assert np.abs(run.e).max() < 1e-2 and np.abs(run.e[-1]).max() < 1e-4


def test_a_posture_is_reached_in_the_null_space():
    arm = ck.planar_arm([1.0, 1.0, 1.0])
    q0, rest = np.array([0.5, 0.5, 0.5]), np.array([0.0, 1.2, 0.0])
    law = ck.Law(arm, ck.position("xy"), alpha=5.0, inverse=ck.damped(1e-4), null_velocity=ck.posture(rest, 2.0))
    run = ck.solve(law, ck.hold(ck.forward(arm, q0).position[:2]), q0, 0.01, 1000)
    assert np.abs(run.e).max() < 1e-3
    j = np.asarray(ck.jacobian(arm, run.q[-1]))[:2]
    pull = rest - np.asarray(run.q[-1])
    # What is left of the pull is seen by the task: the projection into the null space is at rest.
    assert np.abs(pull - np.linalg.pinv(j) @ j @ pull).max() < 1e-3 < np.abs(pull).max()
    with pytest.raises(ck.ArgumentError, match=r"`rest` must have 3 joint values, but has"):
        ck.replace(law, null_velocity=ck.posture([0.0, 1.0]))
