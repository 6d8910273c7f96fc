"""chord and newton: they reach the implicit slope at any z, for every kind of law, and say how near they are."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

import cnclik as ck
from cnclik.integrate.method import evaluations_per_step
from cnclik.law.law import evaluate
from cnclik.robot.model import modelled

ARM = ck.planar_arm([1.0] * 3)
Q = jnp.array([0.3, 0.9, -0.5])
REST = ck.hold(ck.forward(ARM, Q).position[:2])
TARGET = ck.hold(ck.forward(ARM, Q).position[:2] + jnp.array([0.12, -0.2]))
Ts = 0.1


def law(z, **changes):
    return ck.Law(ARM, ck.position("xy"), alpha=z / Ts, **changes)


def slope(law, reference, q):
    """f(q, 0) as a NumPy function."""
    return np.asarray(_slope(law, reference, jnp.asarray(q)))


@jax.jit
def _slope(law, reference, q):
    return evaluate(modelled(law), reference, jnp.zeros(()), q).qdot


@pytest.mark.parametrize(("stage", "tolerance"), [(ck.chord(12), 1e-6), (ck.newton(6), 1e-11)])
def test_implicit_euler_end_point_is_the_root_scipy_finds(stage, tolerance):
    one = law(1.5)
    root = scipy.optimize.root(lambda q: q - np.asarray(Q) - Ts * slope(one, TARGET, q), Q, tol=1e-12)
    assert root.success
    made = ck.step(one, TARGET, Q, 0.0, Ts, ck.METHODS["IE"], stage)
    np.testing.assert_allclose(made.q, root.x, atol=tolerance)
    assert float(made.residual) < tolerance * 10


def test_contraction_does_not_depend_on_z():
    """Near a target the fixed-point iteration contracts with z, the chord iteration with the curvature."""
    for z in (1.5, 15.0):
        assert float(ck.step(law(z), TARGET, Q, 0.0, Ts, ck.METHODS["IE"], ck.chord(4)).contraction) < 0.6
        assert float(ck.step(law(z), TARGET, Q, 0.0, Ts, ck.METHODS["IE"], ck.picard(4)).residual) > 0.1


GAIN = jnp.array([5.0, 20.0])
LAWS = {
    "scalar": dict(alpha=15.0),
    "damped by singular value": dict(alpha=15.0, inverse=ck.singular_damped(0.4, 20.0)),
    "damped weighted per axis": dict(alpha=GAIN, inverse=ck.damped(0.4), weights=jnp.array([1.0, 3.0])),
    "null space": dict(alpha=GAIN, null_velocity=ck.posture(Q, 4.0)),
    "damped null space": dict(alpha=15.0, inverse=ck.damped(0.4), null_velocity=ck.posture(Q, 4.0)),
}


@pytest.mark.parametrize("kind", LAWS)
def test_correction_inverts_the_linearised_law_at_rest(kind):
    """At rest curvature vanishes, and (I − h ∂f/∂q)⁻¹ must come out exactly, here by autodiff and NumPy."""
    options = dict(LAWS[kind])
    task = ck.position("xy", weights=options.pop("weights", None))
    one = ck.Law(ARM, task, **options)
    h, r = 0.3, np.array([0.7, -0.2, 1.1])

    @jax.jit
    def both(q, r):
        at = evaluate(modelled(one), REST, jnp.zeros(()), q)
        return jax.jacfwd(lambda q: _slope(one, REST, q))(q), at.newton(h, r), at.qdot

    derivative, found, f = map(np.asarray, both(Q, r))
    np.testing.assert_allclose(found, r + np.linalg.solve(np.eye(3) - h * derivative, f - r), atol=1e-9)


@pytest.mark.parametrize("inverse", [ck.pseudoinverse(), ck.damped(0.4)])
def test_a_posture_passes_a_newton_step(inverse):
    """Away from rest, by the matrix (n, n) that the formula avoids."""
    one = ck.Law(ARM, ck.position("xy"), alpha=15.0, inverse=inverse, null_velocity=ck.posture([0.3, -0.2, 0.5], 4.0))
    h, k = 0.3, np.array([0.7, -0.2, 1.1])

    @jax.jit
    def step(q):
        at, rows = evaluate(modelled(one), TARGET, jnp.zeros(()), q), ck.jacobian(ARM, q)[:2]
        return at.newton(h, k), at.qdot, rows, jax.vmap(inverse(rows, None).apply, out_axes=1)(jnp.eye(2))

    found, f, J, inverted = map(np.asarray, step(Q))
    slope = 15.0 * inverted @ J + 4.0 * (np.eye(3) - inverted @ J)
    np.testing.assert_allclose(found, k + np.linalg.solve(np.eye(3) + h * slope, f - k), atol=1e-12)


def test_masked_passes_equal_compiled_ones():
    one = law(2.0)
    counts = {ck.chord: (0, 1, 3), ck.newton: (0, 2)}

    step = functools.partial(ck.step, one, TARGET, Q, 0.0, Ts, ck.METHODS["IE"])

    def lanes(make, many):
        return jax.vmap(lambda M: step(make(M, maximum=max(many))))(jnp.array(many))

    @jax.jit
    def masked_and_alone():
        return [(lanes(make, many), [step(make(M)) for M in many]) for make, many in counts.items()]

    for made, alone in masked_and_alone():
        for i, other in enumerate(alone):
            np.testing.assert_allclose(made.q[i], other.q, atol=1e-12)
            np.testing.assert_allclose(made.residual[i], other.residual, atol=1e-12)


def end_point(z, stage):
    return ck.step(ck.Law(ARM, ck.position("xy"), alpha=z / Ts), TARGET, Q, 0.0, Ts, ck.METHODS["IE"], stage).q


def slopes(stage):
    """Of the end point by z: by differences, forward and in reverse."""
    d = 1e-5

    @jax.jit
    def three(z):
        numeric = (end_point(z + d, stage) - end_point(z - d, stage)) / (2 * d)
        return numeric, *(turn(lambda z: end_point(z, stage))(z) for turn in (jax.jacfwd, jax.jacrev))

    return three(1.5)


def test_unrolled_derivative_is_that_of_the_passes():
    numeric, *derivatives = slopes(ck.newton(1))
    for derivative in derivatives:
        np.testing.assert_allclose(derivative, numeric, atol=1e-8)


def test_cost_in_evaluations():
    assert evaluations_per_step(ck.METHODS["EE"], ck.chord(5), 3) == 1
    assert evaluations_per_step(ck.METHODS["IE"], ck.picard(5), 3) == 6
    assert evaluations_per_step(ck.METHODS["IE"], ck.chord(5), 3) == 6
    assert evaluations_per_step(ck.METHODS["CN"], ck.chord(5), 3) == 6
    assert evaluations_per_step(ck.METHODS["TRAPEZOID"], ck.newton(2), 3) == 1 + 2 * 4
    assert int(ck.solve(law(1.0), TARGET, Q, Ts, 4, ck.METHODS["TRAPEZOID"], ck.newton(2)).evaluations) == 4 * 9


def test_a_stage_that_is_not_there_yet_says_so():
    status = ck.step(law(2.0), TARGET, Q, 0.0, Ts, ck.METHODS["IE"], ck.chord(0)).status
    assert int(status) & ck.Status.NOT_CONVERGED
    status = ck.step(law(2.0), TARGET, Q, 0.0, Ts, ck.METHODS["IE"], ck.chord(8)).status
    assert not int(status) & ck.Status.NOT_CONVERGED
    with pytest.raises(ck.ArgumentError, match="`M` must be at least 0"):
        ck.chord(-1)
