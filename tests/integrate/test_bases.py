"""Loops on a free base: orders, limits, drives, long runs, rest.

The truth is SciPy's, on a quaternion that it integrates itself.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from scipy.spatial.transform import Rotation

import cnclik as ck
from cnclik.robot.chart import rates
from cnclik.robot.rotations import exp_so3
from tests.integrate.test_exponential import by_steps
from tests.integrate.test_orders import ORDERS

ROBOT = ck.load_urdf(
    """<robot name="r"><link name="trunk"/><link name="arm"/><link name="hand"/>
    <joint name="j0" type="continuous"><axis xyz="0 1 0"/><origin xyz="0.1 0.2 0.3" rpy="0.3 0 0"/>
    <parent link="trunk"/><child link="arm"/></joint>
    <joint name="j1" type="continuous"><axis xyz="1 0 0"/><origin xyz="0 0.1 0.4"/>
    <parent link="arm"/><child link="hand"/></joint></robot>""",
    tips={"hand": ("hand", [0.0, 0.0, 0.3]), "trunk": "trunk"},
    base="free",
)
HAND = ck.pose(tip="hand")
LAW = ck.Law(ROBOT, HAND, alpha=4.0)


def about(axis, angle):
    return exp_so3(jnp.zeros(3).at[axis].set(angle))


def target(t):
    place = jnp.stack([0.4 * jnp.sin(t), 0.2 * t, 0.7 + 0.1 * jnp.cos(1.3 * t)])
    return ck.Pose(position=place, rotation=about(2, 1.5 * t) @ about(0, 0.3 * jnp.sin(1.1 * t)))


def told(t):
    """The target and its velocity, by hand: position, rotation, (v, ω)."""
    place = np.array([0.4 * np.sin(t), 0.2 * t, 0.7 + 0.1 * np.cos(1.3 * t)])
    turn = Rotation.from_rotvec([0, 0, 1.5 * t])
    spin = np.array([0, 0, 1.5]) + turn.apply([0.33 * np.cos(1.1 * t), 0, 0])
    velocity = [0.4 * np.cos(t), 0.2, -0.13 * np.sin(1.3 * t)]
    return place, turn * Rotation.from_rotvec([0.3 * np.sin(1.1 * t), 0, 0]), np.concatenate([velocity, spin])


PATH = ck.path(target)


def start(away=0.0):
    """A posture with the hand on the path at t = 0, or away from there."""
    q = np.array([0.1, 0.2, -0.1, 0.4, -0.6, 0.3, 0.2, 0.5])
    hand, trunk = (Rotation.from_matrix(ck.forward(ROBOT, q, tip=tip).rotation) for tip in ("hand", "trunk"))
    place, turn, _ = told(0.0)
    q[3:6] = (Rotation.from_rotvec(away * np.array([2.0, -1.0, 1.5])) * turn * hand.inv() * trunk).as_rotvec()
    q[:3] += place + away * np.array([1.0, -0.8, 1.2]) - np.asarray(ck.forward(ROBOT, q, tip="hand").position)
    return q


def whole(q):
    return np.concatenate([q[:3], Rotation.from_rotvec(np.array(q[3:6])).as_matrix().ravel(), q[6:]])


def truth(away):
    def slope(t, y):
        turn, (place, wanted, velocity) = Rotation.from_quat(y[3:7]), told(t)
        q = np.concatenate([y[:3], turn.as_rotvec(), y[7:]])
        at, j = ck.forward(ROBOT, q, tip="hand"), np.asarray(ck.jacobian(ROBOT, q, tip="hand"))
        left = (wanted * Rotation.from_matrix(np.array(at.rotation)).inv()).as_rotvec()
        v = np.linalg.pinv(j) @ (velocity + 4.0 * np.concatenate([place - at.position, left]))
        (u, s), w = (y[3:6], y[6]), v[3:6]
        return np.concatenate([v[:3], 0.5 * (s * w + np.cross(u, w)), [-0.5 * u @ w], v[6:]])

    q = start(away)
    first = np.concatenate([q[:3], Rotation.from_rotvec(q[3:6]).as_quat(), q[6:]])
    end = scipy.integrate.solve_ivp(slope, (0.0, 1.0), first, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return np.concatenate([end[:3], Rotation.from_quat(end[3:7]).as_matrix().ravel(), end[7:]])


def test_order():
    """Breaks for slopes without dexp⁻¹, or slopes that are remembered as they were: order 2 at most."""
    ends, wanted = [whole(by_steps(LAW, PATH, start(0.1), 1 / n, n, "RK4")[0][-1]) for n in (80, 160)], truth(0.1)
    coarse, fine = (np.linalg.norm(end - wanted) for end in ends)
    assert np.log2(coarse / fine) == pytest.approx(ORDERS["RK4"]["from off it"], abs=0.15)


def test_a_base_turns_for_ever_in_the_ball():
    """Breaks for a rotation vector that grows with each turn."""
    law = ck.Law(ROBOT, ck.pose(tip="trunk"), alpha=4.0)
    path = ck.path(
        lambda t: ck.Pose(
            position=jnp.stack([jnp.sin(t), jnp.cos(t), 0 * t]), rotation=about(2, 3 * t) @ about(1, 0.2 * jnp.sin(t))
        )
    )
    run = ck.solve(law, path, np.zeros(8), 0.01, 4_000)  # 19 turns
    w = np.asarray(run.q)[:, 3:6]
    assert np.linalg.norm(w, axis=1).max() <= np.pi + 1e-12
    assert np.abs(np.asarray(run.e)[1000:]).max() < 1e-5
    assert np.abs(np.diff(w, axis=0)).max() > 3.0  # and comes in again on the other side


def test_a_posture_draws_a_base_the_shorter_way():
    rest = start()
    rest[3:6] = [0.0, 0.0, 3.1]
    law = ck.Law(ROBOT, ck.position("z", tip="hand"), alpha=4.0, null_velocity=ck.posture(rest, 2.0))
    q = start()
    q[3:6] = [0.0, 0.0, -3.1]
    run = ck.solve(law, ck.hold_at(ROBOT, law.task, q), q, 0.05, 60)
    assert np.abs(np.asarray(run.q)[:, 5]).min() > 3.05 and "balls" not in repr(law)
    assert run.q[-1][5] == pytest.approx(3.1, abs=0.02)


def test_drives_move_a_base():
    law = ck.replace(LAW, alpha=2.0)
    run = ck.solve(law, PATH, start(0.1), 0.01, 300, "EE", drive=ck.Drive(delay=1.5, lag=0.02))
    assert np.abs(np.asarray(run.e)[-50:]).max() < 0.03
    with pytest.raises(ck.ArgumentError, match="take velocities on a free base"):
        ck.solve(law, PATH, start(), 0.01, 3, drive=ck.Drive(lag=0.02, command="position"))


def test_rest_is_judged_in_the_chart():
    """Breaks for a loop that is differentiated by the rotation vector: R(z) is then another in each posture."""
    law = ck.Law(ROBOT, ck.position(tip="hand"), alpha=4.0)
    assert ck.stability.spectral_radius(law, None, start(), 0.1, "EE") == pytest.approx(0.6, abs=1e-12)
    moving = jax.jit(functools.partial(rates, ROBOT))
    ((_, i),), w = ROBOT.balls, np.array([0.3, -0.5, 0.7])
    for angle, near in ((1.1, 1e-14), (3.1, 2e-7)):  # dexp⁻¹ in closed form
        d, once = np.array([0.6, 0.0, 0.8]) * angle, np.cross(np.array([0.6, 0.0, 0.8]) * angle, w)
        wanted = w + once / 2 + (1 - angle / 2 / np.tan(angle / 2)) / angle**2 * np.cross(d, once)
        y, qdot = (np.pad(v, (i, ROBOT.n - i - 3)) for v in (d, w))
        np.testing.assert_allclose(moving(y, qdot)[i : i + 3], wanted, rtol=0, atol=near)


def test_what_a_free_base_has_not_is_one_line():
    with pytest.raises(ck.ArgumentError, match="`chain` must have no free base and no ball joint, to be"):
        ck.reach(ROBOT, np.eye(4), task=HAND)
    with pytest.raises(ck.ArgumentError, match="for, but name base_ry"):
        ck.Law(ROBOT, ck.joints(["j0", "base_ry"]), alpha=1.0)
    assert ck.Law(ROBOT, ck.joints(), alpha=1.0).task.names == ("j0", "j1")
