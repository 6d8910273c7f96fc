"""Forward kinematics: pose of a tip, geometric Jacobian, manipulability."""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.cache import bounded_jit
from cnclik.record import Array, ArrayLike, Float, cast, record
from cnclik.robot.chain import Chain
from cnclik.robot.model import Model, frames, jacobian_rows, modelled, one_off
from cnclik.robot.rotations import safe_sqrt


@record
class Pose:
    """Position and orientation of a tip in the base frame."""

    position: Float[Array, " 3"]  # [m]
    rotation: Float[Array, "3 3"]  # the columns are the tip's axes


def as_joint_values(chain: Chain | Model, q, name="q", *, finite=False) -> Float[Array, " n"]:
    """q as a floating array (n,), checked."""
    n = errors.kind("chain", chain, (Chain, Model)).n
    q = errors.array(name, q, (n,), finite=finite)
    return q if isinstance(q, jax.Array) else jax.device_put(q)  # jnp.asarray would compile a program


def _computed(fn):
    """The arrays of fn(model, q), in a list: by NumPy, which does not compile, if all are numbers."""
    program = bounded_jit(lambda chain, q, tip: fn(cast(modelled(chain), q.dtype), q, tip), static_argnames="tip")

    def call(chain, q, tip):
        q, number = as_joint_values(chain, q), chain.tip_number(tip)
        if not all(map(errors.concrete, jax.tree.leaves((chain, q)))):
            return program(chain, q, tip=number)
        return [jax.device_put(v.astype(q.dtype)) for v in fn(modelled(chain), np.asarray(q, float), number)]

    return call


@_computed
def _pose(chain, q, tip):
    at = frames(chain, q, tip)
    return at.position, at.rotation


@_computed
def _jacobian(chain, q, tip):
    return [jacobian_rows(chain, frames(chain, q, tip), (0, 1, 2), (0, 1, 2))]


def forward(chain: Chain, q: Float[ArrayLike, " n"], *, tip: str | None = None) -> Pose:
    """Pose of a tip in the base frame, g(q) of Drexler (2016), Section II.

    Args:
      q: (n,) joint values [rad, m].
      tip: its name; None: the only one.
    Returns: `Pose`: position (3,) [m] and rotation (3, 3).
    Raises: ArgumentError if q does not have shape (n,), for an unknown tip, and for a missing name among several tips.
    """
    position, rotation = _pose(chain, q, tip)
    return Pose(position=position, rotation=rotation)


def jacobian(chain: Chain, q: Float[ArrayLike, " n"], *, tip: str | None = None) -> Float[Array, "6 n"]:
    """Geometric Jacobian J(q), (6, n): tip velocity (v, ω) = J q̇ in the base frame, linear rows first.

    Column i is (aᵢ × (p − pᵢ), aᵢ) for a revolute joint and (aᵢ, 0) for a prismatic one (Siciliano et al. 2009, eq.
    3.30). Units: m/s and rad/s per unit of q̇. A joint that does not move the tip has a column of zeros.

    Args: q, tip: as for `forward`.
    Raises: as `forward`.
    """
    return _jacobian(chain, q, tip)[0]


def manipulability(
    chain: Chain, q: Float[ArrayLike, " n"], task: Any = None, *, tip: str | None = None
) -> Float[Array, ""]:
    """Yoshikawa's measure w = √det(J Jᵀ), 0 at a singularity (Yoshikawa 1985, eq. 9).

    Args:
      q, tip: as for `forward`.
      task: a law's task, which names its own tips; default: the whole 6-row geometric Jacobian.
    """
    if not (task is None or isinstance(getattr(task, "targets", None), tuple)):  # a task's class is in a later room
        raise errors.fail("task", "be a Task such as position(), or None", f"is {task!r}")
    q = as_joint_values(chain, q)
    if task is None:
        return _manipulability(chain, None, q, tip=chain.tip_number(tip))
    task = task.about(tip)
    return _manipulability(chain, task.on(chain) if isinstance(chain, Chain) else task, q, tip=0)


@functools.partial(one_off, static_argnames="tip")
def _manipulability(chain, task, q, *, tip):
    chain = cast(modelled(chain), q.dtype)
    every = 0, 1, 2
    rows = jacobian_rows(chain, frames(chain, q, tip), every, every) if task is None else task.rows_at(chain, q)
    rows = rows if len(rows) <= chain.n else rows.T
    return safe_sqrt(jnp.maximum(jnp.linalg.det(rows @ rows.T), 0.0))
