"""A loop of 500 explicit Euler steps on the Panda against the same loop written with Pinocchio."""

import jax.numpy as jnp
import numpy as np
import pinocchio as pin

import cnclik as ck
from cnclik.robot.posture import start_posture
from tests.oracles import damped_inverse, robot_file
from tests.robot.test_urdf import Pinocchio, oracle

N, TS, ALPHA, LAMBDA = 500, 0.01, 5.0, 0.05
DIRECTION = np.array([0.05, -0.08, 0.06])


def loop(where, names, q):
    """q[k+1] = q[k] + Ts J#(ẋ_d + α e) of a pose whose place swings: joint values, first place, desired rotation."""
    start, rotation, _ = where.at(names, q, "panda_hand_tcp", "panda_link0")
    start, desired = start.copy(), pin.exp3(0.4 * np.array([2.0, -1.0, 2.0]) / 3.0) @ rotation  # 0.4 rad off
    path = [q]
    for k in range(N):
        position, rotation, j = where.at(names, path[-1], "panda_hand_tcp", "panda_link0")
        away, velocity = DIRECTION * np.sin(2.0 * k * TS), 2.0 * DIRECTION * np.cos(2.0 * k * TS)
        e = np.concatenate([start + away - position, pin.log3(desired @ rotation.T)])
        path.append(path[-1] + TS * damped_inverse(LAMBDA)(j) @ (np.concatenate([velocity, np.zeros(3)]) + ALPHA * e))
    return np.array(path), start, desired


def test_a_loop_of_500_steps_is_pinocchios():
    file = robot_file("panda")
    arm = ck.load_urdf(file, tip="panda_hand_tcp")
    q0 = start_posture(arm, ck.pose())
    expected, start, rotation = loop(Pinocchio(file, oracle(file)[0]), arm.joint_names, np.array(q0))

    def pose(t):
        return ck.Pose(position=jnp.asarray(start) + DIRECTION * jnp.sin(2.0 * t), rotation=jnp.asarray(rotation))

    law = ck.Law(arm, ck.pose(), alpha=ALPHA, inverse=ck.damped(LAMBDA))
    found = ck.solve(law, ck.path(pose), q0, TS, N, "EE")
    assert np.ptp(expected, axis=0).max() > 0.2  # it moves
    # λ off by 1e-8, or a target one rounding early, shows at 1e-9.
    np.testing.assert_allclose(found.q, expected, rtol=0, atol=1e-9)
