"""Linear theory from the library's own step, against closed forms, nodepy, and the table of docs/stability.md."""

import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.stability import linear
from tests.compiling import compiled

PASSES = range(13)


def picard(M):
    """Passes as an array: one compiled program for every M."""
    return ck.picard(jnp.asarray(M), maximum=12)


def powers(z, M):
    """Σ_{j=0}^{M} (−z)^j."""
    return sum((-z) ** j for j in range(M + 1))


Z = np.linspace(0.05, 2.5, 23)
PLANE = (np.linspace(-3, 3, 13) + 1j * np.linspace(-3, 3, 11)[:, None]) + 0.05


@pytest.mark.parametrize("M", [0, 1, 4, 5, 12])
def test_picard_is_the_polynomial_of_its_passes(M):
    for z in (Z, PLANE):
        np.testing.assert_allclose(linear.amplification(ck.IE, picard(M), z), powers(z, M + 1), rtol=1e-10, atol=1e-12)
        expected = 1 - z / 2 * (1 + powers(z, M))
        np.testing.assert_allclose(linear.amplification(ck.CN, picard(M), z), expected, rtol=1e-9, atol=1e-10)


def test_other_numbers_of_z_need_no_other_program():
    few, many = (linear.amplification("IE", ck.chord(0), np.tile(Z, n)) for n in (1, 100))
    with compiled() as programs:
        for n in (0, 1, 22, 45, 2299):
            found = linear.amplification("IE", ck.chord(0), np.tile(Z, 100)[:n])
            np.testing.assert_allclose(found, np.tile(few, 100)[:n], rtol=1e-14)
            np.testing.assert_allclose(found, many[:n], rtol=1e-14)
    assert not programs


EXACT = {
    "IE": lambda z: 1 / (1 + z),
    "CN": lambda z: (1 - z**2 / 2) / (1 + z),
    "TRAPEZOID": lambda z: (2 - z) / (2 + z),
}


@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("stage", [ck.chord(0), ck.chord(3), ck.newton(1)])
def test_chord_and_newton_solve_a_linear_stage_exactly(name, stage):
    for z in (Z, PLANE, np.array([20.0, 1e4])):
        np.testing.assert_allclose(linear.amplification(name, stage, z), EXACT[name](z), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("method", [m for m in ck.METHODS.values() if m.steps == 1 and not m.exponential], ids=str)
def test_stability_functions_are_those_of_nodepy(method):
    """nodepy derives R from the tableau alone; its z is minus ours."""
    from nodepy import runge_kutta_method as nodepy  # a second, of all workers, if it is at the top

    n = len(method.A)
    A = np.array([[*row, *[0.0] * (n - len(row))] for row in method.A])
    kind = nodepy.RungeKuttaMethod if method.implicit else nodepy.ExplicitRungeKuttaMethod
    p, q = kind(A, np.array(method.b)).stability_function()
    expected = np.polyval(p.coeffs.astype(float), -PLANE) / np.polyval(q.coeffs.astype(float), -PLANE)
    found = linear.amplification(method, ck.chord(1), PLANE)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)


# Largest stable z for M = 0 … 12: roots of the polynomials above.
def limit_of(polynomial):
    """Smallest z > 0 with |R| = 1 where R leaves the unit interval, from the roots of R ∓ 1."""
    roots = np.concatenate([(polynomial - s).roots() for s in (1, -1)])
    real = np.sort(roots[np.abs(roots.imag) < 1e-9].real)
    return next(z for z in real[real > 1e-6] if abs(polynomial(z * (1 + 1e-4))) > 1)


def geometric(M):
    return np.polynomial.Polynomial([(-1.0) ** j for j in range(M + 1)])


X = np.polynomial.Polynomial([0, 1])


@pytest.mark.parametrize("M", PASSES)
def test_table_of_limits(M):
    """To four digits and better: IE, the paper's CN, and the trapezoid by Picard (2 for every M)."""
    stage = picard(M)
    assert linear.stability_limit(ck.IE, stage) == pytest.approx(limit_of(geometric(M + 1)), abs=1e-7)
    assert linear.stability_limit(ck.CN, stage) == pytest.approx(limit_of(1 - X / 2 * (1 + geometric(M))), abs=1e-7)
    assert linear.stability_limit(ck.TRAPEZOID, stage) == pytest.approx(2, abs=1e-7)


def test_table_of_limits_as_published():
    table = {
        0: (2, 2),
        1: (1, 2),
        2: (1.353, 1.478),
        3: (1, 1.353),
        4: (1.215, 1.304),
        5: (1, 1.215),
        10: (1.099, 1.143),
    }
    for M, (ie, cn) in table.items():
        assert linear.stability_limit("IE", picard(M)) == pytest.approx(ie, abs=6e-4)
        assert linear.stability_limit("CN", picard(M)) == pytest.approx(cn, abs=6e-4)
    for stage in (ck.chord(2), ck.newton(2)):
        assert linear.stability_limit("IE", stage) == np.inf
        assert linear.stability_limit("TRAPEZOID", stage) == np.inf
        assert linear.stability_limit("CN", stage) == pytest.approx(1 + np.sqrt(5), abs=1e-9)
    for name, limit in {"EE": 2, "HEUN": 2, "MIDPOINT": 2, "RK4": 2.7852935634}.items():
        assert linear.stability_limit(name) == pytest.approx(limit, abs=1e-9)


def test_monotone_and_dead_beat_values():
    euler = linear.real_axis_limits("EE")
    assert (euler.monotone, euler.dead_beat, euler.fastest) == pytest.approx((1, 1, 1), abs=1e-6)
    trapezoid = linear.real_axis_limits("TRAPEZOID", ck.chord(2))
    assert (trapezoid.monotone, trapezoid.dead_beat) == pytest.approx((2, 2), abs=1e-6)
    paper = linear.real_axis_limits("CN", ck.chord(2))
    assert paper.dead_beat == pytest.approx(np.sqrt(2), abs=1e-6)
    heun = linear.real_axis_limits("HEUN")
    assert np.isnan(heun.dead_beat) and heun.rate == pytest.approx(0.5) and heun.fastest == pytest.approx(1, abs=1e-4)
    implicit = linear.real_axis_limits("IE", ck.chord(2))
    assert implicit.monotone == implicit.fastest == np.inf


def test_what_levels_off_is_fastest_without_end():
    """Rounding on a plateau chooses no place: a least value kept to the end of an open range is least there."""
    noise = np.random.default_rng(0)

    def flat(z):
        return 0.5 + 1e-14 * noise.standard_normal(z.shape) + 1 / (1 + z**2)

    assert linear.least_on(flat, 1e6)[0] == 1e6
    assert linear.least_on(lambda z: np.abs(1 - z / 30), 1e6)[0] == pytest.approx(30, rel=1e-6)


@pytest.mark.parametrize("limit", [1e-4, 0.31, 4.7, 33.0])
def test_a_crossing_of_dear_values_takes_few_of_them(limit):
    """A humanoid with a drive for each joint has few points: each is the eigenvalues of a large matrix."""
    asked = []

    def fn(z):
        asked.extend(z)
        return z

    found = linear.first_above(fn, limit, points=linear.FEW)
    assert abs(found - limit) < 1e-5 * max(1.0, limit) and len(asked) < 50
    assert linear.first_above(fn, limit) == pytest.approx(limit, rel=1e-9)
    assert linear.first_above(fn, 2e6, points=linear.FEW) == np.inf and linear.first_above(fn, -1.0, points=4) == 0.0
    asked.clear()
    at, least = linear.least_on(lambda z: abs(fn(z) - limit), 3 * limit, points=linear.FEW)
    assert abs(at - limit) < 1e-4 * limit and least < 1e-4 * limit and len(asked) < 60


def test_delay_limits():
    for d, published in enumerate((2, 1, 0.618, 0.445, 0.347)):
        assert linear.delay_limit(d) == pytest.approx(2 * np.sin(np.pi / (2 * (2 * d + 1))), abs=1e-6)
        assert linear.delay_limit(d) == pytest.approx(published, abs=6e-4)


def test_delayed_loop_does_what_its_radius_says():
    """e[k+1] = e[k] − z e[k−d], stepped by hand on both sides of the limit."""
    d, limit = 2, 2 * np.sin(np.pi / 10)
    for z, stable in ((0.97 * limit, True), (1.03 * limit, False)):
        e = [1.0] * (d + 1)
        for _ in range(3000):
            e.append(e[-1] - z * e[-1 - d])
        assert (max(map(abs, e[-20:])) < 1) == stable
        assert (linear.delayed_radius("EE", None, z, d) < 1) == stable


def test_region_agrees_with_amplification_and_with_the_limit():
    region = linear.stability_region("RK4", points=81)
    assert region.dims == ("im", "re")
    middle = region.sel(im=0, method="nearest")
    stable = middle.re.values[(middle.values <= 1) & (middle.re.values >= 0)]
    assert stable.max() == pytest.approx(2.785, abs=0.08)


def test_gain_units():
    assert linear.gain_per_step(20.0, 0.05) == pytest.approx(1.0)
    assert linear.gain_per_second(linear.gain_per_step(7.0, 0.01), 0.01) == pytest.approx(7.0)


def test_an_implicit_method_needs_a_stage():
    with pytest.raises(ck.ArgumentError, match="`stage` must be given for IE"):
        linear.stability_limit("IE")
