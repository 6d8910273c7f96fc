"""Bases that move: kinematics against Pinocchio's and MuJoCo's free and planar joints, exchange, and the chart."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import cnclik as ck
from cnclik.robot.model import frames, jacobian_at, modelled
from cnclik.robot.tree import read_urdf
from cnclik.robot.urdf import chain
from tests.refusals import refusals
from tests.robot.test_mjcf import HUMANOID
from tests.robot.test_trees import ROBOTS
from tests.robot.test_urdf import ROOT, long_chain

JOINTS = {"free": pin.JointModelFreeFlyer, "planar": pin.JointModelPlanar}
DOG = f'<robot name="dog"><link name="world"/>{{}}{long_chain(3).partition(">")[2]}'
JOINT = '<joint name="{}" type="{}"><parent link="world"/><child link="l0"/>{}</joint>'


LED = """<robot name="led"><link name="rail"/><link name="cart"/><link name="a"/><link name="b"/><link name="c"/>
<joint name="lift" type="prismatic"><parent link="rail"/><child link="cart"/><axis xyz="0 0.6 0.8"/>
  <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
<joint name="out" type="prismatic"><parent link="cart"/><child link="a"/><origin xyz="0.1 0 0.2" rpy="0.1 0.2 0.3"/>
  <axis xyz="1 0 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/>
  <mimic joint="lift" multiplier="-0.5" offset="0.05"/></joint>
<joint name="turn" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint>
<joint name="back" type="continuous"><parent link="b"/><child link="c"/><origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>
  <mimic joint="turn" multiplier="-2" offset="0.4"/></joint></robot>"""
ROBOTS_ON_BASES = [(name, base, False) for name in ("g1", "tiago", "anymal") for base in JOINTS]


def postures(robot, count, seed=0):
    rng = np.random.default_rng(seed)
    low, high = (np.clip(bound, -2.0, 2.0) for bound in (robot.lower, robot.upper))
    q = rng.uniform(low, high, (count, robot.n))
    for _, i in robot.balls:  # by less than half a turn
        q[:, i : i + 3] *= np.array([0.0, 1e-9, *[0.9] * count])[:count, None]
    return q


@pytest.mark.parametrize(
    ("name", "base", "followers"), [*ROBOTS_ON_BASES, ("led", "planar", False), ("led", "planar", True)]
)
def test_robots_on_bases_are_pinocchios(name, base, followers):
    """Breaks for a base whose axes are others than told, and for values or velocities that are exchanged wrongly.

    Without `followers` Pinocchio has mimic joints as joints of their own, which were left at 0.
    """
    text = LED if name == "led" else (ROOT / ROBOTS[name]).read_text()
    tree, model = read_urdf(text), pin.buildModelFromXML(text, JOINTS[base](), followers)
    robot = chain(tree, tips=[tree.root, *tree.tips()[:2]], base=base)
    q, data, seen = postures(robot, 4), model.createData(), modelled(robot)
    assert robot.n == chain(tree, tips=tree.tips()[:2]).n + {"free": 6, "planar": 3}[base]
    qdot = np.random.default_rng(1).normal(size=q.shape)
    theirs, v = ck.to_model_q(robot, model, q, qdot)
    for row, rates, own, own_rates in zip(theirs, v, q, qdot, strict=True):
        pin.forwardKinematics(model, data, row, rates)
        pin.updateFramePlacements(model, data)
        for i, tip in enumerate(robot.tips):
            frame = model.getFrameId(tip.name, pin.FrameType.BODY)
            at, spin = frames(seen, own, i), pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            np.testing.assert_allclose(at.position, data.oMf[frame].translation, atol=1e-12)
            np.testing.assert_allclose(at.rotation, data.oMf[frame].rotation, atol=1e-12)
            moved = jacobian_at(seen, at) @ own_rates
            np.testing.assert_allclose(moved, spin.vector, atol=1e-11)
    again, rates = ck.from_model_q(robot, model, theirs, v)
    np.testing.assert_allclose(again, q, atol=1e-14)
    np.testing.assert_allclose(rates, qdot, atol=1e-14)


def test_free_and_ball_joints_of_a_model_are_mujocos():
    """Poses, velocities, the centre of mass; breaks for a base whose place is told from the body's, as in a URDF."""
    model = mujoco.MjModel.from_xml_string(HUMANOID)
    robot, data = ck.load_mjcf(HUMANOID, tips=["sole", "head"]), mujoco.MjData(model)
    assert robot.joint_names[:6] == tuple(f"root_{name}" for name in ("x", "y", "z", "rx", "ry", "rz"))
    assert robot.joint_names[-3:] == ("neck_rx", "neck_ry", "neck_rz")
    rng = np.random.default_rng(0)
    q, qdot = rng.uniform(-1, 1, (2, robot.n))
    data.qpos, data.qvel = ck.to_model_q(robot, model, q, qdot)
    mujoco.mj_forward(model, data)
    for tip, seen in (("sole", data.site("sole")), ("head", data.body("head"))):
        np.testing.assert_allclose(ck.forward(robot, q, tip=tip).position, seen.xpos, atol=1e-12)
        np.testing.assert_allclose(np.ravel(ck.forward(robot, q, tip=tip).rotation), seen.xmat, atol=1e-12)
        found = np.zeros((6, model.nv))
        get = mujoco.mj_jacSite if tip == "sole" else mujoco.mj_jacBody
        get(model, data, found[:3], found[3:], seen.id)
        np.testing.assert_allclose(ck.jacobian(robot, q, tip=tip) @ qdot, found @ data.qvel, atol=1e-12)
    np.testing.assert_allclose(ck.com(robot, q), data.subtree_com[0], atol=1e-12)
    again, rates = ck.from_model_q(robot, model, data.qpos, data.qvel)
    np.testing.assert_allclose(again, q, atol=1e-14)
    np.testing.assert_allclose(rates, qdot)
    assert ck.load_mjcf(HUMANOID, tip="sole", base="pelvis").joint_names == ("hip", "knee")


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_files_own_free_joint_is_a_base(kind):
    text = DOG.format(JOINT.format("base", kind, '<axis xyz="0 0 1"/>'))
    own, told = ck.load_urdf(text), ck.load_urdf(long_chain(3), base={"floating": "free"}.get(kind, kind))
    assert own.joint_names == told.joint_names and own.units == told.units
    q = np.linspace(0.1, 0.8, own.n)
    np.testing.assert_array_equal(ck.jacobian(own, q), ck.jacobian(told, q))
    assert ck.load_urdf(text, base="l0").n == ck.load_urdf(long_chain(3)).n
    with pytest.raises(ck.ArgumentError, match=r"`freeze` must be .*but is .base. .did you mean .base_"):
        ck.load_urdf(text, freeze={"base": 0.0})


test_what_a_base_cannot_be = refusals(
    (
        lambda: ck.load_urdf(DOG.format(JOINT.format("legs", "floating", "")), tip="world", base="l0"),
        "`base` must be a link before a floating joint, but is beyond 'legs'",
    ),
    (
        lambda: ck.load_urdf(DOG.format(JOINT.format("base", "planar", '<axis xyz="0 0 -1"/>'))),
        "joint 'base' of the text is planar and has an axis that is not 0 0 1",
    ),
)
