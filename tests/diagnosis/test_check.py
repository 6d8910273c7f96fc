"""What a log breaks is found where it was put, and nothing else."""

import numpy as np
import pytest

import cnclik as ck
from cnclik.diagnosis import check_log
from cnclik.diagnosis.recording import sampling_time

K = np.arange(1000)


def worst(check, what, column=None):
    return next(finding for finding in check.findings if finding.what == what and column in (None, finding.column))


@pytest.mark.parametrize(("step", "shares"), [(1e-5, (1.333, 5.333)), (1.875e-6, (0.25, 1.0))])
def test_a_step_of_ten_microradians_breaks_a_panda(step, shares):
    """franka_ros2#55: of joint 2 in a sample of 1 ms."""
    q = np.zeros((1000, 7))
    q[500:, 1] = step
    check = check_log(1e-3 * K, q, limits="panda")
    measured = [worst(check, what, "joint 2") for what in ("acceleration", "jerk")]
    assert [finding.share for finding in measured] == pytest.approx(shares, rel=1e-3)
    assert [finding.what for finding in check.broken] == (["acceleration", "jerk"] if step == 1e-5 else [])
    assert measured[0].at == pytest.approx(0.5) and measured[1].at == pytest.approx(0.501, abs=1.1e-3)


def test_derivatives_are_those_of_the_motion():
    t = 4e-3 * K
    check = check_log(t, 0.7 * np.sin(3 * t + 1.2), limits={"velocity": 2.0, "acceleration": 6.2})
    for order, what in enumerate(("velocity", "acceleration", "jerk"), 1):
        assert worst(check, what).value == pytest.approx(0.7 * 3**order, rel=1e-3)
    assert [finding.what for finding in check.broken] == ["velocity", "acceleration"]
    alternating = check_log(1e-3 * K, 1e-5 * (-1.0) ** K, limits={"acceleration": 15.0})  # is no noise
    assert alternating.broken[0].share == pytest.approx(40 / 15)


def test_neither_command_nor_tip_goes_round_where_a_joint_wraps():
    """The motion passes π 5 rows after its command."""
    t = 0.01 * np.arange(300)
    sent, q = (np.stack([2.9 + 0.2 * (t - late), 0.3 - 0.1 * (t - late)], 1) for late in (0.0, 0.05))
    sent, q = ((each + np.pi) % (2 * np.pi) - np.pi for each in (sent, q))
    check = check_log(t, q, chain=ck.planar_arm([1.0, 0.8]), command=sent)
    assert [each.value for each in check.findings if each.what == "behind its command"] == pytest.approx([0.01, 0.005])
    assert worst(check, "half-way between rows").value < 0.002


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
    assert worst(check, "missing").value == 3 and worst(check, "missing").at == pytest.approx(1.212, abs=2e-3)
    assert worst(check, "repeated").value == 2 and worst(check, "wrap by 2π").value == 1
    assert not check.broken and worst(check, "velocity").value == pytest.approx(4.0, rel=0.02)
    order = np.r_[0:200, 190:1000]
    assert worst(check_log(t[order], q[order]), "reversed").value == 1
    assert sampling_time(t[order], None) == pytest.approx(4e-3)
    some = rng.random(1000) > 0.05  # rows that a network lost; with their mean for Ts half of the gaps were none
    check = check_log(t[some], q[some])
    assert check.Ts == pytest.approx(4e-3) and worst(check, "missing").value == 1000 - some.sum()
    assert worst(check, "velocity").value == pytest.approx(2.0)


@pytest.mark.parametrize("resolution", [0.0, 2e-4])
def test_noise_breaks_no_limit_but_a_jump_does(resolution):
    """An arm at rest with 0.1 mrad of noise reaches 900 rad/s² at 1 kHz."""
    limits = {"velocity": 0.1, "acceleration": 10.0, "jerk": 5e3}
    for seed in range(20):
        q = np.random.default_rng(seed).standard_normal((1000, 6)) * 1e-4
        q = np.round(q / resolution) * resolution if resolution else q
        check = check_log(1e-3 * K, q, limits=limits, resolution=resolution)
        assert not check.broken and sum((finding.share or 0) > 1 for finding in check.findings) == 18
    q[400:, 2] += 0.02
    check = check_log(1e-3 * K, q, limits={"velocity": 0.1}, resolution=resolution)
    assert [finding.column for finding in check.broken] == ["joint 3"]
    assert worst(check, "jump").at == pytest.approx(0.4)


def test_how_far_the_tip_strays_half_way():
    """A link of 1 m strays by 1 − cos(Δ/2); the range and the speed of a chain count."""
    arm = ck.from_dh(a=[1.0], alpha=[0.0], d=[0.0], lower=[-0.5], upper=[0.5], velocity_limit=[0.09])
    check = check_log(None, 0.1 * np.arange(-6, 7.0), Ts=1.0, chain=arm)
    assert worst(check, "half-way between rows").value == pytest.approx(1e3 * (1 - np.cos(0.05)), rel=1e-6)
    assert [finding.what for finding in check.broken] == ["beyond its range", "velocity"]
    assert "inf" not in str(check)  # nothing is a share of a limit of 0
    assert check.broken[0].value == pytest.approx(0.1)
    assert worst(check_log(None, np.arange(9.0), Ts=1.0, units=["m"]), "velocity").unit == "m/s"
