"""A drive that is fitted is the one that moved: against SciPy's integrator, with noise."""

import numpy as np
import pytest

import cnclik as ck
from cnclik.diagnosis import fit_drive
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
