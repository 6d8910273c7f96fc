"""The loop as a textbook writes it in JAX: 4×4 matrices, arrays, `jnp.linalg`, one robot; `vmap` does the rest."""

import jax
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


def pseudoinverse(j, v, damping):
    """J# v by `jnp.linalg.pinv`."""
    del damping
    return jnp.linalg.pinv(j) @ v


def loop(pose_and_jacobian, inverse, *, alpha, damping, Ts, M):
    """A jitted, vmapped `run(q0, position, rotation, N)` -> (q, ‖e‖); M None is explicit Euler, else the paper's CN.

    Args:
      pose_and_jacobian: q -> ((4, 4), (6, n)); here of this module or of another library.
    """

    def field(q, position, rotation):
        at, j = pose_and_jacobian(q)
        return inverse(j, alpha * error(at, position, rotation), damping)

    def step(q, position, rotation):
        first = slope = field(q, position, rotation)
        if M is None:
            return q + Ts * first
        for _ in range(M):
            slope = field(q + Ts * slope, position, rotation)
        return q + Ts * 0.5 * (first + slope)

    def run(q0, position, rotation, N):
        q = jax.lax.fori_loop(0, N, lambda _, q: step(q, position, rotation), q0)
        return q, jnp.linalg.norm(error(pose_and_jacobian(q)[0], position, rotation))

    return jax.jit(jax.vmap(run, in_axes=(0, 0, 0, None)))


def panda(origins, tip):
    """`pose_and_jacobian` of this module."""

    def at(q):
        pose, frames = forward_kinematics(origins.astype(q.dtype), tip.astype(q.dtype), q)
        return pose, geometric_jacobian(frames, pose)

    return at
