"""The exact factor of the feedback over a step, in both precisions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.spatial

import cnclik as ck
from cnclik.law.feedback import held_feedback, per_step
from tests.oracles import close, hat


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


def test_turns_of_gains_that_differ():
    """Φ e with Φ = (1 − e^{−K·Ts})/Ts, which is the law's own K e at Ts = 0."""
    e, alpha = np.array([0.6, -0.64, 0.48]), np.array([1.0, 7.0, 40.0])
    law = ck.Law(WRIST, ck.orientation(), alpha=alpha)
    find = jax.jit(lambda Ts: held_feedback(law, e, (None,), Ts))
    close(find(0.0), alpha * e, atol=1e-10)
    for Ts in (1e-7, 0.2):
        close(find(Ts), -np.expm1(-alpha * Ts) / Ts * e, atol=1e-10)
