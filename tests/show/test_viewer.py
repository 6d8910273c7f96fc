"""The viewer: frames and meshes against Pinocchio, targets, walls, runs of files, and a server that plays."""

import re
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import cnclik as ck
from cnclik.cli import main
from cnclik.cli import view as cli
from cnclik.measure.dataset import to_dataset
from cnclik.problem.build import problem_from
from cnclik.robot.urdf import load_urdf
from cnclik.show import motion, viewer
from tests import bank
from tests.oracles import robot_file

if not viewer.has_viser():
    pytest.skip("needs viser, the extra `viewer`", allow_module_level=True)

from cnclik.show import shapes

ARM = "planar:1,0.8"
HANDS = ["left_rubber_hand", "right_rubber_hand"]


# --- motions --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def problem():
    return problem_from(ARM, reference="circle", N=30, Ts=0.05, method="EE")


@pytest.fixture(scope="module")
def run(problem):
    return jax.tree.map(np.asarray, problem.run())


def test_a_motion_ends_before_what_is_not_finite(problem, run):
    q = np.array(run.q)
    q[20:] = np.nan
    made = motion.motion_of(to_dataset(ck.replace(run, q=q), problem.law), problem.law.chain)
    assert len(made.poses) == len(made.targets[0]) == made.data.sizes["time"] == 20 and made.data.sizes["step"] == 19


def test_each_tip_has_a_path_and_a_target():
    """Also one that is seen from the other hand; a coordinate that nobody asks for is the tip's own."""
    robot = bank.robot("two arms")
    hands = [tip.name for tip in robot.tips]
    task = ck.stack(
        grip=ck.pose(tip=hands[1], relative_to=hands[0]),
        box=ck.position("yz", tip=hands[0]),
        rest=ck.joints(robot.joint_names[:1]),
    )
    law, q = ck.Law(robot, task, alpha=5.0, inverse=ck.damped(0.1)), np.full(robot.n, 0.3)
    left = np.asarray(ck.forward(robot, q, tip=hands[0]).position)
    paths = ck.hold_at(robot, task, q, box=ck.circle(left, 0.05, period=1.0, normal=[1, 0, 0]))
    run = ck.solve(law, paths, q + 0.02, 0.02, 20, "EE")
    made = motion.motion_of(to_dataset(run, law), robot)
    for i, tip in enumerate(hands):
        wanted = [ck.forward(robot, row, tip=tip).position for row in np.asarray(run.q)]
        np.testing.assert_allclose(made.paths[i], wanted, atol=1e-6)
    left, right = made.targets
    np.testing.assert_allclose(left[:, 0], made.paths[0][:, 0])
    circle = np.array([paths["box"].curve(t)[0] for t in np.asarray(run.t)])
    np.testing.assert_allclose(left[:, 1:], circle[:, 1:], atol=1e-6)
    at, (place, _) = ck.forward(robot, np.asarray(run.q)[7], tip=hands[0]), paths["grip"].curve(0.0)
    np.testing.assert_allclose(right[7], at.position + at.rotation @ place, atol=1e-5)
    parts = [(task, unit) for task, unit, _ in motion.error_parts(made.data)]
    assert parts == [("grip", "m"), ("grip", "rad"), ("box", "m"), ("rest", "rad")]
    assert "error grip" in viewer.caption(made.data, 3)
    # A target of the right hand alone, along x and y, was the left one's, at its height.
    alone = ck.replace(run, x=made.paths[1][:, :2], e=np.full((21, 2), 0.1))
    law = ck.Law(robot, ck.position("xy", tip=hands[1]), alpha=1.0)
    left, right = motion.motion_of(to_dataset(alone, law), robot).targets
    assert left is None and right == pytest.approx(made.paths[1] + [0.1, 0.1, 0.0], abs=1e-5)


def test_a_run_of_no_steps_is_shown():
    robot = ck.planar_arm([1.0, 0.8])
    law, q0 = ck.Law(robot, ck.position("xy"), alpha=1.0), np.array([0.3, 0.5])
    shown = viewer.view(ck.solve(law, ck.hold([1.0, 0.5]), q0, 0.01, 0), law)
    shown.stop()
    assert "OK" in shown.caption.content


# --- meshes and shapes ----------------------------------------------------------------------------------


def box_file(tmp_path, file):
    """A URDF file with a box on each link in place of its meshes: whose centre is the link's frame."""
    text = re.sub(r"<(visual|collision)\b.*?</\1>", "", robot_file(file).read_text(), flags=re.S)
    text = re.sub(r'(<link name="[^"]*")\s*/>', r"\1></link>", text)
    box = '<visual><geometry><box size="0.1 0.1 0.1"/></geometry></visual>'
    (tmp_path / "robot.urdf").write_text(text.replace("</link>", f"{box}</link>"))
    return tmp_path / "robot.urdf"


@pytest.mark.parametrize(
    ("name", "links"),
    [("panda", {"tip": "panda_link1", "base": "panda_link5"}), ("g1", {"tips": HANDS, "base": "planar"})],
    ids=["panda upwards", "g1 on a moving base"],
)
def test_meshes_are_where_pinocchio_has_the_links(name, links, tmp_path):
    import pinocchio as pin

    file = box_file(tmp_path, name)
    model = pin.buildModelFromUrdf(str(file))
    data, chain = model.createData(), load_urdf(file, **links)
    q, own = np.zeros(model.nq), np.random.default_rng(2).uniform(-0.5, 0.5, chain.n)
    base = own[:3] if links["base"] == "planar" else None
    for joint, value in zip(chain.joint_names, own, strict=True):
        if not joint.startswith("base_"):
            q[model.joints[model.getJointId(joint)].idx_q] = value
    pin.framesForwardKinematics(model, data, q)
    start = data.oMf[model.getFrameId(links["base"])].inverse() if base is None else None
    if start is None:
        start = pin.SE3(pin.rpy.rpyToMatrix(0, 0, base[2]), np.array([*base[:2], 0]))
    data_of = SimpleNamespace(q=SimpleNamespace(values=own[None]))
    found, poses = shapes.meshes_of(file, motion.Motion(chain, data_of, motion.link_poses(chain, own[None]), ()))
    frames = [frame for frame in model.frames if frame.type == pin.BODY and frame.name != "universe"]
    places = np.array([(poses[0, shape.frame] @ [*shape.mesh.centroid, 1])[:3] for shape in found])
    for frame in frames:
        wanted = (start * data.oMf[model.getFrameId(frame.name)]).translation
        assert np.abs(places - wanted).max(axis=1).min() < 1e-9, frame.name


def test_walls_are_drawn():
    robot = load_urdf(robot_file("g1"), tips=HANDS)
    pair = ck.distance(ck.sphere(HANDS[0], 0.05, [0, 0, 0.1]), ck.capsule(HANDS[1], 0.04, [0, 0, 0], [0.2, 0, 0.2]))
    walls = [
        ck.wall(ck.position("z", tip=HANDS[0]), above=0.1),
        ck.wall(ck.position("xy", tip=HANDS[1], relative_to=HANDS[0]), normal=[0.0, 2.0], below=0.5),
        ck.wall(pair, above=0.01),
        ck.wall(ck.joints(["left_elbow_joint"]), above=0.1),  # has no shape
    ]
    found = shapes.shapes_of_walls(walls, robot)
    first = 1 + len(robot.joints)
    assert [shape.frame for shape in found] == [0, first, first, first + 1]
    centers = [shape.mesh.centroid for shape in found]
    wanted = [[0, 0, 0.1], [0, 0.25, 0], [0, 0, 0.1], [0.1, 0, 0.1]]
    np.testing.assert_allclose(centers, wanted, atol=1e-6)
    assert found[3].mesh.volume == pytest.approx(np.pi * 0.04**2 * (0.2 * 2**0.5 + 4 / 3 * 0.04), rel=0.03)
    np.testing.assert_allclose(found[3].mesh.extents[[0, 2]], 0.28, rtol=0.02)


# --- the server -----------------------------------------------------------------------------------------


def test_a_run_is_played(problem, run):
    played = ck.show.view(run, problem.law, port=8450)
    try:
        assert played.url == f"http://localhost:{played.server.get_port()}"
        played.show(1e300)
        np.testing.assert_allclose(played.balls[0].position[:2], (run.x + run.e)[-1])
        np.testing.assert_allclose(played.frames[-1].position[:2], run.x[-1], atol=1e-12)
        assert "t = 1.500 s" in played.caption.content and "OK" in played.caption.content
        assert played.slider.max == pytest.approx(1.5)
    finally:
        played.stop()


def test_what_cannot_be_shown_is_refused(problem, run):
    batch = jax.tree.map(lambda v: np.stack([v, v]), run)
    for arguments, words in (
        ({"run": run, "law": None}, "`law` must be a Law"),
        ({"run": "solved", "law": problem.law}, "`run` must be a Trajectory"),
        ({"run": batch, "law": problem.law}, "lane"),
        ({"run": run, "law": problem.law, "port": 100_000}, "`port` must be at most"),
    ):
        with pytest.raises(ck.ArgumentError, match=words):
            ck.show.view(**arguments)


def test_the_command_serves_until_it_is_interrupted(monkeypatch, capsys):
    def interrupt():
        raise KeyboardInterrupt

    waiting = SimpleNamespace(Event=lambda: SimpleNamespace(wait=interrupt))
    monkeypatch.setattr(cli, "threading", waiting)
    main(["view", ARM, "--N", "5", "--method", "EE"])
    assert re.search(r"http://localhost:\d+ \(Ctrl-C ends\)", capsys.readouterr().out)
