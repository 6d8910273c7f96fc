"""picard: what it returns, and that a number of passes given as an array means the same."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from tests.oracles import close

ARM = ck.planar_arm([1.0, 0.8, 0.5])
LAW = ck.Law(ARM, ck.position("xy"), alpha=4.0)
Q = np.array([0.3, 0.9, -0.5])
TARGET = ck.hold([-1.2, 0.9])


def run(stage, q=Q, method="TRAPEZOID"):
    return ck.solve(LAW, TARGET, q, 0.1, 3, method, stage)


def test_array_of_passes_equals_static_passes_under_vmap():
    many = jax.vmap(lambda M: run(ck.picard(M, maximum=5)))(jnp.arange(6))
    for M in (0, 1, 5):
        one = run(ck.picard(M))
        for field in ("q", "e", "qdot", "residual", "contraction"):
            close(getattr(many, field)[M], getattr(one, field), atol=1e-12)
        assert many.evaluations[M] == one.evaluations == 3 * (1 + M)
        np.testing.assert_array_equal(many.status[M], one.status)


def test_a_stage_with_a_batch_of_passes_is_itself_a_batch():
    stages = ck.picard(jnp.array([1, 5]))
    many = jax.vmap(lambda stage: run(stage))(stages)
    close(many.q[1], run(ck.picard(jnp.asarray(5))).q, atol=1e-14)


def test_residual_is_the_last_change_and_contraction_the_ratio_of_the_last_two():
    """From the slopes after M − 2, M − 1 and M passes of implicit Euler, h = Ts."""
    slopes = jax.vmap(lambda M: ck.step(LAW, TARGET, Q, 0.0, 0.1, "IE", ck.picard(M, maximum=5)))(jnp.arange(6))
    changes = np.linalg.norm(np.diff(slopes.qdot, axis=0), axis=1)
    close(slopes.residual[1:], 0.1 * changes, atol=1e-15)
    close(slopes.contraction[2:], changes[1:] / changes[:-1], atol=1e-12)
    # Before the first change: from rest to the explicit slope.
    first = np.linalg.norm(slopes.qdot[0])
    close(slopes.residual[0], 0.1 * first, atol=1e-15)
    close(slopes.contraction[1], changes[0] / first, atol=1e-13)


def test_explicit_methods_have_no_residual():
    made = run(ck.picard(5), method="RK4")
    assert np.all(made.residual == 0) and np.all(made.contraction == 0) and np.all(made.status == 0)


def test_converged_and_at_rest():
    at_rest = ck.hold(ck.forward(ARM, Q).position[:2])
    made = ck.step(LAW, at_rest, Q, 0.0, 0.1, "IE", ck.picard(5))
    close(made.qdot, 0, atol=1e-14)
    assert made.contraction == 0 and made.status == 0


def test_residual_carries_no_derivative():
    fn = lambda a: ck.step(ck.replace(LAW, alpha=a), TARGET, Q, 0.0, 0.1, "IE", ck.picard(5))  # noqa: E731
    slope = jax.jacfwd(lambda a: (fn(a).residual, fn(a).q))(4.0)
    assert slope[0] == 0 and np.all(np.isfinite(slope[1])) and np.any(slope[1] != 0)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: ck.picard(-1), "`M` must be at least 0, but is -1"),
        (lambda: ck.picard(2.0), "`M` must be an integer, but is 2.0"),
        (lambda: ck.picard(True), "`M` must be an integer, but is True"),
        (lambda: ck.picard(None), "`M` must be an integer, but is None"),
        (lambda: ck.picard(jnp.asarray(2.0)), "`M` must be an integer or an array of integers, but has dtype float64"),
        (lambda: ck.picard(np.array([1, -2])), "`M` must be at least 0, but is -2"),
        (lambda: ck.picard(np.array([1, 7]), maximum=5), "`maximum` must be at least M = 7, but is 5"),
        (lambda: ck.picard(np.array([1, 7]), maximum=7.5), "`maximum` must be an integer, but is 7.5"),
        (lambda: ck.picard(5, tolerance=0), "`tolerance` must be positive, but is 0"),
        (lambda: jax.jit(lambda M: ck.picard(M).M)(3), "`maximum` must be given where M is a traced array"),
    ],
)
def test_bad_input(build, message):
    with pytest.raises(ck.ArgumentError, match=message):
        build()
