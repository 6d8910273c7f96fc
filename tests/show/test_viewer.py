"""The viewer: shapes and frames against other code, motions of files, loops without new programs, pages in browsers."""

import colorsys
import dataclasses
import pathlib
import re
import shutil
import subprocess
import sys
import threading
import time
import types

import jax
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_rgb
from scipy.spatial.transform import Rotation

import cnclik as ck
from cnclik.cli import main
from cnclik.problem.build import problem_from
from cnclik.robot.poses import quaternions
from cnclik.robot.urdf import load_urdf
from cnclik.show.viewer import body, files, live, look, meshes, motion, need, page, play, scene, swept
from cnclik.stability.linear import delayed_radius
from cnclik.sweeps.check import parse
from tests.compiling import compiled
from tests.oracles import robot_file

with_viser = pytest.mark.skipif(not need.has_viser(), reason="needs viser, the extra `viewer`")
ARM = "planar:1,0.8"
SLIDER = ck.from_dh([0.3, 0, 0.2], [0.4, -0.5, 0], [0.1, 0.2, 0], kinds="RPR", lower=[-1, -0.2, -1], upper=[1, 0.5, 1])


@pytest.fixture(scope="module")
def problem():
    return problem_from(ARM, reference="circle", N=30, Ts=0.05, method="EE")


@pytest.fixture(scope="module")
def run(problem):
    return jax.tree.map(np.asarray, ck.solve(problem.law, problem.reference, problem.q0, 0.05, 30, "EE"))


# --- shapes and frames ----------------------------------------------------------------------------------


@pytest.mark.parametrize("chain", [ck.panda(), ck.ur5(), SLIDER], ids=["panda", "ur5", "RPR"])
def test_frames_are_those_of_the_chain(chain):
    q = np.random.default_rng(0).uniform(-0.2, 0.5, (3, chain.n))
    found = body.link_poses(chain, q)
    for k in range(3):
        at = ck.forward(chain, q[k])
        np.testing.assert_allclose(found[k, -1, :3, 3], at.position, atol=1e-12)
        np.testing.assert_allclose(found[k, -1, :3, :3], at.rotation, atol=1e-12)


@pytest.mark.parametrize("base", ["panda_link0", "panda_link5"])
def test_links_of_a_file_are_where_pinocchio_has_them(base):
    import pinocchio as pin

    tip = "panda_hand" if base == "panda_link0" else "panda_link1"
    model = pin.buildModelFromUrdf(str(robot_file("panda")))
    data, chain = model.createData(), load_urdf(robot_file("panda"), tip, base)
    rng = np.random.default_rng(1)
    q = rng.uniform(-1, 1, model.nq)
    q[-2:] = 0.0  # fingers
    own = np.array([q[model.joints[model.getJointId(name)].idx_q] for name in chain.joint_names])
    others = [n for n in model.names[1:] if n not in chain.joint_names]
    for name in others:
        q[model.joints[model.getJointId(name)].idx_q] = 0.0
    pin.framesForwardKinematics(model, data, q)
    frames = body.link_poses(chain, own[None])[0]
    from cnclik.robot.tree import read_urdf

    start = data.oMf[model.getFrameId(base)].inverse()
    placed = meshes.placed(read_urdf(robot_file("panda")), [tip], base)
    assert len(placed) > 9
    for link, (frame, at) in placed.items():
        wanted = (start * data.oMf[model.getFrameId(link)]).homogeneous
        np.testing.assert_allclose(frames[frame] @ at, wanted, atol=1e-9, err_msg=link)


HANDS = ["left_rubber_hand", "right_rubber_hand"]


def test_links_of_a_tree_are_where_pinocchio_has_them():
    """Also of a base that both tips' ways lead away from, one of them upwards."""
    import pinocchio as pin

    from cnclik.robot.tree import read_urdf

    base, tips = "left_elbow_link", [HANDS[1], "left_ankle_roll_link"]
    model = pin.buildModelFromUrdf(str(robot_file("g1")))
    data, chain = model.createData(), load_urdf(robot_file("g1"), tips=tips, base=base)
    q, own = np.zeros(model.nq), np.random.default_rng(2).uniform(-0.5, 0.5, chain.n)
    q[[model.joints[model.getJointId(name)].idx_q for name in chain.joint_names]] = own
    pin.framesForwardKinematics(model, data, q)
    frames, start = body.link_poses(chain, own[None])[0], data.oMf[model.getFrameId(base)].inverse()
    for link, (frame, at) in meshes.placed(read_urdf(robot_file("g1")), tips, base).items():
        wanted = (start * data.oMf[model.getFrameId(link)]).homogeneous
        np.testing.assert_allclose(frames[frame] @ at, wanted, atol=1e-9, err_msg=link)
    for i, tip in enumerate(tips):
        np.testing.assert_allclose(frames[i - 2][:3, 3], ck.forward(chain, own, tip=tip).position, atol=1e-12)
    ends = {(p.frame, *np.round(p.vertices.mean(0), 6)) for p in body.parts_of(chain)}
    assert len(ends) >= len(chain.joints)  # a shape for each joint at least, on frames of the tree
    assert {p.frame for p in body.parts_of(chain)} <= set(range(len(chain.joints) + 1))


def volume(vertices, faces):
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.sum(a * np.cross(b, c)) / 6


def test_shapes_are_closed_and_face_outwards():
    start, end, r = np.array([0.1, -0.2, 0.3]), np.array([0.7, 0.4, -0.1]), 0.1
    length = np.linalg.norm(end - start)
    assert volume(*body.rod(start, end, r)) == pytest.approx(np.pi * r**2 * length, rel=0.02)
    assert volume(*body.capsule(start, end, r)) == pytest.approx(np.pi * r**2 * (length + 4 / 3 * r), rel=0.03)


def test_every_link_and_joint_has_a_shape_in_the_palette():
    parts = body.parts_of(ck.planar_arm([1.0, 0.8]))
    assert [p.frame for p in parts] == [1, 2, 1, 2] and {p.color for p in parts} == {"#56B4E9", "#0072B2"}
    assert {p.frame for p in body.parts_of(SLIDER)} == {1, 2, 3}


def test_quaternions_are_scipys():
    turns = Rotation.random(50, random_state=0)
    turns = Rotation.concatenate(
        [turns, Rotation.from_rotvec([[np.pi, 0, 0], [0, np.pi, 0], [0, 0, np.pi], [0, 0, 0]])]
    )
    found, wanted = quaternions(turns.as_matrix()), turns.as_quat(scalar_first=True)
    np.testing.assert_allclose(np.abs(np.sum(found * wanted, axis=1)), 1, atol=1e-12)
    assert (found[:, 0] >= 0).all()


# --- motions and files ------------------------------------------------------------------------------------


def test_a_motion_is_the_run(problem, run):
    made = motion.motion_of(run, problem.law, name="arm")
    np.testing.assert_allclose(made.ways[0][:, :2], run.x, atol=1e-12)
    np.testing.assert_allclose(made.targets[0][:, :2], run.x + run.e)
    np.testing.assert_allclose(made.error["position error [m]"], np.linalg.norm(run.e, axis=1))
    assert made.words[0] == "OK" and not made.level.any() and len(made.level) == 31


@pytest.fixture(scope="module")
def two():
    """Two arms, the right one's target as seen from the left one."""
    robot = load_urdf(robot_file("g1"), tips=HANDS)
    task = ck.stack(
        grip=ck.pose(tip=HANDS[1], relative_to=HANDS[0]), box=ck.position("yz", tip=HANDS[0]), rest=ck.joints()
    )
    law = ck.Law(robot, task, alpha=5.0, inverse=ck.damped(0.1))
    q = np.full(robot.n, 0.3)
    left = np.asarray(ck.forward(robot, q, tip=HANDS[0]).position)
    paths = ck.hold_at(robot, task, q, box=ck.circle(left, 0.05, period=1.0, normal=[1, 0, 0]))
    return law, paths, ck.solve(law, paths, q + 0.02, 0.02, 20, "EE")


def test_a_motion_of_several_tips_has_a_way_and_a_target_of_each(two):
    law, paths, run = two
    made = motion.motion_of(run, law)
    for i, tip in enumerate(HANDS):
        wanted = [ck.forward(law.chain, q, tip=tip).position for q in np.asarray(run.q)]
        np.testing.assert_allclose(made.ways[i], wanted, atol=1e-6)
    left, right = made.targets
    np.testing.assert_allclose(left[:, 0], made.ways[0][:, 0])  # a coordinate that nobody asks for is the tip's own
    circle = np.array([paths["box"].curve(t)[0] for t in np.asarray(run.t)])
    np.testing.assert_allclose(left[:, 1:], circle[:, 1:], atol=1e-6)
    for k in (0, 7):  # where the left hand is now, and what it sees
        at, (place, _) = ck.forward(law.chain, np.asarray(run.q)[k], tip=HANDS[0]), paths["grip"].curve(0.0)
        np.testing.assert_allclose(right[k], at.position + at.rotation @ place, atol=1e-5)
    assert list(made.error) == [
        "grip position error [m]", "grip orientation error [rad]", "box position error [m]", "rest joint error [rad]"
    ]  # fmt: skip
    assert "rest joint error" in play.caption([made], 0.5)
    strokes = [one["stroke"] for one in play.series(play.curves([made])[1])[1:]]
    assert len(set(strokes)) == 4  # a colour each


@with_viser
def test_a_page_of_several_tips(two):
    law, _, run = two
    server = need.server(port=8450)
    try:
        shown = scene.Scene(server)
        shown.put([motion.motion_of(run, law, links=(str(robot_file("g1")), HANDS, None))])
        (drawn,) = shown._drawn
        shown.show(1.0)
        assert len(drawn.tips) == len(drawn.goals) == len(drawn.lines) == 2
        np.testing.assert_allclose(drawn.goals[1].position, drawn.motion.targets[1][-1])
        assert drawn.lowest < -0.5 and shown._drawn[0].parts  # the feet stand below the pelvis
    finally:
        need.stop(server)


def test_a_motion_ends_before_what_is_not_finite(problem, run):
    status, q = np.array(run.status), np.array(run.q)
    status[5], q[20:] = ck.Status.NEAR_SINGULAR, np.nan
    made = motion.motion_of(ck.replace(run, q=q, status=status), problem.law)
    assert len(made.t) == 20 and made.level[5] == motion.WARNING and made.level[-1] == motion.BAD
    assert made.words[-1] == "NON_FINITE" and made.color == motion.LEVELS[motion.BAD]


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    out = tmp_path_factory.mktemp("run")
    main(["solve", ARM, "--method", "EE", "--N", "20", "--csv", "--no-figures", "--out", str(out)])
    return out


def test_files_of_a_run_are_the_same_motion(solved):
    (whole,) = files.read_motions(solved)
    (table,) = files.read_motions(solved / "trajectory.csv")
    np.savez(solved / "own.npz", t=whole.t, q=whole.q)
    (own,) = files.read_motions(solved / "own.npz", files.robot_of(ARM))
    for other in (table, own):
        np.testing.assert_allclose(other.ways, whole.ways, atol=1e-12)
    np.testing.assert_allclose(table.error["position error [m]"], whole.error["position error [m]"])
    assert own.targets == (None,) and not own.error and whole.chain.n == 2


@pytest.mark.parametrize("ending", [".nc", ".csv", ".npz"])
def test_files_of_answers_are_one_motion(tmp_path, ending):
    (tmp_path / "t.csv").write_text("0.5,1.0\n9.0,0.0\n")
    out = tmp_path / f"answers{ending}"
    targets = np.array([[0.5, 1.0, 0.0], [9.0, 0.0, 0.0]])
    made = ck.reach(ck.planar_arm([1.0, 0.8]), targets, task="position")
    from cnclik.measure.answers import answers, save

    at = np.tile(np.eye(4), (2, 1, 1))
    at[:, :3, 3] = targets
    save(answers(made, at), out)
    (found,) = files.read_motions(out, files.robot_of(ARM))
    assert found.words == ("SOLVED", "OUT_OF_REACH") and list(found.level) == [motion.GOOD, motion.WARNING]
    np.testing.assert_allclose(found.ways[0][0], targets[0], atol=1e-5)
    assert found.unit == "target" and found.note == "1 of 2 targets reached"


@pytest.mark.parametrize(
    "name, text, told",
    [
        ("a.npz", None, "`ROBOT` must be given before a.npz"),
        ("a.csv", "1,2\n3,4\n", "must have columns q_JOINT"),
        ("a.nc", "none", "must be a run of `solve`"),
        ("a.npz", "none", "must be a run of `solve`"),
        ("none.nc", None, "No such file"),
    ],
)
def test_files_that_say_nothing_are_one_line(tmp_path, name, text, told):
    if text is not None:
        (tmp_path / name).write_text(text)
    elif name == "a.npz":
        np.savez(tmp_path / name, q=np.zeros((3, 2)))
    with pytest.raises(ck.ArgumentError, match=re.escape(told)):
        files.read_motions(tmp_path / name)


def test_another_robot_is_refused(solved):
    with pytest.raises(ck.ArgumentError, match="must hold joint values \\(N, 7\\) of panda's joints"):
        files.read_motions(solved, files.robot_of("panda"))


# --- live loops ---------------------------------------------------------------------------------------------


def test_gains_and_sampling_times_need_no_new_program(problem):
    first = look.loop_of(problem)
    look.look(problem, first)
    with compiled() as found:
        for alpha, Ts in ((3.0, 0.05), (7.0, 0.02), (45.0, 0.05)):
            seen = look.look(problem, first._replace(alpha=alpha, Ts=Ts))
            assert seen.radius == pytest.approx(abs(1 - alpha * Ts), abs=1e-6)
    assert not found


def test_the_factors_of_a_late_loop_are_the_theorys(problem):
    loop = look.loop_of(problem)._replace(alpha=4.0, delay=2.0)
    seen = look.look(problem, loop)
    assert seen.radius == pytest.approx(float(delayed_radius("EE", None, 0.2, 2)), rel=1e-6)
    assert np.abs(seen.factors).max() == pytest.approx(seen.radius)
    assert "stable" in live.factors_page(seen) and live.factors_page(seen).count("<circle") > 1


def test_a_loop_that_went_astray_has_factors_too(problem):
    seen = look.look(problem, look.loop_of(problem)._replace(alpha=500.0))
    assert seen.radius == pytest.approx(24, rel=1e-6) and "not stable" in live.factors_page(seen)
    made = motion.motion_of(seen.run, problem.law, radius=seen.radius)
    assert np.isfinite(made.q).all() and set(made.level) == {motion.BAD} and "UNSTABLE" in made.words[0]


@pytest.mark.parametrize("radius", [0.9, 1.0, 1.001, 1.5])
def test_colours_say_what_words_say(problem, run, radius):
    """A radius of 1.001 was "not stable" beside a green OK, and what is bad was orange: its red had a hue of 26°."""
    made = motion.motion_of(run, problem.law, radius=radius)
    said = live.factors_page(look.Observation(look.loop_of(problem), run, np.array([radius + 0j]), radius))
    assert ("not stable" in said) == (set(made.level) == {motion.BAD}) == (radius > 1 + 1e-6)
    assert ("stable" in said and "stable nor" not in said and "not stable" not in said) == (radius < 1)
    color = re.search(r"color:(#\w+)", said)[1]
    assert color == motion.LEVELS[motion.GOOD if radius < 1 else motion.WARNING if radius == 1 else motion.BAD]
    hues = [360 * colorsys.rgb_to_hsv(*to_rgb(one))[0] for one in motion.LEVELS]
    assert 140 < hues[0] < 180 and 30 < hues[1] < 60 and min(hues[2], 360 - hues[2]) < 15  # green, orange, red


def test_a_lost_loop_of_a_sweep_is_red():
    """It had the warning's colour: its steps, of which none grows for long, bear no mark of their own."""
    loop = {"robot": ARM, "task": "xy", "reference": "hold", "target": [1.2, 0.6], "Ts": 0.05, "N": 40, "method": "EE"}
    table = {"fixed": loop, "axes": {"alpha": [10.0, 41.0]}, "metrics": ["final_error"]}
    spec = parse(table | {"question": "Which is lost?", "expectation": "The last."}, "two")
    values = xr.DataArray([1e-6, 0.5], dims=["alpha"], coords={"alpha": [10.0, 41.0]})
    best, worst = swept.loops_of(xr.Dataset({"final_error": values}), spec)
    assert best.color == motion.LEVELS[motion.GOOD] and set(worst.level) == {motion.BAD}


def test_a_page_leaves_out_an_even_number_of_instants(problem, run):
    made = motion.motion_of(run, problem.law)
    long = dataclasses.replace(made, t=np.linspace(0, 50, 1001), q=np.zeros((1001, 2)))
    shares, pause = page.frames_of([long])
    steps = np.diff(np.round(shares * 1000).astype(int))
    assert set(steps[:-1]) == {5} and shares[-1] == 1 and len(shares) * pause == pytest.approx(page.LONGEST)


def test_what_is_told_of_an_instant(problem, run):
    made = motion.motion_of(run, problem.law, name="<arm>")
    assert "&lt;arm&gt;" in play.caption([made], 0.5) and "t = 0.750 s" in play.caption([made], 0.5)
    data, names = play.curves([made, dataclasses.replace(made, t=2 * made.t)])
    assert len({len(v) for v in data}) == 1 and len(names) == 2 == len(play.series(names)) - 1


def test_without_viser_the_viewer_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(SystemExit) as left:
        main(["view", ARM])
    shown = capsys.readouterr()
    assert left.value.code == 2 and shown.out == "" and shown.err.count("\n") == 1
    assert "pip install 'cnclik[viewer]'" in shown.err


# --- with viser ----------------------------------------------------------------------------------------------


@with_viser
def test_a_page_is_whole_and_about_a_megabyte(problem, run, capfd):
    made = motion.motion_of(run, problem.law)
    text = page.as_page([made, made])
    assert "<html" in text and 700_000 < len(text) < 1_300_000
    assert not re.search(r'<(script|link|img)[^>]+(src|href)="https?://', text)
    time.sleep(0.2)
    assert capfd.readouterr() == ("", "")  # viser says much of itself


@with_viser
def test_a_scene_shows_the_worst_of_what_it_leaves_out(problem, run):
    made = motion.motion_of(run, problem.law)
    level = np.zeros(5001, int)
    level[3] = motion.BAD
    long = dataclasses.replace(made, t=np.arange(5001.0), q=np.zeros((5001, 2)), level=level, words=("OK",) * 5001)
    server = need.server(port=8400)
    try:
        shown = scene.Scene(server)
        shown.put([dataclasses.replace(long, targets=(None,), error={})])
        (good, bad) = shown._drawn[0].marks
        assert len(good.points) + len(bad.points) == scene.MOST_POINTS - 1 and len(bad.points) == 1
        shown.put([made, made])  # another one beside it: both robots are laid out anew
        assert len(shown._drawn) == 2 and shown._drawn[0].root.position[0] < shown._drawn[1].root.position[0]
    finally:
        need.stop(server)


@with_viser
def test_sliders_run_the_loop(problem, capfd):
    said = []
    viewer = ck.show.viewer.front.Viewer((), live.Live(problem, say=said.append), port=8300)
    try:
        viewer.live.alpha.value = 30.0
        viewer.live.ask()
        for _ in range(200):
            if viewer.live.seen.loop.alpha == 30.0:
                break
            time.sleep(0.1)
        assert viewer.live.seen.radius == pytest.approx(0.5, abs=1e-6)
        viewer.live._keep(viewer.live.motion())
        assert len(viewer.live.motions()) == 2
    finally:
        viewer.stop()
    assert re.fullmatch(r"http://localhost:83\d\d", viewer.url) and len(said) == 2 and "Compiling EE" in said[0]
    assert capfd.readouterr() == ("", "")


@with_viser
def test_view_writes_a_page(problem, run, tmp_path, solved, capsys):
    assert ck.show.view(run, problem.law, beside=str(solved), html=tmp_path / "a.html").exists()
    main(["view", str(solved), "--html", str(tmp_path / "b.html")])
    assert (tmp_path / "b.html").stat().st_size > 700_000 and "Wrote" in capsys.readouterr().out
    for name in ("b.txt", "none/b.html"):
        with pytest.raises(SystemExit):
            main(["view", str(solved), "--html", str(tmp_path / name)])


@with_viser
def test_a_live_view_says_where_it_is_and_ends_with_ctrl_c(monkeypatch, capsys):
    class Waits:
        def wait(self):
            raise KeyboardInterrupt

    monkeypatch.setattr("cnclik.cli.view.threading", types.SimpleNamespace(Event=Waits))
    main(["view", ARM, "--N", "5", "--method", "EE", "--port", "8500"])
    shown = capsys.readouterr()
    assert re.fullmatch(r"http://localhost:85\d\d \(Ctrl-C ends\)\n", shown.out)
    assert shown.err.splitlines()[0] == "Compiling EE …" and shown.err.count("\n") == 2


# --- in a browser ---------------------------------------------------------------------------------------------

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = (
    *("--headless=new", "--no-sandbox", "--hide-scrollbars", "--use-gl=angle", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--virtual-time-budget=6000"),
)


def screenshot(page, out, size=(900, 600)) -> np.ndarray:
    from PIL import Image

    url = pathlib.Path(page).resolve().as_uri()
    place = f"--user-data-dir={out.parent / 'browser'}"
    line = [CHROMIUM, *FLAGS, place, f"--window-size={size[0]},{size[1]}", f"--screenshot={out}", url]
    subprocess.run(line, check=True, timeout=300, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return np.asarray(Image.open(out).convert("RGB")).astype(int)


@with_viser
@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="needs a browser: chromium")
def test_the_arm_is_in_the_middle_of_the_page(tmp_path):
    file = tmp_path / "one.html"
    main(["view", ARM, "--N", "20", "--method", "EE", "--html", str(file)])
    seen = screenshot(file, tmp_path / "one.png", (900, 600))
    high, wide, _ = seen.shape
    middle = seen[high // 6 : 5 * high // 6, wide // 4 : 3 * wide // 4]
    red, green, blue = (middle[..., i] for i in range(3))
    arm = (blue > red + 40) & (blue > green + 10) & (green > red)  # sky and blue, in any light
    assert arm.mean() > 0.005


def test_a_paced_problem_is_shown_as_it_runs():
    made = ck.problem.problem_from("planar:1,1", reference="circle", N=20, max_velocity=(0.05,))
    assert np.abs(look.look(made, look.loop_of(made)).run.qdot).max() <= 0.05 * (1 + 1e-9)


def test_a_name_that_is_too_long_is_refused_in_a_line(capsys):
    with pytest.raises(SystemExit) as left:
        main(["view", "x" * 5000, "--html", "out.html"])
    assert left.value.code == 2 and capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(("typed", "shown"), [(6, 1.0), (-2, 0.0), (0.5, 0.5), (1e300, 1.0)])
def test_any_number_in_the_box_of_the_time_is_a_time(problem, run, typed, shown):
    player, shares = object.__new__(play.Player), []
    made = motion.motion_of(run, problem.law, name="arm")
    player._busy, player.caption = threading.Lock(), types.SimpleNamespace(content="")
    player.scene = types.SimpleNamespace(motions=[made], show=shares.append)
    player._show(typed)
    assert shares == [shown] and "arm" in player.caption.content
