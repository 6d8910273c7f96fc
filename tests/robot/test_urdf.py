"""load_urdf against Pinocchio on every file of the example-robot-data wheel, and its one-line errors."""

import time
import warnings
import xml.etree.ElementTree as ElementTree

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest

import cnclik as ck
from cnclik.robot.builtin import panda, ur5
from cnclik.robot.model import frames, jacobian_rows, modelled
from cnclik.robot.tree import read_urdf
from cnclik.robot.urdf import chain
from tests.oracles import robots

ROOT = robots()
FILES = sorted(str(p.relative_to(ROOT)) for p in ROOT.rglob("*.urdf"))
CONFIGURATIONS = 20


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

    def at(self, names, q, tip, base):
        model, data = self.model, self.data
        full, columns = pin.neutral(model), np.zeros((model.nv, len(names)))
        for name, (value, i, multiplier) in self.values(names, q).items():
            joint = model.joints[model.getJointId(name)]
            circle = [np.cos(value), np.sin(value)]
            full[joint.idx_q : joint.idx_q + joint.nq] = circle if joint.nq == 2 else value
            columns[joint.idx_v, i] += multiplier
        pin.computeJointJacobians(model, data, full)
        pin.updateFramePlacements(model, data)
        frame, root = (model.getFrameId(link, pin.FrameType.BODY) for link in (tip, base))
        m = data.oMf[root].actInv(data.oMf[frame])
        j, own = (pin.getFrameJacobian(model, data, f, pin.LOCAL_WORLD_ALIGNED) @ columns for f in (frame, root))
        away = data.oMf[frame].translation - data.oMf[root].translation
        velocity = j[:3] - own[:3] - np.cross(own[3:], away, axis=0)  # as seen from a base that moves
        turn = data.oMf[root].rotation.T
        return m.translation, m.rotation, np.vstack([turn @ velocity, turn @ (j[3:] - own[3:])])


def compare(arm, base, path, model, tip, ways):
    """Largest deviation of pose and Jacobian from Pinocchio over random configurations within limits."""
    rng = np.random.default_rng(len(tip))
    low, high = (np.clip(bound, -np.pi, np.pi) for bound in (arm.lower, arm.upper))
    q = rng.uniform(low, high, (CONFIGURATIONS, arm.n))
    other = Pinocchio(path, model)
    expected = [other.at(arm.joint_names, row, tip, base) for row in q]

    arm = modelled(arm)
    return max(
        np.abs(a - np.stack(b)).max()
        for found in (seen(arm, jnp.asarray(q) if seen is traced else q) for seen in ways)
        for a, b in zip(found, zip(*expected, strict=True), strict=True)
    )


def numbers(arm, q):
    at = frames(arm, q)
    rows = jacobian_rows(arm, at, (0, 1, 2), (0, 1, 2))
    return at.position, at.rotation, rows


traced = jax.jit(jax.vmap(numbers, (None, 0)))


MOST = 2  # chains of a file that are compared: hands have twenty alike


@pytest.mark.parametrize("file", FILES)
def test_leaves_of_every_robot_match_pinocchio(file):
    path = ROOT / file
    model, reason = oracle(path)
    if model is None:
        with pytest.raises(ck.ArgumentError) as told:
            read_urdf(path)
        pytest.skip(f"{file}: neither Pinocchio ({reason}) nor cnclik ({told.value}) reads it")
    tree = read_urdf(path)
    moved, skipped = tree.tips(), {}
    compared = 0
    for leaf in tree.leaves:
        if leaf not in moved:
            with pytest.raises(ck.ArgumentError, match="moved by a joint"):
                chain(tree, leaf)
            skipped.setdefault("fixed to the root", []).append(leaf)
            continue
        try:
            arm = chain(tree, leaf)
        except ck.ArgumentError as error:
            # The one file of the wheel whose mimic joints name joints that it does not have.
            assert file.endswith("alex_psyonic_hands.urdf") and "which is not in the file" in str(error)
            skipped.setdefault("follows a joint that is not in the file", []).append(leaf)
            continue
        if compared == MOST:
            continue
        compared += 1
        # Breaks for an rpy order, axis normalisation or mimic offset that is wrong, by orders of magnitude.
        assert compare(arm, tree.root, path, model, leaf, [numbers]) < 1e-12, leaf
    for reason, leaves in skipped.items():
        warnings.warn(f"{file}: no chain to {', '.join(leaves)}: {reason}", stacklevel=1)


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
    arm = ck.load_urdf(ROOT / file, tip=tip, base=base)
    assert compare(arm, base, ROOT / file, model, tip, [numbers, traced]) < 1e-12
    back = ck.load_urdf(ROOT / file, tip=base, base=tip)
    limits = dict(zip(arm.joint_names, zip(arm.lower, arm.upper, arm.velocity_limit, strict=True), strict=True))
    assert limits == dict(
        zip(back.joint_names, zip(back.lower, back.upper, back.velocity_limit, strict=True), strict=True)
    )


def test_limits_are_pinocchios():
    for file, tip in (
        ("panda_description/urdf/panda.urdf", "panda_link8"),
        ("ur_description/urdf/ur5_robot.urdf", "tool0"),
        ("icub_description/robots/icub.urdf", "l_hand"),
        ("xarm_description/urdf/xarm7.urdf", None),
    ):
        arm, (model, _) = ck.load_urdf(ROOT / file, tip), oracle(ROOT / file)
        joints = [model.joints[model.getJointId(name)] for name in arm.joint_names]
        np.testing.assert_array_equal(arm.lower, [model.lowerPositionLimit[j.idx_q] for j in joints])
        np.testing.assert_array_equal(arm.upper, [model.upperPositionLimit[j.idx_q] for j in joints])
        np.testing.assert_array_equal(arm.velocity_limit, [model.velocityLimit[j.idx_v] for j in joints])


# --- built in -----------------------------------------------------------------------------------------


def test_builtin_panda_is_the_file():
    arm, file = panda(), ck.load_urdf(ROOT / "panda_description/urdf/panda.urdf", tip="panda_link8")
    assert arm.joint_names == file.joint_names
    np.testing.assert_allclose((arm.lower, arm.upper), (file.lower, file.upper), atol=1e-9)
    np.testing.assert_allclose(arm.velocity_limit, file.velocity_limit, atol=1e-9)
    q = np.random.default_rng(1).uniform(arm.lower, arm.upper)
    # The file writes its right angles with 12 digits.
    np.testing.assert_allclose(ck.forward(arm, q).position, ck.forward(file, q).position, atol=1e-10)
    np.testing.assert_allclose(ck.jacobian(arm, q), ck.jacobian(file, q), atol=1e-10)


def test_builtin_ur5_is_the_file():
    path = ROOT / "ur_description/urdf/ur5_robot.urdf"
    model, _ = oracle(path)
    file = ck.load_urdf(path, tip="tool0")
    q = np.random.default_rng(2).uniform(-np.pi, np.pi, 6)
    # The maker's Denavit-Hartenberg frame 0 is the file's link "base".
    position, rotation, j = Pinocchio(path, model).at(file.joint_names, q, "tool0", "base")
    at = ck.forward(ur5(), q)
    np.testing.assert_allclose(at.position, position, atol=1e-9)
    np.testing.assert_allclose(at.rotation, rotation, atol=1e-9)
    np.testing.assert_allclose(ck.jacobian(ur5(), q), j, atol=1e-9)


# --- mimic joints -------------------------------------------------------------------------------------

LINKS = "".join(f'<link name="{name}"/>' for name in "abcd")


def joint(name, parent, child, kind="revolute", inside="", limit='<limit lower="-1" upper="1" velocity="2"/>'):
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}<axis xyz="0 0 1"/>{limit}{inside}</joint>'


def robot(body):
    return f'<robot name="r">{body}</robot>'


def test_a_mimic_joint_shares_the_coordinate_and_limits_of_its_leader():
    mimic = '<mimic joint="j1" multiplier="-2" offset="0.5"/>'
    body = LINKS + joint("j1", "a", "b") + joint("j2", "b", "c", inside=mimic) + joint("j3", "c", "d", "prismatic")
    arm = ck.load_urdf(robot(body))
    assert arm.joint_names == ("j1", "j3")
    assert [(j.coordinate, j.multiplier, j.offset) for j in arm.joints] == [(0, 1, 0), (0, -2, 0.5), (1, 1, 0)]
    assert (arm.lower[0], arm.upper[0], arm.velocity_limit[0]) == (-1.0, 1.0, 2.0)


def test_mimic_of_a_side_branch_keeps_its_coordinate():
    mimic = '<mimic joint="side"/>'
    body = LINKS + joint("side", "a", "b") + joint("j2", "a", "c", inside=mimic) + joint("j3", "c", "d")
    assert ck.load_urdf(robot(body), tip="d").joint_names == ("side", "j3")


# --- errors, one line each ----------------------------------------------------------------------------

SPLIT = LINKS + joint("j1", "a", "b") + joint("j2", "b", "c") + joint("j3", "b", "d")
MORE = "".join(f'<link name="{k}"/>' for k in "efg")
MORE += joint("j4", "d", "e") + joint("j5", "a", "f") + joint("j6", "a", "g")
ROW = LINKS + joint("j1", "a", "b") + joint("j2", "b", "c") + joint("j3", "c", "d")


@pytest.mark.parametrize(
    "body, told",
    [
        ("", "has no links"),
        (SPLIT, "such as c, d, but is not"),
        (SPLIT + MORE, "such as e, c, f, g, but"),
        (SPLIT + MORE + '<link name="h"/>' + joint("j7", "a", "h"), "such as e, c, f, g and 1 more"),
        (LINKS + joint("j1", "a", "b"), "3 roots: a, c, d"),
        (LINKS + joint("j1", "a", "b") + joint("j2", "b", "a"), "a loop through link 'a'"),
        (ROW + joint("j4", "d", "b"), "a loop: link 'b' hangs on 'j1' and 'j4'"),
        (ROW + joint("j4", "a", "x"), "no link 'x'"),
        (ROW + '<link name="a"/>', "more than one link 'a'"),
        (ROW.replace("j3", "j2"), "more than one joint 'j2'"),
        (ROW.replace("revolute", "round"), "type 'round'"),
        (ROW.replace("revolute", "fixed"), "no.*moving joint|has none"),
        (ROW.replace("0 0 1", "0 0 0"), "axis 0 0 0"),
        (ROW.replace("0 0 1", "0 0"), "joint 'j1' of the text has axis xyz '0 0', not three numbers"),
        (ROW.replace("0 0 1", "0 0 one"), "joint 'j1' of the text has axis xyz 'one'"),
        (ROW.replace('lower="-1"', 'lower="2"'), "has limits from 2 to 1"),
        (ROW.replace('lower="-1"', 'lower="nan"'), "has limit lower 'nan', not within"),
        (ROW.replace('<limit lower="-1" upper="1" velocity="2"/>', ""), "no <limit>"),
        (ROW.replace('<parent link="a"/>', ""), "bad or missing entry"),
        (ROW.replace('<joint name="j1"', "<joint"), "bad or missing entry"),
        (ROW.replace("</joint>", '<mimic joint="no"/></joint>'), "'no', which is not in the file"),
        (ROW.replace("</joint>", '<mimic joint="j2"/></joint>', 2), "j2 -> j2"),
        ('<xacro:include filename="x"/>' + ROW, "run `xacro"),
        (ROW + "<open>", "not well-formed XML"),
    ],
)
def test_bad_files_are_refused_in_one_line(body, told):
    with pytest.raises(ck.ArgumentError, match=told) as error:
        ck.load_urdf(robot(body))
    assert "\n" not in str(error.value)


def test_no_file_an_empty_file_and_no_robot(tmp_path):
    empty, sdf = tmp_path / "empty.urdf", tmp_path / "model.sdf"
    empty.write_text(" ")
    sdf.write_text("<sdf/>")
    for path, told in (
        (tmp_path / "no.urdf", "No such file"),
        (tmp_path, "is a folder"),
        (empty, "is empty"),
        (sdf, "holds <sdf>"),
        (3, "be a file name"),
    ):
        with pytest.raises(ck.ArgumentError, match=told):
            ck.load_urdf(path)


def test_unknown_links_suggest_the_nearest():
    file = robot(ROW.replace('"d"', '"gripper"'))
    with pytest.raises(ck.ArgumentError, match=r"`tip`.*did you mean 'gripper'"):
        ck.load_urdf(file, tip="griper")
    with pytest.raises(ck.ArgumentError, match="`base`"):
        ck.load_urdf(file, base="nowhere")
    for wrong in (3, np.eye(2), ["d"]):
        with pytest.raises(ck.ArgumentError, match="`tip` must be one of the"):
            ck.load_urdf(file, tip=wrong)


def test_what_is_not_kinematics_is_not_read():
    junk = '<link name="e"><visual><geometry/></visual></link><sensor:x y="1"/><gazebo><a>${b}</a></gazebo>'
    body = ROW + joint("j4", "d", "e") + junk
    assert ck.load_urdf(robot(body)).n == 4


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
        assert calls(make(800)) < 2.3 * calls(make(400))
    loose = "<robot name='r'>" + "".join(f"<link name='l{i}'/>" for i in range(5000)) + "</robot>"
    with pytest.raises(ck.ArgumentError, match="5,000 roots: l0, l1, l2, l3, l4 and 4,995 more"):
        read_urdf(loose)


def test_tips_and_tables_of_a_thousand_links_take_seconds(tmp_path, capsys):
    from cnclik.cli import main

    comb = "".join(
        f'<link name="b{k}"/><joint name="k{k}" type="fixed"><parent link="l{k}"/><child link="b{k}"/></joint>'
        for k in range(500)
    )
    (tmp_path / "comb.urdf").write_text(long_chain(500).replace("</robot>", comb + "</robot>"))
    begun = time.process_time()
    main(["robots", str(tmp_path / "comb.urdf")])
    assert time.process_time() - begun < 3  # a walk for each link would take minutes
    shown = capsys.readouterr().out.splitlines()
    assert shown[-2].startswith("1001 links") and len(shown) == 1001 + 4
    assert "b0," not in shown[-1] and "b1, b2," in shown[-1]


LIMITED = long_chain(1).replace("continuous", "revolute").replace("</joint>", '<limit lower="-1" upper="1"/></joint>')


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("<limit", '<origin xyz="1e300 0 0"/><limit', "has origin .* not within ±1e"),
        ("<limit", '<origin rpy="0 0 1e300"/><limit', "has origin .* not within ±1e"),
        ('lower="-1" upper="1"', 'lower="1e300" upper="1e301"', "has limits from 1e"),
    ],
)
def test_numbers_beyond_any_robot(old, new, told):
    with pytest.raises(ck.ArgumentError, match=told):
        read_urdf(LIMITED.replace(old, new))


def test_limits_beyond_any_robot_are_none():
    made = ck.load_urdf(LIMITED.replace('lower="-1" upper="1"', 'lower="-1e308" upper="1e16"'))
    assert made.lower == (-np.inf,) and made.upper == (np.inf,)


def test_loops_of_links_are_found_wherever_they_begin():
    ring = "".join(
        f'<link name="{a}"/><joint name="j{a}" type="continuous"><parent link="{a}"/><child link="{b}"/></joint>'
        for a, b in ("xy", "yz", "zx")
    )
    with pytest.raises(ck.ArgumentError, match="has a loop through link 'x'"):
        read_urdf(robot(f'<link name="free"/>{ring}'))


def test_names_with_markup(tmp_path, capsys):
    from cnclik.cli import main

    (tmp_path / "m.urdf").write_text(long_chain(2).replace("l1", "[/]").replace("j1", "[red]"))
    main(["robots", str(tmp_path / "m.urdf")])
    shown = capsys.readouterr().out
    assert "[/]" in shown and "[red]" in shown


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "UTF-8", "cp1251"])
def test_encodings_are_those_of_the_parser(encoding, tmp_path):
    text = f'<?xml version="1.0" encoding="{encoding}"?>' + long_chain(2).replace("l1", "рука")
    (tmp_path / "e.urdf").write_bytes(text.encode(encoding))
    assert "рука" in read_urdf(tmp_path / "e.urdf").links
    for data in (text.replace(encoding, "klingon").encode(), text.partition("?>")[2].encode("cp1251")):
        (tmp_path / "e.urdf").write_bytes(data)
        with pytest.raises(ck.ArgumentError, match=r"e.urdf is not well-formed XML: "):
            read_urdf(tmp_path / "e.urdf")


def test_a_files_text_is_read_like_the_file(tmp_path):
    (tmp_path / "c.urdf").write_text(long_chain(3), encoding="utf-8")
    of_file, of_text = ck.load_urdf(tmp_path / "c.urdf"), ck.load_urdf("\n " + long_chain(3))
    assert str(of_file) == str(of_text) and of_file.joints[1].origin.position == of_text.joints[1].origin.position
    with pytest.raises(ck.ArgumentError, match="the text holds <html>, not <robot>"):
        ck.load_urdf("<html/>")
