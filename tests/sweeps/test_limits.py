"""Loops that are late or noisy, and the largest stable z beside the data, against the linear theory of both."""

import copy
import tomllib

import numpy as np
import pytest

import cnclik as ck
from cnclik.integrate.drive import Drive
from cnclik.stability import gains
from cnclik.stability.linear import stability_limit
from cnclik.sweeps import run_spec
from cnclik.sweeps.spec import parse
from tests.specs import reaching

SPEC = tomllib.loads(reaching(["final_error"], method=["EE", "IE"], alpha=[1.0, 5.0], Ts=[0.01, 0.1]))
SHIFT = 1e-6  # of the target: small enough for a linear loop
AT = -np.sin(0.3) - np.sin(1.4), np.cos(0.3) + np.cos(1.4)  # the tip at q0


def stable(drive, method="EE", Ts=0.1):
    """The largest stable z."""
    return Ts * gains(Ts=Ts, drive=drive, method=method).largest_stable


def spec(metrics, N, fixed=(), **axes):
    """Loops of explicit Euler at Ts = 0.1, beside their target."""
    made = tomllib.loads(reaching(metrics, N=N))
    made["fixed"] |= {"q0": [0.3, 1.1], "target": [AT[0] + SHIFT, AT[1]], "Ts": 0.1, "method": "EE"} | dict(fixed)
    return parse(made | {"axes": axes})


def limit(fixed=(), drop=(), **axes):
    """The coordinate of a variation of the spec: (dimensions, values), or None."""
    written = copy.deepcopy(SPEC)
    written["fixed"] |= dict(fixed)
    written["axes"] |= axes
    for name in drop:
        written["axes"].pop(name)
    found = parse(written)
    found = found.coordinates(found.grid()).get("limit")
    return found and found[:2]


def test_the_limit_is_over_the_axes_on_which_it_depends():
    dims, values = limit()
    assert dims == ("method",)
    np.testing.assert_allclose(values, [2, stability_limit(ck.METHODS["IE"], ck.picard(5))], rtol=1e-9)
    dims, values = limit(M=[1, 2, 5], method=["IE"])
    assert dims == ("method", "M")
    np.testing.assert_allclose(
        values[0], [stability_limit(ck.METHODS["IE"], ck.picard(m)) for m in (1, 2, 5)], rtol=1e-9
    )
    assert limit({"method": "EE"}, ["method"]) == ((), 2.0)
    assert limit({"N": "round(1/Ts)"})[0] == ("method",)  # Ts is compiled in, and the limit doesn't depend on it
    assert limit({"alpha": "z/Ts"}, ["alpha"], z=[0.5, 1.5])[0] == ("method",)
    assert limit({"alpha": "2*z/Ts"}, ["alpha"], z=[0.5, 1.5]) is None  # an axis z that is not alpha·Ts
    laws = {"exact": {}, "damped": {"damping": 0.1}}
    assert limit(method=["EE"], law=laws) == (("method",), [2.0])  # with damping a little more may be stable
    dims, values = limit(lag=[0.05, 0.3], method=["EE"])  # with a lag z depends on Ts
    assert dims == ("method", "Ts", "lag") and len(values.ravel()) == 4
    np.testing.assert_allclose(values[0, 1, 1], stable(Drive(lag=0.3)), rtol=1e-9)


def test_noise_at_rest_is_as_large_as_theory_says():
    """e[k+1] = e[k] − r(e[k] + n[k]) has variance r/(2 − r) σ²: r = z of explicit, 1 − e^{−z} of exponential Euler."""
    sigma, z = 1e-6, np.array([0.3, 1.0, 1.6])
    axes = {"z": z.tolist(), "noise": [[sigma, 0.0], [sigma, sigma]], "seed": list(range(8))}
    fixed = {"alpha": "z/Ts", "target": list(AT)}
    for method, removed in (("EE", z), ("EXP-EE", -np.expm1(-z))):
        found = run_spec(spec(["rms_error"], 1000, fixed | {"method": method}, **axes)).rms_error
        variance = (found**2).mean("seed").values / sigma**2
        theory = removed / (2 - removed)
        np.testing.assert_allclose(variance, np.stack([theory, 2 * theory], 1), rtol=0.06)
        assert len(np.unique(found)) == found.size  # every seed its own


def test_loops_through_a_lag_end_where_theory_says():
    """With the limit in an expression, half a sample of dead time included."""
    for drive in ({"lag": 0.3, "delay": 1}, {"delay": 0.5}):
        found = run_spec(spec(["final_error"], 400, drive | {"alpha": "share*limit/Ts"}, share=[0.95, 1.05]))
        assert found.final_error[0] < 0.2 * SHIFT and found.final_error[1] > SHIFT
        assert found.limit == pytest.approx(stable(Drive(**drive)), rel=1e-9)
