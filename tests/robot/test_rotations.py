"""SO(3) exp and log and quaternions, values and derivatives, around 0 and around π."""

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest
import scipy.linalg
from scipy.spatial.transform import Rotation

from cnclik.robot import fixed
from cnclik.robot import rotations as rot
from tests.oracles import close, hat


@jax.jit
def exp(w):
    return rot.exp_so3(w)


@jax.jit
def log(r):
    return rot.log_so3(r)


@jax.jit
def quaternion(r):
    return rot.quaternion_from_rotation(r)


derivative_of_exp = jax.jit(jax.jvp, static_argnums=0)
there_and_back = jax.jit(lambda w: log(exp(w)))
slope_there_and_back = jax.jit(jax.jacfwd(there_and_back))
slope_there_and_back_reverse = jax.jit(jax.jacrev(there_and_back))
curvature_there_and_back = jax.jit(jax.hessian(there_and_back))

# The series takes over at an angle of 1e-2 in exp, and at 2 asin(1e-2) ≈ 2e-2 in log.
NEAR_ZERO = [0.0, 1e-300, 1e-20, 1e-12, 1e-8, 1e-5, 1e-3, 0.0099999, 0.0100001, 0.0199996, 0.0200004, 0.05]
BETWEEN = [0.3, 1.0, np.pi / 2, 2.0, 2 * np.pi / 3, 3.0]
NEAR_PI = [np.pi - 1e-2, np.pi - 1e-4, np.pi - 1e-7, np.pi - 1e-10]
AXES = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (0.6, -0.8, 0), (-1, 1, 1), (0.2, -0.3, 0.9)]
UNIT = [np.array(axis) / np.linalg.norm(axis) for axis in AXES]
ANGLES = NEAR_ZERO + BETWEEN + NEAR_PI


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_and_log_values(angle):
    for w in (angle * axis for axis in UNIT):
        exact = Rotation.from_rotvec(w).as_matrix()
        close(exp(w), exact, atol=1e-15)
        close(exp(w), jaxlie.SO3.exp(jnp.asarray(w)).as_matrix(), atol=1e-12)
        # Near π a rounding of R turns the vector by about as much, and never more.
        close(log(exact), w, atol=2e-15, rtol=2e-15)
        if 1e-3 < angle < 3.1:
            close(log(exact), jaxlie.SO3.from_matrix(jnp.asarray(exact)).log(), atol=1e-12)


@pytest.mark.parametrize("angle", ANGLES)
def test_derivatives(angle):
    """log(exp(w)) = w for angles under π: so the derivative is I, and the second one 0."""
    for w in (angle * axis for axis in UNIT):
        for direction in np.eye(3):
            _, slope = derivative_of_exp(exp, (jnp.asarray(w),), (jnp.asarray(direction),))
            exact = scipy.linalg.expm_frechet(hat(w), hat(direction), compute_expm=False)
            close(slope, exact, atol=2e-14)
        close(slope_there_and_back(w), np.eye(3), atol=1e-12)
        close(slope_there_and_back_reverse(w), np.eye(3), atol=1e-12)
        close(curvature_there_and_back(w), 0, atol=1e-9)


turn_slope = jax.jit(jax.jacfwd(lambda s, r, axis: log(r @ exp(s * axis))))
turn_curvature = jax.jit(jax.jacfwd(jax.jacfwd(lambda s, r, axis: log(r @ exp(s * axis)))))
log_slope = jax.jit(jax.jacfwd(log))


@pytest.mark.parametrize("axis", [*np.eye(3), *-np.eye(3), [0.6, 0.8, 0], [0.6, 0, -0.8], [1, 2, -2], [-1, -1, 1]])
def test_log_at_pi(axis):
    """At exactly π: one of the two vectors, length π, with finite derivatives of every order asked for."""
    axis = np.array(axis) / np.linalg.norm(axis)
    r = 2 * np.outer(axis, axis) - np.eye(3)
    w = np.asarray(log(r))
    assert np.linalg.norm(w) == pytest.approx(np.pi, abs=1e-15)
    close(np.abs(w @ axis), np.pi, atol=1e-14)
    # A turn about the axis changes the length at rate 1, on the branch that was returned.
    slope = turn_slope(0.0, r, axis)
    close(slope, axis, atol=1e-14)
    assert np.all(np.isfinite(turn_curvature(0.0, r, axis)))
    assert np.all(np.isfinite(log_slope(r)))


def test_derivative_of_log_against_jaxlie():
    """d log(R exp(δ))/dδ at δ = 0, for angles where jaxlie's own derivative is sound."""
    ours = jax.jit(jax.jacfwd(lambda d, r: log(r @ exp(d))))
    theirs = jax.jit(jax.jacfwd(lambda d, r: (r @ jaxlie.SO3.exp(d)).log()))
    for r in Rotation.random(20, rng=3):
        wanted = theirs(jnp.full(3, 1e-30), jaxlie.SO3.from_matrix(jnp.asarray(r.as_matrix())))
        close(ours(jnp.zeros(3), jnp.asarray(r.as_matrix())), wanted, atol=1e-11)


def test_quaternions():
    for w in (angle * axis for angle in ANGLES[::3] for axis in UNIT):
        r = Rotation.from_rotvec(w)
        wanted = r.as_quat(canonical=True, scalar_first=True)
        found = np.asarray(quaternion(r.as_matrix()))
        close(found * np.sign(found @ wanted), wanted, atol=1e-15)
        assert found[0] >= 0
        close(jnp.array(rot.rotation_from_quaternion(found)), r.as_matrix(), atol=2e-15)


@pytest.mark.parametrize("w", [[np.pi / 2, 0, 0], [0, -np.pi / 2, 0], 2 * np.pi / 3 * np.ones(3) / np.sqrt(3)])
def test_quaternion_slopes_where_entries_are_equally_large(w):
    """At a right angle, and at a third of a turn about (1, 1, 1), whose matrix is a permutation: q̇ = (0, d/2) ∘ q."""
    r = np.round(Rotation.from_rotvec(w).as_matrix())
    found = jax.jacfwd(lambda d: quaternion(exp(d) @ r))(jnp.zeros(3))
    q = quaternion(r)
    close(found, np.vstack([-q[1:], q[0] * np.eye(3) - hat(q[1:])]) / 2, atol=1e-15)


def test_literals_fold():
    """Products with a literal 0 or 1 vanish: what compiled-in geometry is for."""
    x = jnp.asarray(2.0)
    assert fixed.mul(0.0, x) == 0.0 and isinstance(fixed.mul(0.0, x), float)
    assert fixed.mul(1.0, x) is x and fixed.add(x, 0.0) is x and fixed.dot((0.0, 1.0), (x, x)) is x
    assert fixed.mul(x, -1.0) == -2
    turned = fixed.turn((0.0, 0.0, 1.0), x)
    assert [[isinstance(v, float) for v in row] for row in turned] == [[False, False, True]] * 2 + [[True] * 3]
    # An array that happens to be 0 does not fold: its lane may move.
    assert not isinstance(fixed.mul(jnp.asarray(0.0), x), float)


@pytest.mark.parametrize("angle", [0.0, 1e-20, 1e-5, 9.9e-3, 1.01e-2, 0.02, 0.021, 1.0, 3.0, np.pi - 1e-3, np.pi])
def test_float32(angle):
    """Single precision: values to 4e-7, slopes to 1e-4, nothing infinite."""
    for axis in AXES:
        axis = np.array(axis) / np.linalg.norm(axis)
        w = jnp.asarray(angle * axis, jnp.float32)
        assert exp(w).dtype == log(exp(w)).dtype == jnp.float32
        close(exp(w), Rotation.from_rotvec(np.asarray(w, float)).as_matrix(), atol=4e-7)
        again = np.asarray(log(exp(w)))
        close(np.minimum(np.abs(again - w), np.abs(again + w)).max(), 0, atol=2e-6)
        slope = slope_there_and_back(w)
        if angle < 3.1:
            close(slope, np.eye(3), atol=1e-4)
        assert np.all(np.isfinite(slope))
