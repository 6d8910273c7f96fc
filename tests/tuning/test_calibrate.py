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
    told = []
    with jax.enable_x64(x64):
        found = ck.calibrate(
            ck.planar_arm, np.array([0.5, 0.4, 0.2]), q, measured, progress=lambda *report: told.append(report)
        )
    np.testing.assert_allclose(found.values[0], true, atol=1e-8)
    assert found.rms_after < 1e-8 < 1e-2 < found.rms_before and told


def test_shapes_that_do_not_fit_are_named():
    with pytest.raises(ck.ArgumentError, match="measured"):
        ck.calibrate(ck.planar_arm, np.ones(2), np.ones((3, 2)), np.ones((4, 3)))
