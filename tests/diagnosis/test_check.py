"""What a log breaks is found where it was put, and nothing else."""

import json

import numpy as np
import pytest

import cnclik as ck
from cnclik.cli import main
from cnclik.diagnosis import check_log

K = np.arange(1000)


def found(check, what, column=None):
    return [one for one in check.findings if one.what == what and column in (None, one.column)]


@pytest.mark.parametrize(("step", "shares"), [(1e-5, (1.333, 5.333)), (1.875e-6, (0.25, 1.0))])
def test_a_step_of_ten_microradians_breaks_a_panda(step, shares):
    """franka_ros2#55: of joint 2 in a sample of 1 ms."""
    q = np.zeros((1000, 7))
    q[500:, 1] = step
    check = check_log(1e-3 * K, q, limits="panda")
    measured = [found(check, what, "joint 2")[0] for what in ("acceleration", "jerk")]
    assert [one.share for one in measured] == pytest.approx(shares, rel=1e-3)
    assert [one.what for one in check.broken] == (["acceleration", "jerk"] if step == 1e-5 else [])
    assert measured[0].at == pytest.approx(0.5) and measured[1].at == pytest.approx(0.501, abs=1.1e-3)


def test_derivatives_are_those_of_the_motion():
    t = 4e-3 * K
    check = check_log(t, 0.7 * np.sin(3 * t + 1.2), limits={"velocity": 2.0, "acceleration": 6.2})
    for what, order in (("velocity", 1), ("acceleration", 2), ("jerk", 3)):
        assert found(check, what)[0].value == pytest.approx(0.7 * 3**order, rel=1e-3)
    assert [one.what for one in check.broken] == ["velocity", "acceleration"]


def test_no_derivative_goes_across_a_gap_or_a_wrap():
    """Rows that are missing, sent twice, out of order and stale; a joint that passes π; stamps that jitter."""
    rng = np.random.default_rng(0)
    t = 4e-3 * K
    q = 2.0 * t
    keep = np.r_[0:300, 303:500, 500, 500:1000]
    stamps, values = t[keep] + 4e-4 * rng.standard_normal(len(keep)), (q[keep] + np.pi) % (2 * np.pi) - np.pi
    stamps[498] = stamps[497]
    values[700] = values[699]
    check = check_log(stamps, values, limits={"velocity": 5.0})
    assert found(check, "missing")[0].value == 3 and found(check, "missing")[0].at == pytest.approx(1.212, abs=2e-3)
    assert found(check, "repeated")[0].value == 2 and found(check, "wrap by 2π")[0].value == 1
    assert not check.broken and found(check, "velocity")[0].value == pytest.approx(4.0, rel=0.02)
    order = np.r_[0:200, 190:1000]
    assert found(check_log(t[order], q[order]), "reversed")[0].value == 1


@pytest.mark.parametrize("resolution", [0.0, 2e-4])
def test_noise_breaks_no_limit_but_a_jump_does(resolution):
    """An arm at rest with 0.1 mrad of noise reaches 900 rad/s² at 1 kHz."""
    for seed in range(20):
        q = np.random.default_rng(seed).standard_normal((1000, 6)) * 1e-4
        q = np.round(q / resolution) * resolution if resolution else q
        check = check_log(
            1e-3 * K, q, limits={"velocity": 0.1, "acceleration": 10.0, "jerk": 5e3}, resolution=resolution
        )
        assert not check.broken and sum((f.share or 0) > 1 for f in check.findings) == 18
    q[400:, 2] += 0.02
    check = check_log(1e-3 * K, q, limits={"velocity": 0.1}, resolution=resolution)
    assert [one.column for one in check.broken] == ["joint 3"] and found(check, "jump")[0].at == pytest.approx(0.4)


def test_a_command_that_alternates_is_no_noise():
    q = 1e-5 * (-1.0) ** K
    assert check_log(1e-3 * K, q, limits={"acceleration": 15.0}).broken[0].share == pytest.approx(40 / 15)


def test_how_far_the_tip_strays_half_way():
    """A link of 1 m strays by 1 − cos(Δ/2); the range and the speed of a chain count."""
    arm = ck.from_dh(a=[1.0], alpha=[0.0], d=[0.0], lower=[-0.5], upper=[0.5], velocity_limit=[0.09])
    check = check_log(None, 0.1 * np.arange(-6, 7.0), Ts=1.0, chain=arm)
    assert found(check, "half-way between rows")[0].value == pytest.approx(1e3 * (1 - np.cos(0.05)), rel=1e-6)
    assert [one.what for one in check.broken] == ["beyond its range", "velocity"]
    assert check.broken[0].value == pytest.approx(0.1)


def test_a_log_on_the_command_line(tmp_path, capsys):
    """Commands are told from motion by their names; velocities are left out; the exit code says what it found."""
    log, limits = tmp_path / "log.csv", tmp_path / "limits.csv"
    command = 0.1 * (K >= 500)
    table = np.column_stack([1e-3 * K, command, np.roll(command, 20) * 0.99, 50.0 + 0 * K])
    np.savetxt(log, table, delimiter=",", header="time,j1_cmd,j1_pos,j1_velocity", comments="", fmt="%.6f")
    limits.write_text("joint,velocity\n1,50\n")
    for options, code, words in (
        ([], 0, "No limits are given."),
        (["--limits", str(limits)], 1, "Broken limits: 2. The worst: velocity of j1_cmd at 0.5 s."),
        (["--columns", "j1_pos", "--limits", str(limits)], 1, "Broken limits: 1. The worst: velocity of j1_pos"),
    ):
        with pytest.raises(SystemExit) as left:
            main(["check", str(log), *options])
        assert left.value.code == code and words in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["check", str(log), "--json"])
    behind = [one for one in json.loads(capsys.readouterr().out)["findings"] if one["what"] == "behind its command"]
    assert behind[0]["value"] == pytest.approx(0.1) and behind[0]["at"] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--limits", "fr4"], "Option `--limits` must name a CSV file that can be read, but fr4"),
        (["--tip", "hand"], "Option `--tip` must come with ROBOT, but comes without."),
        (["panda"], "must have a column for each of the chain's 7 joints, but has 1"),
        (["--limits", "panda"], "must be a single number, but has 7"),
    ],
)
def test_what_does_not_fit_is_one_line(tmp_path, capsys, options, line):
    log = tmp_path / "log.csv"
    np.savetxt(log, np.column_stack([1e-3 * K, K]), delimiter=",", header="time,q", comments="")
    with pytest.raises(SystemExit) as left:
        main(["check", str(log), *options])
    said = capsys.readouterr().err.strip()
    assert left.value.code == 2 and line in said and "\n" not in said, said
