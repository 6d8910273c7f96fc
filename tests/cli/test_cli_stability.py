"""`cnclik stability`: the table of gains and what it says, a robot, figures with their data, and bad input."""

import dataclasses
import json
import re

import numpy as np
import pytest
import xarray as xr

import cnclik as ck
from cnclik.cli import main
from cnclik.writing import LIST

GAINS = ("largest_stable", "without_overshoot", "recommended")


def shown(capsys, *options):
    """What the command prints, in one line."""
    main(["stability", *map(str, options)])
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("options", "drive", "loop"),
    [
        ("", None, {}),
        ("--Ts 2ms --delay 34ms", {"delay": 17}, {"Ts": 0.002}),
        ("--delay 0", {}, {}),
        ("--delay 2 --method CN --M 2", {"delay": 2.0}, {"method": "CN", "M": 2}),
        ("--lag 10 50 ms", {"lag": [0.01, 0.05]}, {}),
        ("--natural-frequency 5Hz --damping-ratio 0.4 --command position",
         {"natural_frequency": 10 * np.pi, "damping_ratio": 0.4, "command": "position"}, {}),
        ("--delay 1 --cutoff 20Hz --smoothed command", {"delay": 1.0, "cutoff": 20.0, "smoothed": "command"}, {}),
        ("--delay 1 --smoothing 0.5", {"delay": 1.0, "smoothing": 0.5}, {}),
    ],
)  # fmt: skip
def test_the_table_has_the_three_gains_and_those_of_explicit_euler(options, drive, loop, capsys):
    said = shown(capsys, *options.split())
    loop = {"Ts": 0.01, "drive": drive if drive is None else ck.Drive(**drive)} | loop
    ours, euler = ck.gains(**loop), ck.gains(**loop | {"method": "EE", "M": None})
    wanted = [(alpha := getattr(ours, n), alpha * ours.Ts, getattr(euler, n)) for n in GAINS]
    table = said.replace("no limit", "inf")
    rows = [re.search(rf"{n.replace('_', ' ')} (\S+) (\S+) (\S+) ", table).groups() for n in GAINS]
    np.testing.assert_allclose(np.array(rows, float), wanted, rtol=1e-3)
    assert f"{1e3 * 0.1 * ours.response.lag:.3g} mm without feed-forward" in said
    assert f"a step does not overshoot and settles in {ours.response.settling_time:.3g} s" in said
    assert f"MoveIt Servo {euler.recommended:.4g} " in said and ("assumed" in said) == (drive is None)


def test_json_has_the_same_numbers(capsys):
    main(["stability", "--Ts", "10ms", "--delay", "3", "--lag", "20ms", "--alpha", "4", "50", "--json"])
    said, gains = json.loads(capsys.readouterr().out), ck.gains(Ts=0.01, drive=ck.Drive(delay=3, lag=0.02))
    assert [said[name] for name in GAINS] == [getattr(gains, name) for name in GAINS]
    assert said["recommended_response"] == dataclasses.asdict(gains.response) and said["reason"] == gains.reason
    assert said["explicit_euler"]["recommended"] == gains.by("EE").recommended
    assert [(each["alpha"], each["stable"]) for each in said["alpha"]] == [(4.0, True), (50.0, False)]
    assert said["elsewhere"]["pink"]["value"] == gains.elsewhere["pink"].value
    with pytest.raises(SystemExit):
        main(["stability", "--json", "--draw", "gains"])


def test_the_given_gain_is_judged(capsys):
    drive = ("--Ts", "10ms", "--delay", 3, "--lag", "20ms")
    gains = ck.gains(Ts=0.01, drive=ck.Drive(delay=3, lag=0.02))
    said, response = shown(capsys, *drive, "--alpha", 12), gains.at(12)
    assert "yours 12 0.12 " in said and "Your gain (alpha = 12 1/s) is stable: a step overshoots by 12 %" in said
    swings = shown(capsys, "--Ts", "10ms", "--delay", 3, "--alpha", 12)  # above 11.15, by 0.03 %
    assert "a step overshoots by less than 0.1 % (ζ = 0.93)" in swings
    late = response.delay_margin / 0.01
    assert f"tolerates {response.gain_margin:.3g} times this gain, or {late:.4g} samples" in said
    said = shown(capsys, *drive, "--alpha", 50, 4)  # each gain of several
    assert "alpha = 4 1/s) is stable: a step does not overshoot and settles in" in said
    assert f"alpha = 50 1/s) is UNSTABLE where J# gives all that it asks for: {gains.largest_stable:.4g} 1/s" in said
    assert "Your gain (alpha = 0 1/s) asks for no motion." in shown(capsys, *drive, "--alpha", 0)
    assert "yours" not in shown(capsys, *drive)  # nobody gave one
    said = shown(capsys, "--Ts", "0.01", "--delay", "6", "--lag", "4000")  # too slow to settle
    assert "does not settle to within 2 % in the simulated time" in said and "inf" not in said


def test_a_robot_adds_its_joints_speeds_and_other_rates(capsys):
    drive = ("--Ts", "10ms", "--delay", 3, "--speed", 0.25)
    alone, robot = (shown(capsys, *robot, *drive) for robot in ([], ["ur5"]))
    line = re.search(r" ur5 at its start: 0\.25 m/s in .* needs [\d.]+ % of joint \w+'s velocity limit\.", robot)
    assert robot.replace(line[0], "") == alone  # the gains have no robot in them
    held = ("--limits", "bounded", "--damping", 0.05, "--task", "position")
    limits = (
        "joint limits: 10 1/s (z = 0.1), overshoots with one more sample of dead time: recommended up to 8.192 1/s."
    )
    said = shown(capsys, "ur5", *drive, *held)
    assert limits in said
    main(["stability", "ur5", *map(str, (*drive, *held)), "--json"])
    facts = json.loads(capsys.readouterr().out)["robot"]
    assert f"{100 * facts['share_of_its_velocity_limit']:.3g} % of joint {facts['joint']}'s" in said
    assert [rate["answer"] in said for rate in facts["rates"]] == [True, True]
    assert shown(capsys, "ur5", "--delay", 0, "--method", "EE", *held, "--alpha", 200).count("UNSTABLE") == 2  # at it
    said = shown(capsys, "ur5", "--q0", 0, -1, 0, 0, 1, 0)  # stretched: it was 20 % of a joint's limit
    assert said.endswith("ur5 at its start: no joint velocities move the tip in the worst direction: J is singular.")


# --- figures ------------------------------------------------------------------------------------------


def opened(folder, name):
    with xr.open_dataset(folder / name, engine="h5netcdf") as data:
        return data.load()


@pytest.mark.parametrize("delay", ["2", "90"])
def test_chart_has_the_recommended_gains(delay, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("cnclik.cli.stability.CHART_POINTS", 3)
    main(["stability", "--Ts", "10ms", "--delay", delay, "--lag", "50ms", "--draw", "gains", "--out", str(tmp_path)])
    assert {p.name for p in tmp_path.iterdir()} == {LIST, "gains.nc", "gains.png"}
    data = opened(tmp_path, "gains.nc")
    cell = data.isel(Ts=1, dead_time=-1)
    drive = ck.Drive(delay=float(cell.dead_time / cell.Ts), lag=0.05)
    assert float(cell.recommended) == pytest.approx(ck.gains(Ts=float(cell.Ts), drive=drive).recommended)
    assert data.dead_time.max() > 0.0099 * int(delay)  # of now, where the picture has its mark
    assert data.Ts.min() < 0.01 < data.Ts.max() and '"lag": 0.05' in data.attrs["config"]


def test_map_of_loops_through_drives_agrees_with_the_limit(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("cnclik.cli.stability.CELLS", 10)
    drive = ["--Ts", "0.01", "--delay", "3", "--lag", "0.05", "--N", "300"]
    main(["stability", "planar:1,1", "--method", "EE", "--draw", "map", *drive, "--out", str(tmp_path)])
    assert {p.name for p in tmp_path.iterdir()} == {LIST, "map.nc", "map.png"}
    data = opened(tmp_path, "map.nc")
    assert data.ending.attrs["flag_meanings"].split()[3] == "DIVERGED"
    beyond = data.alpha / data.limit
    assert (data.ending.where(beyond > 1.1, 3) == 3).all() and (data.ending.where(beyond < 0.9, 0) < 2).all()
    assert (beyond > 1.1).any() and (beyond < 0.9).any() and "100 loops" in capsys.readouterr().out
    assert '"robot": "planar:1,1"' in data.attrs["config"]
    servo = ["--natural-frequency", "20", "--damping-ratio", "0.1", "--delay", "20"]  # no gain is stable
    rebased = ["--command", "position", "--feedback", "rebased", *servo]
    main(["stability", "--N", "4", "--draw", "map", *rebased, "--out", str(tmp_path)])
    assert (opened(tmp_path, "map.nc").limit == 0).any()
    with pytest.raises(SystemExit):
        main(["stability", "--draw", "map", "--alpha", "0", "--out", str(tmp_path)])
    assert "Option `--alpha` must be positive, but is 0." in capsys.readouterr().err


def test_plane_has_the_limits_of_every_M(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("cnclik.cli.stability.METHODS", ("EE", "IE"))
    main(["stability", "--draw", "plane", "--out", str(tmp_path)])
    assert {p.name for p in tmp_path.iterdir()} == {LIST, "plane.nc", "plane.png"}
    said = " ".join(capsys.readouterr().out.split())
    assert "IE picard(2) 1.3532 1.0000" in said and "IE exact none none" in said
    assert "recommended" not in said  # of methods alone
