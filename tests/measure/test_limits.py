"""check_limits: the shares of velocity, acceleration and jerk limits that a motion uses, against closed forms."""

import numpy as np
import pytest

import cnclik as ck

TS = 0.01
T = TS * np.arange(101)
Q = np.stack([0.5 * 2.0 * T**2, 0.3 * T], axis=1)  # 2 rad/s² from rest; 0.3 rad/s at once


def test_shares_of_a_known_motion():
    found = ck.check_limits(Q, velocity=[4.0, 0.6], acceleration=2.0, jerk=[1000.0, np.inf], Ts=TS)
    np.testing.assert_allclose(found.velocity, [1.99 / 4, 0.5], atol=1e-9)
    np.testing.assert_allclose(found.acceleration, [1.0, 15.0], atol=1e-9)
    np.testing.assert_allclose(found.jerk, [0.1, 0.0], atol=1e-9)
    assert not found.ok and ck.check_limits(Q, velocity=2.0, acceleration=31.0, Ts=TS).ok
    assert "Limits broken" in repr(found) and "joint 2" in repr(found)


def test_a_run_is_checked_by_its_own_velocities_and_the_chains_limits():
    arm = ck.replace(ck.planar_arm([1.0, 0.8]), velocity_limit=(0.5, 1.0))
    law = ck.Law(arm, ck.position("xy"), alpha=5.0)
    for limits, kept in ((None, False), (ck.velocity_scaling(), True)):
        run = ck.solve(ck.replace(law, limits=limits), ck.hold([0.8, 1.0]), [0.2, 0.9], TS, 40, "EE")
        found = ck.check_limits(run, chain=arm)
        assert found.ok == kept and found.names == tuple(arm.joint_names)
        np.testing.assert_allclose(found.velocity, np.abs(run.qdot).max(0) / [0.5, 1.0])


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: ck.check_limits(Q, velocity=1.0), "`Ts` must be a number, but is None"),
        (
            lambda: ck.check_limits(Q, velocity=[1.0, 2.0, 3.0], Ts=TS),
            r"`velocity` must be a single number or have 2 numbers, but has 3",
        ),
        (lambda: ck.check_limits(Q, jerk=-1.0, Ts=TS), "`jerk` must be at least 0, but is -1"),
        (lambda: ck.check_limits(Q, chain=ck.panda(), Ts=TS), "`chain` must have the run's 2 joints, but has 7"),
        (lambda: ck.check_limits(Q, chain=5, Ts=TS), "`chain` must be a Chain, but is int"),
        (lambda: ck.check_limits(Q[:1], Ts=TS), "`run` must have a step, but has none"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_line(made, words):
    with pytest.raises(ck.ArgumentError, match=words):
        made()
