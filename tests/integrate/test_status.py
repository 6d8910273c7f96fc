"""Status bits: each one set where it should be, and nowhere else; require_ok."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.integrate.status import count, names
from cnclik.robot.chain import REVOLUTE, Joint, Offset, assemble

S = ck.Status
Z = (0.0, 0.0, 1.0)


def arm(lower=None, upper=None):
    joints = [Joint(kind=REVOLUTE, axis=Z, origin=Offset(position=(0.0, float(i), 0.0)), coordinate=i) for i in (0, 1)]
    return assemble(joints, Offset(position=(0.0, 1.0, 0.0)), lower=lower, upper=upper)


Q = np.array([0.2, 1.2])
HERE = ck.hold(ck.pose(arm(), Q).position[:2])
NEAR = ck.hold(ck.pose(arm(), Q).position[:2] + jnp.array([0.1, 0.1]))


def run(chain=None, q=Q, target=NEAR, method="IE", stage=ck.picard(8), N=4, Ts=0.1, **law):
    law = ck.Law(chain or arm(), ck.position("xy"), **{"alpha": 2.0, **law})
    return ck.solve(law, target, q, Ts, N, method, stage)


def test_ok():
    made = run()
    np.testing.assert_array_equal(made.status, 0)
    assert ck.require_ok(made) is made


def test_not_converged():
    made = run(stage=ck.picard(1))
    assert made.status[0] == S.NOT_CONVERGED and made.residual[0] > 1e-3
    assert run(stage=ck.picard(1, tolerance=0.5)).status[0] == S.OK
    # Diverging: z = 15 per pass; still only a matter of the residual.
    assert np.all(run(alpha=150.0, stage=ck.picard(8)).status & S.NOT_CONVERGED)


def test_near_singular():
    stretched = np.array([0.2, 1e-4])
    made = run(q=stretched, target=ck.hold(ck.pose(arm(), stretched).position[:2]), method="EE")
    np.testing.assert_array_equal(made.status, S.NEAR_SINGULAR)
    assert np.all(run(q=stretched, target=HERE, near_singular=0.0).status & S.NEAR_SINGULAR == 0)
    # σ_min at Q is 0.55: the threshold is compared with the value itself.
    least = np.linalg.svd(ck.jacobian(arm(), Q)[:2], compute_uv=False)[-1]
    assert run(target=HERE, method="EE", near_singular=least * 1.001).status[0] == S.NEAR_SINGULAR
    assert run(target=HERE, method="EE", near_singular=least * 0.999).status[0] == S.OK


@pytest.mark.parametrize("inverse", [ck.damped(0.05), ck.transpose()])
def test_near_singular_with_other_inverses(inverse):
    stretched = np.array([0.2, 1e-4])
    bad = run(q=stretched, target=ck.hold([-0.3, 1.9]), method="EE", inverse=inverse, N=1)
    assert bad.status[0] == S.NEAR_SINGULAR and np.all(np.isfinite(bad.q))
    assert run(method="EE", inverse=inverse).status[0] == S.OK


def test_at_limit():
    # The second joint turns away from its limit, the first one towards it.
    moved = run(N=4)
    low, high = np.asarray(moved.q).min(0), np.asarray(moved.q).max(0)
    free = run(arm(low - 0.01, high + 0.01), N=4)
    np.testing.assert_array_equal(free.status, S.OK)
    for k, (lower, upper) in enumerate([((low[0] + 1e-3, -9), (9, 9)), ((-9, -9), (9, high[1] - 1e-3))]):
        bad = run(arm(lower, upper), N=4)
        q = np.asarray(bad.q)[1:, k]
        outside = (q <= lower[k]) | (q >= upper[k])
        np.testing.assert_array_equal(bad.status, np.where(outside, S.AT_LIMIT, S.OK))
    assert np.all(run(arm([-9, -9], [0.0, 9.0])).status & S.AT_LIMIT)  # started beyond
    exactly = run(arm(upper=[9, 1.2]), target=HERE, method="EE", N=1)  # on the limit counts as at it
    assert abs(exactly.q[-1, 1] - 1.2) < 1e-15


def test_non_finite():
    slider = ck.from_screws([[0.0] * 3], [[1.0, 0, 0]], [0.0] * 3, kinds="P")
    law = ck.Law(slider, ck.position("x"), alpha=1e200)
    grown = ck.solve(law, ck.hold([1.0]), [0.0], 1.0, 3)
    np.testing.assert_array_equal(grown.status, [0, S.NON_FINITE, S.NON_FINITE])
    # A target that stops being a number.
    lost = ck.path(lambda t: (jnp.where(t > 0.15, jnp.nan, 0.5),))
    made = ck.solve(ck.replace(law, alpha=1.0), lost, [0.0], 0.1, 4)
    np.testing.assert_array_equal(made.status, [0, 0, S.NON_FINITE, S.NON_FINITE])


def test_several_bits_at_once():
    made = run(arm([-9, -9], [0.0, 9.0]), q=np.array([0.2, 1e-3]), stage=ck.picard(0), N=1)
    assert names(made.status[0]) == "NOT_CONVERGED|NEAR_SINGULAR|AT_LIMIT"
    assert count(made.status) == {"OK": 0, "NOT_CONVERGED": 1, "NEAR_SINGULAR": 1, "AT_LIMIT": 1, "NON_FINITE": 0}
    assert names(0) == "OK" and count([0, 0, 8])["OK"] == 2


# --- require_ok ---------------------------------------------------------------------------------------


def made_up(status, t=None):
    status = jnp.asarray(status)
    t = 0.1 * jnp.broadcast_to(jnp.arange(status.shape[-1] + 1.0), (*status.shape[:-1], status.shape[-1] + 1))
    return ck.replace(run(), status=status, t=t)


@pytest.mark.parametrize(
    ("status", "message"),
    [
        ([0, 0, 1, 8], "Step 2 (t = 0.2 s) is NOT_CONVERGED: reduce alpha·Ts, raise M"),
        ([0, 2], "Step 1 (t = 0.1 s) is NEAR_SINGULAR: use damped(...)"),
        ([4], "Step 0 (t = 0 s) is AT_LIMIT: choose another start or path"),
        ([0, 9], "Step 1 (t = 0.1 s) is NOT_CONVERGED|NON_FINITE: reduce alpha·Ts or use damped(...)"),
        ([[0, 0, 1], [0, 2, 0]], "Step 1 of lane (1,) (t = 0.1 s) is NEAR_SINGULAR"),
    ],
)
def test_require_ok_names_the_first_bad_step(status, message):
    with pytest.raises(ck.StepError) as caught:
        ck.require_ok(made_up(status))
    assert str(caught.value).startswith(message) and "\n" not in str(caught.value)


def test_require_ok_allows_what_is_allowed():
    made = made_up([0, 2, 4])
    assert ck.require_ok(made, allow=S.NEAR_SINGULAR | S.AT_LIMIT) is made
    with pytest.raises(ck.StepError, match=r"Step 2 .* AT_LIMIT"):
        ck.require_ok(made, allow=S.NEAR_SINGULAR)


def test_status_survives_jit_and_vmap():
    q = jnp.array([[0.2, 1.2], [0.2, 1e-4]])
    many = jax.jit(jax.vmap(lambda q: run(q=q, target=HERE, method="EE", N=1).status))(q)
    assert many[0, 0] == S.OK and many[1, 0] & S.NEAR_SINGULAR
