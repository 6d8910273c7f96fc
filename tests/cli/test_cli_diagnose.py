"""`cnclik diagnose` and `check` as a user meets them: a log in, a sentence, numbers, a figure; or one line."""

import contextlib
import json
import pathlib

import numpy as np
import pytest

from cnclik.cli import main
from cnclik.cli.log import clock, no_motion, read
from cnclik.diagnosis import diagnose
from cnclik.diagnosis.recording import sampling_time
from cnclik.errors import ArgumentError
from cnclik.show.diagnosis import oscillation
from tests.diagnosis.logs import loop, servo

TS = 0.002
FINGER = """<robot name="finger"><link name="palm"/><link name="tip"/><joint name="index_1" type="continuous">
<parent link="palm"/><child link="tip"/></joint></robot>"""


def write(path, names, *columns):
    np.savetxt(path, np.stack(columns, 1), delimiter=",", header=",".join(names), comments="", fmt="%.8g")
    return str(path)


def answer(capsys, *argv):
    main(["diagnose", *map(str, argv)])
    said = capsys.readouterr().out
    return json.loads(said) if "--json" in argv else said


def test_units_in_names_are_those_of_the_answer(tmp_path, capsys):
    """A lift in mm moves in m; a degree sign, and micro as the Greek letter, are units as well."""
    log, k = str(tmp_path / "log.csv"), np.arange(100)
    table = np.stack([2000 * k, 0.5 * k, 0.1 * k], 1)
    np.savetxt(log, table, delimiter=",", header="t [μs],lift [mm],q1 [°]", comments="", encoding="utf-8")
    main(["check", log, "--json"])
    said = json.loads(capsys.readouterr().out)
    speed = {each["column"]: each for each in said["findings"] if each["what"] == "velocity"}
    assert said["Ts"] == pytest.approx(0.002) and speed["lift"]["unit"] == "m/s" and speed["q1"]["unit"] == "rad/s"
    assert (speed["lift"]["value"], speed["q1"]["value"]) == pytest.approx((0.25, np.radians(50)))


def test_a_figure_names_the_unit_of_what_it_shows(tmp_path):
    """A log in degrees was drawn in rad, as recorded."""
    recorded = read(write(tmp_path / "log.csv", ["time", "q1 [deg]"], TS * np.arange(200), 30 * loop(0.3, 4, 200)))
    signal = recorded.columns(recorded.moved())
    axes = oscillation(signal, diagnose(signal, TS), recorded.names[1:]).axes
    assert np.ptp(axes[0].lines[0].get_ydata()) < 1 and axes[0].get_ylabel() == "q1 [rad or m]"


@pytest.fixture
def log(tmp_path):
    e = loop(0.3, 4, 200)
    return write(tmp_path / "log.csv", ["time", "q1", "q2"], TS * np.arange(200), 1 + 0.1 * e, 2 - 0.2 * e)


def test_a_sentence_with_the_gain_that_would_end_it_and_its_numbers(log, tmp_path, capsys):
    said = answer(capsys, log, "--alpha", 150, "--out", tmp_path / "out")
    assert said.startswith("ringing: period 18.8") and "ms) of dead time. Use an alpha of " in said
    assert "\nConfidence: 0.98.\n" in said and (tmp_path / "out" / "diagnose.png").stat().st_size > 10_000
    said = answer(capsys, log, "--Ts", 0.002, "--columns", "q2", "--json")
    assert said["kind"] == "ringing" and said["factor"] < 0.3
    assert said["drive"]["delay"] == pytest.approx(4, abs=0.01)
    assert 20 < said["recommended_alpha"] < 41 and said["confidence"] == 0.8


def test_a_drive_to_paste(tmp_path, capsys):
    command = np.where(np.arange(200) < 5, 0.0, 0.1)
    motion = servo(command, 0.004, 2.0, natural_frequency=23.0, damping_ratio=2.3)
    log = write(tmp_path / "step.csv", ["t", "command", "position"], 0.004 * np.arange(200), command, motion)
    said = answer(capsys, log, "--step", "--out", tmp_path / "out")
    assert said.startswith("--delay 8ms --natural-frequency 23 --damping-ratio 2.3 --command position\n")
    main(["stability", *said.partition("\n")[0].split()])  # at another Ts the dead time is as long
    assert "0.8 samples (8 ms) of dead time" in capsys.readouterr().out
    assert (tmp_path / "out" / "diagnose.png").stat().st_size > 10_000
    said = answer(capsys, log, "--step", "--json", "--columns", "command", "position")
    assert said["drive"]["natural_frequency"] == pytest.approx(23, rel=1e-3) and said["explained"] > 0.999


def test_Ts_goes_before_stamps_and_stamps_of_recorders_are_read(log, tmp_path, capsys):
    """Nanoseconds, status and text as recorders write them; what is left out is no joint."""
    rows = pathlib.Path(log).read_text().splitlines(keepends=True)
    for lines, Ts, told in (
        (rows, "1ms", "--Ts, though the stamps are 2 ms apart"),
        (rows[:60] + rows[63:], "2ms", "--Ts"),
        ([rows[0], *reversed(rows[1:])], "2ms", "--Ts, though the stamps are -2 ms apart"),
    ):
        (tmp_path / "other.csv").write_text("".join(lines))
        assert f"({told})" in answer(capsys, tmp_path / "other.csv", "--Ts", Ts)
    (tmp_path / "other.csv").write_text("".join([*rows, "9" * 400, rows[-1][rows[-1].index(",") :]]))
    with pytest.raises(SystemExit):
        answer(capsys, tmp_path / "other.csv", "--Ts", "2ms")
    assert "`LOG` must hold times up to 1e+30, but has a larger one in row 201" in capsys.readouterr().err
    rng, k = np.random.default_rng(0), np.arange(200)
    stamps, q = 1.7e18 + 2e6 * k + 4e5 * rng.standard_normal(200), 1 + 0.1 * loop(0.3, 4, 200)
    rows = [f"{s:.0f},{v:.9g},3,base_link,{i}" for s, v, i in zip(stamps, q, k, strict=True)]
    head = "/header/stamp,/position,/status,/header/frame_id,/header/seq"
    (tmp_path / "bag.csv").write_text("\n".join([head, *rows]))
    found = answer(capsys, tmp_path / "bag.csv", "--json")
    assert found["drive"]["delay"] == pytest.approx(4, abs=0.05) and found["Ts"] == pytest.approx(0.002, rel=0.01)
    assert found["Ts_from"] == "/header/stamp, read in ns"


@pytest.mark.parametrize(
    "names",  # of the motion of b, the commands of a and b, the motion of a
    [
        "joint_2_pos joint_1_cmd joint_2_cmd joint_1_pos",
        "q2 q1_cmd q2_cmd q1",
        "/arm/position2 /arm/command1 /arm/command2 /arm/position1",
        "position_b command_a command_b position_a",
        "elbow.actual base.desired elbow.desired base.actual",
    ],
)
def test_commands_are_paired_with_the_motion_of_their_own_joint(tmp_path, names):
    """Whatever their order, and beside columns of other kinds."""
    columns = ["t", *names.split(), "joint_1_vel"]
    log = read(write(tmp_path / "step.csv", columns, *np.arange(60.0).reshape(6, 10)))
    assert log.pairs() == ([2, 3], [4, 1])


def test_an_emergency_stop_is_no_error_and_units_are_read(tmp_path):
    """Degrees were taken for radians."""
    log = read(write(tmp_path / "log.csv", ["t [s]", "e_stop", "q1 [deg]"], *np.arange(60.0).reshape(3, 20)))
    assert log.moved() == [1, 2] and log.table[0, 2] == pytest.approx(np.radians(40.0)) and log.names[2] == "q1"
    assert read(str(tmp_path / "log.csv"), columns=("3", "e_stop")).chosen == [2, 1]
    (tmp_path / "tabs.csv").write_text("t\tq1\n0\t1\n")
    with pytest.raises(ArgumentError, match="separated by commas, but tabs"):
        read(str(tmp_path / "tabs.csv"))


def test_joints_of_a_log_are_in_the_order_of_the_robots(tmp_path, capsys):
    """ROS drivers publish joints in an order of their own, and grippers beside them."""
    names = ["t", "gripper", *(f"panda_joint{i}/position" for i in (7, 1, 2, 4, 3, 6, 5))]
    q = np.tile([0, 0, 0, -1.5, 0, 1.5, 0], (100, 1))
    q[:, 0] = 2.4e-3 * np.arange(100)  # a speed that joint 7 may have, and joint 1 may not
    main(["check", write(tmp_path / "log.csv", names, 1e-3 * np.arange(100), q[:, 0], *q.T), "panda"])
    assert "No limit is broken." in capsys.readouterr().out


@pytest.mark.parametrize(
    ("limits", "joints"), [("limits.csv", ["b", "a"]), ("fr3", [f"fr3_joint{i}" for i in range(1, 8)])]
)
def test_limits_belong_to_joints_by_their_names(tmp_path, monkeypatch, capsys, limits, joints):
    """Published or a table's, they were those of the columns in their order."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "limits.csv").write_text("joint,velocity\nb,1\na,5.26\n")
    q = 4e-3 * K * np.arange(len(joints))[:, None] / (len(joints) - 1)  # the last one at 4 rad/s
    main(["check", write(tmp_path / "log.csv", ["t", *joints[::-1]], 1e-3 * K, *q[::-1]), "--limits", limits])
    assert "No limit is broken." in capsys.readouterr().out


def test_a_joint_that_rests_is_a_joint_whatever_its_name(tmp_path, capsys):
    """Whole numbers in a column index_1 may count rows; the robot's own joint of that name was left out."""
    (tmp_path / "hand.urdf").write_text(FINGER)
    main(["check", write(tmp_path / "log.csv", ["t", "index_1"], 0.01 * K, 0 * K), str(tmp_path / "hand.urdf")])
    assert "index_1   0 rad/s" in capsys.readouterr().out


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        ([], 0, "No limits are given."),
        (["--limits", "limits.csv"], 1, "Broken limits: 2. The worst: velocity of j1_cmd at 0.5 s."),
        (["--columns", "j1_pos", "--limits", "limits.csv"], 1, "Broken limits: 1. The worst: velocity of j1_pos"),
        (["--limits", "robot.urdf"], 2, "Option `--limits` must be one of panda, fr3, FILE.csv, but is 'robot.urdf'"),
        (["--tip", "hand"], 2, "Option `--tip` must come with ROBOT, but comes without."),
        (["panda"], 2, "must have a column for each of the chain's 7 joints, but has 1"),
        (["--limits", "panda"], 2, "must be a single number, but has 7"),
        (["--Ts", "2ms"], 0, "1000 rows, Ts = 2 ms (--Ts, though the stamps are 1 ms apart)."),
        (["--Ts", "0.1ms"], 0, "8,991 rows"),  # a gap before every row
        (["--json"], 0, '"what": "behind its command", "column": "j1_pos", "value": 0.1, "unit": "rad", "at": 0.5,'),
    ],
)
def test_check_of_a_log(tmp_path, monkeypatch, capsys, options, code, words):
    """Names distinguish commands from motion; velocities are left out; the exit code is 1 for a broken limit."""
    monkeypatch.chdir(tmp_path)
    k = np.arange(1000)
    command = 0.1 * (k >= 500)
    motion = np.roll(command, 20) * 0.99
    write("log.csv", ["time", "j1_cmd", "j1_pos", "j1_velocity"], 1e-3 * k, command, motion, 50.0 + 0 * k)
    (tmp_path / "limits.csv").write_text("joint,velocity\n1,50\n")
    with pytest.raises(SystemExit) if code else contextlib.nullcontext() as left:
        main(["check", "log.csv", *options])
    said = capsys.readouterr()
    assert (left.value.code if code else 0) == code and words in (said.err if code == 2 else said.out), said


K = np.arange(400)


@pytest.mark.parametrize("start", [0.0, 1.7e9])
@pytest.mark.parametrize(("unit", "size"), [("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_units_follow_from_the_size_of_stamps(unit, size, start):
    """Logs of 2 to 5 kHz were read as 1000 times slower: now what may be two units is refused, or Ts decides."""
    for Ts in (TS, 2.5e-4, 0.25):
        q = np.stack([(start + Ts * K) * size, np.sin(K)], 1)
        if start or Ts == TS or (unit == "s" and Ts == 2.5e-4) or (unit == "ns" and Ts == 0.25):
            t, places, read = clock(["/header/stamp", "q1"], q)
            assert places == [0] and read == unit and sampling_time(t, None) == pytest.approx(Ts, rel=1e-3)
        else:
            with pytest.raises(ArgumentError, match=f"`Ts` must be given, or the unit .* may be .*{unit}"):
                clock(["t"], q[:, :1])
        assert clock(["t"], q[:, :1], 1.2 * Ts)[2] == unit


def test_units_follow_from_names():
    named = {"__time": 1, "time_ms": 1e-3, "stampNs": 1e-9, "sec": 1, "t [ms]": 1e-3}
    for name, factor in named.items():
        t, places, _ = clock((name,), 0.01 / factor * np.arange(5.0)[:, None])
        assert places == [0] and t == pytest.approx(0.01 * np.arange(5.0)), name
    for name in ("q1", "x", "q_t", "time_constant_q", "translation", "timer_state", "ms"):
        assert clock((name,), np.arange(5.0)[:, None])[:2] == (None, []), name


@pytest.mark.parametrize("names", [("header.stamp.sec", "header.stamp.nanosec"), ("/stamp/secs", "/stamp/nsecs")])
def test_seconds_and_nanoseconds_are_one_time(names):
    ns = 1_700_000_000_900_000_000 + 2_000_000 * K.astype(np.int64)
    t, places, _ = clock([*names, "position"], np.stack([ns // 10**9, ns % 10**9, np.cos(K)], 1).astype(float))
    assert places == [0, 1]
    np.testing.assert_allclose(t, TS * K, atol=1e-9)


def test_jitter_is_no_missing_row_and_status_no_motion():
    rng = np.random.default_rng(0)
    for jitter in (1e-4, 4e-4, 7e-4):
        t = TS * K + jitter * rng.standard_normal(len(K))
        assert sampling_time(t, None) == pytest.approx(TS, rel=0.01)
    t[200:] += 3 * TS
    with pytest.raises(ArgumentError, match="row 201 comes"):
        sampling_time(t, None)
    assert sampling_time(t, TS) == TS  # a Ts that is given goes first
    names = ["q1", "robot_mode", "status", "header.seq", "frame_id", "stateX", "q2"]
    table = np.stack([np.sin(K), 0 * K + 7, K % 3, K, np.nan * K, 0.5 * np.cos(K), K % 2], 1)
    assert no_motion(names, table) == [1, 2, 3, 4]
