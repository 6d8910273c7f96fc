"""Stacks on the command line: `solve`, `export` and `reach` of one file; reach of several tips; refusals."""

import csv
import json
import re
import subprocess
import sys

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr

import cnclik as ck
from cnclik.cli import main
from cnclik.export.example import BUILD
from cnclik.show import run as pictures
from tests.engine.compare import NEEDS_C
from tests.problem.test_stack import FILE
from tests.robot.test_trees import BAXTER, GRIPPERS

STEPS = ["--N", "40"]  # of all runs: one set of programs


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    file = tmp_path_factory.mktemp("stack") / "stack.toml"
    file.write_text(FILE)
    return str(file)


def said(capsys, *argv):
    with pytest.raises(SystemExit) as left:
        main([str(a) for a in argv])
    assert left.value.code == 2
    return capsys.readouterr().err


def test_solve(stack, tmp_path, capsys):
    out = tmp_path / "out"
    main(["solve", str(BAXTER), "--stack", stack, *STEPS, "--csv", "--out", str(out)])
    shown = " ".join(capsys.readouterr().out.split())
    for words in (
        "baxter, tasks hands, rest, N = 40 steps of Ts = 10 ms EXP-MIDPOINT, levels; no dead time given Start: q0",
        "hands: x y z rx ry rz of left_gripper and right_gripper, level 1 of 2 (Damped, λ = 0.001); alpha = 10 1/s, z",
        "z = 0.1; circle from 0.6987",
        "rest: 14 joints, level 2 of 2 (Damped, λ = 0.1); alpha = 1 1/s, z = 0.01; hold (default).",
        "hands position error RMS",
        "rest joint error RMS",
        "hands steps OK 40",
        "10 % of the path",
    ):
        assert words in shown, words
    with xr.open_dataset(out / "trajectory.nc") as data, (out / "trajectory.csv").open() as file:
        rows = list(csv.DictReader(file))
        assert float(rows[3]["x_hands.left_gripper.x"]) == data.x.values[3, 0]
        assert rows[3]["status_rest"] == str(data.task_status.values[3, 1]) and rows[-1]["status_rest"] == ""
        assert list(data.axis_tip.values[[0, 6, 12]]) == [*GRIPPERS, "joints"]
        assert json.loads(data.attrs["config"])["tasks"]["hands"]["radius"] == 0.05
        lines = pictures.error(data).axes[0].get_lines()
        assert [one.get_label() for one in lines] == ["hands [m]", "hands [rad]", "rest [rad]"]
        panels = pictures.tip(data, ck.load_urdf(BAXTER, tips=GRIPPERS)).axes
        assert [panel.get_title() for panel in panels] == GRIPPERS
        assert {"tip", "target", "start"} <= {one.get_label() for one in panels[1].get_lines()}
        data.task_status.values[3, 1] = ck.Status.GROWING
        labels = [one.get_text() for one in pictures.status(data).axes[0].get_yticklabels()]
        assert {"growing: rest", "near singular", "at limit"} <= set(labels) and "growing: hands" not in labels
        sizes = {tuple(np.ptp(panel.get_xlim(), keepdims=True)) for panel in panels}
        assert len(sizes) == 1  # all tips at one scale
    plt.close("all")
    assert {p.suffix for p in out.iterdir() if p.name != ".cnclik"} >= {".nc", ".csv", ".png"}


def test_as_json(stack, tmp_path, capsys):
    main(["solve", str(BAXTER), "--stack", stack, *STEPS, "--json", "--no-figures", "--out", str(tmp_path)])
    told = json.loads(capsys.readouterr().out)
    assert "rest: 14 joints" in told["asked"][-1] and "hands steps" in told["facts"]


@pytest.mark.slow
def test_tune(stack, tmp_path, capsys):
    """Both grippers of a real robot: a gain that no posture is too much for; the posture keeps its own."""
    loop = ["--Ts", "0.01", "--N", "20", "--delay", "2", "--steps", "8", "--out", tmp_path / "tuned"]
    main(["tune", *map(str, [BAXTER, "--stack", stack, *loop])])
    told = json.loads((tmp_path / "tuned" / "tuned.json").read_text())
    assert sorted(told["values"]) == ["hands.alpha"] and told["satisfied"]
    most = 27 / 256  # of an error that a step may take: no overshoot, even with three samples
    assert 1 - np.exp(-0.01 * told["values"]["hands.alpha"]) <= most * (1 + 1e-6)
    printed = capsys.readouterr().out
    assert "tasks hands, rest, EXP-MIDPOINT, Ts 10 ms, N 20.\n" in printed and "RMS error of rest: " in printed
    assert "error.png" in {file.name for file in (tmp_path / "tuned").iterdir()}


def test_what_is_wrong_is_one_line(stack, tmp_path, capsys):
    one = ["solve", BAXTER, "--no-figures", "--out", tmp_path]
    told = said(capsys, *one, "--stack", stack, "--target", "1", "2", "3")
    assert told.startswith("cnclik: Option `--target` must be left out with a stack") and told.count("\n") == 1
    assert "`--stack` must name a TOML file that can be read" in said(capsys, *one, "--stack", tmp_path / "none.toml")
    (tmp_path / "wrong.toml").write_text(FILE.replace("alpha = 10", 'alpha = "fast"'))
    assert "`tasks.hands.alpha` must be a number" in said(capsys, *one, "--stack", tmp_path / "wrong.toml")


# --- export -------------------------------------------------------------------------------------------


@NEEDS_C
def test_export(stack, tmp_path, capsys):
    """With paths the function takes the time; without them each tip's target, by the names of tasks and tips."""
    line = ["export", str(BAXTER), "--stack", stack, "--method", "EE", "--out"]
    main([*line, str(tmp_path / "paths")])
    assert "baxter, tasks hands, rest: step in double, EE along its tasks' paths" in capsys.readouterr().out
    assert "double t; " in (tmp_path / "paths" / "clik_step.h").read_text()
    main([*line, str(tmp_path / "free"), "--no-paths"])
    assert "EE to targets that are arguments" in capsys.readouterr().out
    header = (tmp_path / "free" / "clik_step.h").read_text()
    for name in ("hands_left_gripper_position[3]", "hands_right_gripper_rotation[9]", "rest_values[14]"):
        assert name in header, name
    for folder in ("paths", "free"):
        build = BUILD.format(name="clik_step") + " && ./example"
        subprocess.run(build, shell=True, cwd=tmp_path / folder, check=True, capture_output=True)


@NEEDS_C
def test_kinematics_of_all_tips(stack, tmp_path, capsys):
    main(["export", str(BAXTER), "--stack", stack, "--kinematics", "--out", str(tmp_path)])
    assert "baxter: kinematics in double" in capsys.readouterr().out
    header = (tmp_path / "clik_kinematics.h").read_text()
    for tip in GRIPPERS:
        assert f"{tip}_rotation[9]" in header and f"{tip}_jacobian[84]" in header
    build = BUILD.format(name="clik_kinematics") + " && ./example"
    subprocess.run(build, shell=True, cwd=tmp_path, check=True, capture_output=True)


# --- reach --------------------------------------------------------------------------------------------


def tips_at(row, robot):
    q = np.array([float(row[name]) for name in robot.joint_names])
    return {tip: ck.forward(robot, q, tip=tip) for tip in GRIPPERS}


@pytest.mark.slow
def test_reach_along_the_paths_of_a_stack(stack, tmp_path, capsys):
    out, robot = tmp_path / "answers.csv", ck.load_urdf(BAXTER, tips=GRIPPERS)
    main(["reach", str(BAXTER), "--stack", stack, "--points", "5", "--out", str(out)])
    shown = capsys.readouterr().out
    for words in ("baxter, tasks hands, rest\n", "5 points of the paths over 4 s", "Left out: rest.", "SOLVED"):
        assert words in shown, words
    paths = ck.problem_from(BAXTER, stack=stack).reference["hands"]
    for t, row in zip(np.linspace(0, 4, 5), csv.DictReader(out.open()), strict=True):
        for tip, at in tips_at(row, robot).items():
            place = np.array([float(row[f"hands.{tip}.t{i}3"]) for i in range(3)])
            np.testing.assert_allclose(place, paths[tip].curve(t)[0], atol=1e-5)
            np.testing.assert_allclose(at.position, place, atol=1e-5)
            assert float(row[f"hands.{tip}.position_error"]) < 1e-6
    main(["reach", str(BAXTER), "--stack", stack])
    assert "1 target in" in (shown := capsys.readouterr().out) and "where the paths begin" in shown
    assert "hands.left_gripper: " in shown and "least singular value" in shown


def test_reach_of_several_tips(tmp_path, capsys):
    """Targets by options, by columns of a table, and at random; what is written can be read again."""
    two = ["reach", str(BAXTER), *[word for tip in GRIPPERS for word in ("--tip", tip)], "--task", "position"]
    main([*two, "--target", "700", "300", "200", "mm", "--target", "0.7", "-0.3", "0.2"])
    assert "SOLVED" in (shown := capsys.readouterr().out)
    assert shown.startswith("baxter, task x y z of left_gripper; x y z of right_gripper")
    table = tmp_path / "targets.csv"
    head = "left_gripper.x [mm],left_gripper.y,left_gripper.z,right_gripper/x,right_gripper/y,right_gripper/z"
    table.write_text(f"{head}\n700,0.3,0.2,0.7,-0.3,0.2\n700,0.3,0.2,9,9,9\n")
    main([*two, str(table), "--out", str(tmp_path / "a.npz")])
    assert "SOLVED" in (shown := capsys.readouterr().out) and "OUT_OF_REACH" in shown
    with np.load(tmp_path / "a.npz") as data:
        np.testing.assert_allclose(data["targets"][0, :, :3, 3], [[0.7, 0.3, 0.2], [0.7, -0.3, 0.2]])
        assert list(data["tip"]) == GRIPPERS
        assert data["tip_position_error"][0].max() < 1e-6 and data["tip_position_error"][1, 1] > 1
    main([*two, str(tmp_path / "a.npz")])
    assert "2 targets" in capsys.readouterr().out
    main([*two[:-1], "pose", "--random", "7", "--json"])
    assert json.loads(capsys.readouterr().out)["status"] == {"SOLVED": 7}


LEVELS = """
[tasks.left]
task = "position"
tip = "left_gripper"
target = [0.7, 0.3, 0.2]
level = 1
damping = 0.001
[tasks.right]
task = "position"
tip = "right_gripper"
relative_to = "left_gripper"
target = [0.0, 0.0, 3.0]
level = 2
damping = 0.1
[tasks.rest]
task = "joints"
level = 3
damping = 1
"""


def test_the_nearest_pose_keeps_upper_levels(tmp_path, capsys):
    (tmp_path / "levels.toml").write_text(LEVELS)
    main(["reach", str(BAXTER), "--stack", str(tmp_path / "levels.toml")])
    shown = capsys.readouterr().out
    assert "Where not all can be had: left before right." in shown and "Left out: rest." in shown
    missed = [(float(v), unit) for v, unit in re.findall(r"gripper: (\S+) (\S*m)\b", shown)]
    assert missed[0][1] in ("µm", "nm") and missed[1][0] > 1 and missed[1][1] == "m", shown


@pytest.mark.parametrize(
    ("argv", "told"),
    [
        (["--tip", GRIPPERS[0], "--tip", GRIPPERS[0]], "`--tip` must hold different names"),
        (["--tip", GRIPPERS[0], "--tip", "right"], "`--tip` must be one of the"),
        ([*["--tip", GRIPPERS[0], "--tip", GRIPPERS[1]], "--target", "1", "0", "0"],
         f"`--target` must be given once for each tip ({', '.join(GRIPPERS)}), but is given 1 times"),
        (["--tip", GRIPPERS[0], "--tip", GRIPPERS[1], "TABLE"], "have columns for each tip, such as left_gripper.x"),
        (["--stack", "STACK", "--tip", GRIPPERS[0]], "`--tip` must be left out with a stack"),
        (["--stack", "STACK", "--target", "1", "2", "3"], "`--target` must be left out with a stack"),
        (["--stack", "STACK", "--near", "0", "0"], "`--near` must have shape (14,), but has shape (2,)"),
        (["--stack", "HELD", "--points", "3"], "`--points` must be left out where targets stand still"),
        (["--tip", GRIPPERS[0], "--random", "1", "--points", "3"], "`--points` must come with the paths of a stack"),
        ([], "--random N and --stack FILE must be given, but there is none of them"),
    ],
)  # fmt: skip
def test_what_reach_refuses(argv, told, stack, tmp_path, capsys):
    (tmp_path / "held.toml").write_text('[tasks.a]\ntip = "left_gripper"\n')
    (tmp_path / "table.csv").write_text("x,y,z\n1,2,3\n")
    known = {"STACK": stack, "HELD": tmp_path / "held.toml", "TABLE": tmp_path / "table.csv"}
    more = [] if {"--stack", "--random", "TABLE", "--target"} & {*argv} or not argv else ["--random", "1"]
    assert told in said(capsys, "reach", BAXTER, *(known.get(word, word) for word in argv), *more)


def test_a_loop_begins_where_all_paths_do(stack, tmp_path, capsys):
    begin = ["--begin", "on-path", "--no-figures", "--out", str(tmp_path)]
    main(["solve", str(BAXTER), "--stack", stack, *STEPS, *begin])
    assert "(on the path)" in capsys.readouterr().out
    with xr.open_dataset(tmp_path / "trajectory.nc") as data:
        assert np.abs(data.e.values[:, :12]).max() < 1e-3


def test_a_waypoint_file_has_columns_for_each_tip(tmp_path):
    head = "time," + ",".join(f"{tip}.{axis}" for tip in GRIPPERS for axis in "xyz")
    (tmp_path / "way.csv").write_text(f"{head}\n0,0.7,0.3,0.2,0.7,-0.3,0.2\n1,0.7,0.4,0.2,0.7,-0.5,0.2\n")
    (tmp_path / "s.toml").write_text(f'[tasks.a]\ntask = "position"\ntip = {GRIPPERS}\nreference = "way.csv"\n')
    made = ck.problem_from(BAXTER, stack=tmp_path / "s.toml", N=5)
    ends = [made.reference["a"][tip].curve(1.0)[0] for tip in GRIPPERS]
    np.testing.assert_allclose(ends, [[0.7, 0.4, 0.2], [0.7, -0.5, 0.2]], atol=1e-6)


@pytest.mark.slow
def test_one_file_in_every_verb(tmp_path):
    """As a user calls them, as processes: the same file for all verbs that take stacks."""
    (tmp_path / "stack.toml").write_text(FILE)
    head = 'question = "q"\nexpectation = "e"\nmetrics = ["rms_error"]\n'
    fixed = f'[fixed]\nrobot = "{BAXTER}"\nstack = "stack.toml"\nN = 20\n'
    (tmp_path / "sweep.toml").write_text(head + fixed + '[axes]\nmethod = ["EE", "EXP-EE"]\n')
    every = {
        "solve": ["--stack", "stack.toml", "--N", "20", "--no-figures"],
        "export": ["--stack", "stack.toml", "--method", "EE", "--out", "step"],
        "reach": ["--stack", "stack.toml"],
    }
    lines = [[verb, str(BAXTER), *options] for verb, options in every.items()] + [
        ["sweep", "sweep.toml", "--no-figures"]
    ]
    for line in lines:
        done = subprocess.run([sys.executable, "-m", "cnclik", *line], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, (line, done.stderr)
