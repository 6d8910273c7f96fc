"""Joint and velocity limits: bounds kept, the task kept wherever a linear program says it can be."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import linprog

import cnclik as ck
from cnclik.law import limits as room
from cnclik.robot.model import modelled

RATE, LANES = 10.0, 150
ARM = ck.panda()
LOW, HIGH, SPEED = (np.array(v) for v in (ARM.lower, ARM.upper, ARM.velocity_limit))


def lanes(m, seed, outside=0.0):
    rng = np.random.default_rng(seed)
    j = rng.normal(size=(LANES, m, 7))
    task = rng.normal(size=(LANES, m)) * rng.choice([0.5, 2.0, 5.0], size=(LANES, 1))
    return j, task, rng.uniform(LOW - outside, HIGH + outside, (LANES, 7))


@jax.jit
@functools.partial(jax.vmap, in_axes=(None, 0, 0, 0, None))
def each(limits, j, task, q, wanted):
    made = limits(ck.pseudoinverse(), modelled(ARM), q, j, task, wanted)
    return made.qdot, jnp.asarray(made.limited)


def act(limits, j, task, q, wanted=None):
    return map(np.asarray, each(limits, j, task, q, wanted))


def bounds(q):
    return np.clip(RATE * (LOW - q), -SPEED, SPEED), np.clip(RATE * (HIGH - q), -SPEED, SPEED)


def largest_share(j, task, low, high):
    """By linear programming: the largest s ≤ 1 with J q̇ = s t within bounds, None if no s fits."""
    m = len(task)
    equal = np.c_[j, -task]
    found = linprog(np.r_[np.zeros(7), -1], A_eq=equal, b_eq=np.zeros(m), bounds=[*zip(low, high, strict=True), (0, 1)])
    return -found.fun if found.status == 0 else None


@pytest.mark.parametrize("m", [3, pytest.param(6, marks=pytest.mark.slow)])
def test_saturation_keeps_the_task_where_it_can_be_kept(m):
    j, task, q = lanes(m, seed=m)
    qdot, held = act(ck.saturation(RATE), j, task, q)
    low, high = bounds(q)
    assert (qdot >= low - 1e-9).all() and (qdot <= high + 1e-9).all()
    got = np.einsum("kmn,kn->km", j, qdot)
    share = np.sum(got * task, 1) / np.sum(task**2, 1)
    best = np.array([largest_share(*lane) for lane in zip(j, task, low, high, strict=True)], float)
    # The direction of the task is kept, and no more of it is done than is possible.
    np.testing.assert_allclose(got, share[:, None] * task, atol=1e-7)
    assert (share <= best + 1e-7).all()
    # Algorithm 1 is greedy: it finds the whole task wherever there is one but in a few of a hundred cases.
    whole = best > 1 - 1e-9
    assert np.mean(share[whole] > 1 - 1e-7) > 0.97
    assert np.mean(share / best) > 0.97
    assert held.any() and not held.all()
    plain = np.einsum("knm,km->kn", np.linalg.pinv(j), task)
    np.testing.assert_allclose(qdot[~held], plain[~held], atol=1e-9)
    # Clamping joint by joint, the blind way, would have spoilt the task.
    blind = np.einsum("kmn,kn->km", j, np.clip(plain, low, high))
    assert np.abs(blind - task)[held & whole].max() > 0.1


def test_saturation_brings_joints_back():
    j, task, q = lanes(3, seed=5, outside=0.05)
    qdot, _ = act(ck.saturation(RATE), j, task, q)
    low, high = bounds(q)
    assert ((q < LOW) | (q > HIGH)).any()
    assert (qdot >= low - 1e-9).all() and (qdot <= high + 1e-9).all()  # bounds that point back inside


def test_null_velocity_passes_through_saturation():
    j, task, q = lanes(3, seed=6)
    wanted = np.linspace(-0.2, 0.2, 7)
    qdot, held = act(ck.saturation(RATE), j, 0.1 * task, q, wanted)
    free = ~held
    pinv = np.linalg.pinv(j)
    expected = wanted + np.einsum("knm,km->kn", pinv, 0.1 * task - np.einsum("kmn,n->km", j, wanted))
    np.testing.assert_allclose(qdot[free], expected[free], atol=1e-9)
    got = np.einsum("kmn,kn->km", j, qdot)
    assert np.mean(np.abs(got - 0.1 * task).max(1) < 1e-7) > 0.95


def test_velocity_scaling_keeps_the_direction():
    j, task, q = lanes(3, seed=7)
    qdot, held = act(ck.velocity_scaling(), j, task, q)
    plain = np.einsum("knm,km->kn", np.linalg.pinv(j), task)
    s = np.minimum(1.0, np.min(SPEED / np.abs(plain), axis=1))
    np.testing.assert_allclose(qdot, s[:, None] * plain, rtol=1e-7)
    np.testing.assert_array_equal(held, s < 1)


def test_weighted_least_norm_is_chan_and_dubeys():
    j, task, q = lanes(3, seed=8)
    task = 0.02 * task  # below the velocity limits
    qdot, _ = act(ck.weighted_least_norm(), j, task, q)
    gradient = (HIGH - LOW) ** 2 * (2 * q - HIGH - LOW) / (4 * (HIGH - q) ** 2 * (q - LOW) ** 2)
    plain = np.einsum("knm,km->kn", np.linalg.pinv(j), task)
    weight = np.where(plain * gradient > 0, 1 + np.abs(gradient), 1.0)
    for k in range(LANES):
        inverse = np.diag(1 / weight[k])
        expected = inverse @ j[k].T @ np.linalg.solve(j[k] @ inverse @ j[k].T, task[k])
        np.testing.assert_allclose(qdot[k], expected, atol=1e-9)


def test_weighted_joints_stop_at_their_limits_and_return():
    q = np.array([-1.2, -1.0, -0.999, 0.0, 1.0, 1.2])
    one = modelled(ck.replace(ck.planar_arm([1.0]), lower=(-1.0,), upper=(1.0,)))
    none = jnp.zeros(1)
    outward, inward = (np.array([room.roots_of(one, x[None], v)[0] for x in q]) for v in (1.0, -1.0))
    limited = ck.weighted_least_norm(RATE)
    back = np.array([limited(ck.pseudoinverse(), one, x[None], none[None], none, None).qdot[0] for x in jnp.asarray(q)])
    np.testing.assert_allclose(outward[4:], 0, atol=1e-12)  # no way further out
    np.testing.assert_allclose(outward[:3], 1)  # free to come in
    np.testing.assert_allclose(back, [2.0, 0, 0, 0, 0, -2.0], atol=1e-12)
    assert inward[0] == 0 and inward[1] == 0 and 0 < inward[2] < 0.01 and inward[4] == 1


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


@pytest.mark.parametrize("limits", [ck.saturation(), ck.weighted_least_norm(), ck.bounded()])
def test_a_redundant_arm_tracks_within_limits(limits):
    arm, law, reference, q0 = redundant(limits)
    run = ck.solve(law, reference, q0, 0.01, 400)
    free = ck.solve(ck.replace(law, limits=None), reference, q0, 0.01, 400)
    assert np.asarray(free.q).max(0)[1] > arm.upper[1] + 0.2  # left alone it goes past the limit
    assert (np.asarray(run.q) <= np.array(arm.upper) + 1e-6).all()
    assert np.abs(run.e[-1]).max() < 2e-3 and np.abs(run.e).max() < 2e-2
    assert np.any(np.asarray(run.status) & ck.Status.AT_LIMIT)


@pytest.mark.parametrize("inverse", [ck.damped(0.3), ck.singular_damped(0.5, 2.0)])
def test_damping_does_not_stop_a_saturated_arm(inverse):
    """What a damped inverse holds back is not out of reach: the other joints go on when one is at its limit."""
    _, law, reference, q0 = redundant(ck.saturation())
    run = ck.solve(ck.replace(law, inverse=inverse), reference, q0, 0.01, 400)
    assert np.any(np.asarray(run.status) & ck.Status.AT_LIMIT)
    assert np.abs(run.e[-1]).max() < 5e-3 and np.abs(run.e).max() < 0.06


@pytest.mark.parametrize("limits", [ck.saturation(2.0), ck.weighted_least_norm(2.0), ck.bounded(2.0)])
def test_a_start_outside_comes_back_while_the_task_goes_on(limits):
    arm, law, _, q0 = redundant(limits)
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
    with pytest.raises(ck.ArgumentError, match="rest"):
        ck.solve(ck.replace(law, null_velocity=ck.posture([0.0, 1.0])), ck.hold([1.0, 1.0]), q0, 0.01, 1)


def test_manipulability_is_climbed_in_the_null_space():
    arm, task = ck.planar_arm([1.0, 1.0, 1.0]), ck.position("xy")
    q0 = np.array([0.2, 0.3, 0.1])
    hold = ck.hold(ck.forward(arm, q0).position[:2])
    term = ck.maximize_manipulability(arm, task, 2.0)
    climbs, w = jax.jit(term), jax.jit(lambda q: ck.manipulability(arm, q, task))
    gradient = np.array(climbs(q0)) / 2.0
    step = 1e-6 * np.eye(3)
    np.testing.assert_allclose(gradient, [(w(q0 + d) - w(q0 - d)) / 2e-6 for d in step], atol=1e-6)
    law = ck.Law(arm, task, alpha=5.0, inverse=ck.damped(1e-3), null_velocity=term)
    run = ck.solve(law, hold, q0, 0.01, 300)
    assert w(run.q[-1]) > w(q0) + 0.04 and np.abs(run.e).max() < 1e-3
    assert np.isfinite(np.array(climbs(np.zeros(3)))).all()  # stretched: a kink of w, no NaN
