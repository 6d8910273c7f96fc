"""`cnclik reach` as a user meets it: targets from files, answers in files, a map, and one line for bad input."""

import csv
import json
import re

import numpy as np
import pytest

import cnclik as ck
from cnclik.cli import main

ARM = "planar:1,0.8"
CHAIN = ck.planar_arm([1.0, 0.8])


@pytest.fixture
def targets(tmp_path):
    """Two places that can be reached and one that can't."""
    path = tmp_path / "targets.csv"
    path.write_text("x,y,z\n0.5,1,0\n# a comment\n-0.3,0.7,0\n4,0,0\n")
    return path


def errors_of(q, x):
    return np.linalg.norm(np.asarray(ck.forward(CHAIN, q).position)[:2] - x)


def test_answers_in_a_file(targets, tmp_path, capsys):
    main(["reach", ARM, str(targets), "--task", "xy", "--out", str(tmp_path / "out.csv")])
    shown = capsys.readouterr().out
    assert "3 targets" in shown and "SOLVED" in shown and "OUT_OF_REACH" in shown and "nearest pose" in shown
    rows = list(csv.DictReader((tmp_path / "out.csv").open()))
    assert [r["status"] for r in rows] == ["SOLVED", "SOLVED", "OUT_OF_REACH"]
    for row, x in zip(rows, [(0.5, 1.0), (-0.3, 0.7)], strict=False):
        assert errors_of(np.array([float(row["q1"]), float(row["q2"])]), x) < 1e-6
    assert abs(float(rows[2]["position_error"]) - 2.2) < 1e-4
    main(["reach", "planar:1,1", "--target", "2", "-0.0", "--task", "xy", "--near", "0", "-0.0",
          "--out", str(tmp_path / "zero.csv")])  # fmt: skip
    assert "-0.0," not in (tmp_path / "zero.csv").read_text()  # which an arm at its zero often has


def test_random_targets_as_json(capsys):
    main(["reach", ARM, "--random", "50", "--task", "xy", "--json"])
    said = json.loads(capsys.readouterr().out)
    assert said["targets"] == 50 and said["solve_rate"] == 1.0 and said["status"] == {"SOLVED": 50}
    assert said["seconds"] > 0


def test_a_path_with_a_jump(tmp_path, capsys):
    (tmp_path / "path.csv").write_text("0.5,1,0\n0.52,1,0\n-0.5,-1,0\n")
    main(["reach", ARM, str(tmp_path / "path.csv"), "--task", "xy", "--path", "--jump", "0.3"])
    shown = capsys.readouterr().out
    assert "SOLVED" in shown and "JUMP" in shown and "no joint values" in shown
    assert re.search(r"half-way between rows the tip strays by up to \S+ .?m\n", shown)


def test_one_target_as_solve_takes_it(capsys):
    main(["reach", ARM, "--task", "position", "--target", "700", "300", "0", "mm"])
    said = capsys.readouterr().out
    assert "SOLVED" in said and "q1 " in said and re.search(r"1 target in \S+ s\n", said)
    assert re.search(r"\n  error (zero|\S+ .?m)\n", said)
    main(["reach", ARM, "--task", "position", "--target", "700", "300", "0"])
    assert "OUT_OF_REACH" in capsys.readouterr().out
