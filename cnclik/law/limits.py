"""Limits: joint velocities that respect the robot's limits. `bounded` has a module of its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp

from cnclik.law.inverse import Factored
from cnclik.record import Array, Bool, Float, record

FAR = 1e6  # [rad/s, m/s] stands for no limit: finite, so that no ∞ − ∞ arises


class Evaluation(NamedTuple):
    """Joint velocities within limits: one evaluation of f(q, t)."""

    qdot: Float[Array, " n"]
    factored: Factored  # J#, whose `apply` is that of these velocities
    limited: bool | Bool[Array, ""] = False  # whether a limit changed the velocities
    cut: bool | Bool[Array, ""] = False  # whether the search was cut short
    walls: Float[Array, " k"] | None = None  # ∇h·q̇ + rate·h of each wall, see `cnclik.law.walls`
    least: Any = None  # estimate of the least singular value (), of a stack (tasks,); of the law, as the next
    newton: Callable | None = None  # (h, k) to k + (I + h J#KJ)⁻¹ (f − k), see `cnclik.law.law.newton`


@record
class velocity_scaling:
    """All joint velocities scaled by s = min(1, minᵢ Vᵢ/|q̇ᵢ|): the robot moves in the same direction, more slowly.

    V are the chain's velocity limits; the task velocity is scaled by the same s (Chiacchio, Chiaverini, Sciavicco &
    Siciliano 1991). Position limits are ignored.
    """


def slowed(chain, qdot):
    """Return the velocities scaled to the slowest joint, and whether this changed them."""
    if not chain.slowed:
        return qdot, False
    size, most = jnp.abs(qdot), chain.velocity_limit
    s = jnp.min(jnp.where(size > most, most / jnp.where(size > most, size, 1.0), 1.0))
    return s * qdot, s < 1


def bounds(rate, chain, q):
    """Return the least and largest velocities that the joints may have: ±V, and rate · (limit − q)."""
    most = jnp.minimum(chain.velocity_limit, FAR)

    def bound(limit, unlimited):
        room = jnp.where(jnp.isfinite(limit), limit - q, unlimited)
        return jnp.clip(rate * room, -most, most)

    return bound(chain.lower, -FAR * FAR), bound(chain.upper, FAR * FAR)


# --- what a step keeps, whatever the limit method and the method ----------------------------------------


def within(law, q, qdot, Ts):
    """Return (q after a step, its velocity) of a law with limits: the requested step, but across no limit.

    A combination of evaluations, or too long a step, may not respect them. All velocities are scaled by one factor.
    A joint that would cross a position limit stops on it, and one that is outside does not move farther out.
    """
    qdot, _ = slowed(law.chain, qdot)
    after = q + Ts * qdot
    kept = inside(law, q, after)
    if kept is after:
        return after, qdot
    per_time = 1.0 / jnp.where(Ts == 0, 1.0, Ts)
    return kept, jnp.where(kept == after, qdot, (kept - q) * per_time)


def inside(law, q, after):
    """Return joint values after a step from q, within the law's position limits, or as far outside as q."""
    if law.limits is None or isinstance(law.limits, velocity_scaling) or not law.chain.bounded:
        return after
    return jnp.clip(after, jnp.minimum(law.chain.lower, q), jnp.maximum(law.chain.upper, q))
