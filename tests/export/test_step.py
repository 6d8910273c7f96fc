"""The exported step against JAX: laws, inverses, limits, methods, stages and precisions in turn."""

import numpy as np
import pytest

import cnclik as ck
from tests.engine.compare import NEEDS_C
from tests.export.combinations import INVERSES, LIMITS, NULL, STAGES, Combination, arm, compare
from tests.export.native import native

pytestmark = NEEDS_C

SPREAD = [
    Combination("planar3", "pseudoinverse"),
    Combination("planar2", "singular-damped", "bounded", method="TRAPEZOID", stage="chord"),
    Combination("planar2", "damped", method="IE", stage="newton"),
    Combination("planar3", "damped", "bounded", "posture"),
    Combination("planar3", "singular-damped", "velocity-scaling", "posture", method="EXP-MIDPOINT"),
    Combination("planar2", "damped", method="CN", dtype="float32"),
]


@pytest.mark.parametrize("combination", SPREAD, ids=str)
def test_the_exported_step_is_jaxs(combination):
    off, others = compare(combination, 300)
    assert off <= 1 and others == 0


def test_a_gain_that_is_off_in_its_ninth_digit_is_found():
    combination = Combination("planar3", "pseudoinverse")
    law, method, stage = combination.parts()
    wrong = native(ck.replace(law, alpha=5.0 * (1 + 1e-9)), method=method, stage=stage, dtype=combination.dtype)
    off, _ = compare(combination, 300, step=wrong)
    assert off > 1


def test_the_spread_has_every_name_in_it():
    for field, names in (("inverse", INVERSES), ("limits", LIMITS), ("null", NULL), ("stage", STAGES)):
        assert {getattr(c, field) for c in SPREAD} == set(names)


def test_a_path_takes_the_time():
    law = ck.Law(arm(3), ck.position("xy"), alpha=5.0, inverse=ck.damped(0.1))
    reference, q, found = ck.circle([0.9, 1.2], 0.2, period=1.0), np.array([0.3, 0.5, -0.4]), []
    step = native(law, reference, method="RK4")
    for k in range(8):
        q = step(q, t=k * 0.01, Ts=0.01).q
        found.append(q)
    wanted = ck.solve(law, reference, [0.3, 0.5, -0.4], 0.01, 8, "RK4")
    np.testing.assert_allclose(found, wanted.q[1:], rtol=0, atol=1e-13)


def test_nan_is_told():
    law = ck.Law(ck.planar_arm([1.0, 0.8, 0.6]), ck.position("xy"), alpha=5.0, inverse=ck.damped(0.1))
    step, q = native(law, method="EE"), [0.3, 0.5, -0.4]
    for given in (([np.nan, 0, 0], [0.9, 1.2]), (q, [np.nan, 0.0]), (q, [0.9, 1.2], [np.nan, 0.0])):
        assert step(*given, Ts=0.01).status & ck.Status.NON_FINITE
    assert step(q, [0.9, 1.2], np.zeros(2)).status == 0


@pytest.mark.parametrize(("dtype", "near"), [("float64", 1e-15), ("float32", 1e-6)])
def test_kinematics_are_the_librarys(dtype, near):
    chain = ck.panda()
    q = np.linspace(-1, 1, 7)
    made, wanted = native(chain, dtype=dtype)(q), ck.forward(chain, q)
    np.testing.assert_allclose(made.position, wanted.position, rtol=0, atol=near)
    np.testing.assert_allclose(made.rotation, wanted.rotation, rtol=0, atol=near)
    np.testing.assert_allclose(made.jacobian, ck.jacobian(chain, q), rtol=0, atol=near)
