"""`cnclik solve`, `robots` and `trouble` as a user meets them: files, figures, summary, and one line for bad input."""

import csv
import errno
import itertools
import json

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr

import cnclik as ck
from cnclik import writing
from cnclik.cli import main
from cnclik.show import run as pictures


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    out = tmp_path_factory.mktemp("solved")
    main(["solve", "planar:1,1", "--method", "EE", "--N", "30", "--alpha", "0", "--csv", "--out", str(out)])
    return out


def test_files_hold_the_run(solved):
    names = {"trajectory.nc", "trajectory.csv", "error.png", "joints.png", "status.png", "tip.png", "velocities.png"}
    assert {p.name for p in solved.iterdir()} == {writing.LIST, *names}
    with xr.open_dataset(solved / "trajectory.nc") as data, (solved / "trajectory.csv").open() as file:
        rows = list(csv.DictReader(file))
        assert len(rows) == 31
        np.testing.assert_array_equal([float(r["q_q2"]) for r in rows], data.q.values[:, 1])
        assert rows[-1]["status"] == "" and rows[0]["status"] == "0"


def test_a_run_without_csv_and_figures_leaves_none_of_an_earlier_one(tmp_path, capsys, monkeypatch):
    """They would be of another result; a file of others in the way is named before the loop is run."""
    again = ["solve", "planar:1,1", "--method", "EE", "--N", "30", "--no-figures", "--out", str(tmp_path)]
    main([*again, "--csv"])
    (tmp_path / "notes.txt").write_text("theirs")
    main(again)
    assert {p.name for p in tmp_path.iterdir()} == {writing.LIST, "trajectory.nc", "notes.txt"}
    (tmp_path / "trajectory.csv").write_text("theirs, too")
    main(again)
    assert (tmp_path / "trajectory.csv").read_text() == "theirs, too"
    monkeypatch.setattr("cnclik.cli.solve._march", None)
    with pytest.raises(SystemExit) as stopped:
        main([*again, "--csv"])
    assert stopped.value.code == 2 and "trajectory.csv there is not cnclik's own" in capsys.readouterr().err


def test_summary_tells_of_a_gain_that_corrects_nothing(tmp_path, capsys):
    main(["solve", "planar:1,1", "--method", "EE", "--N", "30", "--alpha", "0", "--no-figures", "--out", str(tmp_path)])
    shown = " ".join(capsys.readouterr().out.split())
    assert "planar:1,1, tip end of the last link, task x y, N = 30 steps" in shown
    assert "Held back: the gain is 0; over the last quarter" in shown


def test_remedies_are_options(tmp_path, capsys):
    """What --json prints is what the sentence says, and taken as options it mends."""
    loop = ["solve", "planar:1,1", "--task", "xy", "--target", "0.5", "1.2", "--Ts", "0.1", "--method", "EE"]
    loop += ["--no-figures", "--json", "--out", str(tmp_path)]

    def told(*options):
        main([*loop, *options])
        return json.loads(capsys.readouterr().out)["verdict"]

    shakes = told("--alpha", "26", "--N", "40")
    assert shakes["kind"] in ("swinging", "growing") and shakes["change"] == {"alpha": pytest.approx(2.5)}
    assert "Use an alpha of at most 2.5 1/s." in shakes["sentence"]
    assert told("--alpha", "2.5", "--N", "60")["kind"] == "settled"
    short = told("--alpha", "0.2", "--N", "10")
    assert short["kind"] == "too short to tell" and f"Run {short['change']['N']} steps." in short["sentence"]
    assert told("--alpha", "0.2", "--N", str(short["change"]["N"]))["kind"] == "settled"


def test_a_figure_that_cannot_be_drawn_costs_no_data(tmp_path, monkeypatch, capsys):
    def broken(data):
        raise ValueError("no ink")

    monkeypatch.setattr(pictures, "error", broken)
    with pytest.raises(SystemExit) as left:
        main(["solve", "planar:1,1", "--method", "EE", "--N", "30", "--alpha", "0", "--out", str(tmp_path)])
    said = capsys.readouterr().err.strip().splitlines()
    assert left.value.code == 1 and "no ink" in said[-1]
    assert {"trajectory.nc", "joints.png"} <= {p.name for p in tmp_path.iterdir()}


def test_a_disk_that_is_full_at_any_write_loses_no_file_before_it(solved, tmp_path, monkeypatch, capsys):
    """Every write of the command fails once: each file that was finished is in the folder, and the answer is given."""
    names, check = {p.name for p in solved.iterdir()}, writing.check_target
    for failing in itertools.count():
        calls, out = itertools.count(), tmp_path / f"out{failing}"

        def checked(target, overwrite, calls=calls, failing=failing):
            if target.parent.exists() and next(calls) == failing:
                raise OSError(errno.ENOSPC, "No space left on device")
            check(target, overwrite=overwrite)

        monkeypatch.setattr(writing, "check_target", checked)
        try:
            main(["solve", "planar:1,1", "--method", "EE", "--N", "30", "--alpha", "0", "--csv", "--out", str(out)])
        except SystemExit as left:
            shown = capsys.readouterr()
            said = shown.err.strip().splitlines()
            assert left.code == 2 and "No space left on device" in said[-1]
            assert ("another --out" in said[-1]) == (failing < 2) and "joint velocity" in shown.out
            assert "Held back: the gain is 0" in shown.out, shown.out
            found = {p.name for p in out.glob("*.*")} - {writing.LIST}
            assert found < names and len(found) == failing
        else:
            break
        assert not list(tmp_path.rglob(".partial-*"))
    assert failing == 7  # two files of data and five figures: each failed once
    assert {p.name for p in out.iterdir()} == names


def test_a_joint_at_rest_is_drawn_at_rest(solved):
    with xr.open_dataset(solved / "trajectory.nc") as data:
        data = data.load()
    data.qdot.values[:, 0] = 1.0
    data.qdot.values[:, 1] = 1e-17 * np.resize([1, -1], data.qdot.shape[0])
    figure = pictures.joint_velocities(data, ck.planar_arm([1.0, 1.0]))
    low, high = figure.axes[1].get_ylim()
    plt.close(figure)
    assert high - low > 0.01


@pytest.mark.parametrize(
    "argv, told",
    [
        (["robots", "nowhere.urdf"], "No such file"),
        (["solve", "nowhere.urdf"], "No such file"),
        (["solve", "panda", "--q0", "0", "nan", "0", "0", "0", "0", "0"], "must be finite"),
        (["solve", "panda", "--q0", "1"], "must have shape (7,)"),
        (["solve", "panda", "--alpha", "-1"], "at least 0"),
        (["solve", "panda", "--near-singular", "x"], "must be a number"),
    ],
)
def test_bad_input_is_one_line_and_2(argv, told, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as left:
        main(argv)
    shown = capsys.readouterr()
    assert left.value.code == 2 and told in shown.err and shown.out == ""
    assert shown.err.count("\n") == 1 and not any(tmp_path.iterdir())
