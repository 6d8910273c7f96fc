"""The exact factor of the feedback over a step: against SciPy's matrix exponential, in both forms and precisions."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.spatial

import cnclik as ck
from cnclik.law.feedback import held_feedback, per_step
from tests.oracles import close, hat

MATRIX = np.array([[5.0, 1.0, 0.0], [-2.0, 3.0, 0.5], [0.3, 0.0, 40.0]])


def wanted(k, Ts):
    """(I − e^{−K·Ts})/Ts by one exponential of twice the size, which divides by nothing (Van Loan 1978)."""
    m = len(k)
    whole = np.zeros((2 * m, 2 * m))
    whole[:m, :m], whole[:m, m:] = -k * Ts, np.eye(m)
    return k @ scipy.linalg.expm(whole)[:m, m:]


@pytest.mark.parametrize(("dtype", "digits"), [(np.float64, 2e-13), (np.float32, 2e-5)])
def test_gain_matrices_small_and_large(dtype, digits):
    find = jax.jit(lambda Ts: per_step(jnp.asarray(MATRIX, dtype), Ts))
    for Ts in (0.0, 1e-6, 1e-3, 0.1, 1.0, 30.0, 1e3):
        exact = wanted(MATRIX, Ts)
        close(find(dtype(Ts)), exact, atol=digits * np.abs(exact).max())


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_numbers_and_axes_with_their_derivatives(dtype):
    Ts = dtype(0.05)
    slope = jax.jit(jax.vmap(jax.value_and_grad(lambda a: per_step(a, Ts)), 0))
    a = np.array([0.0, 1e-6, 0.1, 0.199, 0.201, 1.0, 20.0, 1e4])
    value, derivative = slope(jnp.asarray(a, dtype))
    z = a.astype(dtype).astype(float) * float(Ts)
    eps = np.finfo(dtype).eps
    close(value, -np.expm1(-z) / float(Ts), rtol=8 * eps)
    close(derivative, np.exp(-z), atol=1e3 * eps)
    close(per_step(jnp.asarray([0.0, 4.0], dtype), dtype(0.0)), [0.0, 4.0])
    time = jax.grad(lambda Ts: per_step(jnp.asarray(4.0), Ts))
    close([time(0.0), time(0.5)], [-8.0, (0.5 * 4 * np.exp(-2) + np.expm1(-2)) / 0.25], atol=1e-12)


def rotation(v):
    return scipy.linalg.expm(hat(np.asarray(v)))


WRIST = ck.from_dh([0.0] * 3, [0.1] * 3, [0.1] * 3)


@pytest.mark.parametrize("size", [1e-7, 0.3, 3.0])
def test_turns_of_one_gain(size):
    """Of a target at rest (1 − e^{−z}) e; of one that turns, that with the mean of the turn at both ends."""
    law = ck.Law(WRIST, ck.orientation(), alpha=7.0)
    e, Ts = size * np.array([0.6, -0.64, 0.48]), 0.2
    find = jax.jit(lambda e, turn: held_feedback(law, e, (turn,), jnp.asarray(Ts)))
    share = (1 - np.exp(-1.4)) / Ts
    turn = rotation([0.1, 0.2, -0.15])
    close(find(e, np.eye(3)), share * e, atol=1e-15 * size)
    close(find(e, turn), share * (e + turn @ e) / 2, atol=1e-14 * size)
    at_once = jax.jit(jax.jacfwd(lambda Ts: held_feedback(law, jnp.asarray(e), (jnp.eye(3),), Ts)))(0.0)
    close(at_once, -0.5 * 49 * e, atol=1e-9)


def test_the_error_of_an_orientation_goes_along_with_the_turn():
    """E(t + s) = exp(T(s) e^{−α s} e) is what the law ω = ω_d + α e_R does, in 400 small steps."""
    alpha, spin, e, Ts, N = 7.0, np.array([0.5, 1.0, -0.75]), np.array([0.6, -0.64, 0.48]), 0.2, 400
    target, tip = np.eye(3), rotation(-e)
    for _ in range(N):
        half = rotation(spin * Ts / N / 2)
        middle = scipy.spatial.transform.Rotation.from_matrix(half @ target @ tip.T).as_rotvec()
        tip = rotation((spin + alpha * middle) * Ts / N) @ tip
        target = half @ half @ target
    left = scipy.spatial.transform.Rotation.from_matrix(target @ tip.T).as_rotvec()
    close(left, np.exp(-alpha * Ts) * rotation(spin * Ts) @ e, atol=1e-3)


def test_turns_of_gains_that_differ():
    """Φ e with Φ = (I − e^{−K·Ts})/Ts, which is the law's own K e at Ts = 0 and all of e at a large gain."""
    e = np.array([0.6, -0.64, 0.48])
    for alpha in (np.array([1.0, 7.0, 40.0]), MATRIX):
        law = ck.Law(WRIST, ck.orientation(), alpha=alpha)
        k = np.diag(alpha) if alpha.ndim == 1 else alpha
        find = jax.jit(lambda Ts, law=law: held_feedback(law, e, (None,), Ts))
        for Ts in (0.0, 1e-7, 0.2):
            close(find(Ts), wanted(k, Ts) @ e, atol=1e-10)


def test_a_gain_matrix_of_a_stack_costs_what_its_tasks_do():
    """Powers of the whole (m, m) made exported steps of megabytes, of which most was products with 0."""
    arm = ck.planar_arm([1.0, 0.8, 0.6])
    tasks = ck.stack(hand=ck.position("xy"), rest=ck.joints())
    matrix = np.array([[9.0, 2.0], [2.0, 5.0]])
    law = ck.Law(arm, tasks, alpha={"hand": matrix, "rest": 0.5}, inverse=ck.damped(0.1))
    e, Ts = np.array([0.3, -0.2, 0.1, 0.4, -0.5]), 0.1
    made = functools.partial(held_feedback, law, turns=(None, None), Ts=jnp.asarray(Ts))
    close(made(e), [*wanted(matrix, Ts) @ e[:2], *wanted(0.5 * np.eye(3), Ts) @ e[2:]], atol=1e-14)
    assert "[3,3] = dot_general" in (text := str(jax.make_jaxpr(made)(e))) and "[5,5] = dot_general" not in text
