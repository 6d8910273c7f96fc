"""A drive that is fitted is the one that moved, and its intervals hold the truth: against SciPy's integrator."""

import time

import numpy as np
import pytest

import cnclik as ck
from cnclik.diagnosis.fit import NOT_REBASED, fit_drive
from cnclik.errors import ArgumentError
from cnclik.integrate.drive import Drive, sampled
from tests.diagnosis.recordings import servo
from tests.oracles import late_by

TS = 0.004


def step(N=150, at=10, size=0.2):
    return np.where(np.arange(N) >= at, size, 0.0) + 0.5


def noisy(motion, seed=0, share=0.002):
    return motion + share * np.ptp(motion) * np.random.default_rng(seed).standard_normal(motion.shape)


def within(fit, **numbers):
    return all(np.all(fit.interval[n][0] <= v) and np.all(v <= fit.interval[n][1]) for n, v in numbers.items())


def test_dead_time_alone():
    command, k = step(), np.arange(150)
    for delay in (0.0, 3.4):
        late = np.interp(k - delay, k + 1.0, command)  # a constant position is reached a sample later
        fit = fit_drive(TS * k, command, noisy(late))
        assert fit.drive.order == 0 and fit.drive.delay == pytest.approx(delay, abs=0.1)
        assert fit.explained > 0.999 and fit.motion.shape == (150, 1)
    assert fit_drive(None, step(), np.interp(k, k + 1.0, step()), TS).options == "--delay 0 --command position"


@pytest.mark.parametrize(
    ("kind", "delay", "numbers"),
    [
        ("position", 2.3, {"lag": 0.02}),
        ("position", 2.1, {"natural_frequency": 23.0, "damping_ratio": 2.3}),
        ("position", 3.6, {"natural_frequency": 40.0, "damping_ratio": 0.2}),
        ("velocity", 1.5, {"lag": 0.04}),
        ("velocity", 1.0, {"natural_frequency": 60.0, "damping_ratio": 0.8}),
    ],
)
def test_lags_and_servos(kind, delay, numbers):
    """Their numbers, the size of the noise, and a gain from which nothing overshoots."""
    k, own = np.arange(250), {"lag": "lag", "natural_frequency": "omega", "damping_ratio": "zeta"}
    command = step(250) if kind == "position" else 0.3 * np.sin(0.05 * k) * (k > 20) + 0.1 * (k > 90)
    motion = servo(command, TS, delay, velocity=kind == "velocity", **{own[n]: v for n, v in numbers.items()})
    fit = fit_drive(None, command, noisy(motion, share=2e-4), TS, command_kind=kind)
    assert fit.drive.command == kind and fit.drive.delay == pytest.approx(delay, abs=0.1)
    for name, value in numbers.items():
        assert getattr(fit.drive, name) == pytest.approx(value, rel=0.03)
    assert fit.rms[0] == pytest.approx(2e-4 * np.ptp(motion), rel=0.2)
    truth = ck.gains(Ts=TS, drive=Drive(command=kind, delay=delay, **numbers), method="EE").recommended
    assert 0.75 * truth < fit.recommended_alpha < 1.03 * truth


def test_joints_share_numbers_unless_they_differ():
    command = np.stack([step(), step(size=-0.3)], 1)
    for lags in ((0.03, 0.03), (0.02, 0.05)):
        moves = [noisy(servo(command[:, i], TS, 2.0, lag=lag), i) for i, lag in enumerate(lags)]
        motion = np.stack(moves, 1)
        fit = fit_drive(None, command, motion, TS)
        assert np.size(fit.drive.lag) == len(set(lags)) and within(fit, delay=2.0)
        np.testing.assert_allclose(fit.drive.lag, sorted(set(lags)), rtol=0.02)
    assert str(fit).startswith("lag: delay 2.0") and "Recommended alpha: " in str(fit)
    alike = fit_drive(None, command[:, :1], motion[:, :1], TS)  # the slow joint decides
    assert fit.recommended_alpha < 0.8 * alike.recommended_alpha


def test_a_joint_that_is_left_out_has_the_numbers_of_the_others():
    """A joint that does not move as commanded was said to move by -29 times it, with 0.85 ± 7668 rad/s."""
    command = np.stack([step(), step(size=-0.3), step(size=0.25)], 1)
    moves = [noisy(servo(command[:, i], TS, 2.0, lag=lag), i) for i, lag in enumerate((0.02, 0.05))]
    fit = fit_drive(None, command, np.stack([*moves, np.random.default_rng(2).normal(size=150)], 1), TS)
    assert "Joint 3 does not follow its command, and is left out." in fit.note and "Motion is" not in fit.note
    np.testing.assert_allclose(fit.drive.lag, [0.02, 0.05, np.sqrt(0.02 * 0.05)], rtol=0.02)


@pytest.mark.parametrize(
    ("kind", "gain", "drift"), [("velocity", 0.9, -0.02), ("position", 1.0, 0.03), ("position", 1.2, 0)]
)
def test_a_gain_divides_the_recommended_alpha(kind, gain, drift):
    """Of a motion × 0.95 no dead time was found, with 99.85 % explained, and ten times the largest stable gain."""
    command = step(300, size=0.3) - 0.5 * (kind == "velocity")
    moved = servo(command, TS, 5.0, lag=0.015, velocity=kind == "velocity")
    one = fit_drive(None, command, noisy(moved, share=1e-4), TS, command_kind=kind)
    motion = moved[0] + gain * (moved - moved[0]) + drift * TS * np.arange(300)
    fit = fit_drive(None, command, noisy(motion, share=1e-4), TS, command_kind=kind)
    assert fit.drive.order == 1 and fit.drive.delay * TS + fit.drive.lag == pytest.approx(5 * TS + 0.015, rel=0.02)
    assert fit.gain[0] == pytest.approx(gain, abs=0.01) and fit.drift[0] == pytest.approx(drift, abs=0.003)
    assert ("times what is commanded" in str(fit)) == (gain != 1)
    assert fit.recommended_alpha == pytest.approx(one.recommended_alpha / gain, rel=0.05)


def test_no_gain_is_safe_where_commands_begin_at_joints_that_move_by_another_gain():
    """u = q0 + g (q + z e − q0): such a loop does not arrive, or runs away where z is small."""
    command = step(200)
    moved = servo(command, TS, 2.0, lag=0.02)
    assert "begin at the measured joints" in fit_drive(None, command, moved[0] + 0.95 * (moved - moved[0]), TS).note
    assert "begin at" not in fit_drive(None, command, moved, TS).note
    for z in (0.05, 0.5):
        q = [0.0] * 4
        for _ in range(400):
            at = 0.95 * (q[-3] + z * (1.0 - q[-3]))
            q.append(q[-1] + (1 - np.exp(-TS / 0.02)) * (at - q[-1]))
        assert abs(q[-1] - 1.0) > 0.04


@pytest.mark.parametrize(("rate", "rows"), [(250, 200), (100, 120), (500, 200)])
def test_an_integral_part_does_not_hide_the_lag_of_a_velocity_servo(rate, rows):
    """In the end its joints are not late, and it was taken for 0.6 samples of dead time, whose gain overshot 10 %."""
    Ts, lags = 1 / rate, (0.006, 0.009)
    command = np.where(np.arange(rows)[:, None] < 10, 0.0, [0.2, 0.2])
    motion = np.stack([integrating(c, Ts, lag) for c, lag in zip(command.T, lags, strict=True)], 1)
    fit = fit_drive(None, command, motion, Ts, command_kind="velocity")
    np.testing.assert_allclose(fit.drive.lag, lags, rtol=0.1)
    assert fit.drive.delay < 0.1 and "integral part (0.0" in fit.note
    for lag in lags:
        q = integrating(range(3 * rate), Ts, lag, lambda _, q: fit.recommended_alpha * (1 - q))
        assert q.max() < 1.05 and abs(q[-1] - 1) < 0.02


def integrating(command, Ts, lag, law=lambda u, q: u, rate=10.0, parts=40):
    """(N,) motion of a velocity servo with an integral part: lag v' = (v_c − v) + rate ∫(v_c − v), v_c by a law."""
    q, v, missed, found, h = 0.0, 0.0, 0.0, [], Ts / parts
    for sent in command:
        found.append(q)
        u = law(sent, q)
        for _ in range(parts):
            after = v + h / lag * (u - v + rate * missed)
            missed, q, v = missed + h * (u - 0.5 * (v + after)), q + h * 0.5 * (v + after), after
    return np.array(found)


def test_what_the_log_leaves_open_has_no_gain():
    """ζ = 0.01 ± 5 at a bound gave 0.02 1/s without a word; a log that ends before its servo swings."""
    short = step(60)
    fit = fit_drive(None, short, noisy(servo(short, TS, 2.0, omega=4.0, zeta=0.3), share=1e-4), TS, kind="second-order")
    assert fit.recommended_alpha is None and "shorter than the drive's own period" in fit.note
    fit = fit_drive(None, step(), noisy(servo(step(), TS, 2.0, omega=60.0, zeta=0.01), share=1e-4), TS)
    assert fit.recommended_alpha is None and "damping ratio is at the end of what is tried" in fit.note


def test_numbers_that_a_log_leaves_open_do_not_run_away():
    """Beside a slow joint two that follow within a sample, with dead times of their own: their ω was 0 once."""
    command, drives = np.tile(step(200)[:, None], (1, 3)), ((150.0, 0.6, 2.0), (2e4, 14.0, 2.6), (2e4, 3.0, 2.3))
    motion = [servo(command[:, 0], TS, late, omega=w, zeta=zeta, velocity=True) for w, zeta, late in drives]
    fit = fit_drive(None, command, np.stack(motion, 1), TS, command_kind="velocity")
    assert np.min(fit.drive.natural_frequency) > 100 and np.min(fit.drive.damping_ratio) > 0.1
    assert fit.drive.natural_frequency[0] == pytest.approx(150.0, rel=1e-3)


def test_what_no_drive_does_is_named():
    """A servo whose speed is limited: what is left of the motion has a structure."""
    command, limited = step(300, size=1.0), [0.5]
    for u in command[:-1]:
        limited.append(limited[-1] + np.clip(0.15 * (u - limited[-1]), -0.008, 0.008))
    assert "has a structure" in str(fit_drive(None, command, noisy(np.array(limited), share=1e-3), TS))
    more = fit_drive(None, command, noisy(1.1 * np.array(limited), share=1e-3), TS).note
    assert "has a structure" in more and NOT_REBASED in more  # whatever else there is to say
    assert "structure" not in str(fit_drive(None, command, noisy(servo(command, TS, 2.0, lag=0.02)), TS))


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ((step(), np.ones(150)), "Argument `motion` must move in every column, but stands still."),
        ((1e-200 * step(), 1e-200 * step()), "Argument `command` must move in every column, but stands still."),
        ((step(), step()[:99]), "Argument `motion` must have the shape of the commands, (150, 1), but has (99, 1)."),
        ((step(9), step(9)), "Argument `motion` must have at least 16 rows, but has 9."),
        (
            (step(), np.random.default_rng(1).random(150)),
            "Argument `motion` must be what the command leads to, but only",
        ),
        ((step(), -step()), "Argument `motion` must move by about what is commanded, but moves by -0.9"),
        ((step(), 57.3 * step()), "Argument `motion` must move by about what is commanded, but moves by 5"),
    ],
)
def test_what_no_drive_explains_is_refused(given, line):
    with pytest.raises(ArgumentError) as said:
        fit_drive(None, *given, TS)
    assert str(said.value).startswith(line)


def test_times_must_be_even():
    t = TS * np.arange(150)
    t[70:] += 2 * TS
    with pytest.raises(ArgumentError, match=r"row 71 comes 0\.012 s after"):
        fit_drive(t, step(), step())
    assert fit_drive(t, step(), step(), TS).drive.delay == pytest.approx(0, abs=1.01)  # a Ts goes before all stamps
    with pytest.raises(ArgumentError, match="`t` must have the commands' 150 rows, but has 100"):
        fit_drive(TS * np.arange(100), step(), step())


@pytest.mark.filterwarnings("error")
def test_small_and_large_logs_take_little_time():
    """20 rows, and 1,500 rows of seven joints that differ; numbers of any size warn of nothing."""
    rng = np.random.default_rng(0)
    for size in (1e-20, 1.0, 1e15):
        command = size * (0.5 + np.outer(np.arange(20) >= 5, [0.1, 0.05, -0.1]))
        motion = np.stack([servo(c, TS, 2.0, lag=0.01) for c in command.T], 1)
        fit = fit_drive(None, command, motion + 1e-3 * size * rng.standard_normal((20, 3)), TS)
        assert late_by(fit.drive, TS) / TS == pytest.approx(4.0, abs=0.6)
    k = np.arange(1500)
    command = 0.1 * np.outer((k >= 50) * np.sign(np.sin(k / 200 + 0.1)), rng.uniform(0.5, 1, 7))
    motion = np.stack([servo(c, TS, 2.3, omega=30 + 2 * j, zeta=0.8) for j, c in enumerate(command.T)], 1)
    motion = 0.95 * motion + 1e-4 * rng.standard_normal(motion.shape)
    begin = time.thread_time()
    fit = fit_drive(None, command, motion, TS)
    assert time.thread_time() - begin < 3
    np.testing.assert_allclose(fit.drive.natural_frequency, 30 + 2 * np.arange(7), rtol=0.02)
    np.testing.assert_allclose(fit.gain, 0.95, atol=0.005)


def moved(drive, command, Ts):
    """(N,) motion after commands (N,), by the drive's sampled equation."""
    model, x, made = sampled(drive, Ts), 0.0, []
    u = command - command[0] * (drive.command == "position")
    u = u if drive.command == "velocity" or drive.order else np.diff(u, prepend=0.0) / Ts
    line = np.concatenate([np.zeros(model.whole + 1), u])
    x = np.zeros(model.size)
    for now, before in zip(line[1 : 1 + len(u)], line[: len(u)], strict=True):
        made.append(x[0])
        x = model.phi @ x + model.now * now + (0.0 if model.late is None else model.late * before)
    return np.array(made)


@pytest.mark.parametrize("count", [12, pytest.param(300, marks=pytest.mark.slow)])
def test_intervals_of_95_per_cent_hold_the_truth(count):
    """Steps and random commands, one to four joints, noise of 0.01 to 1 %, gains: in 93 to 97 of 100 (12: in most)."""
    told = []
    for i in range(count):
        rng = np.random.default_rng([11, i])
        Ts, order, d = float(np.exp(rng.uniform(-7, -3.4))), int(rng.integers(3)), float(rng.uniform(0, 15))
        slow, zeta, k = (
            np.exp(rng.uniform(np.log(max(0.005, Ts)), np.log(0.1))),
            rng.uniform(0.3, 1.3),
            int(rng.integers(1, 5)),
        )
        numbers = ({}, {"lag": slow}, {"natural_frequency": 2 * zeta / slow, "damping_ratio": zeta})[order]
        drive = Drive(delay=d, command=str(rng.choice(["position", "velocity"])), **numbers)
        N = int(np.clip(rng.uniform(10, 25) * (d + slow / Ts + 1), 100, 900))
        command = np.outer((np.arange(N) > 9) * (np.arange(N) < N * rng.choice([0.5, 1])), rng.uniform(0.05, 0.3, k))
        if rng.random() < 0.4:
            command = np.cumsum(rng.standard_normal((N, k)) * (np.arange(N)[:, None] > 3), 0) * 0.02
        motion = rng.choice([1, 1, 0.95]) * np.stack([moved(drive, c, Ts) for c in command.T], 1)
        motion = noisy(motion, [12, i], rng.choice([1e-4, 1e-3, 1e-2])) + rng.uniform(-1, 1, k)
        fit = fit_drive(None, command, motion, Ts, command_kind=drive.command)
        if fit.drive.order == order:
            told += [within(fit, **{name: getattr(drive, name)}) for name in fit.interval]
    assert len(told) > count
    assert 0.93 <= np.mean(told) <= 0.98 if count > 100 else np.mean(told) > 0.8, np.mean(told)
