"""Sweeps of loops whose error is measured late or with noise, against the linear theory of both."""

import tomllib

import numpy as np
import pytest

from cnclik.errors import ArgumentError
from cnclik.integrate.drive import Drive
from cnclik.stability import gains
from cnclik.sweeps import check, run_spec
from tests.specs import reaching

SHIFT = 1e-6  # of the target: small enough for a linear loop
AT = -np.sin(0.3) - np.sin(1.4), np.cos(0.3) + np.cos(1.4)  # the tip at q0


def stable(drive, method="EE"):
    """The largest stable z at Ts = 0.1."""
    return 0.1 * gains(Ts=0.1, drive=drive, method=method).largest_stable


def spec(metrics, N, fixed=(), **axes):
    """Loops of explicit Euler at Ts = 0.1, beside their target."""
    made = tomllib.loads(reaching(metrics, N=N))
    made["fixed"] |= {"q0": [0.3, 1.1], "target": [AT[0] + SHIFT, AT[1]], "Ts": 0.1, "method": "EE"} | dict(fixed)
    return check.parse(made | {"axes": axes})


@pytest.mark.slow
def test_loops_that_are_late_end_where_theory_says():
    """At 0.95 and 1.05 of the largest stable z, `limit` in a spec; exponential Euler has none with one sample."""
    of = spec(["final_error"], 400, {"alpha": "share*limit/Ts"}, delay=[0, 1, 3], share=[0.95, 1.05])
    found = run_spec(of)
    assert found.delay.values.tolist() == [0, 1, 3] and [len(a) for a in of.grid().outer] == [3]
    np.testing.assert_allclose(found.limit, [2, 1, stable(Drive(delay=3))], rtol=1e-9)
    assert (found.final_error.sel(share=0.95) < 0.2 * SHIFT).all() and (
        found.final_error.sel(share=1.05) > 2 * SHIFT
    ).all()
    of = spec(["final_error"], 400, {"method": "EXP-EE", "alpha": "z/Ts"}, delay={"range": [1, 2]}, z=[0.92, 1.01, 2.5])
    found = run_spec(of)
    np.testing.assert_array_equal(found.final_error > SHIFT, [[False, False, False], [False, True, True]])
    np.testing.assert_allclose(found.limit, [np.inf, stable(Drive(delay=2), "EXP-EE")], rtol=1e-9)


def test_noise_at_rest_is_as_large_as_theory_says():
    """e[k+1] = e[k] − r(e[k] + n[k]) has variance r/(2 − r) σ²: r = z of explicit, 1 − e^{−z} of exponential Euler."""
    sigma, z = 1e-6, np.array([0.3, 1.0, 1.6])
    axes = {"z": z.tolist(), "noise": [[sigma, 0.0], [sigma, sigma]], "seed": list(range(8))}
    fixed = {"alpha": "z/Ts", "target": list(AT)}
    for method, taken in (("EE", z), ("EXP-EE", -np.expm1(-z))):
        found = run_spec(spec(["rms_error"], 1000, fixed | {"method": method}, **axes)).rms_error
        variance = (found**2).mean("seed").values / sigma**2
        theory = taken / (2 - taken)
        np.testing.assert_allclose(variance, np.stack([theory, 2 * theory], 1), rtol=0.06)
        assert len(np.unique(found)) == found.size  # every seed its own


def test_drives_are_options_like_the_others():
    """Loops with a lag, on an axis and fixed, beside the limits of theory; half a sample of dead time has one too."""
    limits = [stable(Drive(lag=lag, delay=1)) for lag in (0.05, 0.3)]
    at = {"alpha": "share*bound/Ts", "delay": 1, "bound": limits[1]}
    found = run_spec(spec(["final_error"], 400, at | {"lag": 0.3}, share=[0.95, 1.05]))
    assert found.final_error[0] < 0.2 * SHIFT and found.final_error[1] > SHIFT and "limit" not in found.coords
    found = run_spec(spec(["final_error"], 400, at | {"bound": min(limits) * 0.95, "share": 1}, lag=[0.05, 0.3]))
    assert (found.final_error < 0.2 * SHIFT).all()
    half = spec(["final_error"], 400, {"alpha": "share*limit/Ts", "delay": 0.5}, share=[0.95, 1.05])
    found = run_spec(half)
    assert found.limit == pytest.approx(stable(Drive(delay=0.5)))
    assert found.final_error[0] < 0.2 * SHIFT and found.final_error[1] > 2 * SHIFT


def test_what_is_not_asked_for_changes_nothing():
    """Without noise and delay the loop is `solve`'s own program; noise of 0 and a delay of 0 give its numbers."""
    alone = spec(["final_error"], 20, alpha=[5.0])
    made = alone.build(alpha=5.0)
    assert made.noise is None and made.drive.prompt
    without = run_spec(alone).final_error.values
    quiet = run_spec(spec(["final_error"], 20, {"alpha": 5.0}, noise=[0.0, 1e-3])).final_error.values
    assert quiet[0] == pytest.approx(without[0], rel=1e-9) and quiet[1] > 1e-5


@pytest.mark.parametrize(
    ("fixed", "axes", "words"),
    [
        ({"delay": -1}, {}, "`delay` must be at least 0, but is -1"),
        ({}, {"delay": [0, -1.5]}, "`axes.delay` must be at least 0"),
        ({"lag": 0.1, "natural_frequency": 3.0}, {}, "`natural_frequency` must be left out where there is a lag"),
        ({"feedback": "measure"}, {}, "did you mean 'measured'"),
        ({"noise": -1e-3}, {}, "`noise` must be at least 0, but is -0.001"),
        ({}, {"noise": [0.0, -1e-3]}, "`axes.noise` must hold values that are at least 0, but holds -0.001"),
        ({"noise": [1e-3] * 3}, {}, "`noise` must have 1 or 2 numbers, but has 3"),
        ({"nois": 1e-3}, {}, r"holds 'nois' \(did you mean 'noise'\?\)"),
        ({"delay": "round(limit)"}, {}, "`delay` must not depend on itself"),
    ],
)
def test_what_is_no_delay_or_noise_is_refused(fixed, axes, words):
    with pytest.raises(ArgumentError, match=words):
        spec(["final_error"], 5, fixed, **axes)
