"""picard, chord and newton: the implicit slope they reach, what they say of it, and their numbers of passes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.integrate.method import evaluations_per_step
from cnclik.law.law import evaluate
from cnclik.robot.model import modelled
from tests.oracles import close
from tests.refusals import refusals

ARM = ck.planar_arm([1.0, 0.8, 0.5])
LAW = ck.Law(ARM, ck.position("xy"), alpha=4.0)
Q = np.array([0.3, 0.9, -0.5])
TARGET = ck.hold([-1.2, 0.9])


def test_residual_is_the_last_change_and_contraction_the_ratio_of_the_last_two():
    """From the slopes after M − 2, M − 1 and M passes of implicit Euler, h = Ts; they carry no derivative."""

    def step(M, alpha=4.0):
        stage = ck.picard(M, maximum=None if isinstance(M, int) else 5)
        return ck.step(ck.replace(LAW, alpha=alpha), TARGET, Q, 0.0, 0.1, "IE", stage)

    slopes = jax.jit(jax.vmap(step))(jnp.arange(6))
    changes = np.linalg.norm(np.diff(slopes.qdot, axis=0), axis=1)
    close(slopes.residual[1:], 0.1 * changes, atol=1e-15)
    close(slopes.contraction[2:], changes[1:] / changes[:-1], atol=1e-12)
    # Before the first change: from rest to the explicit slope.
    first = np.linalg.norm(slopes.qdot[0])
    close(slopes.residual[0], 0.1 * first, atol=1e-15)
    close(slopes.contraction[1], changes[0] / first, atol=1e-13)
    # A number of passes that is compiled in, and its derivatives.
    alone, slope = jax.jit(lambda a: (step(3, a), jax.jacfwd(lambda a: step(3, a))(a)))(4.0)
    for field in ("q", "e", "qdot", "residual", "contraction", "status"):
        close(getattr(alone, field), getattr(slopes, field)[3], atol=1e-12)
    assert slope.residual == slope.contraction == 0 and np.all(np.isfinite(slope.q)) and np.any(slope.q != 0)


test_bad_input = refusals(
    (lambda: ck.picard(-1), "`M` must be at least 0, but is -1"),
    (lambda: ck.picard(2.0), "`M` must be an integer, but is 2.0"),
    (lambda: ck.picard(True), "`M` must be an integer, but is True"),
    (lambda: ck.picard(jnp.asarray(2.0)), "`M` must be an integer or an array of integers, but has dtype float64"),
    (lambda: ck.picard(np.array([1, 7]), maximum=5), "`M` must be 0 to `maximum`, 5, but is 1 to 7"),
    (lambda: ck.picard(5, tolerance=0), "`tolerance` must be positive, but is 0"),
    (lambda: jax.jit(lambda M: ck.picard(M).M)(3), "`maximum` must be given where M is a traced array"),
)


REST = ck.hold(ck.forward(ARM, Q).position[:2])
NEAR = ck.hold(ck.forward(ARM, Q).position[:2] + jnp.array([0.12, -0.2]))
Ts = 0.1


def law(z, **changes):
    return ck.Law(ARM, ck.position("xy"), alpha=z / Ts, **changes)


def slope(law, reference, q):
    """f(q, 0) as a NumPy function."""
    return np.asarray(_slope(law, reference, jnp.asarray(q)))


@jax.jit
def _slope(law, reference, q):
    return evaluate(modelled(law), reference, jnp.zeros(()), q).qdot


@pytest.mark.parametrize("stage", [ck.chord(20), ck.newton(8)])
def test_with_a_joint_at_its_limit_derivatives_are_of_the_others(stage):
    """At z = 2, where Picard's iteration diverges and one with derivatives of no joint, or of all, too."""
    limits = dict(lower=(-3.0, -3.0, -3.0), upper=(3.0, 0.75, 3.0), velocity_limit=(20.0, 20.0, 20.0))
    arm, start = ck.replace(ck.planar_arm([0.8, 0.6, 0.4]), **limits), [0.3, 0.74, 0.6]
    goal = np.asarray(ck.forward(arm, [0.4, 1.1, 0.9]).position)[:2]
    law = ck.Law(arm, ck.position("xy"), alpha=40.0, inverse=ck.damped(0.02), limits=ck.bounded(5.0))
    run, wild = (ck.solve(law, ck.hold(goal), start, 0.05, 4, "IE", s) for s in (stage, ck.picard(8)))
    assert set(run.status.tolist()) == {int(ck.Status.AT_LIMIT)} and run.residual.max() < 1e-10
    np.testing.assert_allclose(0.75 - run.q[1:, 1], 0.8 * (0.75 - run.q[:-1, 1]), atol=1e-9)  # the rate leaves 1/1.25
    assert wild.residual.min() > 1


GAIN = jnp.array([5.0, 20.0])
LAWS = {
    "damped by singular value": dict(alpha=15.0, inverse=ck.singular_damped(0.4, 20.0)),
    "damped weighted per axis": dict(alpha=GAIN, inverse=ck.damped(0.4), weights=jnp.array([1.0, 3.0])),
    "null space": dict(alpha=GAIN, null_velocity=ck.posture(Q, 4.0)),
}


@pytest.mark.parametrize("kind", LAWS)
def test_correction_inverts_the_linearised_law_at_rest(kind):
    """At rest curvature vanishes, and (I − h ∂f/∂q)⁻¹ must come out exactly, here by autodiff and NumPy."""
    options = dict(LAWS[kind])
    task = ck.position("xy", weights=options.pop("weights", None))
    one = ck.Law(ARM, task, **options)
    h, r = 0.3, np.array([0.7, -0.2, 1.1])

    @jax.jit
    @ck.native
    def both(q, r):
        at = evaluate(modelled(one), REST, jnp.zeros(()), q)
        return jax.jacfwd(lambda q: _slope(one, REST, q))(q), at.newton(h, r), at.qdot

    derivative, found, f = map(np.asarray, both(Q, r))
    np.testing.assert_allclose(found, r + np.linalg.solve(np.eye(3) - h * derivative, f - r), atol=1e-9)


def test_cost_in_evaluations():
    assert evaluations_per_step(ck.METHODS["EE"], ck.chord(5), 3) == 1
    assert evaluations_per_step(ck.METHODS["IE"], ck.picard(5), 3) == 6
    assert evaluations_per_step(ck.METHODS["CN"], ck.chord(5), 3) == 6
    assert evaluations_per_step(ck.METHODS["TRAPEZOID"], ck.newton(2), 3) == 1 + 2 * 4
