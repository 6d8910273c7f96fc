"""Elbows and knees that bend past straight, and frozen joints of a base."""

import math

import numpy as np
import pytest

import cnclik as ck
from cnclik.robot.posture import past_straight
from tests.oracles import robot_file


def test_elbows_that_bend_past_straight_are_found():
    """A Panda's elbow by 23°, a G1's knees by 5°, where the limb is longest by its own kinematics."""
    panda = ck.load_urdf(robot_file("panda"), tip="panda_hand")
    ((name, straight, beyond),) = past_straight(panda)
    assert name == "panda_joint4" and math.degrees(beyond) == pytest.approx(22.8, abs=0.1)
    reach = []
    for q4 in (straight - 0.02, straight, straight + 0.02):
        q = np.array([0, 0, 0, q4, 0, 0, 0])
        wrist = ck.load_urdf(robot_file("panda"), tip="panda_link5")
        reach.append(np.linalg.norm(np.asarray(ck.forward(wrist, q[:5]).position) - [0, 0, 0.333]))
    assert reach[1] > max(reach[0], reach[2])
    legs = ck.load_urdf(robot_file("g1"), tips=["left_ankle_roll_link", "right_ankle_roll_link"])
    assert [(n, round(math.degrees(b))) for n, _, b in past_straight(legs)] == [
        ("left_knee_joint", 5), ("right_knee_joint", 5),
    ]  # fmt: skip
    assert past_straight(ck.ur5()) == [] and past_straight(ck.planar_arm([1.0, 1.0])) == []


@pytest.mark.parametrize(("base", "freeze"), [("planar", {"base_x": 1.0, "base_yaw": 0.3}), ("free", {"base_z": 0.5})])
def test_joints_of_a_base_may_be_frozen(base, freeze):
    whole = ck.load_urdf(robot_file("panda"), tip="panda_hand", base=base)
    frozen = ck.load_urdf(robot_file("panda"), tip="panda_hand", base=base, freeze=freeze)
    rng = np.random.default_rng(0)
    q = rng.uniform(-0.5, 0.5, frozen.n)
    values = dict(zip(frozen.joint_names, q, strict=True)) | freeze
    there = ck.forward(whole, np.array([values[name] for name in whole.joint_names]))
    here = ck.forward(frozen, q)
    np.testing.assert_allclose(here.position, there.position, atol=1e-6)
    np.testing.assert_allclose(here.rotation, there.rotation, atol=1e-6)
    with pytest.raises(ck.ArgumentError, match="with_base"):
        ck.load_urdf(robot_file("panda"), tip="panda_hand", base="free", freeze={"base_rx": 0.1})
