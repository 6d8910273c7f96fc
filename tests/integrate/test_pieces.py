"""A run in pieces is the run in one, and stays lost once it is."""

import numpy as np
import pytest

import cnclik as ck
from cnclik.integrate.solve import in_pieces, joined

ARM = ck.planar_arm([1.0, 0.8])
XY = ck.position("xy")
Q = np.array([0.4, 1.1])
GOAL = ck.hold(np.array([0.9, 0.9]))


def both(law, reference, method, N, size, t0=0.0):
    method = ck.METHODS[method]
    loop = law, reference, Q, 0.05, N, method, ck.picard(5)
    return joined(in_pieces(*loop, size=size, t0=t0), N), ck.solve(*loop, t0=t0)


@pytest.mark.parametrize(("N", "size"), [(30, 30), (30, 7), (29, 10)])
def test_pieces_make_the_whole(N, size):
    circle = ck.circle([1.1, 0.5], 0.2, period=1.3)
    made, whole = both(ck.Law(ARM, XY, alpha=4.0), circle, "RK4", N, size, t0=0.7)
    assert made.q.shape == whole.q.shape and made.status.shape == whole.status.shape
    for name in ("t", "q", "x", "e", "qdot"):
        np.testing.assert_allclose(getattr(made, name), getattr(whole, name), atol=1e-11)
    assert int(made.evaluations) == int(whole.evaluations)


def test_a_loop_that_is_lost_stays_lost():
    """`solve` would refuse to begin the next piece there."""
    null = ck.posture(np.zeros(2), 1e30)  # of which a damped inverse lets some through
    made, whole = both(ck.Law(ARM, XY, alpha=1.0, inverse=ck.damped(0.1), null_velocity=null), GOAL, "EE", 40, 8)
    assert not np.isfinite(whole.q[-1]).any()
    np.testing.assert_array_equal(np.isfinite(made.q), np.isfinite(whole.q))
    np.testing.assert_allclose(made.t, whole.t)
    assert made.status[-1] == whole.status[-1]
