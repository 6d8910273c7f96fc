"""Null-space terms: motions of a redundant arm that do not move the task.

A term is a record that maps q (n,) to a joint velocity q̇₀ (n,); the law projects it, (I − J# J) q̇₀ (Liégeois 1977;
Siciliano et al. 2009, eq. 3.55).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp

from cnclik import errors
from cnclik.law.inverse import gram_factor
from cnclik.record import Array, ArrayLike, Float, Number, leaf, record, replace
from cnclik.robot import chart
from cnclik.robot.chain import Chain
from cnclik.robot.model import modelled
from cnclik.task.parts import At
from cnclik.task.task import Task, rows


@record
class Posture:
    """See `posture`."""

    rest: Float[Array, " n"]
    rate: Number
    balls: tuple[tuple[int, int], ...] = dataclasses.field(default=(), repr=False)  # set by `on`, for the robot

    def on(self, chain):
        return replace(self, balls=chain.balls)

    def __call__(self, q):
        if len(self.rest) != len(q):
            raise errors.fail("rest", f"have shape ({len(q)},)", f"has shape ({len(self.rest)},)")
        return self.rate * chart.between(self, q, self.rest)


@record
class MaximizeManipulability:
    """See `maximize_manipulability`."""

    chain: Chain
    task: Task
    gain: Number

    def __call__(self, q):
        chain = modelled(self.chain)

        def w(y):  # its tiny shift keeps the derivative finite at w = 0, where w has a kink
            return jnp.prod(jnp.diagonal(gram_factor(rows(self.task, At(chain, chart.out(chain, q, y))))[0]))

        return self.gain * jax.grad(w)(chart.centre(chain, q))


@record(kw_only=False)
class ScaledNullVelocity:
    """A null-space velocity times a gain."""

    base: Callable[[Array], Array] | ArrayLike
    gain: Number

    def __call__(self, q):
        return self.gain * evaluated(self.base, q)


@record(kw_only=False)
class WithoutDrift:
    """See `without`."""

    base: Callable[[Array], Array] | ArrayLike
    drift: Float[Array, " n"]

    def __call__(self, q):
        return evaluated(self.base, q) - self.drift


def evaluated(wanted, q):
    """q̇₀ (n,) of a null-space velocity, which is a record, a function of q, or an array."""
    if dataclasses.is_dataclass(wanted):
        return wanted(q)
    values, n = wanted(q) if callable(wanted) else wanted, len(q)
    values = jnp.asarray(errors.array("null_velocity", values, finite=False))
    if values.shape != (n,):
        raise errors.fail("null_velocity", f"return shape ({n},)", f"returns shape {values.shape}")
    return values


def without(wanted, drift):
    """A null-space velocity minus a constant part (n,): q̇₀(q) − c. A posture remains one, with another rest."""
    if isinstance(wanted, Posture) and not wanted.balls:
        return replace(wanted, rest=jnp.asarray(wanted.rest) - drift / wanted.rate)
    return WithoutDrift(wanted, drift)


def posture(rest: Float[ArrayLike, " n"], rate: Number = 1.0) -> Posture:
    """Move the joints towards a posture in the null space: q̇₀ = rate · (q_rest − q).

    Args:
      rest: (n,) joint values [rad, m], such as the middle of the limits.
      rate: [1/s].
    """
    rate = leaf(errors.number("rate", rate, positive=True))
    return Posture(rest=errors.array("rest", rest, (None,)), rate=rate)


def maximize_manipulability(chain: Chain, task: Task, gain: Number = 1.0) -> MaximizeManipulability:
    """Move away from singularities in the null space: q̇₀ = gain · ∂w/∂q, w = √det(J Jᵀ) (Yoshikawa 1985).

    Args:
      chain, task: those of the law.
      gain: [1/s per unit of w].
    """
    task = errors.kind("task", task, Task).on(errors.kind("chain", chain, Chain))
    return MaximizeManipulability(chain=chain, task=task, gain=leaf(errors.number("gain", gain, positive=True)))
