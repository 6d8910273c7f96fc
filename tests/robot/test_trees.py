"""Robots with several tips: load_urdf and join against Pinocchio, all tips at once; what can't be is refused."""

import jax
import numpy as np
import pytest

import cnclik as ck
from tests.refusals import refusals
from tests.robot.test_urdf import ROOT

ROBOTS = {
    "g1": "g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf",
    "talos": "talos_data/robots/talos_full_v2.urdf",
    "icub": "icub_description/robots/icub.urdf",
    "baxter": "baxter_description/urdf/baxter.urdf",
    "pr2": "pr2_description/urdf/pr2.urdf",
    "tiago": "tiago_description/robots/tiago_dual.urdf",
    "allegro": "allegro_hand_description/urdf/allegro_right_hand.urdf",
    "anymal": "anymal_b_simple_description/robots/anymal-kinova.urdf",
}
G1 = ROOT / "g1_description/urdf/g1_29dof_rev_1_0.urdf"
ARMS = ["left_rubber_hand", "right_rubber_hand"]
BAXTER = ROOT / ROBOTS["baxter"]
GRIPPERS = ["left_gripper", "right_gripper"]


def postures(robot, count, seed=0):
    low, high = (np.clip(bound, -np.pi, np.pi) for bound in (robot.lower, robot.upper))
    return np.random.default_rng(seed).uniform(low, high, (count, robot.n))


def test_two_arms_are_joined():
    """Against the same robot as one tree: a torso that carries two arms. Also under jit and vmap."""
    torso = ck.load_urdf(G1, tips={"left": "torso_link", "right": "torso_link", "head": ("torso_link", [0, 0, 0.4])})
    (q,), alone = postures(torso, 1), ck.panda()
    where = np.eye(4)
    where[:3, 3] = 0.0, -0.3, 0.2
    robot = ck.join(torso, alone, at="left", transform=[0.0, 0.3, 0.2], prefix="left_")
    robot = ck.join(robot, alone, at="right", transform=where, prefix="right_")
    assert [t.name for t in robot.tips] == ["head", "left_tip", "right_tip"] and robot.n == 3 + 7 + 7
    assert robot.joint_names[3] == "left_panda_joint1" and robot.lower[10:] == alone.lower
    arms = postures(alone, 2, seed=1)
    q = np.concatenate([q, *arms])
    carrier = ck.forward(torso, q[:3], tip="head")

    @jax.vmap
    def slopes(v):
        tips = [t.name for t in robot.tips]
        by_jax = jax.jacfwd(lambda v: {tip: ck.forward(robot, v, tip=tip).position for tip in tips})(v)
        return by_jax, {tip: ck.jacobian(robot, v, tip=tip) for tip in tips}

    by_jax, traced = jax.jit(slopes)(q[None])
    for side, own, offset in (("left", arms[0], [0, 0.3, -0.2]), ("right", arms[1], [0, -0.3, -0.2])):
        at, tip = ck.forward(robot, q, tip=f"{side}_tip"), ck.forward(alone, own)
        np.testing.assert_allclose(at.rotation, carrier.rotation @ tip.rotation, atol=1e-14)
        away = carrier.rotation @ (np.array(offset) + tip.position)
        np.testing.assert_allclose(at.position, carrier.position + away, atol=1e-14)
        j = np.asarray(ck.jacobian(robot, q, tip=f"{side}_tip"))
        np.testing.assert_allclose(j[:3], by_jax[f"{side}_tip"][0], atol=1e-13)
        np.testing.assert_allclose(traced[f"{side}_tip"][0], j, atol=1e-14)


def test_tools_and_bases_of_trees():
    """A tip's place on its link, whose axes are not those of the joint that carries it, is that of a tool there."""
    robot = ck.load_urdf(BAXTER, tips=GRIPPERS)
    (q,) = postures(robot, 1)
    longer = ck.with_base(ck.with_tool(robot, [0, 0, 0.1], tip=GRIPPERS[1]), [1.0, 2.0, 3.0])
    before, after = ([ck.forward(r, q, tip=tip) for tip in GRIPPERS] for r in (robot, longer))
    np.testing.assert_allclose(after[0].position, np.add(before[0].position, [1, 2, 3]))
    end = before[1].position + before[1].rotation @ np.array([0, 0, 0.1]) + np.array([1, 2, 3])
    np.testing.assert_allclose(after[1].position, end, atol=1e-14)
    camera, place = "left_hand_camera_link", [0.1, -0.2, 0.3]
    held, placed = ck.load_urdf(BAXTER, tip=camera), ck.load_urdf(BAXTER, tips={"end": (camera, place)})
    wanted = ck.forward(ck.with_tool(held, place), q[:7])
    np.testing.assert_allclose(ck.forward(placed, q[:7]).position, wanted.position, atol=1e-14)
    assert "tips=['left_gripper'" in repr(robot)


def arms(tips=tuple(ARMS), **options):
    return ck.load_urdf(G1, tips=list(tips) if isinstance(tips, tuple) else tips, **options)


test_what_cannot_be_meant_is_refused = refusals(
    (lambda: arms(()), r"`tips` must hold different links, or be {name: link} .*but is \[\]"),
    (lambda: arms(("left_hand",)), "`tips` must be one of .* is 'left_hand'"),
    (lambda: ck.load_urdf(G1, tip="left_rubber_hnd"), "`tip` .*did you mean 'left_rubber_hand'"),
    (lambda: arms(("pelvis",)), "`tips` must be moved by a joint, but is 'pelvis', fixed to"),
    (lambda: arms(tip=ARMS[0]), "`tip` must be left out where `tips` are given"),
    (lambda: arms({"a": (ARMS[0], [1, 2])}), r"`tips\['a'\]` must have shape"),
    (lambda: arms(freeze={"waist_yaw": 0}), "`freeze` must be one of .*'waist_yaw' .did you mean"),
    (lambda: arms(base="free", freeze={"base_rx": 0.1}), "`freeze` must be one of .*is 'base_rx'"),
    (lambda: arms(freeze={"waist_yaw_joint": 9}), r"`freeze\['waist_yaw_joint'\]` must be within"),
    (lambda: arms(freeze=["waist_yaw_joint"]), "`freeze` must be {name of a joint"),
    (lambda: ck.forward(arms(), np.zeros(17)), "`tip` must be given .* the tips are left_rubber"),
    (lambda: ck.join(ck.panda(), ck.panda()), "`prefix` must tell the names of both robots apart"),
)


FROZEN = {
    "fixed": {"waist_yaw_joint": 0.3, "left_elbow_joint": 0.8},
    "planar": {"base_x": 1.0, "base_yaw": 0.3},
    "free": {"base_z": 0.5},
}


@pytest.mark.parametrize("base", FROZEN)
def test_frozen_joints_are_where_they_are_frozen(base):
    whole, robot = (arms(base=base, freeze=freeze) for freeze in (None, FROZEN[base]))
    assert set(whole.joint_names) - set(robot.joint_names) == set(FROZEN[base])
    (q,) = postures(whole, 1)
    for name, value in FROZEN[base].items():
        q[whole.joint_names.index(name)] = value
    rest = [whole.joint_names.index(name) for name in robot.joint_names]
    for tip in ARMS:
        at, same = (ck.forward(r, v, tip=tip) for r, v in ((whole, q), (robot, q[rest])))
        np.testing.assert_allclose(at.position, same.position, atol=1e-14)
        np.testing.assert_allclose(at.rotation, same.rotation, atol=1e-14)
        j = np.asarray(ck.jacobian(whole, q, tip=tip))[:, rest]
        np.testing.assert_allclose(ck.jacobian(robot, q[rest], tip=tip), j, atol=1e-14)
