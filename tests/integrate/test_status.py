"""Status bits: each one set where it should be, and nowhere else; require_ok."""

import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.integrate.status import StepError, count, growing, names
from tests.bank import screws

S = ck.Status


def arm(lower=(-9.0, -9.0), upper=(9.0, 9.0)):
    """Limits as arrays are parameters of a program."""
    return ck.replace(ck.planar_arm([1.0, 1.0]), lower=jnp.array(lower, float), upper=jnp.array(upper, float))


Q = np.array([0.2, 1.2])
HERE = ck.hold(ck.forward(arm(), Q).position[:2])
NEAR = ck.hold(ck.forward(arm(), Q).position[:2] + jnp.array([0.1, 0.1]))

SLIDER = screws([[0.0] * 3], [[1.0, 0, 0]], [0.0] * 3, kinds="P")  # J = 1: the error shrinks by R(z), exactly
HOLD_ONE, WAVE = ck.hold([1.0]), ck.lissajous([0.0], [1.0], period=2.0)


def run(chain=None, q=Q, target=NEAR, method="IE", M=8, tolerance=1e-3, **law):
    """One program for all numbers of passes."""
    stage = ck.picard(np.array(M), maximum=8, tolerance=tolerance)
    law = ck.Law(chain or arm(), ck.position("xy"), **{"alpha": 2.0, **law})
    return ck.solve(law, target, q, 0.1, 4, method, stage)


def test_not_converged():
    made = run(alpha=1.2, M=1)  # by more than 1 mm or mrad
    assert made.status[0] == S.NOT_CONVERGED and 1.5e-3 > made.residual[0] > 1e-3
    assert run(M=1, tolerance=0.5).status[0] == S.OK
    # Diverging: z = 15 per pass.
    assert np.all(run(alpha=150.0).status & S.NOT_CONVERGED)


def test_near_singular():
    stretched = np.array([0.2, 1e-4])
    made = run(q=stretched, target=ck.hold(ck.forward(arm(), stretched).position[:2]), method="EE")
    np.testing.assert_array_equal(made.status, S.NEAR_SINGULAR)
    assert np.all(run(q=stretched, target=HERE, near_singular=0.0).status & S.NEAR_SINGULAR == 0)
    # σ_min at Q is 0.55: the threshold is compared with an estimate from below, within √2 for two rows.
    least = np.linalg.svd(ck.jacobian(arm(), Q)[:2], compute_uv=False)[-1]
    assert run(target=HERE, method="EE", near_singular=least * 1.001).status[0] == S.NEAR_SINGULAR
    assert run(target=HERE, method="EE", near_singular=least * 0.999 / np.sqrt(2)).status[0] == S.OK


def test_at_limit():
    # The second joint turns away from its limit, the first one towards it.
    moved = run()
    low, high = np.asarray(moved.q).min(0), np.asarray(moved.q).max(0)
    free = run(arm(low - 0.01, high + 0.01))
    np.testing.assert_array_equal(free.status, S.OK)
    for k, (lower, upper) in enumerate([((low[0] + 1e-3, -9), (9, 9)), ((-9, -9), (9, high[1] - 1e-3))]):
        bad = run(arm(lower, upper))
        q = np.asarray(bad.q)[1:, k]
        outside = (q <= lower[k]) | (q >= upper[k])
        np.testing.assert_array_equal(bad.status, np.where(outside, S.AT_LIMIT, S.OK))
    assert np.all(run(arm([-9, -9], [0.0, 9.0])).status & S.AT_LIMIT)  # started beyond
    exactly = run(arm(upper=[9, 1.2]), target=HERE, method="EE")  # on the limit counts as at it
    assert abs(exactly.q[-1, 1] - 1.2) < 1e-15


def test_non_finite():
    law = ck.Law(SLIDER, ck.position("x"), alpha=1e100)
    grown = ck.solve(law, ck.hold([1.0]), [0.0], 1.0, 5, "EE")
    np.testing.assert_array_equal(grown.status & S.NON_FINITE, [0, 0, 0, S.NON_FINITE, S.NON_FINITE])
    assert grown.status[0] == S.GROWING | S.DIVERGED
    # A target that stops being a number.
    lost = ck.path(lambda t: (jnp.where(t > 0.15, jnp.nan, 0.5),))
    turned = ck.Law(ck.planar_arm([1.0]), ck.position("x"), alpha=1.0)
    made = ck.solve(turned, lost, [1.2], 0.1, 4, "EE")
    np.testing.assert_array_equal(made.status, [0, 0, S.NON_FINITE, S.NON_FINITE | S.NEAR_SINGULAR])


@pytest.mark.parametrize(("dtype", "least"), [(np.float32, 16384), (np.float64, 1e6)])
def test_diverged_while_all_is_finite(dtype, least):
    """Joint values without meaning are told of, also where the error stays small."""
    law = ck.Law(arm(), ck.position("xy"), alpha=2.0)
    for q0, bit in (((0.9 * least, 0.5), 0), ((0.6 * least, -0.6 * least), S.DIVERGED)):
        q = np.array(q0, dtype)
        here = ck.hold(ck.forward(law.chain, q).position[:2])
        made = ck.solve(law, here, q, 0.1, 4, "EE")
        np.testing.assert_array_equal(made.status & S.DIVERGED, bit)


def test_several_bits_at_once():
    made = run(arm([-9, -9], [0.0, 9.0]), q=np.array([0.2, 1e-3]), M=0)
    assert names(made.status[0]) == "NOT_CONVERGED|NEAR_SINGULAR|AT_LIMIT|GROWING"
    seen = {"NOT_CONVERGED", "NEAR_SINGULAR", "AT_LIMIT", "GROWING"}
    assert count(made.status[:1]) == {"OK": 0} | {s.name: int(s.name in seen) for s in S if s}
    assert names(0) == "OK" and count([0, 0, 8])["OK"] == 2


def test_values_of_bits_never_change():
    """Stored datasets hold them."""
    bits = {"NOT_CONVERGED": 1, "NEAR_SINGULAR": 2, "AT_LIMIT": 4, "NON_FINITE": 8, "OVER_VELOCITY": 16, "GROWING": 32}
    bits |= {"TASK_TOO_LARGE": 64, "DIVERGED": 256, "WALLS_CONTRADICT": 1024}
    assert {s.name: s.value for s in S.__members__.values()} == {"OK": 0, **bits}


def test_over_velocity():
    law = ck.Law(ck.replace(SLIDER, velocity_limit=(0.5,)), ck.position("x"), alpha=1.0)
    made = ck.solve(law, HOLD_ONE, [0.0], 0.25, 6, "EE")  # q̇ = e: 1, 0.75, 0.5625, 0.42, ...
    np.testing.assert_array_equal(made.status, [S.OVER_VELOCITY] * 3 + [S.OK] * 3)
    # What holds velocities at the limit does not exceed it, in single precision either.
    for dtype in (np.float32, np.float64):
        held = ck.solve(ck.replace(law, limits=ck.velocity_scaling()), HOLD_ONE, np.zeros(1, dtype), 0.25, 6, "EE")
        np.testing.assert_array_equal(held.status, [S.AT_LIMIT] * 4 + [S.OK] * 2)  # e: 1, 0.875, 0.75, 0.625, 0.5


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_growing_from_the_limit_of_stability_on(dtype):
    law = ck.Law(SLIDER, ck.position("x"), alpha=1.0)

    def status(z, target=HOLD_ONE, **changes):
        moved = ck.replace(law, alpha=z / 0.125, **changes)
        return np.asarray(ck.solve(moved, target, np.zeros(1, dtype), 0.125, 60, "EE").status)

    for z in (0.01, 1.0, 1.9, 1.99):
        np.testing.assert_array_equal(status(z), S.OK)
    for z in (2.0, 2.001, 2.3, 5.0):  # from standing oscillation on
        np.testing.assert_array_equal(status(z)[:20] & ~S.DIVERGED, S.GROWING)
    # A moving target, with and without feed-forward: the error grows from 0 to its lag, as it must.
    for z in (0.1, 1.0, 1.9):
        for feedforward in (0.0, 1.0):
            np.testing.assert_array_equal(status(z, WAVE, feedforward=feedforward), S.OK)
    assert np.mean((status(5.0, WAVE)[:20] & S.GROWING) != 0) > 0.8
    noise = np.sin(np.arange(60.0))[:, None]  # by which an error grows and shrinks
    shaken = ck.solve(ck.replace(law, alpha=8.0), HOLD_ONE, np.zeros(1, dtype), 0.125, 60, "EE", noise=noise)
    np.testing.assert_array_equal(shaken.status, S.OK)


def test_an_error_that_turns_round_and_keeps_its_size_grows():
    """It turns round as a whole: one axis may keep its sign."""
    e = jnp.array([[1.0, 0.1], [-0.96, 0.3], [0.9, 0.4]])
    law = ck.Law(arm(), ck.position("xy"), alpha=2.0)
    assert growing(law, HERE, jnp.arange(3.0), e).tolist() == [S.GROWING, 0]


def test_a_task_of_more_rows_than_joints():
    """Least squares is a compromise: damped it runs and says so; exact it is refused, see tests/law."""
    law = ck.Law(arm(), ck.position("xyz"), alpha=2.0, inverse=ck.damped(0.1))
    target = ck.forward(arm(), Q).position + jnp.array([0.1, 0.1, 0.05])
    assert np.all(ck.solve(law, ck.hold(target), Q, 0.1, 3).status & S.TASK_TOO_LARGE)


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
        ([0, 16], "Step 1 (t = 0.1 s) is OVER_VELOCITY: reduce alpha, slow the path down, or use limits="),
        ([32], "Step 0 (t = 0 s) is GROWING: reduce alpha·Ts"),
        ([68], "Step 0 (t = 0 s) is AT_LIMIT|TASK_TOO_LARGE: control fewer coordinates"),
        ([0, 9], "Step 1 (t = 0.1 s) is NOT_CONVERGED|NON_FINITE: reduce alpha·Ts, use damped(...)"),
        ([[0, 0, 1], [0, 2, 0]], "Step 1 of lane (1,) (t = 0.1 s) is NEAR_SINGULAR"),
    ],
)
def test_require_ok_names_the_first_bad_step(status, message):
    with pytest.raises(StepError) as caught:
        ck.require_ok(made_up(status))
    assert str(caught.value).startswith(message) and "\n" not in str(caught.value)


def test_require_ok_allows_what_is_allowed():
    made = made_up([0, 2, 4])
    assert ck.require_ok(made, allow=S.NEAR_SINGULAR | S.AT_LIMIT) is made
    with pytest.raises(StepError, match=r"Step 2 .* AT_LIMIT"):
        ck.require_ok(made, allow=S.NEAR_SINGULAR)
    with pytest.raises(ck.ArgumentError, match="`allow` must be a Status, but is list"):
        ck.require_ok(made, allow=["NEAR_SINGULAR"])
