"""SO(3) exp and log and quaternions, values and derivatives, around 0 and around π."""

import functools

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import scipy.linalg
from scipy.spatial.transform import Rotation

from cnclik.robot import fixed
from cnclik.robot import rotations as rot
from tests.oracles import close, hat

# Traced once for all programs.
exp, log, quaternion = (jax.jit(f) for f in (rot.exp_so3, rot.log_so3, rot.quaternion_from_rotation))


def each(fn):
    """The function of one case, compiled once for all of them."""
    return jax.jit(jax.vmap(fn))


# The series takes over at an angle of 1e-2 in exp, and at 2 asin(1e-2) ≈ 2e-2 in log.
NEAR_ZERO = [0.0, 1e-300, 1e-20, 1e-12, 1e-8, 1e-5, 1e-3, 0.0099999, 0.0100001, 0.0199996, 0.0200004, 0.05]
BETWEEN = [0.15, 0.3, 1.0, np.pi / 2, 2.0, 2 * np.pi / 3, 3.0]
NEAR_PI = [np.pi - 1e-2, np.pi - 1e-4, np.pi - 1e-7, np.pi - 1e-10]
AXES = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (0.6, -0.8, 0), (-1, 1, 1), (0.2, -0.3, 0.9)]
UNIT = [np.array(axis) / np.linalg.norm(axis) for axis in AXES]
ANGLES = NEAR_ZERO + BETWEEN + NEAR_PI
WS = np.array([angle * axis for angle in ANGLES for axis in UNIT])
AT_PI = np.array([*np.eye(3), *-np.eye(3), [0.6, 0.8, 0], [0.6, 0, -0.8], [1, 2, -2], [-1, -1, 1]])
AT_PI /= np.linalg.norm(AT_PI, axis=1, keepdims=True)
HALF_TURNS = 2 * AT_PI[:, :, None] * AT_PI[:, None] - np.eye(3)


@functools.cache
def derivatives():
    """Of log(R exp(w)), forward, reverse and second ones: of all w with R = I, and of w = 0 with half turns."""
    turned = lambda w, r: log(r @ exp(w))  # noqa: E731
    second = jax.jacfwd(lambda w, r: (jax.jacrev(turned)(w, r),) * 2, has_aux=True)
    w, r = np.concatenate([WS, 0 * AT_PI]), np.concatenate([np.stack([np.eye(3)] * len(WS)), HALF_TURNS])
    (exps, forward), (curvature, reverse) = each(
        lambda w, r: (jax.jacfwd(lambda w: (exp(w), turned(w, r)))(w), second(w, r))
    )(w, r)
    return w, exps, forward, reverse, curvature


def test_exp_and_log_values():
    exact = Rotation.from_rotvec(WS).as_matrix()
    peer = lambda w, r: (jaxlie.SO3.exp(w).as_matrix(), jaxlie.SO3.from_matrix(r).log())  # noqa: E731
    made, back, of_peer, back_of_peer = map(np.asarray, each(lambda w, r: (exp(w), log(r), *peer(w, r)))(WS, exact))
    close(made, exact, atol=1e-15)
    close(made, of_peer, atol=1e-12)
    # Near π a rounding of R turns the vector by about as much, and never more.
    close(back, WS, atol=2e-15, rtol=2e-15)
    between = np.repeat([1e-3 < angle < 3.1 for angle in ANGLES], len(UNIT))
    close(back[between], back_of_peer[between], atol=1e-12)


def test_derivatives():
    """log(exp(w)) = w for angles under π: so the derivative is I, and the second one 0."""
    w, slopes, forward, reverse, curvature = (np.asarray(v)[: len(WS)] for v in derivatives())
    exact = [[scipy.linalg.expm_frechet(hat(one), hat(d), compute_expm=False) for d in np.eye(3)] for one in w]
    close(np.moveaxis(slopes, -1, 1), exact, atol=2e-14)
    close(forward, np.broadcast_to(np.eye(3), forward.shape), atol=1e-12)
    close(reverse, np.broadcast_to(np.eye(3), reverse.shape), atol=1e-12)
    close(curvature, 0, atol=1e-9)


def test_log_at_pi():
    """At exactly π: one of the two vectors, length π, with finite derivatives of every order asked for."""
    w, entries = map(np.asarray, each(lambda r: (log(r), jax.jacfwd(log)(r)))(HALF_TURNS))
    close(np.linalg.norm(w, axis=1), np.pi, atol=1e-15)
    close(np.abs(np.sum(w * AT_PI, axis=1)), np.pi, atol=1e-14)
    _, _, *slopes, curvature = (np.asarray(v)[len(WS) :] for v in derivatives())
    for slope in slopes:  # a turn about the axis changes the length at rate 1, on the branch that was returned
        close(np.einsum("kij,kj->ki", slope, AT_PI), AT_PI, atol=1e-14)
    assert np.all(np.isfinite(curvature)) and np.all(np.isfinite(entries))


def test_quaternions():
    r = Rotation.from_rotvec(WS[::3])
    wanted = r.as_quat(canonical=True, scalar_first=True)
    found = np.asarray(each(quaternion)(r.as_matrix()))
    close(found * np.sign(np.sum(found * wanted, axis=1, keepdims=True)), wanted, atol=1e-15)
    assert np.all(found[:, 0] >= 0)
    close(each(lambda q: jnp.array(rot.rotation_from_quaternion(q)))(found), r.as_matrix(), atol=2e-15)


def test_quaternion_slopes_where_entries_are_equally_large():
    """At a right angle, and at a third of a turn about (1, 1, 1), whose matrix is a permutation: q̇ = (0, d/2) ∘ q."""
    ws = [[np.pi / 2, 0, 0], [0, -np.pi / 2, 0], 2 * np.pi / 3 * np.ones(3) / np.sqrt(3)]
    r = np.round(Rotation.from_rotvec(ws).as_matrix())
    slope = jax.jacfwd(lambda d, r: quaternion(exp(d) @ r))
    found = each(lambda r: (quaternion(r), slope(jnp.zeros(3), r)))(r)
    for q, made in zip(*map(np.asarray, found), strict=True):
        close(made, np.vstack([-q[1:], q[0] * np.eye(3) - hat(q[1:])]) / 2, atol=1e-15)


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


def test_float32():
    """Single precision: values to 4e-7, slopes to 1e-4, nothing infinite."""
    angles = [0.0, 1e-20, 1e-5, 9.9e-3, 1.01e-2, 0.02, 0.021, 1.0, 3.0, np.pi - 1e-3, np.pi]
    w = np.array([angle * axis for angle in angles for axis in UNIT], np.float32)
    there_and_back = jax.jit(lambda w: log(exp(w)))
    made = each(lambda w: (exp(w), there_and_back(w), jax.jacfwd(there_and_back)(w)))(w)
    turn, again, slope = map(np.asarray, made)
    assert turn.dtype == again.dtype == np.float32
    close(turn, Rotation.from_rotvec(np.asarray(w, float)).as_matrix(), atol=4e-7)
    close(np.minimum(np.abs(again - w), np.abs(again + w)), 0, atol=2e-6)
    within = np.linalg.norm(w, axis=1) < 3.1
    close(slope[within], np.broadcast_to(np.eye(3), (within.sum(), 3, 3)), atol=1e-4)
    assert np.all(np.isfinite(slope))
