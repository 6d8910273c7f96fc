"""Where the tip is and how it moves: pose, geometric Jacobian, manipulability.

`frames` is the component-form core that every loop runs on; `pose`, `jacobian` and `manipulability` are the
public functions on ordinary arrays.
"""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from cnclik import errors
from cnclik.hints import opaque
from cnclik.record import record
from cnclik.robot import spatial as sp
from cnclik.robot.chain import REVOLUTE, Chain, Joint
from cnclik.robot.trig import sincos


@record
class Pose:
    """Position (3,) [m] and rotation (3, 3) of the tip in the base frame."""

    position: jax.Array
    rotation: jax.Array


@record
class Frames:
    """Component form: the tip's pose, and for each joint its axis and a point on it, in the base frame."""

    position: tuple
    rotation: tuple
    axes: tuple
    points: tuple


@opaque
def _link(joint: Joint, position, rotation, value, sine, cosine):
    """Carry the frame over one joint: its fixed offset, then its motion."""
    point = sp.vadd(position, sp.matvec(rotation, joint.origin.position))
    rotation = sp.matmul(rotation, joint.origin.rotation)
    axis = sp.matvec(rotation, joint.axis)
    if joint.kind == REVOLUTE:
        return point, sp.matmul(rotation, sp.rotation_about(joint.axis, sine, cosine)), axis, point
    return sp.vadd(point, sp.scale(value, axis)), rotation, axis, point


def frames(chain: Chain, q) -> Frames:
    """All frames of the chain at q, a tuple of n scalars."""
    values = [sp.add(sp.mul(j.multiplier, q[j.coordinate]), j.offset) for j in chain.joints]
    turning = [i for i, j in enumerate(chain.joints) if j.kind == REVOLUTE]
    sines, cosines = sincos(tuple(values[i] for i in turning)) if turning else ((), ())
    sine, cosine = dict(zip(turning, sines, strict=True)), dict(zip(turning, cosines, strict=True))
    position, rotation, axes, points = sp.ZERO, sp.IDENTITY, [], []
    for i, joint in enumerate(chain.joints):
        position, rotation, axis, point = _link(joint, position, rotation, values[i], sine.get(i), cosine.get(i))
        axes.append(axis)
        points.append(point)
    return Frames(
        position=sp.vadd(position, sp.matvec(rotation, chain.tip.position)),
        rotation=sp.matmul(rotation, chain.tip.rotation),
        axes=tuple(axes),
        points=tuple(points),
    )


def jacobian_rows(chain: Chain, at: Frames, linear, angular):
    """Rows of the geometric Jacobian, each a tuple of n scalars.

    A revolute joint moves the tip by a × (p − pᵢ) and turns it by a; a prismatic one moves it by a.

    Args:
      linear, angular: which of the axes 0, 1, 2 to return; the rest is never computed.
    """
    columns = [[0.0] * chain.n for _ in (*linear, *angular)]
    for joint, axis, point in zip(chain.joints, at.axes, at.points, strict=True):
        if joint.kind == REVOLUTE:
            velocity, spin = sp.cross(axis, sp.vsub(at.position, point)), axis
        else:
            velocity, spin = axis, sp.ZERO
        entries = [velocity[i] for i in linear] + [spin[i] for i in angular]
        for row, entry in zip(columns, entries, strict=True):
            row[joint.coordinate] = sp.add(row[joint.coordinate], sp.mul(joint.multiplier, entry))
    return tuple(tuple(row) for row in columns)


# --- public: ordinary arrays --------------------------------------------------------------------------


def stack(values, like):
    """Nested tuples of scalars (literals among them) as one array with the dtype of `like`."""
    if isinstance(values, tuple):
        return jnp.stack([stack(v, like) for v in values])
    return jnp.asarray(values, like.dtype)


def as_joint_values(chain: Chain, q, name="q", *, finite=False):
    """q as a floating array (n,), checked."""
    q = errors.array(name, q, (chain.n,), finite=finite)
    return q if isinstance(q, jax.Array) else jnp.asarray(q)


@jax.jit
def _pose(chain, q):
    at = frames(chain, tuple(q))
    return Pose(position=stack(at.position, q), rotation=stack(at.rotation, q))


@jax.jit
def _jacobian(chain, q):
    return stack(jacobian_rows(chain, frames(chain, tuple(q)), (0, 1, 2), (0, 1, 2)), q)


def pose(chain: Chain, q: ArrayLike) -> Pose:
    """Pose of the tip in the base frame, g(q) of Drexler (2016), Section II.

    Args:
      q: (n,) joint values [rad, m].
    Returns: `Pose`: position (3,) [m] and rotation (3, 3).
    Raises: ArgumentError if q does not have shape (n,).
    """
    return _pose(chain, as_joint_values(chain, q))


def jacobian(chain: Chain, q: ArrayLike) -> jax.Array:
    """Geometric Jacobian J(q), (6, n): tip velocity (v, ω) = J q̇ in the base frame, linear rows first.

    Column i is (aᵢ × (p − pᵢ), aᵢ) for a revolute joint and (aᵢ, 0) for a prismatic one (Siciliano et al.
    2009, eq. 3.30). Units: m/s and rad/s per unit of q̇.

    Args:
      q: (n,) joint values [rad, m].
    Raises: ArgumentError if q does not have shape (n,).
    """
    return _jacobian(chain, as_joint_values(chain, q))


def manipulability(chain: Chain, q: ArrayLike, task=None) -> jax.Array:
    """Yoshikawa's measure w = √det(J Jᵀ), 0 at a singularity (Yoshikawa 1985, eq. 9).

    Args:
      q: (n,) joint values [rad, m].
      task: a task from `cnclik.law`; by default the whole 6-row geometric Jacobian.
    """
    q = as_joint_values(chain, q)
    return _manipulability(chain, task, q)


@jax.jit
def _manipulability(chain, task, q):
    at = frames(chain, tuple(q))
    axes = ((0, 1, 2), (0, 1, 2)) if task is None else (task.linear, task.angular)
    j = stack(jacobian_rows(chain, at, *axes), q)
    rows = j if j.shape[0] <= j.shape[1] else j.T
    return sp.safe_sqrt(jnp.maximum(jnp.linalg.det(rows @ rows.T), 0.0))
