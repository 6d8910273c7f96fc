"""Limits: joint velocities that respect the robot's limits, and keep the task while freedom is left.

A limits record is called with the inverse, the chain, q, the rows of the task Jacobian, the task velocity and the
null-space velocity, and returns a `Limited`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.law import dense
from cnclik.law.inverse import Factored, Levels, positive, through, tiny_shift
from cnclik.record import Array, Bool, Float, Number, leaf, record
from cnclik.robot.rotations import safe_norm

FAR = 1e6  # [rad/s, m/s] stands for no limit: finite, so that no ∞ − ∞ arises
WIDE = 4 * math.pi  # [rad, m] the limits of a wider or open range act as in a range of this width
NOISE = 0.05  # relative rounding error of `_beyond_reach`: J Jᵀ is rounded by some 1/64 of its shift


class Limited(NamedTuple):
    """Joint velocities within limits."""

    qdot: Float[Array, " n"]
    apply: Callable  # applies the J# that holds at these velocities
    least: Float[Array, ""]  # estimate of the least singular value of J
    limited: bool | Bool[Array, ""]  # whether a limit changed the velocities
    cut: bool | Bool[Array, ""] = False  # whether the search was cut short
    walls: Float[Array, " k"] | None = None  # ∇h·q̇ + rate·h of each wall, see `cnclik.law.walls`


# --- velocity limits alone ----------------------------------------------------------------------------


@record
class Scaled:
    """See `velocity_scaling`."""

    positions = False  # position limits are ignored

    def __call__(self, inverse, chain, q, rows, velocity, null) -> Limited:
        factored = inverse(rows)
        qdot, limited = slowed(chain, through(factored.apply, rows, velocity, null))
        return Limited(qdot=qdot, apply=factored.apply, least=factored.least, limited=limited)


def velocity_scaling() -> Scaled:
    """All joint velocities times s = min(1, minᵢ Vᵢ/|q̇ᵢ|): the robot moves in the same direction, more slowly.

    V are the chain's velocity limits; the task velocity is scaled by the same s (Chiacchio, Chiaverini, Sciavicco &
    Siciliano 1991). Position limits are ignored.
    """
    return Scaled()


def slowed(chain, qdot):
    """The velocities scaled to the slowest joint, and whether this changed them."""
    if not chain.slowed:
        return qdot, False
    size, most = jnp.abs(qdot), chain.velocity_limit
    s = jnp.min(jnp.where(size > most, most / jnp.where(size > most, size, 1.0), 1.0))
    return s * qdot, s < 1


# --- weighted least norm ------------------------------------------------------------------------------


@record
class Weighted:
    """See `weighted_least_norm`."""

    rate: Number

    def __call__(self, inverse, chain, q, rows, velocity, null) -> Limited:
        plain = inverse(rows)
        unlimited = through(plain.apply, rows, velocity, null)
        roots = roots_of(chain, q, unlimited)
        made = inverse(rows * roots)
        factored = Factored(lambda t: roots * made.apply(t), plain.least)
        back = self.rate * (jnp.clip(q, chain.lower, chain.upper) - q) if chain.bounded else None
        if null is not None:
            null = roots * roots * null
            back = null if back is None else back + null
        qdot, late = slowed(chain, through(factored.apply, rows, velocity, back))
        # Limited: a joint four times as heavy as in mid-range, unless it cannot move at all.
        stopped = jnp.any((roots < 0.5) & (chain.lower < chain.upper))
        return Limited(qdot=qdot, apply=factored.apply, least=plain.least, limited=late | stopped)


def roots_of(chain, q, qdot):
    """Square roots of the joints' inverse weights, 1/w = D/(D + N), w = 1 + N/D = 1 + |∂H/∂q|; 0 for a fixed joint."""
    if not chain.bounded:
        return jnp.ones_like(q)
    low, high = chain.lower, chain.upper
    room = jnp.minimum(high - low, WIDE)
    free = room > 0
    room = jnp.where(free, room, 1.0)
    below, above = (jnp.clip(gap, 0.0, 0.5 * room) for gap in (q - low, high - q))
    near = jnp.minimum(below, above)
    half = 2.0 * near * (room - near)  # in a form without the root of 0
    root = half / jnp.sqrt(half * half + room * room * (room - 2.0 * near))
    return jnp.where(free, jnp.where(qdot * (below - above) > 0, root, 1.0), 0.0)


def weighted_least_norm(rate: Number = 10.0) -> Weighted:
    """Weighted least norm for joint limits, W⁻¹ Jᵀ (J W⁻¹ Jᵀ)⁻¹ (Chan & Dubey 1995, eqs. 11-17).

    wᵢ = 1 + |∂H/∂qᵢ| for a joint that would move towards its nearer limit, else 1, with
    H = ¼ Σ (uᵢ − lᵢ)²/((uᵢ − qᵢ)(qᵢ − lᵢ)): a joint slows to rest at its limit and leaves it freely, while the
    others take its share. The law's own inverse is applied to J W^(−½), so damping works with it; where no
    freedom is left the weighted J becomes singular, and damping is needed. Velocity limits by scaling. Where a range
    is wider than 4π rad (m), or open on one side, each limit is felt as one of a range of that width; a joint whose
    limits are equal doesn't move.

    Args:
      rate: a joint outside its limits returns at rate · (distance), as far as the task leaves freedom [1/s].
    """
    return Weighted(rate=positive("rate", rate))


# --- bounds -------------------------------------------------------------------------------------------


def bounds(rate, chain, q):
    """The least and largest velocities that the joints may have: ±V, and rate · (limit − q)."""
    most = jnp.minimum(chain.velocity_limit, FAR)

    def bound(limit, unlimited):
        room = jnp.where(jnp.isfinite(limit), limit - q, unlimited)
        return jnp.clip(rate * room, -most, most)

    return bound(chain.lower, -FAR * FAR), bound(chain.upper, FAR * FAR)


def exponential_rate(alpha: Number, Ts: Number) -> Number:
    """(1 − exp(−α Ts))/Ts, the rate that does over a step of Ts what α does in continuous time; never above 1/Ts.

    As a rate of limits or walls it takes none past its limit, however large α·Ts is.

    Args: alpha: [1/s], positive. Ts: sampling time [s].
    """
    z = errors.number("alpha", alpha, positive=True) * errors.number("Ts", Ts, positive=True)
    return leaf(-(jnp if isinstance(z, jax.Array) else np).expm1(-z) / Ts)


# --- saturation in the null space ---------------------------------------------------------------------


class _Pass(NamedTuple):
    """The state between passes of the saturation."""

    locked: Float[Array, " n"]  # 1 where a joint moves at its bound
    fixed: Float[Array, " n"]  # null-space velocities; locked joints have their bounds
    done: Bool[Array, ""]  # whether a pass kept all bounds with the whole task
    best: Float[Array, ""]  # largest share of the task so far, negative while no share fits
    qdot: Float[Array, " n"]  # the velocities with this share
    kept: Float[Array, " n"]  # the joints locked with this share
    limited: Bool[Array, ""]
    reached: Float[Array, " two"]  # the parts that no joints can reach, see `_beyond_reach`; inf before the first pass


@record
class Saturated:
    """See `saturation`."""

    rate: Number

    def __call__(self, inverse, chain, q, rows, velocity, null) -> Limited:
        plain = inverse(rows)
        if not (chain.bounded or chain.slowed):
            qdot = through(plain.apply, rows, velocity, null)
            return Limited(qdot=qdot, apply=plain.apply, least=plain.least, limited=False)
        low, high = bounds(self.rate, chain, q)
        # A zero of the loop's dtype that is NaN if q or the task is. It is added below to results of comparisons, which
        # are all false for NaN, so that no such lane looks like one at rest.
        zero = (jnp.sum(q) + jnp.sum(velocity)) * 0.0
        if not isinstance(inverse, Levels):
            found = _saturated(inverse, rows, velocity, None, null, low, high, zero)
            # If not even the share 0 fits, a joint has to come back and no freedom is left: clipped least squares.
            qdot, limited = jnp.clip(found.qdot + zero, low, high), found.limited
        else:  # each level uses the freedom left by those above, with the least change of them
            qdot, limited = 0.0 * q + zero, False
            for level in range(len(inverse.names)):
                which, upper = inverse.upto(level + 1)
                own, some = np.array(upper.level) == level, rows[which]
                due, left = jnp.where(own, velocity[which], 0.0), jnp.where(own, some @ qdot, 0.0)
                last = null if level + 1 == len(inverse.names) else None
                found = _saturated(upper, some, due, left, last, low - qdot, high - qdot, zero)
                change = found.qdot if level == 0 else jnp.where(found.best < 0, 0.0, found.qdot)
                qdot, limited = jnp.clip(qdot + change + zero, low, high), limited | found.limited
        apply = inverse(_free(rows, found.kept)).apply
        return Limited(qdot=qdot, apply=apply, least=plain.least, limited=limited)


def _free(rows, locked):
    """The rows without the locked joints' columns."""
    return rows * (1.0 - locked)


def _saturated(inverse, rows, velocity, less, null, low, high, zero) -> _Pass:
    """The largest share of `velocity` (m,) that fits, minus what is already there (m,), if anything."""
    size = safe_norm(velocity)
    # A joint whose limits are equal is locked from the first pass on.
    fixed = jnp.where(low < high, zero, zero + 1.0)

    def one(at: _Pass) -> _Pass:
        left = _free(rows, at.locked)
        apply = inverse(left).apply
        along = apply(velocity)
        there = rows @ at.fixed if less is None else rows @ at.fixed + less
        rest = at.fixed - apply(there)
        # Can the remaining joints still reach the task, and make up for the locked ones? By geometry alone: what a
        # damped inverse holds back next to a singularity is no reason to stand still.
        beyond = _beyond_reach(left, velocity, there)
        lost = jnp.any(beyond > (1 + NOISE) * at.reached + 0.01 * size)
        along, rest = (v + zero for v in (along, rest))
        s, worst, at_bound, over = _share(along, rest, low, high, at.locked)
        s = jnp.where(lost, -1.0, s)
        fits = ~over & ~lost
        better = ~at.done & (fits | (s > at.best) | (at.best < 0))
        share = jnp.where(fits | (s < 0), 1.0, s)
        return _Pass(
            locked=jnp.maximum(at.locked, worst),
            fixed=jnp.where(worst > 0, at_bound, at.fixed),
            done=at.done | fits,
            best=jnp.where(better, jnp.where(fits, 1.0, s), at.best),
            qdot=jnp.where(better, share * along + rest, at.qdot),
            kept=jnp.where(better, at.locked, at.kept),
            limited=at.limited | over,
            reached=jnp.where(jnp.isinf(at.reached), beyond, at.reached),
        )

    never = jnp.zeros_like(zero, bool)
    nothing = jnp.zeros_like(low) + zero
    null = nothing if null is None else nothing + null
    start = _Pass(
        locked=fixed,
        fixed=jnp.where(fixed > 0, low, null),
        done=never,
        best=zero - 1.0,
        qdot=nothing,
        kept=nothing,
        limited=never,
        reached=jnp.full(2, jnp.inf) + zero,
    )
    passes = max(rows.shape[1] - len(rows), 0) + 2  # most loops need only the first
    found, _ = lax.scan(lambda at, _: (lax.cond(at.done, lambda at: at, one, at), None), start, None, length=passes)
    return found


def _beyond_reach(rows, *velocities):
    """Norms of the parts of task velocities that no joint velocity gives.

    shift·(J Jᵀ + shift·I)⁻¹ is the projection onto it as shift → 0. It is applied twice, so that single precision,
    whose shift is large, finds only directions with σ below 0.01 of ‖J‖ out of reach. It is accurate to NOISE, by the
    rounding of J Jᵀ.
    """
    shift = tiny_shift(rows)
    factor = dense.cholesky(dense.shifted(rows @ rows.T, shift))

    def beyond(velocity):
        return shift * safe_norm(dense.cholesky_solve(factor, shift * dense.cholesky_solve(factor, velocity)))

    return jnp.stack([beyond(velocity) for velocity in velocities])


def _share(a, b, low, high, locked):
    """The largest s ≤ 1 with low ≤ s·a + b ≤ high, −1 if none; the joint that bounds it; its bound; whether one does.

    Flacco, De Luca & Khatib (2015), Algorithm 2.
    """

    slack = 64 * jnp.finfo(a.dtype).eps * (1.0 + jnp.abs(a) + jnp.abs(b))
    whole, free = a + b, locked < 0.5
    out = free & ((whole > high + slack) | (whole < low - slack))
    moves = jnp.abs(a) > slack
    inverse = 1.0 / jnp.where(moves, a, 1.0)
    one, two = (low - slack - b) * inverse, (high + slack - b) * inverse
    cap = jnp.where(moves, jnp.maximum(one, two), -1.0)  # a joint that does not move stays outside for any share
    cap = jnp.where(out, cap, jnp.inf)
    most, least = jnp.minimum(jnp.min(cap), 1.0), jnp.max(jnp.where(free & moves, jnp.minimum(one, two), 0.0))
    s = jnp.where((most >= jnp.maximum(least, 0.0)) & (most >= 0), most, -1.0)
    # The most critical joint, or the first of several, is locked next.
    critical = out & (cap <= jnp.min(cap))
    worst = (critical & (jnp.cumsum(critical) == 1)).astype(a.dtype)
    return s, worst, jnp.where(whole > high, high, low), jnp.any(out)


def saturation(rate: Number = 10.0) -> Saturated:
    """Saturation in the null space, SNS (Flacco, De Luca & Khatib 2015, Algorithm 1), for position and velocity limits.

    While a joint would exceed its bounds, the joint that limits the task most moves at its bound and the others take
    over its share, (J W)# (ẋ − J q̇_N) + q̇_N. Where they cannot, the task velocity is scaled by the largest share s ∈
    [0, 1] that was found, so that its direction is kept. As no locked joint is released, a larger one may exist. The
    bounds on q̇ᵢ are ±Vᵢ and rate · (limit − qᵢ): a joint approaches its limit exponentially, and a joint outside its
    limits comes back, whatever the task asks for.

    Directions in which the other joints have singular values below 0.01·‖J‖ in float32 (4e-7·‖J‖ in float64) count as
    out of reach.

    In a stack with `levels` each level has its own share and changes nothing above it (Algorithm 4). All tasks of one
    level, and of a stack without levels, slow down together.

    Args:
      rate: [1/s]; with rate·Ts ≤ 1 no step has to be cut short at a limit, see `exponential_rate`.
    """
    return Saturated(rate=positive("rate", rate))


# --- what a step keeps, whatever the limit method and the method ----------------------------------------


def within(law, q, qdot, Ts):
    """(q after a step, its velocity) of a law with limits: the requested step, but across no limit.

    Each evaluation of the law respects the limits, but a combination of several, or too long a step, may not. All
    velocities are scaled by the same factor. A joint that would cross a position limit stops on it, and one that is
    outside does not move farther out.
    """
    qdot, _ = slowed(law.chain, qdot)
    after = q + Ts * qdot
    kept = inside(law, q, after)
    if kept is after:
        return after, qdot
    per_time = 1.0 / jnp.where(Ts == 0, 1.0, Ts)
    qdot = jnp.where(kept == after, qdot, (kept - q) * per_time)
    return kept, qdot


def inside(law, q, after):
    """Joint values after a step from q, within the law's position limits, or as far outside as q."""
    if not _keeps_positions(law):
        return after
    return jnp.clip(after, jnp.minimum(law.chain.lower, q), jnp.maximum(law.chain.upper, q))


def _keeps_positions(law):
    return getattr(law.limits, "positions", law.limits is not None) and law.chain.bounded
