"""Limits: joint velocities that respect the robot's limits, with the task kept while freedom is left.

A limits record is called with the inverse, the chain, q, the rows of the task Jacobian, the task velocity and
the null-space velocity, and returns a `Limited`. Which joints have limits is known when the program is traced;
the others cost nothing.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike

from cnclik.hints import opaque
from cnclik.law import dense
from cnclik.law.inverse import Factored, positive, tiny_shift
from cnclik.record import record
from cnclik.robot import spatial as sp

FAR = 1e6  # [rad/s, m/s] stands for no limit: finite, so that no ∞ − ∞ arises
WIDE = 4 * math.pi  # [rad, m] a wider range, or one that is open, has limits that are felt as far as those of this one
NOISE = 0.05  # relative, of two of `_beyond_reach`: each feels the rounding of J Jᵀ, some 1/64 of its shift


class Limited(NamedTuple):
    """Joint velocities within limits."""

    qdot: tuple
    apply: Callable  # the J# that acts at these velocities
    least: object  # estimate of the least singular value of J
    held: object  # whether a limit changed what was asked for


# --- velocity limits alone ----------------------------------------------------------------------------


@record
class Scaled:
    """See `velocity_scaling`."""

    positions = False  # are not looked at

    def __call__(self, inverse, chain, q, rows, velocity, wanted) -> Limited:
        factored = inverse(rows)
        qdot, held = slowed(chain, _through(factored.apply, rows, velocity, wanted))
        return Limited(qdot=qdot, apply=factored.apply, least=factored.least, held=held)


def velocity_scaling() -> Scaled:
    """All joint velocities times s = min(1, minᵢ Vᵢ/|q̇ᵢ|): the robot follows the same direction, slower.

    V are the chain's velocity limits; the task velocity is scaled by the same s (Chiacchio, Chiaverini,
    Sciavicco & Siciliano 1991). Position limits are not looked at.
    """
    return Scaled()


def slowed(chain, qdot):
    """The velocities scaled to the slowest joint, and whether that changed them."""
    if unlimited(chain.velocity_limit):
        return qdot, False
    s = sp.smallest(sp.each(_ratio, qdot, chain.velocity_limit))
    return sp.scale(s, qdot), s < 1


def unlimited(*bounds) -> bool:
    """Whether it is known, while tracing, that there is no limit among these."""
    return all(isinstance(b, tuple) and all(sp.is_number(x) and math.isinf(x) for x in b) for b in bounds)


def _ratio(v, limit):
    """What to scale a velocity with, so that it is within its limit."""
    if sp.is_number(limit) and limit == math.inf:
        return 1.0
    over = jnp.abs(v) > limit
    return jnp.where(over, limit / jnp.where(over, jnp.abs(v), 1.0), 1.0)


def _through(apply, rows, velocity, wanted):
    """J# v + (I − J# J) q̇₀."""
    qdot = apply(velocity)
    if wanted is None:
        return qdot
    return sp.vadd(qdot, sp.vsub(wanted, apply(sp.matvec(rows, wanted))))


# --- weighted least norm ------------------------------------------------------------------------------


@record
class Weighted:
    """See `weighted_least_norm`."""

    rate: object

    def __call__(self, inverse, chain, q, rows, velocity, wanted) -> Limited:
        plain = inverse(rows)
        asked = _through(plain.apply, rows, velocity, wanted)
        roots = sp.each(_root, q, asked, chain.lower, chain.upper)
        made = inverse(sp.rescale(rows, roots))
        factored = Factored(lambda t: sp.each(sp.mul, roots, made.apply(t)), plain.least)
        back = None
        if not unlimited(chain.lower, chain.upper):
            back = sp.each(lambda x, low, high: self.rate * (jnp.clip(x, low, high) - x), q, chain.lower, chain.upper)
        if wanted is not None:
            wanted = sp.each(lambda r, w: sp.mul(sp.mul(r, r), w), roots, wanted)
            back = wanted if back is None else sp.vadd(back, wanted)
        qdot, late = slowed(chain, _through(factored.apply, rows, velocity, back))
        # Held back: a joint four times as heavy as it would be in mid-range, unless it can't move at all.
        stopped = sp.some(
            sp.each(
                lambda r, low, high: False if sp.is_number(r) else (r < 0.5) & (low < high),
                roots,
                chain.lower,
                chain.upper,
            )
        )
        return Limited(qdot=qdot, apply=factored.apply, least=plain.least, held=sp.some((late, stopped)))


@opaque
def _root(q, qdot, low, high):
    """Square root of a joint's inverse weight, 1/w = D/(D + N) with w = 1 + N/D = 1 + |∂H/∂q|; 0 for a fixed joint."""
    if unlimited((low, high)):
        return 1.0
    room = high - low
    room = min(room, WIDE) if sp.is_number(room) else jnp.minimum(room, WIDE)
    free = room > 0
    room = jnp.where(free, room, 1.0)
    below, above = (jnp.clip(gap, 0.0, 0.5 * room) for gap in (q - low, high - q))
    near = jnp.minimum(below, above)
    half = 2.0 * near * (room - near)  # written so that there is no root of 0
    root = half / jnp.sqrt(half * half + room * room * (room - 2.0 * near))
    return jnp.where(free, jnp.where(qdot * (below - above) > 0, root, 1.0), 0.0)


def weighted_least_norm(rate: ArrayLike = 10.0) -> Weighted:
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


# --- saturation in the null space ---------------------------------------------------------------------


class _Pass(NamedTuple):
    """What a pass of the saturation hands to the next."""

    locked: tuple  # per joint: 1 where it moves at its bound
    fixed: tuple  # n null-space velocities, those of locked joints at their bounds
    done: object  # a pass met every bound with the whole task
    best: object  # largest share of the task met so far, negative while no share fits
    qdot: tuple  # the velocities that met it
    kept: tuple  # and the joints locked then
    held: object


@record
class Saturated:
    """See `saturation`."""

    rate: object

    def __call__(self, inverse, chain, q, rows, velocity, wanted) -> Limited:
        plain = inverse(rows)
        if unlimited(chain.lower, chain.upper, chain.velocity_limit):
            qdot = _through(plain.apply, rows, velocity, wanted)
            return Limited(qdot=qdot, apply=plain.apply, least=plain.least, held=False)
        low, high = sp.parts(self._bounds, q, chain.lower, chain.upper, chain.velocity_limit)
        # A zero of the loop's dtype that is NaN where q or the task is: added below to what is chosen by comparisons,
        # all of them false for NaN, so that no lane that is not finite passes for one at rest.
        zero = (sp.total(q) + sp.total(velocity)) * 0.0
        asked = sp.safe_norm(velocity)

        def free(locked):
            """The rows without the locked joints' columns."""
            return sp.rescale(rows, sp.each(lambda gone: 1.0 - gone, locked))

        # A joint with a single value is no joint: out from the first pass on.
        fixed = sp.each(lambda l, h: jnp.where(l < h, zero, zero + 1.0), low, high)
        reached = _beyond_reach(free(fixed), velocity)

        def one(at: _Pass, _):
            left = free(at.locked)
            apply = inverse(left).apply
            along = apply(velocity)
            rest = sp.vsub(at.fixed, apply(sp.matvec(rows, at.fixed)))
            # Is the task still within reach of the joints that are left? Of geometry, that is: what a damped
            # inverse holds back next to a singularity is no reason to stand still.
            lost = _beyond_reach(left, velocity) > (1 + NOISE) * reached + 0.01 * asked
            along, rest = (sp.each(lambda x: x + zero, v) for v in (along, rest))
            s, worst, at_bound, over = _share(along, rest, low, high, at.locked)
            s = jnp.where(lost, -1.0, s)
            fits = ~over & ~lost
            better = ~at.done & (fits | (s > at.best) | (at.best < 0))
            share = jnp.where(fits | (s < 0), 1.0, s)
            made = sp.vadd(sp.scale(share, along), rest)

            def choose(new, old):
                return sp.each(lambda a, b: jnp.where(better, a, b), new, old)

            return _Pass(
                locked=sp.each(jnp.maximum, at.locked, worst),
                fixed=sp.each(lambda w, bound, v: jnp.where(w > 0, bound, v), worst, at_bound, at.fixed),
                done=at.done | fits,
                best=jnp.where(better, jnp.where(fits, 1.0, s), at.best),
                qdot=choose(made, at.qdot),
                kept=choose(at.locked, at.kept),
                held=at.held | over,
            ), None

        never = jnp.zeros_like(zero, bool)
        nothing = sp.each(lambda x: jnp.zeros_like(x) + zero, q)
        wanted = nothing if wanted is None else sp.vadd(nothing, wanted)
        start = _Pass(
            locked=fixed,
            fixed=sp.each(lambda gone, bound, w: jnp.where(gone > 0, bound, w), fixed, low, wanted),
            done=never,
            best=zero - 1.0,
            qdot=nothing,
            kept=nothing,
            held=never,
        )
        found, _ = lax.scan(one, start, None, length=max(chain.n - len(rows), 0) + 2)
        factored = inverse(free(found.kept))
        # Where no share fits, not even 0, a joint has to come back and no freedom is left: least squares, clipped.
        qdot = sp.each(lambda v, l, h: jnp.clip(v + zero, l, h), found.qdot, low, high)
        return Limited(qdot=qdot, apply=factored.apply, least=plain.least, held=found.held)

    def _bounds(self, q, low, high, speed):
        """The velocities a joint may have."""
        far = min(speed, FAR) if sp.is_number(speed) else jnp.minimum(speed, FAR)

        def bound(limit, unlimited):
            if sp.is_number(limit):
                room = limit - q if math.isfinite(limit) else jnp.full_like(q, unlimited)
            else:
                room = jnp.where(jnp.isfinite(limit), limit - q, unlimited)
            return jnp.clip(self.rate * room, -far, far)

        return bound(low, -FAR * FAR), bound(high, FAR * FAR)


def _beyond_reach(rows, velocity):
    """Norm of the part of a task velocity that no joint velocity gives.

    shift·(J Jᵀ + shift·I)⁻¹ is the projection onto it as shift → 0; twice over, so that single precision, whose
    shift is large, takes for out of reach only what lies in directions of σ below 0.01 of ‖J‖. The rounding of J Jᵀ
    is felt in it: to NOISE.
    """
    shift = tiny_shift(rows)
    factor = dense.ldl(dense.gram(rows, shift))
    once = sp.scale(shift, dense.ldl_solve(factor, velocity))
    return shift * sp.safe_norm(dense.ldl_solve(factor, once))


@opaque
def _share(along, rest, low, high, locked):
    """The largest s ≤ 1 with low ≤ s·along + rest ≤ high, −1 if none; the joint that bounds it; its bound.

    Flacco, De Luca & Khatib (2015), Algorithm 2.
    """

    def joint(a, b, l, h, gone):
        slack = 64 * jnp.finfo(a.dtype).eps * (1.0 + jnp.abs(a) + jnp.abs(b))
        whole = a + b
        out = (gone < 0.5) & ((whole > h + slack) | (whole < l - slack))
        moves = jnp.abs(a) > slack
        inverse = 1.0 / jnp.where(moves, a, 1.0)
        one, two = (l - b) * inverse, (h - b) * inverse
        cap = jnp.where(moves, jnp.maximum(one, two), -1.0)  # what doesn't move is outside whatever the share is
        floor = jnp.where((gone < 0.5) & moves, jnp.minimum(one, two), 0.0)
        return jnp.where(out, cap, 2.0), floor, jnp.where(whole > h, h, l), out

    caps, floors, ends, beyond = sp.parts(joint, along, rest, low, high, locked)
    smallest = sp.smallest(caps)
    most, least = jnp.minimum(smallest, 1.0), -sp.smallest(sp.each(jnp.negative, floors))
    s = jnp.where((most >= jnp.maximum(least, 0.0)) & (most >= 0), most, -1.0)
    # The most critical joint is the one locked next.
    critical = sp.first(sp.each(lambda cap, out: out & (cap <= smallest), caps, beyond))
    worst = sp.each(lambda it, a: jnp.where(it, 1.0, 0.0).astype(a.dtype), critical, along)
    return s, worst, ends, sp.some(beyond)


def saturation(rate: ArrayLike = 10.0) -> Saturated:
    """Saturation in the null space, SNS (Flacco, De Luca & Khatib 2015, Algorithm 1), for position and velocity.

    While some joint would exceed its bounds, the one that bounds the task most moves at its bound and the others
    take over its share, (J W)# (ẋ − J q̇_N) + q̇_N; where they can't, the task velocity is scaled by the largest
    share s ∈ [0, 1] that fits, so its direction is kept. Bounds on q̇ᵢ are ±Vᵢ and rate · (limit − qᵢ): a joint
    nears its limit exponentially, and one outside comes back, whatever the task asks.

    Args:
      rate: [1/s]; with rate·Ts ≤ 1 no step has to be cut short at a limit.
    """
    return Saturated(rate=positive("rate", rate))


# --- what a step keeps, whatever the limit method and the method ----------------------------------------


def within(law, q, qdot, Ts):
    """(q after a step, its velocity) of a law with limits: as asked for, but across none of them.

    What the law keeps at each of its evaluations, a combination of several, or a step that is too long, may not. All
    velocities are scaled alike; a joint that would cross a position limit ends on it, and one that is outside doesn't
    go farther out.
    """
    qdot, _ = slowed(law.chain, qdot)
    after = sp.vadd(q, sp.scale(Ts, qdot))
    kept = inside(law, q, after)
    if kept is after:
        return after, qdot
    per_time = 1.0 / jnp.where(Ts == 0, 1.0, Ts)
    qdot = sp.each(lambda x, v, there, end: jnp.where(there == end, v, (there - x) * per_time), q, qdot, kept, after)
    return kept, qdot


def inside(law, q, after):
    """Joint values after a step from q, within the position limits that the law respects, or as far outside as q."""
    chain = law.chain
    if not getattr(law.limits, "positions", law.limits is not None) or unlimited(chain.lower, chain.upper):
        return after

    def joint(x, end, low, high):
        return jnp.clip(end, jnp.minimum(low, x), jnp.maximum(high, x))

    return sp.each(joint, q, after, chain.lower, chain.upper)
