"""The loop at rest as a linear one: what rates say is what the step itself does, differentiated."""

import numpy as np
import pytest

import cnclik as ck
from cnclik.stability.loop import loop_at_rest
from cnclik.stability.spectrum import step_maps

ARM = ck.planar_arm([1.0, 0.8, 0.6, 0.5])
Q = np.array([0.3, 0.9, -0.5, 0.4])
POSE = ck.pose("xy", "z")
SCALE, TS = np.array([0.3, 1.0, 2.0]), np.array([0.1, 0.05, 0.1])
TURNING = np.array([[2.0, -3.0, 0.0], [3.0, 2.0, 0.0], [0.0, 0.0, 4.0]])
STACK = ck.stack(tip=ck.position("xy"), angle=ck.orientation("z"), rest=ck.joints(weights=[1.0, 2.0, 1.0, 0.5]))


def both(law, method, stage):
    loop = loop_at_rest(law, None, Q, method, stage)
    assert loop.rates is not None
    theirs = step_maps(loop.law, loop.held, loop.q, SCALE, TS, loop.method, loop.stage)
    return loop.maps(SCALE, TS), theirs


@pytest.mark.parametrize(
    ("method", "stage"),
    [
        ("EE", None),
        ("RK4", None),
        ("CN", ck.picard(3)),
        ("IE", ck.newton(1)),
        ("TRAPEZOID", ck.chord(2)),
        ("AB2", None),
        ("AB4", None),
        ("EXP-EE", None),
        ("EXP-RK4", None),
    ],
    ids=str,
)
def test_a_step_does_what_rates_say(method, stage):
    law = ck.Law(ARM, POSE, alpha=[3.0, 5.0, 2.0], inverse=ck.damped(0.4))
    for ours, theirs in zip(*both(law, method, stage), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)


@pytest.mark.parametrize("method", ["EE", "EXP-EE"])
@pytest.mark.parametrize(
    "law",
    [
        ck.Law(ARM, POSE, alpha=3.0),
        ck.Law(ARM, POSE, alpha=TURNING),
        ck.Law(ARM, ck.pose("xy", "z", weights=[1.0, 2.0, 0.3]), alpha=TURNING, inverse=ck.damped(0.4)),
        ck.Law(ARM, POSE, alpha=3.0, inverse=ck.transpose()),
        ck.Law(ARM, POSE, alpha=3.0, inverse=ck.singular_damped(0.5, 2.0), limits=ck.weighted_least_norm()),
        ck.Law(ARM, STACK, alpha={"tip": [4.0, 2.0], "angle": 3.0, "rest": 1.0}, inverse=ck.damped(0.3)),
        ck.Law(ARM, STACK, alpha={"tip": [[4.0, 1.0], [1.0, 2.0]], "angle": 3.0, "rest": 1.0},
               inverse=ck.levels(["tip"], ["angle", "rest"], damping=(0.01, 0.3))),
        ck.Law(ARM, STACK, alpha=2.0, inverse=ck.error_damped(0.3), limits=ck.saturation()),
    ],
    ids=["exact", "turning", "weights", "transpose", "limits", "stack", "levels", "error-damped"],
)  # fmt: skip
def test_whatever_the_law(law, method):
    for ours, theirs in zip(*both(law, method, None), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_a_null_space_velocity_and_a_gain_without_eigenvectors_have_none():
    free = ck.Law(ARM, POSE, alpha=3.0, null_velocity=ck.posture(Q, 1.0))
    assert loop_at_rest(free, None, Q, "EE", None).rates is None
    sheared = ck.Law(ARM, POSE, alpha=np.array([[2.0, 1.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]]))
    assert loop_at_rest(sheared, None, Q, "EE", None).rates is None
