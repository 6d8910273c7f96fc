"""The low-pass filter in the loop that `solve` runs, against the scalar loop and closed forms."""

import jax
import numpy as np
import pytest

import cnclik as ck
from cnclik.stability.linear import removed
from cnclik.stability.poles import scalar_loop
from tests.integrate.test_exponential import HOME, TURNED, WRIST

ARM, Q0, TS, N, STEP = ck.planar_arm([1.0, 1.0]), np.array([0.3, 1.2]), 0.01, 200, 1e-5
DRIVES = {
    "dead time": dict(delay=2),
    "lag": dict(delay=2, lag=0.03),
    "servo": dict(natural_frequency=30.0, command="position"),
    "measured late": dict(measurement_delay=2, lag=0.03),
    "own commands": dict(delay=1, natural_frequency=30.0, command="position", feedback="commanded"),
}


@pytest.mark.parametrize("name", DRIVES)
def test_a_step_of_a_filtered_target_is_the_scalar_loops(name):
    """The answer to 1 − ρ^(k+1), by superposition. Filtered errors and commands: see test_combinations."""
    drive = ck.Drive(smoothing=0.6, smoothed="target", **DRIVES[name])
    alpha = min(0.5 * ck.gains(Ts=TS, drive=drive, method="CN", M=5).largest_stable, 60.0)
    run = ck.solve(
        ck.Law(ARM, ck.joints(), alpha=alpha), ck.hold(values=Q0 + np.array([STEP, 0])), Q0, TS, N, "CN", drive=drive
    )
    loop, s = scalar_loop(drive, TS), float(removed("CN", alpha * TS, 5))
    answer = loop.response(s, loop.q, loop.displaced[:, None], N)[:, 0]
    expected = 1 - np.convolve(-np.diff(answer, prepend=1.0), 1 - 0.6 ** np.arange(1, N + 2))[: N + 1]
    np.testing.assert_allclose(np.asarray(run.e)[:, 0] / STEP, expected, atol=1e-9)


def test_a_filtered_target_turns_and_lags():
    """Rotations by ρ of the angle that is left in each sample; a line with feed-forward is Ts ρ/(1 − ρ) late."""
    drive, c, s = ck.Drive(smoothing=0.8, smoothed="target"), np.cos(0.5), np.sin(0.5)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ HOME
    run = ck.solve(
        ck.Law(WRIST, ck.orientation(), alpha=2000.0), ck.hold(None, turn), TURNED, TS, 40, "EXP-RK4", drive=drive
    )
    size = np.linalg.norm(np.asarray(run.e), axis=1)
    np.testing.assert_allclose(size[1:], 0.5 * 0.8 ** np.arange(1, 41), atol=2e-4)
    place = np.asarray(ck.forward(ARM, Q0).position)[:2]
    line = ck.line(place, place + np.array([0.1, 0]), duration=2.0)
    run = ck.solve(ck.Law(ARM, ck.position("xy"), alpha=20.0), line, Q0, TS, 150, "EXP-MIDPOINT", drive=drive)
    np.testing.assert_allclose(np.asarray(run.e)[-1], [0.05 * 0.01 * 0.8 / 0.2, 0], atol=1e-6)


def test_it_is_differentiable_and_a_cut_off_is_a_share():
    law = ck.Law(ARM, ck.position("xy"), alpha=10.0)
    target = ck.hold(np.asarray(ck.forward(ARM, Q0).position)[:2] + np.array([0.05, -0.04]))

    def end(**filters):
        return ck.solve(law, target, Q0, TS, 20, "EE", drive=ck.Drive(delay=1, **filters)).e[-1, 0]

    each = jax.jit(jax.vmap(ck.native(jax.value_and_grad(lambda kept: end(smoothing=kept)))))
    values, slopes = each(np.array([0.5, 0.5 + 1e-6, 0.5 - 1e-6, np.exp(-2 * np.pi * 10.0 * TS), 0.0]))
    assert slopes[0] == pytest.approx(float(values[1] - values[2]) / 2e-6, rel=1e-6)
    assert end(cutoff=10.0) == pytest.approx(float(values[3]), rel=1e-12)
    assert values[4] == end()
