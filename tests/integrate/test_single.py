"""Single precision: a loop arrives, however small its steps are next to a spacing of q."""

import jax
import numpy as np
import pytest

import cnclik as ck

ARM = ck.planar_arm([1.0, 0.8])
Q0, GOAL = np.array([2.0, 1.0]), np.array([2.05, 0.95])
TARGET = np.asarray(ck.forward(ARM, GOAL).position)[:2]
Ts, ALPHA, N = 1e-3, 10.0, 2000
FLOOR = np.spacing(np.float32(2.0)) / 2 / (ALPHA * Ts)  # [rad] where a plain sum stops: 1.2e-5


def ended(limits=None, method="EE", dtype=np.float32, n=N):
    arm = ck.replace(ARM, lower=(-3.0, -3.0), upper=(3.0, 3.0))
    law = ck.Law(arm, ck.position("xy"), alpha=ALPHA, limits=limits)
    return ck.solve(law, ck.hold(TARGET.astype(dtype)), Q0.astype(dtype), Ts, n, method)


@pytest.mark.parametrize("method", ["EE", "EXP-MIDPOINT"])
def test_a_loop_arrives_as_in_double(method):
    """It stopped 1.8e-5 m short at 1 kHz and 10 1/s, 1.5e-3 m at 8 kHz and 1 1/s."""
    run = ended(method=method)
    assert run.q.dtype == run.qdot.dtype == np.float32
    assert np.linalg.norm(run.e[-1]) < 5e-7 < 0.05 * FLOOR
    wide = ended(method=method, dtype=np.float64)
    # On the way, too: no slower than in double precision.
    np.testing.assert_allclose(run.q, wide.q, atol=1e-6)


def test_with_limits_it_arrives_and_keeps_them():
    assert np.linalg.norm(ended(limits=ck.velocity_scaling()).e[-1]) < 5e-7
    arm = ck.replace(ARM, lower=(-3.0, -3.0), upper=(2.02, 3.0))
    law = ck.Law(arm, ck.position("xy"), alpha=ALPHA, inverse=ck.damped(0.05), limits=ck.bounded())
    q = np.asarray(ck.solve(law, ck.hold(TARGET.astype(np.float32)), Q0.astype(np.float32), Ts, N, "EE").q)
    assert q[:, 0].max() <= np.float32(2.02) and q[-1, 0] > 2.0199


def test_in_lanes_and_in_a_loop_of_ones_own():
    """A step gives q alone; its velocity, summed in double precision, is the remedy that the documentation names."""
    law, reference = ck.Law(ARM, ck.position("xy"), alpha=ALPHA), ck.hold(TARGET.astype(np.float32))
    starts = np.stack([Q0, Q0 + 0.01]).astype(np.float32)
    many = ck.lanes(lambda q0: ck.solve(law, reference, q0, Ts, N, "EE").e[-1])(starts)
    assert np.abs(many).max() < 5e-7
    step = jax.jit(lambda q: ck.step(law, reference, q, 0.0, Ts, "EE"))
    alone, summed = starts[0], Q0.copy()
    for _ in range(N):
        alone = step(alone).q
        summed = summed + Ts * np.asarray(step(summed.astype(np.float32)).qdot, float)
    assert np.linalg.norm(alone - GOAL) > 0.3 * FLOOR  # q alone stops short
    assert np.linalg.norm(summed - GOAL) < 0.1 * FLOOR
