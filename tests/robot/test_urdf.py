"""load_urdf against Pinocchio on every file of the example-robot-data wheel, and its one-line errors."""

import xml.etree.ElementTree as ElementTree

import jax
import numpy as np
import pinocchio as pin
import pytest

import cnclik as ck
from cnclik.robot.builtin import panda, ur5
from cnclik.robot.model import frames, jacobian_at, modelled
from cnclik.robot.tree import read_urdf
from cnclik.robot.urdf import chain
from tests.oracles import robots
from tests.refusals import refusals

ROOT = robots()
FILES = sorted(str(p.relative_to(ROOT)) for p in ROOT.rglob("*.urdf"))


def oracle(path):
    """Pinocchio's model, or the reason that it has none."""
    try:
        return pin.buildModelFromUrdf(str(path)), None
    except ValueError as error:
        return None, str(error)


def mimics(path):
    """Mimic joint -> (joint, multiplier, offset), read here and not by the code under test."""
    found = {}
    for joint in ElementTree.parse(path).getroot().findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None and joint.get("type") != "fixed":
            numbers = (float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0)))
            found[joint.get("name")] = (mimic.get("joint"), *numbers)
    return found


class Pinocchio:
    """Pose and Jacobian of a link against another, as functions of the coordinates named."""

    def __init__(self, path, model):
        self.model, self.data, self.mimics = model, model.createData(), mimics(path)

    def values(self, names, q):
        """Joint name -> (value, coordinate, multiplier), mimics followed."""
        known = {name: (q[i], i, 1.0) for i, name in enumerate(names)}
        for name in self.mimics:
            leader, multiplier, offset = name, 1.0, 0.0
            while leader in self.mimics:
                leader, factor, shift = self.mimics[leader]
                multiplier, offset = multiplier * factor, multiplier * shift + offset
            if leader in names:
                i = names.index(leader)
                known[name] = (multiplier * q[i] + offset, i, multiplier)
        return known

    def posed(self, names, q):
        """Pinocchio's own coordinates, and how its velocities depend on those of the coordinates named."""
        model = self.model
        full, columns = pin.neutral(model), np.zeros((model.nv, len(names)))
        for name, (value, i, multiplier) in self.values(names, q).items():
            joint = model.joints[model.getJointId(name)]
            circle = [np.cos(value), np.sin(value)]
            full[joint.idx_q : joint.idx_q + joint.nq] = circle if joint.nq == 2 else value
            columns[joint.idx_v, i] += multiplier
        return full, columns

    def at(self, names, q, tip, base):
        model, data = self.model, self.data
        full, columns = self.posed(names, q)
        pin.computeJointJacobians(model, data, full)
        pin.updateFramePlacements(model, data)
        frame, root = (model.getFrameId(link, pin.FrameType.BODY) for link in (tip, base))
        m = data.oMf[root].actInv(data.oMf[frame])
        j, own = (pin.getFrameJacobian(model, data, f, pin.LOCAL_WORLD_ALIGNED) @ columns for f in (frame, root))
        away = data.oMf[frame].translation - data.oMf[root].translation
        velocity = j[:3] - own[:3] - np.cross(own[3:], away, axis=0)  # as seen from a base that moves
        turn = data.oMf[root].rotation.T
        return m.translation, m.rotation, np.vstack([turn @ velocity, turn @ (j[3:] - own[3:])])


def numbers(arm, q, tip=0):
    at = frames(arm, q, tip)
    return at.position, at.rotation, jacobian_at(arm, at)


def compare(arm, base, path, model, count=4):
    """Largest deviation of pose and Jacobian of each tip from Pinocchio over random configurations within limits."""
    rng = np.random.default_rng(len(arm.tips[0].name))
    low, high = (np.clip(bound, -np.pi, np.pi) for bound in (arm.lower, arm.upper))
    q, worst, seen = rng.uniform(low, high, (count, arm.n)), 0.0, modelled(arm)
    other = Pinocchio(path, model)
    for i, tip in enumerate(arm.tips):
        expected = [other.at(arm.joint_names, row, tip.name, base) for row in q]
        for found, wanted in zip(numbers(seen, q, i), zip(*expected, strict=True), strict=True):
            worst = max(worst, np.abs(found - np.stack(wanted)).max())
    return worst


@pytest.mark.parametrize("file", FILES)
def test_leaves_of_every_robot_match_pinocchio(file):
    """All that joints move; breaks for a joint carried by another than the file says, an rpy order, a mimic."""
    path = ROOT / file
    model, reason = oracle(path)
    if model is None:
        with pytest.raises(ck.ArgumentError) as told:
            read_urdf(path)
        pytest.skip(f"{file}: neither Pinocchio ({reason}) nor cnclik ({told.value}) reads it")
    tree = read_urdf(path)
    for leaf in {link for link in tree.links if not tree.below[link]} - set(tree.tips()):
        with pytest.raises(ck.ArgumentError, match="moved by a joint"):
            chain(tree, leaf)
    if file.endswith("alex_psyonic_hands.urdf"):  # the one whose mimic joints name joints that it does not have
        with pytest.raises(ck.ArgumentError, match="which is not in the file"):
            chain(tree, tips=tree.tips())
        return
    assert not tree.tips() or compare(chain(tree, tips=tree.tips()), tree.root, path, model) < 1e-12


@pytest.mark.parametrize(
    ("file", "base", "tip"),
    [  # foot to hand, hand to hand, a way up alone, a gripper whose fingers mimic and a mobile base's wheel
        ("talos_data/robots/talos_reduced.urdf", "left_sole_link", "gripper_right_base_link"),
        ("talos_data/robots/talos_reduced.urdf", "gripper_left_base_link", "gripper_right_base_link"),
        ("panda_description/urdf/panda.urdf", "panda_hand", "panda_link0"),
        ("pr2_description/urdf/pr2.urdf", "l_gripper_l_finger_tip_link", "r_gripper_r_finger_tip_link"),
    ],
)
def test_a_way_through_the_root(file, base, tip):
    model, _ = oracle(ROOT / file)
    arm, back = (ck.load_urdf(ROOT / file, tips=[b], base=a) for a, b in ((base, tip), (tip, base)))
    assert compare(arm, base, ROOT / file, model) < 1e-12
    if file.startswith("pr2"):  # joints of all kinds
        q = np.random.default_rng(0).uniform(-1, 1, (3, arm.n))
        traced = jax.jit(jax.vmap(numbers, (None, 0)))
        for a, b in zip(traced(modelled(arm), q), numbers(modelled(arm), q), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-12)
    about, again = (np.array([one.lower, one.upper, one.velocity_limit]) for one in (arm, back))
    order = [back.joint_names.index(name) for name in arm.joint_names]
    np.testing.assert_array_equal(again[:, order], about)


@pytest.mark.parametrize(
    ("make", "file", "base", "tip", "near"),  # a file writes its right angles with 12 digits
    [
        (panda, "panda_description/urdf/panda.urdf", "panda_link0", "panda_link8", 1e-10),
        (ur5, "ur_description/urdf/ur5_robot.urdf", "base", "tool0", 1e-9),  # the maker's frame 0 is the link "base"
    ],
)
def test_builtin_robots_and_limits_are_the_files(make, file, base, tip, near):
    arm, read, (model, _) = make(), ck.load_urdf(ROOT / file, tip=tip), oracle(ROOT / file)
    joints = [model.joints[model.getJointId(name)] for name in read.joint_names]
    np.testing.assert_array_equal(read.lower, [model.lowerPositionLimit[j.idx_q] for j in joints])
    np.testing.assert_array_equal(read.upper, [model.upperPositionLimit[j.idx_q] for j in joints])
    np.testing.assert_array_equal(read.velocity_limit, [model.velocityLimit[j.idx_v] for j in joints])
    elbow = [2] * (make is ur5)  # which turns half as far by the file
    ranges = (np.delete((each.lower, each.upper), elbow, 1) for each in (arm, read))
    np.testing.assert_allclose(*ranges, atol=1e-9)
    if make is panda:
        assert arm.joint_names == read.joint_names
        np.testing.assert_allclose(arm.velocity_limit, read.velocity_limit, atol=1e-9)
    q = np.random.default_rng(1).uniform(-1.5, 1.5, arm.n)
    position, rotation, j = Pinocchio(ROOT / file, model).at(read.joint_names, q, tip, base)
    np.testing.assert_allclose(ck.forward(arm, q).position, position, atol=near)
    np.testing.assert_allclose(ck.forward(arm, q).rotation, rotation, atol=near)
    np.testing.assert_allclose(ck.jacobian(arm, q), j, atol=near)


LINKS = "".join(f'<link name="{name}"/>' for name in "abcd")


def joint(name, parent, child, kind="revolute", inside="", limit='<limit lower="-1" upper="1" velocity="2"/>'):
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}<axis xyz="0 0 1"/>{limit}{inside}</joint>'


def robot(body):
    return f'<robot name="r">{body}</robot>'


def test_limits_too_large_to_be_meant_are_none():
    arm = ck.load_urdf(robot(ROW.replace('lower="-1" upper="1"', 'lower="-1e16" upper="1e16"')))
    assert arm.lower == (-np.inf,) * 3 and arm.upper == (np.inf,) * 3


SPLIT = LINKS + joint("j1", "a", "b") + joint("j2", "b", "c") + joint("j3", "b", "d")
ROW = LINKS + joint("j1", "a", "b") + joint("j2", "b", "c") + joint("j3", "c", "d")
RING = "".join(f'<link name="{a}"/>' + joint(f"j{a}", a, b) for a, b in ("xy", "yz", "zx"))


BAD = (
    ("", "has no links"),
    (SPLIT, "such as c, d, but is not"),
    (LINKS + joint("j1", "a", "b"), "3 roots: a, c, d"),
    (LINKS + joint("j1", "a", "b") + joint("j2", "b", "a"), "a loop through link 'a'"),
    (ROW + joint("j4", "d", "b"), "a loop: two joints carry link 'b'"),
    (ROW + joint("j4", "a", "x"), "no link 'x'"),
    (ROW + '<link name="a"/>', "more than one link 'a'"),
    (ROW.replace("j3", "j2"), "more than one joint 'j2'"),
    (ROW.replace("revolute", "round"), "type 'round'"),
    (ROW.replace("revolute", "fixed"), "a joint that moves after 'a'"),
    (ROW.replace("0 0 1", "0 0 0"), "axis 0 0 0"),
    (ROW.replace("0 0 1", "0 0"), "joint 'j1' of the text has axis xyz '0 0', not three numbers"),
    (ROW.replace("0 0 1", "0 0 one"), "joint 'j1' of the text has axis xyz '0 0 one'"),
    (ROW.replace('lower="-1"', 'lower="2"'), "has limits from 2 to 1"),
    (ROW.replace('lower="-1"', 'lower="nan"'), "has limit lower 'nan', not a number within"),
    (ROW.replace('<limit lower="-1" upper="1" velocity="2"/>', ""), "no <limit>"),
    (ROW.replace('<parent link="a"/>', ""), "bad or missing entry"),
    (ROW.replace('<joint name="j1"', "<joint"), "bad or missing entry"),
    (ROW.replace("</joint>", '<mimic joint="no"/></joint>'), "'no', which is not in the file"),
    (ROW.replace("</joint>", '<mimic joint="j2"/></joint>', 2), "'j2' follows 'j2'"),
    ('<xacro:include filename="x"/>' + ROW, "run `xacro"),
    (ROW + "<open>", "not well-formed XML"),
    ('<link name="free"/>' + RING, "has a loop through link 'x'"),
    (ROW.replace("<limit", '<origin xyz="1e300 0 0"/><limit'), "has origin .* not three numbers within ±1e"),
    (ROW.replace("<limit", '<origin rpy="0 0 1e300"/><limit'), "has origin .* not three numbers within ±1e"),
    (ROW.replace('lower="-1" upper="1"', 'lower="1e300" upper="1e301"'), "has limits from 1e"),
)
test_bad_files_are_refused_in_one_line = refusals(
    *((lambda body=b: ck.load_urdf(robot(body)), says) for b, says in BAD)
)


def long_chain(count, mimic=False):
    rows = ['<robot name="r"><link name="l0"/>']
    for i in range(count):
        more = f'<mimic joint="j{i - 1}"/>' if mimic and i else ""
        rows.append(f'<link name="l{i + 1}"/><joint name="j{i}" type="continuous"><parent link="l{i}"/>')
        rows.append(f'<child link="l{i + 1}"/>{more}</joint>')
    return "".join(rows) + "</robot>"


def test_large_trees_are_read_in_time_that_grows_with_their_size():
    """Work counted in Python calls: doubling a file may not quadruple it."""
    import cProfile
    import pstats

    def calls(text):
        profile = cProfile.Profile()
        profile.runcall(read_urdf, text)
        return pstats.Stats(profile).total_calls

    for make in (long_chain, lambda n: long_chain(n, mimic=True)):
        assert calls(make(400)) < 2.15 * calls(make(200))
    loose = "<robot name='r'>" + "".join(f"<link name='l{i}'/>" for i in range(2000)) + "</robot>"
    with pytest.raises(ck.ArgumentError, match="2,000 roots: l0, l1"):
        read_urdf(loose)


def test_a_files_text_is_read_like_the_file(tmp_path):
    (tmp_path / "c.urdf").write_text(long_chain(3), encoding="utf-8")
    of_file, of_text = ck.load_urdf(tmp_path / "c.urdf"), ck.load_urdf("\n " + long_chain(3))
    assert str(of_file) == str(of_text) and of_file.joints[1].origin.position == of_text.joints[1].origin.position
    with pytest.raises(ck.ArgumentError, match="the text holds <html>, not <robot>"):
        ck.load_urdf("<html/>")
    with pytest.raises(ck.ArgumentError, match="`base` must be fixed, planar, free or one of the 4 links"):
        ck.load_urdf(long_chain(3), base=np.eye(4))
