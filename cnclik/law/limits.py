"""Limits: joint velocities that respect the robot's limits, with the task kept while freedom is left.

A limits record is called with the inverse, the chain, q, the rows of the task Jacobian, the task velocity and
the null-space velocity, and returns a `Limited`. Which joints have limits is known when the program is traced;
the others cost nothing.
"""

import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike

from cnclik import errors
from cnclik.hints import opaque
from cnclik.law import dense
from cnclik.law.inverse import Factored, tiny_shift
from cnclik.record import leaf, record
from cnclik.robot import spatial as sp


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

    def __call__(self, inverse, chain, q, rows, velocity, wanted) -> Limited:
        factored = inverse(rows)
        qdot, held = _slow_down(chain, _through(factored.apply, rows, velocity, wanted))
        return Limited(qdot=qdot, apply=factored.apply, least=factored.least, held=held)


def velocity_scaling() -> Scaled:
    """All joint velocities times s = min(1, minᵢ Vᵢ/|q̇ᵢ|): the robot follows the same direction, slower.

    V are the chain's velocity limits; the task velocity is scaled by the same s (Chiacchio, Chiaverini,
    Sciavicco & Siciliano 1991). Position limits are not looked at.
    """
    return Scaled()


def _slow_down(chain, qdot):
    """The velocities scaled to the slowest joint, and whether that changed them."""
    ratios = [
        limit / jnp.maximum(jnp.abs(v), limit)
        for v, limit in zip(qdot, chain.velocity_limit, strict=True)
        if math.isfinite(limit)
    ]
    if not ratios:
        return qdot, False
    s = functools.reduce(jnp.minimum, ratios)
    return sp.scale(s, qdot), s < 1


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
        roots, back = zip(*map(self._joint, q, asked, chain.lower, chain.upper), strict=True)
        made = inverse(tuple(tuple(map(sp.mul, row, roots)) for row in rows))
        factored = Factored(lambda t: tuple(map(sp.mul, roots, made.apply(t))), plain.least)
        if wanted is not None:
            back = sp.vadd(back, tuple(sp.mul(sp.mul(r, r), w) for r, w in zip(roots, wanted, strict=True)))
        qdot = _through(factored.apply, rows, velocity, None if _all_zero(back) else back)
        qdot, slowed = _slow_down(chain, qdot)
        # Held back: a joint four times as heavy as it would be in mid-range.
        stopped = [r < 0.5 for r in roots if not sp.is_number(r)]
        return Limited(qdot=qdot, apply=factored.apply, least=plain.least, held=_any([slowed, *stopped]))

    def _joint(self, q, qdot, low, high):
        """Square root of the joint's inverse weight, and the velocity that brings it back inside."""
        if not (math.isfinite(low) and math.isfinite(high)) or low == high:
            return 1.0, 0.0
        return _weigh_joint(q, qdot, low, high, self.rate)


@opaque
def _weigh_joint(q, qdot, low, high, rate):
    below, above = jnp.maximum(q - low, 0.0), jnp.maximum(high - q, 0.0)  # room on both sides
    room, skew = high - low, (q - low) - (high - q)
    # 1/w = D/(D + N), w = 1 + N/D = 1 + |∂H/∂q|; its root has no root of 0 in it.
    half = 2.0 * below * above
    root = half / jnp.sqrt(half * half + room * room * jnp.abs(skew))
    back = rate * (jnp.clip(q, low, high) - q)
    return jnp.where(qdot * skew > 0, root, 1.0), back


def weighted_least_norm(rate: ArrayLike = 10.0) -> Weighted:
    """Weighted least norm for joint limits, W⁻¹ Jᵀ (J W⁻¹ Jᵀ)⁻¹ (Chan & Dubey 1995, eqs. 11-17).

    wᵢ = 1 + |∂H/∂qᵢ| for a joint that would move towards its nearer limit, else 1, with
    H = ¼ Σ (uᵢ − lᵢ)²/((uᵢ − qᵢ)(qᵢ − lᵢ)): a joint slows to rest at its limit and leaves it freely, while the
    others take its share. The law's own inverse is applied to J W^(−½), so damping works with it; where no
    freedom is left the weighted J becomes singular, and damping is needed. Velocity limits by scaling.

    Args:
      rate: a joint outside its limits returns at rate · (distance), as far as the task leaves freedom [1/s].
    """
    return Weighted(rate=_positive("rate", rate))


def _all_zero(values):
    return all(sp.is_number(v) and v == 0 for v in values)


def _any(found):
    found = [f for f in found if f is not False]
    return functools.reduce(jnp.logical_or, found) if found else False


# --- saturation in the null space ---------------------------------------------------------------------


class _Pass(NamedTuple):
    """What a pass of the saturation hands to the next."""

    locked: tuple  # per limited joint: 1 where it moves at its bound
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
        n, m = chain.n, len(rows)
        bounds = [
            _bounds(*limits, self.rate)
            for limits in zip(q, chain.lower, chain.upper, chain.velocity_limit, strict=True)
        ]
        limited = [i for i in range(n) if bounds[i] is not None]
        plain = inverse(rows)
        if not limited:
            qdot = _through(plain.apply, rows, velocity, wanted)
            return Limited(qdot=qdot, apply=plain.apply, least=plain.least, held=False)
        low, high = zip(*(bounds[i] for i in limited), strict=True)
        # A zero of the loop's dtype that is NaN where q or the task is: added below to what is chosen by comparisons,
        # all of them false for NaN, so that no lane that is not finite passes for one at rest.
        zero = sp.total((*q, *velocity)) * 0.0
        asked = sp.safe_norm(velocity)
        reached = _beyond_reach(rows, velocity)

        def free(locked):
            """The rows without the locked joints' columns."""
            factor = dict(zip(limited, locked, strict=True))
            return tuple(
                tuple(sp.mul(1.0 - factor[i], x) if i in factor else x for i, x in enumerate(row)) for row in rows
            )

        def one(at: _Pass, _):
            left = free(at.locked)
            apply = inverse(left).apply
            along = apply(velocity)
            rest = sp.vsub(at.fixed, apply(sp.matvec(rows, at.fixed)))
            # Is the task still within reach of the joints that are left? Of geometry, that is: what a damped
            # inverse holds back next to a singularity is no reason to stand still.
            lost = _beyond_reach(left, velocity) > reached + 0.01 * asked
            of_limited = [tuple(v[i] + zero for i in limited) for v in (along, rest)]
            s, worst, at_bound, over = _share(*of_limited, low, high, at.locked)
            s = jnp.where(lost, -1.0, s)
            fits = ~over & ~lost
            better = ~at.done & (fits | (s > at.best) | (at.best < 0))
            share = jnp.where(fits | (s < 0), 1.0, s)
            made = sp.vadd(sp.scale(share, along), rest)
            choose = functools.partial(_choose, better)
            fixed = list(at.fixed)
            for k, i in enumerate(limited):
                fixed[i] = jnp.where(worst[k] > 0, at_bound[k], fixed[i])
            return _Pass(
                locked=tuple(jnp.maximum(a, w) for a, w in zip(at.locked, worst, strict=True)),
                fixed=tuple(fixed),
                done=at.done | fits,
                best=jnp.where(better, jnp.where(fits, 1.0, s), at.best),
                qdot=choose(made, at.qdot),
                kept=choose(at.locked, at.kept),
                held=at.held | over,
            ), None

        never = jnp.zeros_like(zero, bool)
        nothing = (zero,) * len(limited)
        start = _Pass(
            locked=nothing,
            fixed=tuple(w + zero for w in wanted) if wanted is not None else (zero,) * n,
            done=never,
            best=zero - 1.0,
            qdot=(zero,) * n,
            kept=nothing,
            held=never,
        )
        found, _ = lax.scan(one, start, None, length=max(n - m, 0) + 2)
        factored = inverse(free(found.kept))
        # Where no share fits, not even 0, a joint has to come back and no freedom is left: least squares, clipped.
        qdot = [x + zero for x in found.qdot]
        for k, i in enumerate(limited):
            qdot[i] = jnp.clip(qdot[i], low[k], high[k])
        return Limited(qdot=tuple(qdot), apply=factored.apply, least=plain.least, held=found.held)


def _choose(better, new, old):
    return tuple(jnp.where(better, a, b) for a, b in zip(new, old, strict=True))


def _beyond_reach(rows, velocity):
    """Norm of the part of a task velocity that no joint velocity gives.

    shift·(J Jᵀ + shift·I)⁻¹ is the projection onto it as shift → 0; twice over, so that single precision, whose
    shift is large, takes for out of reach only what lies in directions of σ below 0.01 of ‖J‖.
    """
    shift = tiny_shift(rows)
    factor = dense.ldl(dense.gram(rows, shift))
    once = sp.scale(shift, dense.ldl_solve(factor, velocity))
    return shift * sp.safe_norm(dense.ldl_solve(factor, once))


def _bounds(q, low, high, speed, rate):
    """The velocities a joint may have, or None where it has no limit at all."""
    if not any(map(math.isfinite, (low, high, speed))):
        return None
    far = 1e6 if not math.isfinite(speed) else speed  # stands for unlimited: finite, so that no ∞ − ∞ arises
    least = jnp.full_like(q, -far) if not math.isfinite(low) else jnp.clip(rate * (low - q), -far, far)
    most = jnp.full_like(q, far) if not math.isfinite(high) else jnp.clip(rate * (high - q), -far, far)
    return least, most


@opaque
def _share(along, rest, low, high, locked):
    """The largest s ≤ 1 with low ≤ s·along + rest ≤ high, −1 if none; the joint that bounds it; its bound.

    Flacco, De Luca & Khatib (2015), Algorithm 2.
    """
    tiny = 64 * jnp.finfo(along[0].dtype).eps
    least, most, caps, ends, beyond = 0.0, 1.0, [], [], []
    for a, b, l, h, gone in zip(along, rest, low, high, locked, strict=True):
        slack = tiny * (1.0 + jnp.abs(a) + jnp.abs(b))
        whole = a + b
        out = (gone < 0.5) & ((whole > h + slack) | (whole < l - slack))
        moves = jnp.abs(a) > slack
        inverse = 1.0 / jnp.where(moves, a, 1.0)
        one, two = (l - b) * inverse, (h - b) * inverse
        cap = jnp.where(moves, jnp.maximum(one, two), 1.0)
        floor = jnp.where(moves, jnp.minimum(one, two), 0.0)
        stuck = out & ~moves  # outside whatever the share is
        cap = jnp.where(out, jnp.where(stuck, -1.0, cap), 2.0)
        floor = jnp.where((gone < 0.5) & moves, floor, 0.0)
        most, least = jnp.minimum(most, cap), jnp.maximum(least, floor)
        caps.append(cap)
        ends.append(jnp.where(whole > h, h, l))
        beyond.append(out)
    over = functools.reduce(jnp.logical_or, beyond)
    s = jnp.where((most >= least) & (most >= 0), most, -1.0)
    # The most critical joint is the one locked next.
    smallest = functools.reduce(jnp.minimum, caps)
    worst, taken = [], jnp.zeros_like(over)
    for cap, out in zip(caps, beyond, strict=True):
        it = out & (cap <= smallest) & ~taken
        taken = taken | it
        worst.append(jnp.where(it, 1.0, 0.0).astype(along[0].dtype))
    return s, tuple(worst), tuple(ends), over


def saturation(rate: ArrayLike = 10.0) -> Saturated:
    """Saturation in the null space, SNS (Flacco, De Luca & Khatib 2015, Algorithm 1), for position and velocity.

    While some joint would exceed its bounds, the one that bounds the task most moves at its bound and the others
    take over its share, (J W)# (ẋ − J q̇_N) + q̇_N; where they can't, the task velocity is scaled by the largest
    share s ∈ [0, 1] that fits, so its direction is kept. Bounds on q̇ᵢ are ±Vᵢ and rate · (limit − qᵢ): a joint
    nears its limit exponentially, and one outside comes back, whatever the task asks.

    Args:
      rate: [1/s]; with rate·Ts ≤ 1 an explicit step does not cross a limit.
    """
    return Saturated(rate=_positive("rate", rate))


def _positive(name, value):
    return leaf(errors.number(name, value, positive=True))
