"""A drive that is fitted is the one that moved: against SciPy's integrator, with noise."""

import time

import numpy as np
import pytest
import scipy.linalg

import cnclik as ck
from cnclik.diagnosis import fit_drive
from cnclik.diagnosis.response import response
from cnclik.errors import ArgumentError
from tests.diagnosis.recordings import servo

TS = 0.004


def slow(*cases):
    return [pytest.param(*case, marks=pytest.mark.slow) for case in cases]


def step(N=150, at=10, size=0.2):
    return np.where(np.arange(N) >= at, size, 0.0) + 0.5


def noisy(motion, seed=0, share=0.002):
    return motion + share * np.ptp(motion) * np.random.default_rng(seed).standard_normal(len(motion))


def test_dead_time_alone():
    command = step()
    for delay in (0.0, 3.4):
        k = np.arange(len(command))
        late = np.interp(k - delay, k + 1.0, command)  # a position that is held is there a sample later
        fit = fit_drive(None, command, noisy(late), TS)
        assert fit.drive.order == 0 and fit.drive.delay == pytest.approx(delay, abs=0.1)
        assert fit.explained > 0.999 and fit.motion.shape == (150, 1)


@pytest.mark.parametrize(("delay", "lag"), [(2.3, 0.02), *slow((0.0, 0.03), (5.0, 0.05))])
def test_a_lag(delay, lag):
    command = step()
    fit = fit_drive(TS * np.arange(150), command, noisy(servo(command, TS, delay, lag=lag)))
    assert fit.drive.order == 1 and fit.drive.command == "position"
    assert fit.drive.delay == pytest.approx(delay, abs=0.1) and fit.drive.lag == pytest.approx(lag, rel=0.02)
    assert 0.5 < fit.rms[0] / 0.0004 < 2 and fit.uncertainty["delay"] < 0.1


@pytest.mark.parametrize(("delay", "omega", "zeta"), [(2.1, 23.0, 2.3), *slow((0.0, 25.0, 0.7), (3.6, 40.0, 0.2))])
def test_a_servo(delay, omega, zeta):
    """An overdamped one has a fast part that looks like dead time: there noise weighs more."""
    command, share = step(250), 0.002 if zeta < 1 else 0.0005
    fit = fit_drive(None, command, noisy(servo(command, TS, delay, omega=omega, zeta=zeta), share=share), TS)
    assert fit.drive.order == 2 and fit.drive.delay == pytest.approx(delay, abs=0.1)
    assert float(fit.drive.natural_frequency) == pytest.approx(omega, rel=0.03)
    assert float(fit.drive.damping_ratio) == pytest.approx(zeta, rel=0.03)


def test_a_velocity_drive_on_any_command():
    k = np.arange(200)
    command = 0.3 * np.sin(0.05 * k) * (k > 20) + 0.1 * (k > 90)
    fit = fit_drive(None, command, noisy(servo(command, TS, 1.5, lag=0.04, velocity=True)), TS, command_kind="velocity")
    assert fit.drive.order == 1 and fit.drive.command == "velocity"
    assert fit.drive.delay == pytest.approx(1.5, abs=0.1) and fit.drive.lag == pytest.approx(0.04, rel=0.02)
    servoed = noisy(servo(command, TS, 1.0, omega=60.0, zeta=0.8, velocity=True), share=0.0001)
    fit = fit_drive(None, command, servoed, TS, command_kind="velocity", kind="second-order")
    assert float(fit.drive.natural_frequency) == pytest.approx(60, rel=0.03)


def test_joints_that_differ_have_numbers_of_their_own():
    command = np.stack([step(), step(size=-0.3)], 1)
    alike = np.stack([noisy(servo(c, TS, 2.0, lag=0.03), i) for i, c in enumerate(command.T)], 1)
    fit = fit_drive(None, command, alike, TS, kind="lag")
    assert np.ndim(fit.drive.lag) == 0 and fit.drive.lag == pytest.approx(0.03, rel=0.02)
    lags = (0.02, 0.05)
    differ = np.stack(
        [noisy(servo(c, TS, 2.0, lag=lag), i) for i, (c, lag) in enumerate(zip(command.T, lags, strict=True))], 1
    )
    fit = fit_drive(None, command, differ, TS, kind="lag")
    np.testing.assert_allclose(fit.drive.lag, lags, rtol=0.02)
    assert fit.drive.delay == pytest.approx(2, abs=0.1) and fit.rms.shape == (2,)


def test_what_is_fitted_goes_into_the_loop():
    """The drive is one for `driven_limits`, and its options are those of the command line."""
    from cnclik.stability.driven import driven_limits

    command = step()
    fit = ck.fit_drive(None, command, servo(command, TS, 2.0, lag=0.03), TS)
    assert fit.options == "--delay 2 --lag 0.03 --command position"
    assert str(fit).startswith("lag: delay 2 ± ") and "explained" in str(fit)
    assert 0 < driven_limits("EE", Ts=TS, drive=fit.drive).stable < 2


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ((step(), np.ones(150)), "Argument `motion` must move in every column, but stands still."),
        ((np.ones(150), step()), "Argument `command` must move in every column, but stands still."),
        ((step(), step()[:99]), "Argument `motion` must have the shape of the commands, (150, 1), but has (99, 1)."),
        ((1e-200 * step(), 1e-200 * step()), "Argument `command` must move in every column, but stands still."),
        ((step(9), step(9)), "Argument `motion` must have at least 16 rows, but has 9."),
        (
            (step(), np.random.default_rng(1).standard_normal(150)),
            "Argument `motion` must be what the command leads to, but only",
        ),
    ],
)
def test_what_holds_no_motion(given, line):
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
    coarse = (1e5 + 0.01 * np.arange(150)).astype(np.float32)  # 7.8 ms apart, as far as float32 tells
    with pytest.raises(ArgumentError, match="`t` must be times that are equally far apart, but are 0"):
        fit_drive(coarse, step(), step())


@pytest.mark.parametrize(
    ("kind", "gain", "drift"),
    [
        ("velocity", 0.95, 0.0),
        ("position", 1.0, 0.03),
        *slow(("position", 1.2, 0.0), ("velocity", 0.9, -0.02), ("velocity", 1.0, 0.03), ("position", 0.9, -0.02)),
    ],
)
def test_gain_and_drift_are_fitted_beside_the_drive(kind, gain, drift):
    """Of a motion × 0.95 no dead time was found, with 99.85 % explained, and ten times the largest stable gain."""
    command = step(300, size=0.3) - 0.5 * (kind == "velocity")
    moved = servo(command, TS, 5.0, lag=0.015, velocity=kind == "velocity")
    motion = moved[0] + gain * (moved - moved[0]) + drift * TS * np.arange(300)
    fit = fit_drive(None, command, noisy(motion, share=2e-4), TS, command_kind=kind)
    assert fit.drive.order == 1 and fit.drive.delay == pytest.approx(5, abs=0.4), str(fit)
    assert fit.drive.delay * TS + fit.drive.lag == pytest.approx(5 * TS + 0.015, rel=0.02)
    assert fit.gain[0] == pytest.approx(gain, abs=0.01) and fit.drift[0] == pytest.approx(drift, abs=0.003)
    assert ("times what is commanded" in str(fit)) == (abs(gain - 1) > 0.02)


def test_a_gain_is_told_apart_from_a_drift():
    """Of three joints × 0.95 that drift "0.914 to 0.975 times" was said: where they come to rest, drift and all."""
    command = step(400, size=1.0)[:, None] * [0.12, -0.08, 0.06]
    moved = np.stack([servo(c, TS, 5.0, lag=0.015) for c in command.T], 1)
    fit = fit_drive(None, command, 0.95 * moved + 8e-6 * np.arange(400)[:, None], TS)
    assert "Motion is 0.95 times what is commanded (joint 1, 2, 3)" in str(fit), str(fit)


def test_what_no_drive_does_is_named():
    """A servo whose speed is limited: what is left of the motion has a structure."""
    command, limited = step(300, size=1.0), [0.5]
    for u in command[:-1]:
        limited.append(limited[-1] + np.clip(0.15 * (u - limited[-1]), -0.008, 0.008))
    fit = fit_drive(None, command, noisy(np.array(limited), share=1e-3), TS)
    assert "has a structure" in str(fit) and fit.largest_stable_alpha is None
    fit = fit_drive(None, command, noisy(servo(command, TS, 2.0, lag=0.02)), TS)
    assert "structure" not in str(fit)


@pytest.mark.parametrize(("factor", "said"), [(-1.0, "-1 times"), (180 / np.pi, "57.3 times")])
def test_a_sign_or_another_unit_is_no_gain(factor, said):
    command = step(200)
    moved = servo(command, TS, 2.0, lag=0.02)
    with pytest.raises(ArgumentError, match="move by about what is commanded") as error:
        fit_drive(None, command, noisy(factor * (moved - moved[0])), TS)
    assert said in str(error.value)


@pytest.mark.filterwarnings("error")
def test_small_and_large_recordings_take_little_time():
    """20 rows of three joints took 35 s; 1,500 rows of seven must take 5. Numbers of any size warn of nothing."""
    rng = np.random.default_rng(0)
    command = 0.5 + np.outer(np.arange(20) >= 5, [0.1, 0.05, -0.1])
    motion = np.stack([servo(c, TS, 2.0, lag=0.01) for c in command.T], 1) + 1e-3 * rng.standard_normal((20, 3))
    begin = time.thread_time()
    fit = fit_drive(None, command, motion, TS)
    assert time.thread_time() - begin < 3  # 0.4 s on a machine that does nothing else
    assert fit.drive.delay + fit.drive.lag / TS == pytest.approx(4.5, abs=0.5)
    for size in (1e-20, 1e15):
        tiny = fit_drive(None, size * command[:, :1], size * motion[:, :1], TS)
        assert np.all(np.isfinite(list(tiny.uncertainty.values())))


@pytest.mark.slow
def test_seven_joints_take_seconds():
    rng, k = np.random.default_rng(0), np.arange(1500)
    command = 0.1 * np.outer((k >= 50) * np.sign(np.sin(k / 200 + 0.1)), rng.uniform(0.5, 1, 7))
    motion = np.stack([servo(c, TS, 2.3, omega=30 + 2 * j, zeta=0.8) for j, c in enumerate(command.T)], 1)
    begin = time.thread_time()
    fit = fit_drive(None, command, 0.95 * motion + 1e-4 * rng.standard_normal(motion.shape), TS)
    assert time.thread_time() - begin < 5
    np.testing.assert_allclose(fit.drive.natural_frequency, 30 + 2 * np.arange(7), rtol=0.02)
    np.testing.assert_allclose(fit.gain, 0.95, atol=0.005)


def largest_stable(delay, lag, gain):
    """alpha [1/s] from which on a loop of explicit Euler and a position drive with a lag grows, by running it."""
    low, high, parts = 0.0, 6.0 / (TS * (delay + lag / TS + 1)), 10
    keep = np.exp(-TS / parts / lag)
    arrives = np.floor((np.arange(400 * parts) + 0.5) / parts - delay).astype(int)
    for _ in range(9):
        alpha = 0.5 * (low + high)
        x, sent, steps, seen = 0.0, 1.0, np.zeros(400), []
        for k in range(400):
            seen.append(x)
            sent -= alpha * TS * gain * x
            steps[k] = sent
            for at in arrives[k * parts : (k + 1) * parts]:
                x += (1 - keep) * ((steps[at] if at >= 0 else 0.0) - x)
        grows = np.max(np.abs(seen[300:])) > np.max(np.abs(seen[100:200]))
        low, high = (low, alpha) if grows else (alpha, high)
    return 0.5 * (low + high)


@pytest.mark.parametrize("cells", [3, pytest.param(30, marks=pytest.mark.slow)])
def test_the_largest_stable_gain_is_within_its_range(cells):
    """In nine of ten cells, where the recording says it: a step of all joints at once. Else it says why not."""
    rng, within = np.random.default_rng(4), 0
    for _ in range(cells):
        delay, lags, gain = rng.uniform(1, 6), rng.uniform(0.01, 0.04, 2), rng.uniform(0.85, 1.1)
        command = np.stack([step(200), step(200, size=-0.3)], 1)
        motion = np.stack([servo(c, TS, delay, lag=lag) for c, lag in zip(command.T, lags, strict=True)], 1)
        motion = motion[0] + gain * (motion - motion[0]) + 1e-3 * rng.standard_normal(motion.shape)
        fit = fit_drive(None, command, motion, TS)
        low, high = fit.largest_stable_alpha
        truth = min(largest_stable(delay, lag, gain) for lag in lags)
        within += low <= truth <= high
        assert high < 1.6 * low
    assert within >= 0.9 * cells
    rounded = command.copy()
    rounded[:, 0] *= 1 + 4e-16 * rng.standard_normal(len(rounded))  # roundings are no steps of one joint
    assert fit_drive(None, rounded, motion, TS).largest_stable_alpha == pytest.approx((low, high), rel=1e-6)
    one_by_one = command.copy()
    one_by_one[:, 1] = np.roll(one_by_one[:, 1], 90)
    one_by_one[:90, 1] = command[0, 1]
    motion = np.stack([servo(c, TS, 2.0, lag=0.02) for c in one_by_one.T], 1)
    alone = fit_drive(None, one_by_one, motion + 1e-4 * rng.standard_normal(motion.shape), TS)
    assert alone.largest_stable_alpha is None and "all joints at once" in str(alone)


@pytest.mark.parametrize("joints, command_kind, numbers", [(7, "position", (0.03,)), (2, "velocity", (40.0, 0.7))])
def test_no_range_of_the_largest_stable_gain_where_recordings_do_not_show_it(joints, command_kind, numbers):
    """On redundant arms, and with velocity servos that integrate, it did not hold the truth: results/loops."""
    drive = dict(zip(("lag",) if len(numbers) == 1 else ("natural_frequency", "damping_ratio"), numbers, strict=True))
    command = np.stack([step(100, size=0.1)] * joints, 1)
    command = command - command[0]
    moved = response(ck.Drive(delay=2.0, command=command_kind, **drive), command, TS)
    fit = fit_drive(None, command, moved, TS, command_kind=command_kind)
    assert fit.largest_stable_alpha is None and "not known of" in str(fit)


def test_a_dead_time_of_none_is_said_as_none():
    k = np.arange(150)
    fit = fit_drive(None, step(), np.interp(k, k + 1.0, step()), TS)
    assert fit.options == "--delay 0 --command position"


@pytest.mark.parametrize(("rate", "rows"), [(250, 200), *slow((100, 120), (500, 200))])
def test_an_integral_part_does_not_hide_the_lag_of_a_velocity_servo(rate, rows):
    """In the end its joints are not late, and it was taken for 0.6 samples of dead time, whose gain overshot by 10 %.
    A loop on such servos with the gain that is recommended from the recording does not overshoot by 5 %."""
    Ts, lags = 1 / rate, (0.006, 0.009)
    command = np.zeros((rows, 2))
    command[10:] = 0.2
    motion = np.stack([integrating(c, Ts, lag) for c, lag in zip(command.T, lags, strict=True)], 1)
    fit = fit_drive(None, command, motion, Ts, command_kind="velocity")
    if rate == 250:
        np.testing.assert_allclose(fit.drive.lag, lags, rtol=0.2)
        np.testing.assert_allclose(fit.gain, 1, atol=0.02)
        assert fit.drive.delay < 0.2 and "has a structure" in fit.note
    law = ck.Law(ck.planar_arm([1.0, 0.8]), ck.position("xy"), alpha=1.0)
    alpha = ck.recommend(law, None, np.array([0.3, 1.1]), Ts=Ts, method="EE", drive=fit.drive).recommended
    for lag in lags:
        q = integrating(range(3 * rate), Ts, lag, lambda _, q: alpha * (1 - q))
        assert q.max() < 1.05 and abs(q[-1] - 1) < 0.02


def integrating(command, Ts, lag, law=lambda u, q: u, rate=10.0, parts=20):
    """(N,) motion of a velocity servo with an integral part: lag v' = (v_c − v) + rate ∫(v_c − v), v_c by a law."""
    q, v, missed, found, h = 0.0, 0.0, 0.0, [], Ts / parts
    for sent in command:
        found.append(q)
        u = law(sent, q)
        for _ in range(parts):
            after = v + h / lag * (u - v + rate * missed)
            missed, q, v = missed + h * (u - v), q + h * 0.5 * (v + after), after
    return np.array(found)


def test_joints_that_swing_together_have_no_gain():
    """Two servos on one heavy inertia matrix, which a servo of its own does not fit: in the end both are where they
    are sent, and no gain other than 1 is said of them."""
    M, kv, kp = np.array([[0.5, 0.25], [0.25, 0.3]]), np.diag([10.0, 6.0]), np.diag([300.0, 200.0])
    inverse = np.linalg.inv(M)
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ kp, -inverse @ kv]])
    phi = scipy.linalg.expm(np.block([[a, -a[:, :2]], [np.zeros((2, 6))]]) * TS)
    x, motion, command = np.zeros(4), [], np.zeros((300, 2))
    command[10:] = 0.1, 0.03
    for u in command:
        motion.append(x[:2])
        x = (phi @ np.concatenate([x, u]))[:4]
    fit = fit_drive(None, command, 0.3 + np.array(motion), TS)
    assert np.abs(fit.gain - 1).max() > 0.02 and "has a structure" in fit.note
    assert "times what is commanded" not in fit.note and "rebased" not in fit.note


@pytest.mark.parametrize("gain", [0.95, 1.08])
def test_no_gain_is_safe_where_commands_begin_at_joints_that_move_by_another_gain(gain):
    """u = q0 + g (q + z e − q0): such a loop does not arrive, or runs away where z is small. It is said of position
    commands that are not what is followed, and of no other drive."""
    command = step(200)
    moved = servo(command, TS, 2.0, lag=0.02)
    fit = fit_drive(None, command, moved[0] + gain * (moved - moved[0]), TS)
    assert "feedback rebased" in fit.note
    assert "rebased" not in fit_drive(None, command, moved, TS).note
    for z in (0.05, 0.5):
        q = [0.0] * 4
        for _ in range(400):
            at = gain * (q[-3] + z * (1.0 - q[-3]))
            q.append(q[-1] + (1 - np.exp(-TS / 0.02)) * (at - q[-1]))
        assert abs(q[-1] - 1.0) > 0.04
