"""Drives: what is sampled is exact, and a loop through them is what plain integration gives."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

import cnclik as ck
from cnclik.integrate.drive import Drive, sampled
from tests.bank import screws
from tests.oracles import close
from tests.refusals import refusals

Ts = 0.02
ARM = ck.planar_arm([1.0, 0.8])
LAW = ck.Law(ARM, ck.position("xy"), alpha=5.0)
Q = np.array([0.3, 1.1])
TARGET = np.asarray(ck.forward(ARM, Q).position)[:2] + np.array([0.05, -0.04])
SLIDER = screws([[0.0] * 3], [[1.0, 0, 0]], [0.0, 0.0, 0.0], kinds="P")


@pytest.mark.parametrize("command", ["velocity", "position"])
def test_drives_of_any_speed_are_numbers_known_or_traced(command):
    """From 1e-9 to 1e9: an error at rest stays at rest, nothing grows, and what is far faster than Ts acts at once."""
    decades = np.array([1e-9, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9])
    w, zeta = (v.ravel() for v in np.meshgrid(decades, np.array([1e-4, 0.4, 1.0, 30.0, 1e6])))
    several = dict(lag=decades), dict(natural_frequency=w, damping_ratio=zeta)
    traced = jax.jit(lambda numbers, step: sampled(Drive(command=command, **numbers), step))
    for step in (1e-4, 1.0):
        for numbers in several:
            known, traced_too = sampled(Drive(command=command, **numbers), step), traced(numbers, step)
            for found in (known, traced_too):
                assert np.isfinite(found.phi).all() and np.isfinite(found.now).all()
                assert np.abs(np.linalg.eigvals(np.asarray(found.phi))).max() < 1 + 1e-9
                follows = np.eye(found.size)[0 if command == "position" else 1]  # a command that has long been held
                moved = found.phi @ follows + found.now
                wanted = follows if command == "position" else follows + step * np.eye(found.size)[0]
                np.testing.assert_allclose(moved, np.broadcast_to(wanted, moved.shape), atol=1e-7 * max(step, 1.0))
            for a, b in ((known.phi, traced_too.phi), (known.now, traced_too.now)):
                np.testing.assert_allclose(b, a, atol=1e-7 * max(step, 1.0), rtol=1e-6)
    assert sampled(Drive(lag=1e-9, command=command), 0.01).now[..., 0] == pytest.approx(
        1.0 if command == "position" else 0.01, rel=1e-4
    )


def test_a_late_measurement_of_a_known_path_costs_nothing():
    """e[k+1] − e[k] is then what the path and its velocity leave, whatever the delay; to stability it is dead time."""
    start = np.asarray(ck.forward(ARM, Q).position)[:2]
    path = ck.line(start, start + np.array([0.1, -0.05]), duration=1.0)
    runs = [
        ck.solve(LAW, path, Q, Ts, 50, "EXP-MIDPOINT", drive=Drive(measurement_delay=d, delay=e))
        for d, e in ((0, 0), (4, 0), (0, 4))
    ]
    worst = [float(np.abs(run.e).max()) for run in runs]
    assert worst[1] < 3 * worst[0] + 1e-9 and worst[2] > 0.005
    assert Drive(measurement_delay=4, delay=1.5).lumped.delay == 5.5
    late = (Drive(measurement_delay=d, delay=4 - d) for d in (0, 3))
    limits = [ck.gains(Ts=Ts, method="EE", drive=drive).largest_stable for drive in late]
    assert limits[0] == limits[1]
    for share, settles in ((0.95, True), (1.05, False)):
        law = ck.replace(LAW, alpha=share * limits[0])
        e = ck.solve(law, ck.hold(start + np.array([1e-7, 0])), Q, Ts, 400, "EE", drive=Drive(measurement_delay=4)).e
        assert (np.abs(e[-20:]).max() < 1e-7) == settles


@pytest.mark.parametrize("drive", [None, Drive(delay=1), Drive(measurement_delay=2)], ids=str)
def test_noise_is_added_to_the_measured_error(drive):
    """On a slider, whose loop is linear: q[k+1] = q[k] + z (1 − q + n)[k−d], and the noise is that of its own step."""
    law, noise = ck.Law(SLIDER, ck.position("x"), alpha=10.0), np.sin(np.arange(30.0))[:, None]
    run = ck.solve(law, ck.hold([1.0]), [0.0], Ts, 30, "EE", drive=drive, noise=noise)
    command, measured = (0, 0) if drive is None else (int(drive.delay), drive.measurement_delay)
    q = [0.0]
    for k in range(30):
        sent = k - command
        q.append(q[k] + 0.2 * (1.0 - q[max(sent - measured, 0)] + noise[sent, 0]) * (sent >= 0))
    close(run.q[:, 0], q, atol=1e-12)
    close(run.e[:, 0], 1.0 - np.array(q), atol=1e-12)  # the true one
    assert not np.any(run.status & ck.Status.GROWING)


def with_drive(drive):
    return ck.solve(LAW, ck.hold(TARGET), Q, Ts, 5, "EE", drive=drive)


test_what_is_no_drive_is_refused = refusals(
    (lambda: Drive(delay=-1), "`delay` must be at least 0, but is -1"),
    (lambda: Drive(delay=101.5), "`delay` must be at most 101 samples"),
    (lambda: Drive(delay="34ms"), "`delay` must be a number, but is '34ms'"),
    (lambda: Drive(lag="20ms"), "`lag` must be an array of real numbers, but is '20ms'"),
    (lambda: Drive(delay=150, measurement_delay=60), "a measurement included, but is 210"),
    (lambda: Drive(delay=jnp.nan), "`delay` must be finite"),
    (lambda: Drive(lag=0.1, natural_frequency=3.0), "`natural_frequency` must be left out where there is a lag"),
    (lambda: Drive(lag=1e-100, command="position"), "`lag` must be at least 1e-12, but is 1e-100"),
    (lambda: Drive(lag=[0.0, 0.1], command="position"), "`lag` must be positive, but is 0"),
    (lambda: Drive(lag=[-0.1, 0.1]), "`lag` must be at least 0, but is -0.1"),
    (lambda: Drive(lag=None), "`lag` must be an array of real numbers, but is None"),
    (lambda: Drive(natural_frequency=[]), "`natural_frequency` must hold numbers, but is empty"),
    (lambda: Drive(natural_frequency=0.0), "`natural_frequency` must be positive"),
    (lambda: Drive(damping_ratio=0.7), "`damping_ratio` must come with a natural_frequency"),
    (lambda: Drive(feedback="rebased"), "`feedback` must come with command position and a lag"),
    (
        lambda: Drive(feedback="rebased", command="position", lag=0.1, measurement_delay=2),
        "`feedback` must come with command position and a lag or servo, its dead time as delay alone",
    ),
    (lambda: Drive(command="torque"), "`command` must be one of velocity, position, but is 'torque'"),
    (lambda: Drive(feedback="mesured"), "did you mean 'measured'"),
    (lambda: Drive(smoothing=1.0), "`smoothing` must be below 1"),
    (lambda: Drive(cutoff=3.0, smoothing=0.5), "`cutoff` must be left out where there is a smoothing"),
    (lambda: Drive(smoothed="errors"), "did you mean 'error'"),
    (lambda: with_drive(Drive(lag=np.ones(3))), "`lag` must have 2 numbers, but has 3"),
    (lambda: with_drive(3), "`drive` must be Drive"),
    (lambda: jax.jit(lambda d: Drive(delay=d).delay)(1.0), "`delay` must be a known number"),
)


def test_exponentials_of_drives():
    """Against 60 digits: stiff, badly damped and slow servos."""
    rng = np.random.default_rng(0)
    with mpmath.workdps(60):
        for _ in range(40):
            w, zeta = 10 ** rng.uniform(-4, 1.5), 10 ** rng.uniform(-2, 1.5)
            a = np.array([[0, 1, 0], [0, 0, w], [0, -w, -2 * zeta * w]])
            drive = Drive(natural_frequency=w, damping_ratio=zeta)
            exact = np.array(mpmath.expm(mpmath.matrix(a), method="taylor").tolist(), float)
            np.testing.assert_allclose(sampled(drive, 1.0).phi, exact, atol=2e-14)


@pytest.mark.parametrize(("lag", "near"), [(0.02, 1e-13), (0.0, 1e-5)])
def test_each_joint_goes_through_its_own_drive(lag, near):
    """Two sliders with lags of their own, or of which one has none, move as each alone does."""
    alone = [
        ck.solve(ck.Law(SLIDER, ck.position("x"), alpha=5.0), ck.hold([1.0]), [0.0], Ts, 25, "EE", drive=drive).q[:, 0]
        for drive in (Drive(lag=lag, delay=1.4), Drive(lag=0.05, delay=1.4))
    ]
    both = screws([[0.0] * 3] * 2, np.eye(3)[:2], [0.0] * 3, kinds="PP")
    drive = Drive(lag=[lag, 0.05], delay=1.4)
    run = ck.solve(
        ck.Law(both, ck.position("xy"), alpha=5.0), ck.hold([1.0, 1.0]), [0.0, 0.0], Ts, 25, "EE", drive=drive
    )
    close(run.q, np.stack(alone, axis=1), atol=near)
