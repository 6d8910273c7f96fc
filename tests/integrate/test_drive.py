"""Drives: what is sampled is exact, and what is no drive. Loops through them are in test_combinations."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

import cnclik as ck
from cnclik.integrate.drive import Drive, sampled
from tests.integrate.test_exponential import HOME, TURNED, WRIST
from tests.refusals import refusals

Ts = 0.02
ARM = ck.planar_arm([1.0, 0.8])
LAW = ck.Law(ARM, ck.position("xy"), alpha=5.0)
Q = np.array([0.3, 1.1])
TARGET = np.asarray(ck.forward(ARM, Q).position)[:2] + np.array([0.05, -0.04])


@pytest.mark.parametrize("command", ["velocity", "position"])
def test_drives_of_any_speed_are_numbers_known_or_traced(command):
    """From 1e-9 to 1e9: an error at rest stays at rest, nothing grows, and what is far faster than Ts acts at once."""
    decades = np.array([1e-9, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9])
    w, zeta = (v.ravel() for v in np.meshgrid(decades, np.array([1e-4, 0.4, 1.0, 30.0, 1e6])))
    lags = decades if command == "position" else np.append(decades, 0.0)  # a joint of several may have none
    several = dict(lag=lags), dict(natural_frequency=w, damping_ratio=zeta)
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


def test_a_filtered_target_turns():
    """By a share of the angle that is left in each sample."""
    drive, c, s = ck.Drive(smoothing=0.8, smoothed="target"), np.cos(0.5), np.sin(0.5)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ HOME
    run = ck.solve(
        ck.Law(WRIST, ck.orientation(), alpha=1000.0), ck.hold(None, turn), TURNED, Ts, 40, "EXP-RK4", drive=drive
    )
    size = np.linalg.norm(np.asarray(run.e), axis=1)
    np.testing.assert_allclose(size[1:], 0.5 * 0.8 ** np.arange(1, 41), atol=2e-4)


def test_a_filter_is_differentiable_and_a_cut_off_is_a_share():
    law = ck.replace(LAW, alpha=10.0)

    def end(**filters):
        return ck.solve(law, ck.hold(TARGET), Q, 0.01, 20, "EE", drive=ck.Drive(delay=1, **filters)).e[-1, 0]

    each = jax.jit(jax.vmap(ck.native(jax.value_and_grad(lambda kept: end(smoothing=kept)))))
    values, slopes = each(np.array([0.5, 0.5 + 1e-6, 0.5 - 1e-6, np.exp(-2 * np.pi * 10.0 * 0.01), 0.0]))
    assert slopes[0] == pytest.approx(float(values[1] - values[2]) / 2e-6, rel=1e-6)
    assert end(cutoff=10.0) == pytest.approx(float(values[3]), rel=1e-12)
    assert values[4] == end()
