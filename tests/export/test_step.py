"""The exported step against JAX: inverses, limits, methods, stages and precisions in turn."""

import jax
import numpy as np
import pytest

import cnclik as ck
from tests.bank import told
from tests.engine.compare import NEEDS_C
from tests.export.native import arm, native

pytestmark = NEEDS_C
TS, REST, SINGULAR = 0.01, [0.3, 0.3, 0.3], ck.singular_damped(0.1, 0.2)
RESULTS = ("q", "qdot", "e", "x", "residual")
SPREAD = [  # inverse, limits, posture, method, stage, dtype
    (ck.pseudoinverse(), None, None, "EE", ck.picard(1), "float64"),
    (ck.damped(0.1), ck.velocity_scaling(), None, "IE", ck.newton(2), "float64"),
    (SINGULAR, ck.bounded(), ck.posture(REST), "EXP-MIDPOINT", ck.picard(1), "float64"),
    (ck.damped(0.1), None, None, "CN", ck.picard(3), "float32"),
]


def a_law(inverse, limits=None, null=None):
    return ck.Law(arm(3), ck.position("xy"), alpha=5.0, inverse=inverse, limits=limits, null_velocity=null)


def lanes(inverse, dtype, count=60):
    """q, position and velocity: some q beyond their limits, some singular if that is damped, the last a NaN."""
    random = np.random.default_rng(0)
    q = random.uniform(0.3, 2.1, (count, 3))
    if not isinstance(inverse, type(ck.pseudoinverse())):
        q[:6] = random.normal(0, 1e-2, (6, 3)) * np.arange(6)[:, None]
    q[-1, 0] = np.nan
    return [v.astype(dtype) for v in (q, random.uniform(0.3, 1.5, (count, 2)), random.normal(0, 0.1, (count, 2)))]


def by_jax(law, method, stage, given):
    def one(q, position, velocity):
        moving = ck.causal(told(ck.hold(position), velocity))
        return ck.step(law, moving, q, 0.0, TS, method, stage)

    with ck.use_engine("plain"):
        return jax.jit(jax.vmap(one))(*given)


def off(law, method, stage, dtype, wanted, given):
    """The largest difference of the exported step, relative to 1 + the number; statuses are the same."""
    step = native(law, method=method, stage=stage, dtype=dtype)
    rows = [step(q, position, velocity=velocity, Ts=TS) for q, position, velocity in zip(*given, strict=True)]
    worst = 0.0
    for name in RESULTS:
        found, real = np.array([getattr(row, name) for row in rows]), np.asarray(getattr(wanted, name))
        np.testing.assert_array_equal(np.isfinite(found), np.isfinite(real))
        worst = max(worst, np.nanmax(np.abs(found - real) / (1 + np.abs(real))))
    edges = np.abs(np.abs(wanted.q) - 2.0).min(axis=1) < 1e-5  # there a rounding decides about AT_LIMIT
    np.testing.assert_array_equal(np.where(edges, 0, [row.status for row in rows]), np.where(edges, 0, wanted.status))
    return worst


@pytest.mark.parametrize(("inverse", "limits", "null", "method", "stage", "dtype"), SPREAD, ids=str)
def test_the_exported_step_is_jaxs(inverse, limits, null, method, stage, dtype):
    law, given = a_law(inverse, limits, null), lanes(inverse, dtype)
    wanted, near = by_jax(law, method, stage, given), {"float64": 1e-11, "float32": 1e-4}[dtype]
    assert off(law, method, stage, dtype, wanted, given) < near
    if law.inverse == ck.pseudoinverse():  # a gain that is off in its ninth digit is found
        wrong = ck.replace(law, alpha=5.0 * (1 + 1e-9))
        assert off(wrong, method, stage, dtype, wanted, given) > 10 * near


@pytest.mark.parametrize(("dtype", "near"), [("float64", 1e-15), ("float32", 1e-6)])
def test_kinematics_are_the_librarys(dtype, near):
    chain = ck.panda()
    q = np.linspace(-1, 1, 7)
    made, wanted = native(chain, dtype=dtype)(q), ck.forward(chain, q)
    np.testing.assert_allclose(made.position, wanted.position, rtol=0, atol=near)
    np.testing.assert_allclose(made.rotation, wanted.rotation, rtol=0, atol=near)
    np.testing.assert_allclose(made.jacobian, ck.jacobian(chain, q), rtol=0, atol=near)
