"""Where the tip is and how it moves, on ordinary arrays: pose, geometric Jacobian, manipulability."""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from cnclik import errors
from cnclik.record import cast, record
from cnclik.robot import spatial as sp
from cnclik.robot.chain import Chain
from cnclik.robot.frames import frames, jacobian_rows
from cnclik.robot.rolled import in_form, one_off


@record
class Pose:
    """Position (3,) [m] and rotation (3, 3) of the tip in the base frame."""

    position: jax.Array
    rotation: jax.Array


def as_joint_values(chain: Chain, q, name="q", *, finite=False):
    """q as a floating array (n,), checked."""
    q = errors.array(name, q, (chain.n,), finite=finite)
    return q if isinstance(q, jax.Array) else jnp.asarray(q)


def _frames(chain, q):
    """The chain in the form that pays, and its frames at q (n,)."""
    chain, start = in_form(chain, q)
    chain = cast(chain, q.dtype)
    return chain, frames(chain, start)


def _rows(chain, q, linear=(0, 1, 2), angular=(0, 1, 2)):
    """Rows of the geometric Jacobian as an array, see `jacobian_rows`."""
    return sp.packed(jacobian_rows(*_frames(chain, q), linear, angular), q.dtype)


@one_off
def _pose(chain, q):
    _, at = _frames(chain, q)
    return Pose(position=sp.packed(at.position, q.dtype), rotation=sp.packed(at.rotation, q.dtype))


_jacobian = one_off(_rows)


@one_off(static_argnames=("linear", "angular"))
def jacobians(chain, postures, *, linear, angular):
    """Chosen rows of the geometric Jacobian at each of (K, n) postures: (K, rows, n)."""
    return jax.vmap(lambda q: _rows(chain, q, linear, angular))(postures)


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
    return _manipulability(chain, task, as_joint_values(chain, q))


@one_off
def _manipulability(chain, task, q):
    rows = sp.thin(_rows(chain, q) if task is None else _rows(chain, q, task.linear, task.angular))
    return sp.safe_sqrt(jnp.maximum(jnp.linalg.det(sp.products(rows, rows)), 0.0))
