"""Calibration: link lengths that nobody told it."""

import jax
import numpy as np
import pytest

import cnclik as ck


@pytest.mark.parametrize("x64", [True, False])
def test_link_lengths_from_twenty_poses(x64):
    true = np.array([0.51, 0.37, 0.23])
    q = np.random.default_rng(0).uniform(-2, 2, (20, 3))
    a = np.cumsum(q, axis=1)  # along +y at q = 0
    measured = np.stack([-np.sin(a) @ true, np.cos(a) @ true, np.zeros(20)], axis=1)
    with jax.enable_x64(x64):
        found = ck.calibrate(ck.planar_arm, np.array([0.5, 0.4, 0.2]), q, measured)
    np.testing.assert_allclose(found.value, true, atol=1e-10)
    assert found.rms_after < 1e-10 < 1e-2 < found.rms_before and found.status == "converged"
    assert ck.calibrate(ck.planar_arm, true - 0.2, q, measured, upper=0.5).value[0] == pytest.approx(0.5)


GIVEN = {"build": ck.planar_arm, "start": np.ones(2), "q": np.ones((3, 2)), "measured": np.ones((3, 3))}


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"measured": np.ones((4, 3))}, r"`measured` must have shape \(3, 3\)"),
        ({"q": np.ones((3, 4))}, r"`q` must have shape \(n, 2\), but has shape \(3, 4\)"),
        ({"build": 3}, "`build` must be a function of the value, but is 3"),
        ({"build": lambda value: None}, "`build` must return a Chain, but is NoneType"),
        ({"start": []}, "`start` must hold numbers, but is empty"),
        ({"lower": np.zeros(3)}, "`bounds of start` must be a single number or have 2 numbers, but has 3"),
        ({"steps": 1}, "`steps` must be at least 3"),
    ],
)
def test_what_does_not_fit_is_named(changes, told):
    with pytest.raises(ck.ArgumentError, match=told) as caught:
        ck.calibrate(**(GIVEN | changes))
    assert "\n" not in str(caught.value)
