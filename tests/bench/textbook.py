"""The loop as a textbook writes it in JAX: 4×4 matrices, arrays, `jnp.linalg`, one robot; `vmap` does the rest."""

import jax.numpy as jnp
from jax.scipy.linalg import cho_factor, cho_solve


def turn_about_z(angle):
    c, s, o, i = jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle), jnp.ones_like(angle)
    return jnp.array([[c, -s, o, o], [s, c, o, o], [o, o, i, o], [o, o, o, i]])


def forward_kinematics(origins, tip, q):
    """Pose of the tip (4, 4) and frames of the joints (n, 4, 4), joint i turning about its own z."""
    at, frames = jnp.eye(4, dtype=q.dtype), []
    for i in range(len(q)):
        at = at @ origins[i] @ turn_about_z(q[i])
        frames.append(at)
    return at @ tip, jnp.stack(frames)


def geometric_jacobian(frames, at):
    """(6, n), linear rows first."""
    axes, points = frames[:, :3, 2], frames[:, :3, 3]
    return jnp.concatenate([jnp.cross(axes, at[:3, 3] - points), axes], axis=1).T


def rotation_vector(r):
    """log of a rotation, angle below π."""
    v = 0.5 * jnp.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    sine = jnp.linalg.norm(v)
    small = sine < 1e-6
    return v * jnp.where(small, 1.0, jnp.arctan2(sine, 0.5 * (jnp.trace(r) - 1.0)) / jnp.where(small, 1.0, sine))


def error(at, position, rotation):
    """(6,): position, then rotation vector in the base frame."""
    return jnp.concatenate([position - at[:3, 3], rotation_vector(rotation @ at[:3, :3].T)])


def damped(j, v, damping):
    """Jᵀ (J Jᵀ + λ² I)⁻¹ v by Cholesky."""
    gram = j @ j.T + damping**2 * jnp.eye(6, dtype=j.dtype)
    return j.T @ cho_solve(cho_factor(gram), v)


def step(pose_and_jacobian, q, position, rotation, *, alpha, damping, Ts):
    """One step of explicit Euler; pose_and_jacobian: q -> ((4, 4), (6, n)), of this module or of another library."""
    at, j = pose_and_jacobian(q)
    return q + Ts * damped(j, alpha * error(at, position, rotation), damping)


def panda(origins, tip):
    """`pose_and_jacobian` of this module."""

    def at(q):
        pose, frames = forward_kinematics(origins.astype(q.dtype), tip.astype(q.dtype), q)
        return pose, geometric_jacobian(frames, pose)

    return at
