"""R(z) against closed forms, nodepy, and the library's own stepping."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.integrate.march import march
from cnclik.stability import amplification, stability_limit
from cnclik.stability.linear import first_beyond, gain_removing, removed
from tests.refusals import refusals

PLANE = (np.linspace(-3, 3, 13) + 1j * np.linspace(-3, 3, 11)[:, None]) + 0.05
RALSTON = ck.Method(name="R", A=((0.0,), (2 / 3, 0.0)), b=(0.25, 0.75), c=(0.0, 2 / 3), order=2, source="Ralston")
METHODS = [*(m for m in ck.METHODS.values() if isinstance(m, ck.Method) and not m.exponential), RALSTON]


def powers(z, M):
    """Σ_{j=0}^{M} (−z)^j."""
    return sum((-z) ** j for j in range(M + 1))


@pytest.mark.parametrize("M", [0, 1, 4, 5, 12])
def test_passes_are_a_polynomial(M):
    wanted = 1 - PLANE / 2 * (1 + powers(PLANE, M))
    np.testing.assert_allclose(amplification("IE", PLANE, M), powers(PLANE, M + 1), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(amplification("CN", PLANE, M), wanted, rtol=1e-9, atol=1e-10)


def test_exponential_methods_decay_exactly():
    for z in (PLANE, np.array([20.0, 1e4])):
        np.testing.assert_allclose(amplification("EXP-RK4", z), np.exp(-z), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_stability_functions_are_those_of_nodepy(method):
    """nodepy derives R from the tableau alone; its z is minus ours."""
    from nodepy import runge_kutta_method as nodepy  # a second, of all workers, if it is at the top

    n = len(method.A)
    A = np.array([[*row, *[0.0] * (n - len(row))] for row in method.A])
    kind = nodepy.RungeKuttaMethod if method.implicit else nodepy.ExplicitRungeKuttaMethod
    p, q = kind(A, np.array(method.b)).stability_function()
    expected = np.polyval(p.coeffs.astype(float), -PLANE) / np.polyval(q.coeffs.astype(float), -PLANE)
    np.testing.assert_allclose(amplification(method, PLANE), expected, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize(
    ("method", "stage"),
    [(m, s) for m in METHODS for s in (ck.picard(0), ck.picard(3), ck.chord(0), ck.newton(1))
     if m.implicit or str(s) == "picard(0)"],
    ids=str,
)  # fmt: skip
def test_the_library_steps_by_the_same_factor(method, stage):
    """Its own stepping over q̇ = −z q, in the field's words for an implicit stage."""

    class Field:
        def __init__(self, z, q):
            self.qdot = -z * q
            self.newton = lambda h, k: k + (self.qdot - k) / (1 + h * z)

    with jax.enable_x64(True):
        for z in (0.3, 1.7):
            q = march(lambda _, q, z=z: Field(z, q), jnp.ones(1), 1.0, method, stage).q
            np.testing.assert_allclose(amplification(method, z, stage), q[0], rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize(
    ("method", "limit"),
    [("EE", 2), ("IE", np.inf), ("CN", 1 + 5**0.5), ("RK4", 2.785293563405282), ("TRAPEZOID", np.inf),
     ("EXP-EE", np.inf), (RALSTON, 2)], ids=str,
)  # fmt: skip
def test_limits_on_the_real_axis(method, limit):
    assert stability_limit(method) == pytest.approx(limit, rel=1e-9)


@pytest.mark.parametrize("M", range(1, 13))
def test_limits_of_passes_are_roots_of_their_polynomials(M):
    z = np.polynomial.Polynomial([0, 1])
    for method, R in (("IE", sum(((-z) ** j for j in range(M + 2)), 0 * z)),
                      ("CN", 1 - z / 2 * (1 + sum(((-z) ** j for j in range(M + 1)), 0 * z)))):  # fmt: skip
        roots = np.concatenate([(R - s).roots() for s in (1, -1)])
        real = np.sort(roots[np.abs(roots.imag) < 1e-9].real)
        expected = next(x for x in real[real > 1e-6] if abs(R(x * (1 + 1e-4))) > 1)
        assert stability_limit(method, M) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("method", ["EE", "RK4", "IE", "CN", "EXP-EE"])
def test_the_gain_that_removes_a_share_is_the_inverse(method):
    for share in (1e-4, 0.1, 0.6):
        assert removed(method, gain_removing(share, method)) == pytest.approx(share, rel=1e-9)
    assert gain_removing(1.0, "EXP-EE") == np.inf


def test_a_search_finds_the_first_place():
    assert first_beyond(lambda x: x > 3.25, 1e6) == pytest.approx(3.25, rel=1e-12)
    assert first_beyond(lambda x: x > 1234.5, 1e6) == pytest.approx(1234.5, rel=1e-12)
    assert first_beyond(lambda x: x > 2e6, 1e6) == np.inf


test_bad_input_is_named = refusals(
    (lambda: amplification("EEE", 1.0), "`method` must be one of"),
    (lambda: amplification("EE", np.nan), "`z` must be a finite number"),
    (lambda: amplification("EE", "1"), "`z` must be a finite number"),
    (lambda: amplification("EE", [True]), "`z` must be a finite number"),
    (lambda: amplification("IE", 1.0, -1), "`M` must be at least 0"),
    (lambda: amplification("IE", 1.0, 2.5), "`M` must be an integer"),
)
