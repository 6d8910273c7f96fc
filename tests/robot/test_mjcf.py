"""Models in MJCF against MuJoCo's own kinematics: poses and Jacobians of all bodies and sites; what is refused."""

import re
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

import cnclik as ck
from cnclik.cli import main
from cnclik.errors import Remark
from cnclik.robot.files import read_robot
from cnclik.robot.mjcf import read_mjcf
from cnclik.robot.urdf import chain
from tests.oracles import close, robot_file
from tests.refusals import refusals
from tests.robot.test_trees import ROBOTS, ROOT, postures

mujoco = pytest.importorskip("mujoco")

MIXED = """<mujoco model="mixed"><worldbody>
<body name="table" pos="1 0 0"><geom size=".3 .3 .1" type="box"/></body>
<body name="box" pos="1 0 .5"><freejoint/><geom size=".1"/></body>
<body name="base" pos=".1 .2 .3" euler="10 20 30"><geom size=".1"/>
  <body name="arm" pos="0 .1 .2" quat="1 .1 .2 .3">
    <joint name="turn" axis="1 2 3" pos=".1 0 .05" range="-90 90"/>
    <joint name="lift" type="slide" axis="0 1 1" pos="0 .2 0" ref=".05" range="-.2 .3"/>
    <joint name="roll" axis="0 0 1" ref="25" pos=".3 .1 0"/>
    <geom size=".1" pos=".1 0 0"/>
    <site name="camera" pos=".1 .2 .3" euler="0 90 0"/>
    <body name="hand" pos=".3 0 0">
      <joint name="left" type="slide" axis="0 1 0" range="0 .04"/><geom size=".02"/>
      <site name="hand" pos="0 0 .1"/>
    </body>
    <body name="finger" pos=".3 .1 0">
      <joint name="right" type="slide" axis="0 -1 0" ref=".01"/><geom size=".02"/>
    </body>
    <body name="hatch" pos=".5 0 0"><joint name="stuck" axis="0 1 0" ref="5"/><geom size=".02"/></body>
  </body>
</body></worldbody>
<equality><joint joint1="right" joint2="left" polycoef=".002 .8 0 0 0"/><joint joint1="stuck" polycoef=".3 0 0 0 0"/>
</equality></mujoco>"""
HUMANOID = """<mujoco><worldbody><body name="pelvis" pos="0 0 1"><freejoint name="root"/><geom size=".1"/>
<body name="thigh" pos="0 .1 0"><joint name="hip" axis="0 1 0"/><geom size=".05" pos="0 0 -.2"/>
<body name="foot" pos="0 0 -.4"><joint name="knee" axis="0 1 0"/><geom size=".05"/><site name="sole" pos="0 0 -.05"/>
</body></body><body name="head" pos="0 0 .5"><joint name="neck" type="ball"/><geom size=".1"/></body>
</body></worldbody></mujoco>"""
PANDA = robot_file("panda")


def through_mujoco(file):
    """A URDF file as MuJoCo has it, its links kept apart and without its meshes."""
    root = ElementTree.parse(file).getroot()
    for link in root.iter("link"):
        for kind in ("visual", "collision"):
            for one in link.findall(kind):
                link.remove(one)
    settings = {"fusestatic": "false", "balanceinertia": "true", "boundmass": "1e-6", "boundinertia": "1e-9"}
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", settings)
    return mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))


def compare(model, count, root):
    """Largest deviation of poses and Jacobians of all that joints move, and of the centre of mass; what is compared."""
    tree = read_mjcf(model)
    joints = {link: {e.type for e in tree.way(link)[1]} - {"fixed"} for link in tree.links if " of " not in link}
    links = [link for link, types in joints.items() if types and "floating" not in types]
    robot = chain(tree, tips=links)
    data, worst = mujoco.MjData(model), 0.0
    for q in postures(robot, count):
        way = np.transpose([ck.to_model_q(robot, model, q, v)[1] for v in np.eye(robot.n)])
        data.qpos[:] = ck.to_model_q(robot, model, q)
        for name, value in still(model).items():
            data.qpos[model.jnt_qposadr[model.joint(name).id]] = value
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        worst = max(worst, np.abs(ck.com(robot, q) - data.subtree_com[root]).max())
        for link in links:
            site = link.removesuffix(" (site)") if link.endswith("(site)") else link
            of_site = link != site or mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, link) < 0
            seen = data.site(site) if of_site else data.body(link)
            j = np.zeros((6, model.nv))
            (mujoco.mj_jacSite if of_site else mujoco.mj_jacBody)(model, data, j[:3], j[3:], seen.id)
            found = ck.forward(robot, q, tip=link)
            pairs = (
                (found.position, seen.xpos),
                (found.rotation, seen.xmat.reshape(3, 3)),
                (ck.jacobian(robot, q, tip=link), j @ way),
            )
            worst = max(worst, *(np.abs(np.asarray(a) - b).max() for a, b in pairs))
    return worst, links


def still(model):
    """Joints that an equality constraint stays at a value."""
    each = [k for k in range(model.neq) if model.eq_type[k] == 2 and model.eq_obj2id[k] < 0]
    at = [(model.joint(model.eq_obj1id[k]), model.eq_data[k][0]) for k in each]
    return {joint.name: model.qpos0[joint.qposadr[0]] + shift for joint, shift in at}


def humanoid(text=HUMANOID):
    return ck.load_mjcf(HUMANOID, tip="sole"), mujoco.MjModel.from_xml_string(text)


def test_a_joint_that_follows_is_where_the_model_holds_it():
    """MuJoCo has it as a joint of its own, and does not move it where only kinematics are computed.

    One that is held at a constant is no joint of the robot, and neutral.
    """
    model, robot = mujoco.MjModel.from_xml_string(MIXED), ck.load_mjcf(MIXED, tip="hand", base="base")
    assert robot.joint_names == ("turn", "lift", "roll", "left")
    q, v = ck.to_model_q(robot, model, [[0.1, 0.2, 0.3, 0.03]], [0.0, 0.0, 0.0, 2.0])
    of = {name: model.joint(name) for name in ("right", "stuck")}
    at, speed = ({name: x[0, getattr(joint, adr)[0]] for name, joint in of.items()} for x, adr in
                 ((q, "qposadr"), (v, "dofadr")))  # fmt: skip
    np.testing.assert_allclose([at["right"], at["stuck"]], [0.01 + 0.002 + 0.8 * 0.03, 0.0])
    assert speed == {"right": 1.6, "stuck": 0.0}


@pytest.mark.parametrize("name", ["mixed", "g1"])
def test_all_bodies_and_sites_are_mujocos(name):
    """Breaks for joints of one body in another order, about another place, or counted from another zero.

    Masses are those of what has joints: neither of a table nor of a box that lies about.
    """
    mixed = name == "mixed"
    model = mujoco.MjModel.from_xml_string(MIXED) if mixed else through_mujoco(ROOT / ROBOTS["g1"]).compile()
    worst, links = compare(model, 3 if mixed else 1, model.body("base").id if mixed else 0)
    assert worst < 1e-12 and len(links) > 1


def test_what_a_model_says_of_its_joints(tmp_path):
    file = tmp_path / "mixed.xml"
    file.write_text(MIXED, encoding="utf-8")
    tips = ["hand (site)", "finger", "camera", "hatch"]
    spec = mujoco.MjSpec.from_string(MIXED)
    robot, *every = [ck.load_mjcf(m, tips=tips) for m in (str(file), file, MIXED, spec, spec.compile())]
    assert all(str(one) == str(robot) for one in every)
    assert robot.joint_names == ("turn", "lift", "roll", "left")
    close(robot.lower, [-np.pi / 2, -0.2, -np.inf, 0])
    close(robot.upper, [np.pi / 2, 0.3, np.inf, 0.04])
    assert robot.velocity_limit == (np.inf,) * 4 and robot.units == ("rad", "m", "rad", "m")
    assert ck.load_mjcf(MIXED, tip="camera", freeze={"lift": 0.1}).joint_names == ("turn", "roll")


CLOSED = """<mujoco><worldbody><body name="a"><joint name="p" axis="0 1 0"/><geom size=".1"/>
<body name="b" pos="1 0 0"><joint name="r" axis="0 1 0"/><geom size=".1"/></body></body></worldbody>
<equality>{}</equality></mujoco>"""


@pytest.mark.parametrize(
    ("constraint", "says"),
    [
        ('<connect body1="b" body2="world" anchor="1 0 0"/>', "the text has constraints beside"),
        ('<joint joint1="r" joint2="p" polycoef="0 1 2 0 0"/>', "beside linear couplings"),
    ],
)
def test_couplings_that_are_none_of_a_tree_are_remarked_on(constraint, says):
    with pytest.warns(Remark, match=says):
        assert ck.load_mjcf(CLOSED.format(constraint)).n == 2
    assert ck.load_mjcf(CLOSED.format('<joint joint1="r" joint2="p" polycoef="0 1 2 0 0" active="false"/>')).n == 2


test_what_cannot_be_meant_is_refused = refusals(
    (lambda: ck.load_mjcf(HUMANOID, tip="soles", base="pelvis"), "`tip` must be one of .* 'soles' .did you mean"),
    (lambda: ck.load_mjcf(HUMANOID, tip="sole", base="free"), "`base` must be left out .* joint 'root' already"),
    (lambda: ck.load_mjcf("<mujoco><world/></mujoco>"), "`model` must be one that MuJoCo reads, but it finds: "),
    (lambda: read_robot("<mujoco><world/></mujoco>"), "`robot` must be one that MuJoCo reads, but it finds: "),
    (lambda: read_robot({}), "`robot` must name a URDF file, but is dict"),
    (lambda: ck.load_mjcf("nowhere.xml"), "`model` must name an MJCF file"),
    (lambda: ck.load_mjcf(3), "`model` must name an MJCF file, but is int"),
    (lambda: ck.load_mjcf(HUMANOID, tip="sole", base="floating"), "`base` must be fixed, planar, free or one of "),
    (lambda: ck.from_model_q(*humanoid(), np.zeros(13)), "`q` must hold a quaternion for each free"),
    (lambda: ck.to_model_q(*humanoid(MIXED), np.zeros(8)), "`model` must have .* but has no root_x, .* knee"),
    (lambda: ck.to_model_q(*humanoid(), np.zeros(8), np.zeros(4)), "`qdot` must have 8 numbers, but has 4"),
    (lambda: ck.to_model_q(ck.planar_arm([1.0]), {}, [0.0]), "`model` must be a pinocchio.Model or .*, but is dict"),
    (lambda: ck.from_model_q(ck.planar_arm([1.0]), None, [0.0]), "`model` must be a pinoc.* but is NoneType"),
    (lambda: ck.load("panda_mjcf"), "`robot` must be a URDF or MJCF file, panda, ur5, planar:1,1,1 or a name of"),
    (lambda: ck.load("panda", tip="hand"), "`tip` must be left out for the robot 'panda', but is 'hand'"),
)


def test_one_reader_takes_files_and_names(tmp_path, monkeypatch, capsys):
    """Also on the command line: a name of robot_descriptions, which here is a package of three."""
    package, other = tmp_path / "robot_descriptions", tmp_path / "model.urdf"
    package.mkdir()
    (package / "__init__.py").write_text("")
    file = tmp_path / "anything"
    file.write_text("<?xml version='1.0'?>\n<!-- a <robot> -->\n" + HUMANOID, encoding="utf-8")
    other.write_bytes(file.read_bytes())
    (package / "one_mj_description.py").write_text(f"MJCF_PATH = {str(file)!r}")
    (package / "panda_description.py").write_text(f"URDF_PATH = {str(PANDA)!r}")
    (package / "far_description.py").write_text("raise OSError('no network')")
    monkeypatch.syspath_prepend(tmp_path)
    for name in (file, str(other), "one_mj_description"):
        robot = ck.load(name, base="pelvis", tips={"foot": ("sole", [0, 0, 0.1])}, freeze={"hip": 0.1})
        assert robot.joint_names == ("knee",)
    assert ck.load("panda_description", tip="panda_hand").n == ck.load("panda").n == 7
    assert ck.load("planar:1,2") is ck.load("planar:1,2") and ck.load("planar:1,2").n == 2
    assert ck.load(PANDA, tip="panda_link3").n == 3
    with pytest.raises(ck.ArgumentError, match="'far_description' ends with OSError: no network"):
        ck.load("far_description")
    for name, said in (("one_mj_description", "Tips .*: sole, head"), (str(file), "floating")):
        main(["robots", name])
        assert re.search(said, capsys.readouterr().out)


def test_without_mujoco_it_is_said(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ck.ArgumentError, match=r"needs the package mujoco.*pip install 'cnclik\[mjcf\]'"):
        ck.load(HUMANOID)
