"""Whole explicit Euler loops on eight robots against the same loop written with Pinocchio."""

import importlib.metadata
import pathlib

import numpy as np
import pinocchio as pin
import pytest

import cnclik as ck
from cnclik.robot.posture import start_posture

# file, tip, base: robots people own, 6 to 8 joints, prismatic and continuous ones among them.
ROBOTS = {
    "Panda": ("panda_description/urdf/panda.urdf", "panda_hand_tcp", None),
    "UR5": ("ur_description/urdf/ur5_robot.urdf", "tool0", None),
    "UR10": ("ur_description/urdf/ur10_robot.urdf", "tool0", None),
    "iCub arm": ("icub_description/robots/icub.urdf", "l_hand", "chest"),
    "Talos arm": ("talos_data/robots/talos_reduced.urdf", "gripper_left_base_link", "torso_2_link"),
    "PR2 arm": ("pr2_description/urdf/pr2.urdf", "r_gripper_tool_frame", None),
    "Kinova": ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector", None),
    "xArm7": ("xarm_description/urdf/xarm7.urdf", None, None),
}
N, TS, ALPHA, LAMBDA = 500, 0.01, 5.0, 0.05


def folder() -> pathlib.Path:
    files = importlib.metadata.files("example-robot-data")
    return pathlib.Path(next(f for f in files if f.name == "panda.urdf").locate()).resolve().parents[2]


def target(k, start, direction):
    """Position and its velocity at step k: a slow sine along a direction, from the start."""
    t = k * TS
    return start + direction * np.sin(2.0 * t), 2.0 * direction * np.cos(2.0 * t)


def loop(path, arm, tip, base, q0, direction):
    """q[k+1] = q[k] + Ts Jᵀ(JJᵀ + λ²I)⁻¹(ẋ_d + α e), pose task, in NumPy on Pinocchio's kinematics."""
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    joints = [model.joints[model.getJointId(name)] for name in arm.joint_names]
    columns = [j.idx_v for j in joints]
    frame = model.getFrameId(tip, pin.FrameType.BODY)
    root = model.getFrameId(base, pin.FrameType.BODY) if base else None

    def at(q):
        full = pin.neutral(model)
        for joint, value in zip(joints, q, strict=True):
            full[joint.idx_q : joint.idx_q + joint.nq] = [np.cos(value), np.sin(value)] if joint.nq == 2 else value
        pin.computeJointJacobians(model, data, full)
        pin.updateFramePlacements(model, data)
        j = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[:, columns]
        m = data.oMf[frame]
        if root is None:
            return m.translation.copy(), m.rotation.copy(), j
        turn = data.oMf[root].rotation.T
        m = data.oMf[root].actInv(m)
        return m.translation, m.rotation, np.vstack([turn @ j[:3], turn @ j[3:]])

    start, rotation_d, _ = at(q0)
    # The desired orientation: 0.4 rad off, about a skew axis.
    rotation_d = pin.exp3(0.4 * np.array([2.0, -1.0, 2.0]) / 3.0) @ rotation_d
    q, path_of_q = q0.copy(), [q0.copy()]
    for k in range(N):
        position, rotation, j = at(q)
        x_d, v_d = target(k, start, direction)
        e = np.concatenate([x_d - position, pin.log3(rotation_d @ rotation.T)])
        task = np.concatenate([v_d, np.zeros(3)]) + ALPHA * e
        q = q + TS * j.T @ np.linalg.solve(j @ j.T + LAMBDA**2 * np.eye(6), task)
        path_of_q.append(q.copy())
    return np.array(path_of_q), start, rotation_d


QUICK = ("Panda",)  # compiling a chain takes seconds


@pytest.mark.parametrize("name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in ROBOTS])
def test_a_loop_of_500_steps_is_pinocchios(name):
    import jax.numpy as jnp

    file, tip, base = ROBOTS[name]
    arm = ck.load_urdf(folder() / file, tip, base)
    tip = tip or "link_eef"
    q0 = start_posture(arm, ck.pose())
    direction = np.array([0.05, -0.08, 0.06])
    expected, start, rotation_d = loop(folder() / file, arm, tip, base, q0, direction)

    def pose(t):
        return ck.Pose(position=jnp.asarray(start) + direction * jnp.sin(2.0 * t), rotation=jnp.asarray(rotation_d))

    law = ck.Law(arm, ck.pose(), alpha=ALPHA, inverse=ck.damped(LAMBDA))
    found = ck.solve(law, ck.path(pose), q0, TS, N, "EE")
    assert np.ptp(expected, axis=0).max() > 0.2  # it moves
    # λ off by 1e-8, or a target one rounding early, shows at 1e-9.
    np.testing.assert_allclose(found.q, expected, rtol=0, atol=1e-9)
