"""Limits of every kind, kept by every limit method, method and stage, in both dtypes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck

INF = np.inf
ARM = ck.planar_arm([0.5, 0.4, 0.3])
Q0 = np.array([0.2, 0.9, -0.6])
N, TS = 40, 0.05
# Of the first and the second joint: lower and upper limits [rad].
KINDS = {
    "both": ([0.1, 0.5], [0.5, 1.1]),
    "lower": ([0.1, -2.0], [INF, 2.0]),
    "upper": ([-INF, -2.0], [0.3, 2.0]),
    "lower, huge": ([0.1, -2.0], [1e16, 2.0]),
    "upper, huge": ([-1e16, -2.0], [0.3, 2.0]),
    "beyond single precision": ([-1e300, 0.5], [0.3, 1e300]),
    "one value": ([0.2, -2.0], [0.2, 2.0]),
    "both of one value": ([0.2, 0.9], [0.2, 0.9]),
    "narrow": ([0.2 - 1e-3, -2.0], [0.2 + 1e-3, 2.0]),
    "none": ([-INF, -INF], [INF, INF]),
}
LIMITS = {"scaling": ck.velocity_scaling(), "bounded": ck.bounded()}
# A tableau whose combination of slopes may be faster than each of them.
EXTREME = ck.Method(name="EXTREME", A=((), (0.25,)), b=(-1.0, 2.0), c=(0.0, 0.25), order=2, source="b < 0")


def law_of(limits, lower, upper, speed):
    """With limits of the first two joints as arrays, which are parameters of a program."""
    third = jnp.asarray([INF], lower.dtype)
    lower, upper = jnp.concatenate([lower, -third]), jnp.concatenate([upper, third])
    arm = ck.replace(ARM, lower=lower, upper=upper, velocity_limit=jnp.stack([speed] * 3))
    return ck.Law(arm, ck.position("xy"), alpha=8.0, inverse=ck.damped(0.01), limits=LIMITS[limits])


def cases(dtype):
    """Limits, velocity limit, start and target of every kind: inside, on a limit, and a rounding outside."""
    found = []
    for low, high in KINDS.values():
        low, high = (np.array(v).clip(-np.finfo(dtype).max, np.finfo(dtype).max) for v in (low, high))
        low, high = (np.where(np.abs(v) < np.finfo(dtype).max, v, np.sign(v) * INF).astype(dtype) for v in (low, high))
        on = np.where(np.abs(high) < 10, high, np.where(np.abs(low) < 10, low, Q0[:2])).astype(dtype)
        beyond = np.where(on == high, np.nextafter(on, dtype(9)), np.where(on == low, np.nextafter(on, dtype(-9)), on))
        for start in (np.clip(Q0[:2], low, high), on, beyond):
            for target in ([0.9, -0.5], [-0.4, 0.6]):
                q0 = np.append(start, Q0[2]).astype(dtype)
                found.append((low, high, dtype(2.0), q0, np.array(target, dtype)))
    return [np.stack(v) for v in zip(*found, strict=True)]


@pytest.mark.parametrize(
    ("limits", "method", "stage", "dtype"),
    [
        ("bounded", "CN", ck.chord(2), np.float64),
        ("bounded", "EXP-MIDPOINT", None, np.float32),
        ("scaling", EXTREME, None, np.float64),
    ],
)
def test_kept(limits, method, stage, dtype):
    def one(low, high, speed, q0, target):
        return ck.solve(law_of(limits, low, high, speed), ck.hold(target), q0, TS, N, method, stage or ck.picard(5))

    made = cases(dtype)
    run = jax.jit(jax.vmap(one))(*made)
    low, high, _, q0, _ = made
    q, qdot = np.asarray(run.q)[..., :2], np.asarray(run.qdot)
    assert run.q.dtype == dtype and np.isfinite(run.q).all() and np.isfinite(run.e).all()
    rounding = 100 * np.finfo(dtype).eps
    assert np.all(np.abs(qdot) <= 2.0 * (1 + rounding))
    np.testing.assert_allclose(np.diff(run.q, axis=1) / TS, qdot, atol=rounding * 10 / TS)
    assert np.ptp(run.q, axis=1).max() > 0.5  # they move
    if limits == "scaling":
        return
    bottom, top = np.minimum(low, q0[:, :2]), np.maximum(high, q0[:, :2])
    assert np.all(q >= bottom[:, None]) and np.all(q <= top[:, None])
    fixed = low == high
    status = np.asarray(run.status) & ck.Status.AT_LIMIT
    assert np.all(np.abs(q - low[:, None])[np.broadcast_to(fixed[:, None], q.shape)] <= np.finfo(dtype).eps)
    assert status.any()


def test_a_joint_of_one_value_is_no_joint():
    """The arm moves as one whose second joint is welded, and is not at a limit all the time."""
    bend = 0.9
    welded = ck.planar_arm([np.hypot(0.5 + 0.4 * np.cos(bend), 0.4 * np.sin(bend)), 0.3])
    turned = np.arctan2(0.4 * np.sin(bend), 0.5 + 0.4 * np.cos(bend))  # of its first link, which is two
    fixed = ck.replace(ARM, lower=(-INF, bend, -INF), upper=(INF, bend, INF))
    runs = []
    for arm, q0 in ((fixed, [0.2, bend, 0.7]), (welded, [0.2 + turned, 0.7 + bend - turned])):
        law = ck.Law(arm, ck.position("xy"), alpha=8.0, inverse=ck.damped(0.01), limits=ck.bounded())
        runs.append(ck.solve(law, ck.hold([0.3, 0.7]), q0, TS, N, "EE"))
    assert np.all(np.asarray(runs[0].q)[:, 1] == bend) and np.linalg.norm(runs[0].e[-1]) < 1e-3
    np.testing.assert_allclose(runs[0].e, runs[1].e, atol=1e-9)
    ck.require_ok(runs[0])


@pytest.mark.parametrize("limits", LIMITS)
def test_gradients_are_finite(limits):
    @ck.native
    def loss(low, high, speed, q0, target):
        run = ck.solve(law_of(limits, low, high, speed), ck.hold(target), q0, TS, 10, "EE")
        return jnp.sum(run.e[-1] ** 2) + jnp.sum(run.q[-1])

    made = cases(np.float64)
    found = jax.jit(jax.vmap(jax.grad(loss, argnums=(0, 1, 2, 3, 4))))(*made)
    for value, name in zip(found, ("lower", "upper", "velocity", "start", "target"), strict=True):
        assert np.isfinite(value).all(), name
