"""`cnclik solve` and `reach` as users meet them: files, figures, what was asked, summary and verdict."""

import csv
import json
import re

import numpy as np
import pytest
import xarray as xr

import cnclik as ck
from cnclik import writing
from cnclik.cli import main
from tests.problem.test_build import TWO

ARM = ["solve", "planar:1,1", "--method", "EE", "--N", "30"]
HAND = """<robot name="hand"><link name="base"/><link name="arm"/><link name="wrist"/><link name="flange"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
  <limit lower="-2" upper="2" velocity="3"/></joint>
<joint name="j2" type="revolute"><parent link="arm"/><child link="wrist"/><origin xyz="0.4 0 0"/><axis xyz="0 0 1"/>
  <limit lower="-2" upper="2" velocity="3"/></joint>
<joint name="j3" type="revolute"><parent link="wrist"/><child link="flange"/><origin xyz="0.3 0 0"/>
  <axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="3"/></joint></robot>"""


def shown(capsys, *argv):
    main(list(map(str, argv)))
    return " ".join(capsys.readouterr().out.split())


def test_files_hold_the_run(tmp_path, capsys):
    assert "the gain is 0" in shown(capsys, *ARM, "--alpha", "0", "--out", tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {writing.LIST, "trajectory.nc", "overview.png", "tip.png"}
    with xr.open_dataset(tmp_path / "trajectory.nc") as data:
        assert data.q.shape == (31, 2) and json.loads(data.attrs["config"])["robot"] == "planar:1,1"


def test_a_file_of_others_in_the_way_is_named_before_the_loop_is_run(tmp_path, capsys, monkeypatch):
    (tmp_path / "tip.png").write_text("theirs")
    monkeypatch.setattr("cnclik.problem.build.Problem.run", None)
    with pytest.raises(SystemExit) as stopped:
        main([*ARM, "--out", str(tmp_path)])
    assert stopped.value.code == 2 and "tip.png there is not cnclik's own" in capsys.readouterr().err


def test_what_was_asked_is_said(tmp_path, capsys):
    run = [*ARM[:4], "--N", "3", "--no-figures", "--out", tmp_path]
    said = shown(capsys, *run)
    assert said.startswith(
        "planar:1,1, x, y [m]; N = 3 steps of Ts = 10 ms EE, pseudoinverse, alpha = 5 1/s, ideal drive"
    )
    assert "Start: q0 = [-1.0576, 1.5654] rad Target [-0.20756, 1.1731] m" in said  # every joint by 0.3 rad
    given = ["--Ts", "4ms", "--q0", "0.5", "1", "--target", "0.3", "1.2", "--alpha", "4", "--delay", "8"]
    said = shown(capsys, *run, *given)
    assert "8 samples (32 ms)" in said and "q0 = [0.5, 1] rad Target [0.3, 1.2] m" in said


def test_a_path_may_begin_where_the_arm_is_not_or_the_arm_on_the_path(tmp_path, capsys):
    way = tmp_path / "way.csv"
    way.write_text("time,x,y\n0,0.8,0.9\n2,0.5,1.1\n")
    run = [*ARM[:4], "--reference", way, "--N", "3", "--no-figures", "--out", tmp_path / "out", "--q0", "0.3", "0.9"]
    for begin, jump in ((), True), (("--begin", "on-path"), False):
        assert "Path from [0.8, 0.9] m" in shown(capsys, *run, *begin)
        with xr.open_dataset(tmp_path / "out" / "trajectory.nc") as data:
            assert (np.abs(data.e.values[0]).max() > 1e-3) == jump


def test_what_a_loop_did_and_what_to_change(tmp_path, capsys):
    """The exit code is that of a command that did its work; what --json prints mends the loop."""
    assert "(q1), no limits" in shown(capsys, *ARM, "--alpha", "1e308", "--no-figures", "--out", tmp_path)  # not finite
    loop = ["solve", "planar:1,1", "--task", "xy", "--target", "0.5", "1.2", "--Ts", "0.1", "--method", "EE", "--N", 40]
    loop += ["--no-figures", "--json", "--out", tmp_path]
    swings = json.loads(shown(capsys, *loop, "--alpha", "26"))["verdict"]
    assert swings["kind"] in ("swinging", "growing")
    (name, value), *_ = swings["change"].items()
    assert name == "alpha" and f"{value:.4g} 1/s" in swings["sentence"]
    assert json.loads(shown(capsys, *loop, "--alpha", value))["verdict"]["kind"] == "settled"


def test_a_problem_in_a_file(tmp_path, capsys):
    (tmp_path / "cell.py").write_text(TWO)
    run = ["solve", tmp_path / "cell.py", "--N", "20", "--Ts", "4ms", "--no-figures", "--out", tmp_path / "out"]
    said = shown(capsys, *run, "--alpha", "3")
    assert said.startswith("cell, hand: x, y [m] of tip; rest: q1, q2, q3 [rad]; N = 20 steps of Ts = 4 ms")
    assert "levels, alpha = 3 1/s" in said and "hand error [m] RMS zero" in said
    assert "hand: 3 1/s (z = 0.012), within" in shown(
        capsys, "stability", tmp_path / "cell.py", "--Ts", "4ms", "--delay", "2", "--alpha", "3"
    )
    said = shown(capsys, "export", tmp_path / "cell.py", "--method", "EE", "--out", tmp_path / "step")
    assert "to targets that are arguments" in said and "hand_position" in (tmp_path / "step/clik_step.h").read_text()


def test_a_full_disk_leaves_the_answer(tmp_path, monkeypatch, capsys):
    def full(*paths):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(writing.os, "replace", full)
    with pytest.raises(SystemExit) as left:
        main([*ARM, "--no-figures", "--out", str(tmp_path / "out")])
    said = capsys.readouterr()
    assert left.value.code == 2 and "No space left on device" in said.err and "joint velocity" in said.out
    assert not list(tmp_path.rglob(".partial-*"))


def test_the_fastest_joint_is_named_and_whose_limit_is_nearest(capsys, tmp_path):
    """In numbers without powers of ten: "1.67e+05 % of a joint's limit; 0 µs a step; 0.00918 µm"."""
    (tmp_path / "hand.urdf").write_text(HAND.replace('velocity="3"', 'velocity="0.01"', 1))
    run = ["solve", tmp_path / "hand.urdf", "--task", "xy", "--q0", 0.5, 0.9, 0.2, "--no-figures"]
    run += ["--out", tmp_path / "out"]
    said = shown(capsys, *run, "--reference", "circle", "--radius", "0.05")
    assert re.search(r"the error is at most [\d.]+ nm", said) and not re.search(r" 0 µs|e-\d+ µ", said), said
    run += ["--N", 40, "--target", 0.3, 0.3]
    said = shown(capsys, *run)
    fast = re.search(r"joint velocity up to (\S+) rad/s \((j\d)\), \d{1,3},\d{3} % of the limit of j1", said)
    with xr.open_dataset(tmp_path / "out" / "trajectory.nc") as data:
        most = np.abs(data.qdot.values).max(0)
    assert fast[2] == f"j{1 + most.argmax()}" != "j1" and float(fast[1]) == pytest.approx(most.max(), rel=1e-2)
    assert "up to 0 rad/s (j1), 0 % of its limit" in shown(capsys, *run, "--alpha", 0)  # not "no limits"


def test_random_targets_as_json_and_a_remark_is_one_line_and_an_entry_of_it(tmp_path, capsys):
    file = tmp_path / "hand.urdf"
    heavy = '<link name="arm"><inertial><mass value="heavy"/></inertial></link>'
    file.write_text(HAND.replace('<link name="arm"/>', heavy))
    main(["reach", str(file), "--random", "50", "--task", "xy", "--json"])
    said = capsys.readouterr()
    assert said.err.count("as one without masses") == said.err.count("\n") == 1
    found = json.loads(said.out)
    assert found["targets"] == 50 and found["solve_rate"] == 1.0 and found["status"] == {"SOLVED": 50}
    assert found["seconds"] > 0 and found["remarks"][0].startswith("Link")


LINKS = "planar:1,0.8"


def test_answers_in_a_file(tmp_path, capsys):
    """Of two places that can be reached and one that can't."""
    (tmp_path / "targets.csv").write_text("x,y,z\n0.5,1,0\n# a comment\n-0.3,0.7,0\n4,0,0\n")
    said = shown(capsys, "reach", LINKS, tmp_path / "targets.csv", "--task", "xy", "--out", tmp_path / "out.csv")
    assert "3 targets" in said and "SOLVED" in said and "OUT_OF_REACH" in said and "nearest pose" in said
    rows = list(csv.DictReader((tmp_path / "out.csv").open()))
    assert [r["status"] for r in rows] == ["SOLVED", "SOLVED", "OUT_OF_REACH"]
    for row, x in zip(rows, [(0.5, 1.0), (-0.3, 0.7)], strict=False):
        at = ck.forward(ck.planar_arm([1.0, 0.8]), np.array([float(row["q1"]), float(row["q2"])])).position
        assert np.linalg.norm(np.asarray(at)[:2] - x) < 1e-6
    assert abs(float(rows[2]["position_error"]) - 2.2) < 1e-4
    zero = ["--target", "2", "-0.0", "--near", "0", "-0.0"]
    main(["reach", "planar:1,1", "--task", "xy", *zero, "--out", str(tmp_path / "zero.csv")])
    assert "-0.0," not in (tmp_path / "zero.csv").read_text()  # which an arm at its zero often has


def test_a_path_with_a_jump(tmp_path, capsys):
    (tmp_path / "path.csv").write_text("0.5,1,0\n0.52,1,0\n-0.5,-1,0\n")
    said = shown(capsys, "reach", LINKS, tmp_path / "path.csv", "--task", "xy", "--path", "--jump", "0.3")
    assert "SOLVED" in said and "JUMP" in said and "no joint values" in said
    assert re.search(r"half-way between rows the tip strays by up to \S+ .?m$", said)


def test_one_target_as_solve_takes_it(capsys):
    main(["reach", LINKS, "--task", "position", "--target", "700", "300", "0", "mm"])
    said = capsys.readouterr().out
    assert "SOLVED" in said and "q1 " in said and re.search(r"1 target in \S+ s\n", said)
    assert re.search(r"\n  error (zero|\S+ .?m)\n", said)
    assert "OUT_OF_REACH" in shown(capsys, "reach", LINKS, "--task", "position", "--target", 700, 300, 0)
