"""`cnclik diagnose` as a user meets it: a recording in, a sentence, numbers, a figure; one line for bad input."""

import json
import pathlib

import numpy as np
import pytest

from cnclik.cli import main
from tests.diagnosis.recordings import loop, servo

TS = 0.002


def write(path, names, *columns):
    np.savetxt(path, np.stack(columns, 1), delimiter=",", header=",".join(names), comments="", fmt="%.8g")
    return str(path)


@pytest.fixture
def log(tmp_path):
    e = loop(0.3, 4, 200)
    t = TS * np.arange(200)
    return write(tmp_path / "log.csv", ["time", "q1", "q2"], t, 1 + 0.1 * e, 2 - 0.2 * e)


@pytest.fixture
def recorded(tmp_path):
    command = np.where(np.arange(200) < 5, 0.0, 0.1)
    motion = servo(command, 0.004, 2.0, omega=23.0, zeta=2.3)
    return write(tmp_path / "step.csv", ["t", "command", "position"], 0.004 * np.arange(200), command, motion)


def test_a_sentence_with_the_gain_that_would_end_it(log, tmp_path, capsys):
    main(["diagnose", log, "--alpha", "150", "--out", str(tmp_path / "out")])
    said = capsys.readouterr().out
    assert said.startswith("ringing: period 18.8") and "as with 4 samples (8 ms) of dead time. Use an alpha of " in said
    assert "\nConfidence: 0.95.\n" in said and (tmp_path / "out" / "diagnose.png").stat().st_size > 10_000


def test_numbers_as_json(log, capsys):
    main(["diagnose", log, "--Ts", "0.002", "--columns", "q2", "--json"])
    said = json.loads(capsys.readouterr().out)
    assert said["kind"] == "ringing" and said["rings"] and said["delay"] == 4 and abs(said["z"] - 0.3) < 0.003
    assert said["drive"]["delay"] == pytest.approx(4, abs=0.01) and said["drive"]["lag"] is None
    assert 20 < said["recommended_alpha"] < 41 and said["confidence"] == 0.8 and len(said["amplitude"]) == 1


def test_a_drive_to_paste(recorded, tmp_path, capsys):
    main(["diagnose", recorded, "--step", "--out", str(tmp_path / "out")])
    first = capsys.readouterr().out.splitlines()[0]
    assert first == "--delay 2 --natural-frequency 23 --damping-ratio 2.3 --command position"
    assert (tmp_path / "out" / "diagnose.png").stat().st_size > 10_000
    main(["diagnose", recorded, "--step", "--json", "--columns", "command", "position"])
    said = json.loads(capsys.readouterr().out)
    assert said["kind"] == "second-order" and said["natural_frequency"] == pytest.approx(23, rel=1e-3)
    assert said["lag"] is None and said["explained"] > 0.999


def test_Ts_goes_before_stamps_and_stamps_of_recorders_are_read(log, tmp_path, capsys):
    """Nanoseconds, status and text as recorders write them; what is left out is no joint."""
    main(["diagnose", log, "--Ts", "0.001", "--json"])
    said = json.loads(capsys.readouterr().out)
    assert said["Ts"] == 0.001 and said["Ts_from"] == "--Ts, though the stamps are 2 ms apart"
    rows = pathlib.Path(log).read_text().splitlines(keepends=True)
    (tmp_path / "gap.csv").write_text("".join(rows[:60] + rows[63:]))
    main(["diagnose", str(tmp_path / "gap.csv"), "--Ts", "2ms"])
    assert "(--Ts, though of the stamps row 60 comes 0.008 s after the one before)" in capsys.readouterr().out
    (tmp_path / "back.csv").write_text("".join([rows[0], *reversed(rows[1:])]))
    main(["diagnose", str(tmp_path / "back.csv"), "--Ts", "2ms"])
    assert "(--Ts, though of the stamps the median step is -0.002 s)" in capsys.readouterr().out
    (tmp_path / "semicolons.csv").write_text("".join(rows).replace(",", ";"))
    with pytest.raises(SystemExit):
        main(["diagnose", str(tmp_path / "semicolons.csv"), "--Ts", "2ms"])
    assert "must have columns that are separated by commas" in capsys.readouterr().err
    rng, k = np.random.default_rng(0), np.arange(200)
    stamps = 1.7e18 + 2e6 * k + 4e5 * rng.standard_normal(200)
    q = 1 + 0.1 * loop(0.3, 4, 200)
    rows = [f"{s:.0f},{v:.9g},3,base_link,{i}" for s, v, i in zip(stamps, q, k, strict=True)]
    file = tmp_path / "bag.csv"
    file.write_text("\n".join(["/header/stamp,/position,/status,/header/frame_id,/header/seq", *rows]))
    main(["diagnose", str(file), "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["delay"] == 4 and found["Ts"] == pytest.approx(0.002, rel=0.01) and len(found["amplitude"]) == 1
    assert found["Ts_from"] == "/header/stamp, read in ns"


def test_causes_that_no_gain_ends(tmp_path, capsys):
    grows = 0.1 * 1.01 ** np.arange(300)
    main(["diagnose", write(tmp_path / "sign.csv", ["e_x", "e_y"], grows, 0 * grows + 1), "--Ts", "0.01"])
    said = capsys.readouterr().out
    assert said.startswith("growth without oscillation") and "Growing: e_x.\n" in said
    spiral = 0.1 * (1 - 0.05j) ** np.arange(300)
    main(
        ["diagnose", write(tmp_path / "turned.csv", ["e_x", "e_y"], spiral.real, spiral.imag), "--Ts", "0.01", "--json"]
    )
    found = json.loads(capsys.readouterr().out)
    assert found["cause"] == "turned frames" and found["angle"] == pytest.approx(90, abs=1)
    assert found["factor"] is None and found["axis"] == pytest.approx([0, 0, 1])


def test_what_solve_writes_can_be_read(tmp_path, capsys):
    """Its last row has no velocity: of a loop that is 17 samples late, from its joints and from its errors."""
    loop = "planar:1,1 --target 1.2 0.5 --alpha 30 --Ts 0.002 --delay 17 --method EE --N 400 --csv --no-figures"
    main(["solve", *loop.split(), "--out", str(tmp_path)])
    log = str(tmp_path / "trajectory.csv")
    for columns in (["q_q1", "q_q2"], ["e_x", "e_y"]):
        capsys.readouterr()
        main(["diagnose", log, "--alpha", "30", "--columns", *columns, "--json"])
        found = json.loads(capsys.readouterr().out)
        assert found["rings"] and 0.05 < found["z"] < 0.08, columns  # 0.06, of a motion so large that it bends
        assert 7 < found["recommended_alpha"] < 12  # 1/(e (17 + 1) Ts) is 10.2


@pytest.mark.parametrize(
    "names",
    [
        ("joint_2_pos", "joint_1_cmd", "joint_2_cmd", "joint_1_pos"),
        ("q2", "q1_cmd", "q2_cmd", "q1"),
        ("/arm/position2", "/arm/command1", "/arm/command2", "/arm/position1"),
        ("position_b", "command_a", "command_b", "position_a"),
        ("elbow.actual", "base.desired", "elbow.desired", "base.actual"),
    ],
)
def test_commands_are_paired_with_the_motion_of_their_own_joint(tmp_path, capsys, names):
    """Whatever their order, and beside columns of other kinds."""
    a = np.where(np.arange(200) < 5, 0.0, 0.1)
    b = np.where(np.arange(200) < 60, 0.0, -0.2)
    moved = [servo(command, 0.004, 2.0, lag=0.02) for command in (a, b)]
    numbers = [0.004 * np.arange(200), moved[1], a, b, moved[0], np.gradient(moved[0])]
    log = write(tmp_path / "step.csv", ["t", *names, "joint_1_vel"], *numbers)
    main(["diagnose", log, "--step", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["lag"] == pytest.approx(0.02, rel=0.05) and found["explained"] > 0.999
    np.testing.assert_allclose(found["gain"], [1, 1], atol=0.01)
