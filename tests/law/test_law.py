"""The law q̇ = J#(ẋ_d + K e) against NumPy, its gain over a step with derivatives, and what is no law."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.law.feedback import per_step
from tests.bank import told
from tests.oracles import close, damped_inverse, planar_jacobian, planar_position
from tests.refusals import refusals

LENGTHS = np.array([0.7, 1.1, 0.4])
ARM = ck.planar_arm(LENGTHS.tolist())
Q = np.array([0.3, -0.9, 0.6])
TARGET, VELOCITY = np.array([0.5, 1.2]), np.array([0.3, -0.2])
REFERENCE, XY = told(ck.hold(TARGET), VELOCITY), ck.position("xy")


def qdot(law, reference=REFERENCE):
    return ck.step(law, reference, Q, 0.0, 0.1, "EE").qdot


def test_the_law_is_numpys():
    """Weights scale rows and errors, a factor the feed-forward: for the CI's other settings; see test_combinations."""
    w = np.array([1.0, 3.0])
    weighted = ck.position("xy", weights=w)
    law = ck.Law(ARM, weighted, alpha=5.0, inverse=ck.damped(0.3), feedforward=0.5)
    j, v = np.diag(w) @ planar_jacobian(LENGTHS, Q), 0.5 * VELOCITY + 5.0 * (TARGET - planar_position(LENGTHS, Q))
    close(qdot(law), damped_inverse(0.3)(j) @ (w * v), atol=1e-13)


test_bad_input = refusals(
    (lambda: ck.Law(3, XY, alpha=1.0), "`chain` must be a Chain, but is int"),
    (lambda: ck.Law(ARM, "xy", alpha=1.0), "`task` must be a Task, but is str"),
    (lambda: ck.Law(ARM, XY, alpha=[1, 2, 3]), "`alpha` must be a single number or have 2 numbers, but has 3"),
    (lambda: ck.Law(ARM, XY, alpha=np.nan), r"`alpha` must be finite, but is nan"),
    (lambda: ck.Law(ARM, XY, alpha=-5), "`alpha` must be at least 0, but is -5"),
    (lambda: ck.Law(ARM, XY, alpha=np.eye(2)), r"`alpha` must have shape \(\) or \(2,\), but has"),
    (
        lambda: ck.Law(ARM, ck.pose("xyz", "z"), alpha=1),
        r"`task` must have at most 3 coordinates, one per joint, .* but has 4: x, y, z, rz\.",
    ),
    (lambda: ck.Law(ARM, XY, alpha=1, inverse="damped"), "`inverse` must be pseudoinverse()"),
    (lambda: ck.Law(ARM, XY, alpha=1, null_velocity=np.ones(3)), r"`null_velocity` must be None or posture\("),
    (lambda: ck.Law(ARM, XY, alpha=1, null_velocity=ck.posture([0, 1])), "`rest` must have 3 joint values, but has"),
    (lambda: ck.Law(ARM, XY, alpha=1, feedforward=[1, 2]), "`feedforward` must be a number"),
    (lambda: qdot(ck.Law(ARM, XY, alpha=1), reference=ck.hold([1.0])), "`reference` must give 2 values"),
    (lambda: qdot(ck.Law(ARM, ck.orientation(), alpha=1), reference=REFERENCE), "`reference` must give a rotation"),
)


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


def test_a_step_of_no_time():
    close(per_step(jnp.asarray([0.0, 4.0]), 0.0), [0.0, 4.0])
    slope = jax.jit(jax.vmap(jax.grad(lambda Ts: per_step(jnp.asarray(4.0), Ts))))
    close(slope(np.array([0.0, 0.5])), [-8.0, (0.5 * 4 * np.exp(-2) + np.expm1(-2)) / 0.25], atol=1e-12)
