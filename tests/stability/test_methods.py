"""Theory of exponential and multistep methods, against closed forms, and against the loops themselves."""

import jax
import numpy as np
import pytest

import cnclik as ck
from cnclik.integrate.drive import Drive
from cnclik.measure.outcome import Ending
from cnclik.stability import linear
from cnclik.stability.attraction import attraction_radius, certified_radius, curvature_bound
from cnclik.stability.maps import outcomes
from cnclik.stability.recommend import analyse
from cnclik.stability.spectrum import spectrum
from cnclik.tuning.conditions import Scenario, rollout
from cnclik.tuning.parameters import Adjustable

EXPONENTIAL = [name for name, m in ck.METHODS.items() if m.exponential]
ARM, Q = ck.planar_arm([1.0, 0.8, 0.5]), np.array([0.3, 0.7, -0.4])
X = np.asarray(ck.forward(ARM, Q).position)[:2]
LAW = ck.Law(ARM, ck.position("xy"), alpha=8.0)


@pytest.mark.parametrize("method", EXPONENTIAL)
def test_exponential_methods_decay_exactly(method):
    z = np.array([0.0, 1e-9, 0.01, 0.5, 2.0, 10.0, 50.0, 1e6])
    np.testing.assert_allclose(linear.amplification(method, None, z), np.exp(-z), rtol=0, atol=1e-12)
    plane = np.linspace(0, 50, 7) + 1j * np.linspace(-9, 9, 5)[:, None]
    np.testing.assert_allclose(linear.amplification(method, None, plane), np.exp(-plane), rtol=0, atol=1e-12)
    assert linear.stability_limit(method) == np.inf


def test_limits_of_an_exponential_method():
    found = linear.real_axis_limits("EXP-RK4")
    assert (found.stable, found.monotone, found.fastest) == (np.inf,) * 3 and np.isnan(found.dead_beat)
    assert [linear.delay_limit(d, "EXP-EE") for d in (0, 1)] == [np.inf, np.inf]
    for d, rounded in ((2, 0.962), (3, 0.589)):
        exact = -np.log1p(-2 * np.sin(np.pi / (2 * (2 * d + 1))))
        assert linear.delay_limit(d, "EXP-AB2") == pytest.approx(exact, abs=1e-9) == pytest.approx(rounded, abs=5e-4)
    region = linear.stability_region("EXP-EE", points=5)
    np.testing.assert_allclose(region.values[2], np.exp(-region.re.values), rtol=1e-12)


LIMITS = {"AB2": 1.0, "AB3": 6 / 11, "AB4": 0.3, "ZNN4": 1.0, "ZEAD4": 1.0, "ZNN6": 2 / 3, "IFD5": 0.28078}


@pytest.mark.parametrize("method", LIMITS)
def test_limits_of_multistep_methods(method):
    """The last stable z, and from the roots of its own polynomial: on the unit circle there and outside beyond."""
    limit = linear.stability_limit(method)
    assert limit == pytest.approx(LIMITS[method], abs=1e-4)
    a, b = (np.pad(w, (0, 6 - len(w))) for w in (ck.METHODS[method].a, ck.METHODS[method].b))
    for z in (0.5 * limit, limit, 1.01 * limit):
        roots = np.roots(np.r_[1.0, -(a - z * b)])
        assert np.abs(linear.amplification(method, None, z)) == pytest.approx(np.abs(roots).max(), abs=1e-9)
    assert np.abs(linear.amplification(method, None, np.array([1e-3, 0.99 * limit]))).max() < 1


def test_late_measurements_of_multistep_methods():
    assert [linear.delay_limit(d, "AB2") for d in range(5)] == pytest.approx([1, 0.828, 0.615, 0.465, 0.367], abs=6e-4)
    euler = [linear.delay_limit(d) for d in range(5)]
    np.testing.assert_allclose(euler, [2, 1, 0.618, 0.445, 0.347], atol=5e-4)
    assert np.isnan(linear.real_axis_limits("AB2").dead_beat)  # two real factors meet before they are 0


@pytest.mark.parametrize("method", [pytest.param("EXP-RK4", marks=pytest.mark.slow), "EXP-AB3", "AB2", "ZNN4"])
def test_the_loops_own_step_has_the_factors_of_the_theory(method):
    found = spectrum(ck.replace(LAW, alpha=4.0), None, Q, 0.2, method)
    factors = np.sort_complex(np.repeat(linear.factors(method, None, 0.8), 2))
    if method in ("AB2", "ZNN4"):
        np.testing.assert_allclose(np.sort_complex(np.round(found.task, 9)), np.round(factors, 9), atol=2e-9)
    assert found.radius == pytest.approx(np.abs(linear.amplification(method, None, 0.8)), abs=1e-12)
    assert found.null_radius == pytest.approx(1, abs=1e-9)  # nothing acts there
    assert found.direction.shape == (2,)


def test_damped_directions():
    law = ck.replace(LAW, inverse=ck.damped(0.4))
    sigma = np.linalg.svd(np.asarray(ck.jacobian(ARM, Q))[:2])[1]
    kept = 1 + np.expm1(-1.6) * sigma**2 / (sigma**2 + 0.16)
    for method in ("EXP-EE", "EXP-AB2"):
        found = np.sort(np.abs(spectrum(law, None, Q, 0.2, method).task))[::-1][:2]
        np.testing.assert_allclose(found, np.sort(kept)[::-1], atol=1e-12)
    pushed = spectrum(ck.replace(LAW, inverse=ck.transpose()), None, Q, 0.2, "EXP-EE").task.real
    np.testing.assert_allclose(np.sort(pushed), np.sort(1 + np.expm1(-1.6) * sigma**2), atol=1e-12)


def test_advice():
    free = analyse(LAW, None, Q, Ts=0.1, method="EXP-AB2")
    assert free.gains.largest == free.times.largest == free.margin.margin == np.inf and free.gains.evaluations == 1
    bound = ck.recommend(LAW, None, Q, Ts=0.1, method="AB2")
    assert bound.z_largest == pytest.approx(1, abs=1e-6) and "changes sign" in bound.limit


@pytest.mark.parametrize(("method", "z"), [("AB2", 1.0), pytest.param("ZNN6", 2 / 3, marks=pytest.mark.slow)])
def test_measured_loops_agree_with_the_limit(method, z):
    """Small errors shrink on one side of it and grow on the other."""

    @jax.jit
    def last(alpha):
        run = ck.solve(ck.replace(LAW, alpha=alpha), ck.hold(X + 1e-7), Q, 0.1, 300, method)
        return abs(run.e[-3:]).max()

    assert last(9.7 * z) < 1e-9 and last(10.3 * z) > 2e-7


@pytest.mark.parametrize(
    ("method", "delay", "limit"),
    [
        ("EXP-EE", 2, 0.962),
        pytest.param("AB2", 1, 0.828, marks=pytest.mark.slow),
        pytest.param("EXP-AB2", 1, np.inf, marks=pytest.mark.slow),
    ],
)
def test_measured_loops_that_are_late_agree(method, delay, limit):
    method = ck.METHODS[method]

    @jax.jit
    def last(alpha):
        loop = Adjustable(law=ck.replace(LAW, alpha=alpha), Ts=np.asarray(0.1))
        run = rollout(
            loop, Scenario(reference=ck.hold(X + 1e-7), q0=Q), 250, method, ck.picard(1), drive=Drive(delay=delay)
        )
        return abs(run.e[-4:]).max()

    if limit == np.inf:
        assert last(30.0) < 2e-7  # 1 − e^{−3} = 0.95: it rings, and does not grow
    else:
        assert last(9.5 * limit) < 3e-8 and last(10.5 * limit) > 3e-7


def test_certificate_of_exponential_euler():
    """That of explicit Euler with 1 − e^{−z}; at every gain."""
    arm = ck.planar_arm([1.0, 1.0])
    q = np.array([0.0, np.pi / 2])
    slow, fast = (ck.Law(arm, ck.position("xy"), alpha=a) for a in (-np.expm1(-30.0) * 10, 300.0))
    found = certified_radius(fast, q, Ts=0.1, method="EXP-EE")
    assert found == pytest.approx(certified_radius(slow, q, Ts=0.1)) and found > 0
    assert certified_radius(fast, q, Ts=0.1) == 0
    assert attraction_radius(-np.expm1(-5.0), 1.0, curvature_bound(arm)) > attraction_radius(1.9, 1.0, 2.618)
    with pytest.raises(ck.ArgumentError, match="Argument `method` must be one of EE, EXP-EE"):
        certified_radius(fast, q, Ts=0.1, method="RK4")


def test_loops_are_judged_with_every_method():
    """Settled, stable at any gain, and by the same words."""
    found = outcomes(LAW, ck.hold(X + 0.1), Q, alpha=np.array([4.0, 100.0]), Ts=0.1, N=60, method="EXP-AB2")
    assert set(found.ending.tolist()) == {0}


@pytest.mark.parametrize("method", ["EXP-EE", pytest.param("EXP-MIDPOINT", marks=pytest.mark.slow)])
def test_measured_maps_of_exponential_methods_have_no_diverged_cell(method):
    """Over four decades of z, where explicit Euler is lost in half of the plane."""
    axes = {"alpha": np.geomspace(1.0, 400.0, 8), "Ts": np.geomspace(0.02, 0.5, 8)[:, None], "N": 200}
    lost = [outcomes(LAW, ck.hold(X + 0.1), Q, method=name, **axes).ending > Ending.SLOW for name in ("EE", method)]
    assert lost[0].mean() > 0.45 and not lost[1].any()
