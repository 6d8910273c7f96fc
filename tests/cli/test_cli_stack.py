"""`cnclik solve --stack` as a user meets it: what was asked, each task's errors, files, figures; other verbs refuse."""

import csv
import json

import matplotlib.pyplot as plt
import pytest
import xarray as xr

import cnclik as ck
from cnclik.cli import main
from cnclik.show import run as pictures
from tests.problem.test_stack import FILE
from tests.robot.test_trees import BAXTER, GRIPPERS


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
    out, page = tmp_path / "out", tmp_path / "page.html"
    main(["solve", str(BAXTER), "--stack", stack, "--N", "40", "--csv", "--out", str(out), "--report", str(page)])
    shown = " ".join(capsys.readouterr().out.split())
    for words in (
        "baxter, tasks hands, rest, N = 40 steps of Ts = 10 ms EXP-MIDPOINT, levels Start: q0",
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
        labels = [one.get_text() for one in pictures.status(data).axes[0].get_yticklabels()]
        assert "growing: hands" in labels and "growing: rest" in labels and "at limit" in labels
    plt.close("all")
    assert {p.suffix for p in out.iterdir() if p.name != ".cnclik"} >= {".nc", ".csv", ".png"}
    assert "hands" in page.read_text() and "The moving robot is left out" in page.read_text()
    assert "is of a stack" in said(capsys, "view", out / "trajectory.nc", "--html", tmp_path / "view.html")


def test_as_json(stack, tmp_path, capsys):
    main(["solve", str(BAXTER), "--stack", stack, "--N", "3", "--json", "--no-figures", "--out", str(tmp_path)])
    told = json.loads(capsys.readouterr().out)
    assert "rest: 14 joints" in told["asked"][-1] and "hands steps" in told["facts"]


@pytest.mark.parametrize("verb", ["tune", "export", "view", "stability", "reach"])
def test_other_verbs_refuse(verb, stack, tmp_path, capsys):
    more = {"export": ["--out", str(tmp_path)], "reach": ["--random", "1"]}.get(verb, [])
    told = said(capsys, verb, BAXTER, "--stack", stack, *more)
    assert f"`stack` must be left out for `cnclik {verb}`, which takes one task so far" in told


def test_what_is_wrong_is_one_line(stack, tmp_path, capsys):
    one = ["solve", BAXTER, "--no-figures", "--out", tmp_path]
    told = said(capsys, *one, "--stack", stack, "--target", "1", "2", "3")
    assert told.startswith("cnclik: Argument `target` must be left out with a stack") and told.count("\n") == 1
    assert "`stack` must name a TOML file that can be read" in said(capsys, *one, "--stack", tmp_path / "none.toml")
    (tmp_path / "wrong.toml").write_text(FILE.replace("alpha = 10", 'alpha = "fast"'))
    assert "`tasks.hands.alpha` must be a number" in said(capsys, *one, "--stack", tmp_path / "wrong.toml")
