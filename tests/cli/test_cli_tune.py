"""`cnclik tune` as a user meets it."""

import json

import numpy as np
import pytest

import cnclik as ck
from cnclik.cli import main

ARM = ["tune", "planar-clockwise:1,1", "--reference", "line", "--target", "0", "1", "--q0", "0"]
ARM += [str(np.pi / 2), "--method", "EE", "--Ts", "0.1", "--N", "30"]
KEYS = {"cnclik", "alpha", "values", "loss", "losses", "speeds", "satisfied", "status", "why", "evaluations", "drive"}
KEYS |= {"response", "gains", "config"}


def tuned(tmp_path, *options):
    main([*ARM, *map(str, options), "--out", str(tmp_path)])
    return json.loads((tmp_path / "tuned.json").read_text())


def test_numbers_and_a_figure(tmp_path, capsys):
    made = tuned(tmp_path, "--delay", 0, "--damping", 0.01)
    assert set(made) == KEYS and made["config"]["damping"] == 0.01 and made["config"]["N"] == 30
    assert made["satisfied"] and made["alpha"] == made["values"]["alpha"] == pytest.approx(2.5)
    assert made["alpha"] == made["gains"]["recommended"] and made["response"]["overshoot"] < 0.01
    assert made["losses"][1] == pytest.approx(2.13e-3, rel=1e-2)
    out = capsys.readouterr().out
    assert "alpha = 2.5 1/s (from 5)\n" in out and f"Wrote error.png, tuned.json to {tmp_path}/." in out
    assert (tmp_path / "error.png").stat().st_size > 10_000


def test_unknown_drives_are_assumed(tmp_path, capsys):
    made = tuned(tmp_path, "--no-figures")
    assert made["gains"]["assumed"] and made["alpha"] < 2 and made["drive"]["lag"] == 0.1
    assert "drives: 0.3 samples (30 ms) of dead time, a lag of 100 ms, assumed" in capsys.readouterr().out


def test_a_path_that_no_gain_makes_slow_enough_ends_with_1(tmp_path, capsys):
    """A quarter of a metre in the 0.1 s of the run is beyond a UR5's joints."""
    run = "tune ur5 --task position --reference line --target 0.3 -0.3 0.4 --N 5 --delay 0 --Ts 0.01 --method EE"
    with pytest.raises(SystemExit) as stopped:
        main([*run.split(), "--no-figures", "--out", str(tmp_path)])
    assert stopped.value.code == 1 and "No values were found that keep the limits" in capsys.readouterr().out
    assert json.loads((tmp_path / "tuned.json").read_text())["status"] == "infeasible"


def test_a_drive_for_each_joint_as_a_fit_prints_it(tmp_path):
    """The slowest decides here."""
    options = ["--delay", 1, "--command", "position", "--no-figures", "--lag", 0.05, 0.2]
    made = tuned(tmp_path, *options)
    allowed = ck.gains(Ts=0.1, method="EE", drive=ck.Drive(delay=1, command="position", lag=0.2)).recommended
    assert made["satisfied"] and made["alpha"] == pytest.approx(allowed, rel=1e-6)
