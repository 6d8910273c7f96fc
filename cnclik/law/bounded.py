"""Bounded least squares: of all joint velocities within bounds, those that miss the task least.

They are the minimum of Σ ((J q̇ − v)ᵢ/λᵢ)² + |q̇ − q̇₀|², which without bounds is what a damped inverse gives, in
low ≤ q̇ ≤ high: found by projected Newton steps (Bertsekas 1982), a descent from face to face of the box.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax

from cnclik import errors
from cnclik.law import dense
from cnclik.law.inverse import positive, through
from cnclik.law.limits import Limited, bounds
from cnclik.record import brief, record
from cnclik.shapes import Array, Bool, Float, Int, Number

LEAST = 1e-10  # of the trace of J Jᵀ, for λ²: with less what rounding leaves of H = Jᵀ D⁻¹ J + I is no longer I


class Problem(NamedTuple):
    """The least of |B q̇ − w|² + |q̇ − rest|² in low ≤ q̇ ≤ high."""

    b: Float[Array, "m n"]
    w: Float[Array, " m"]
    rest: Float[Array, " n"]
    low: Float[Array, " n"]
    high: Float[Array, " n"]

    def hessian(self):
        """Half of it: BᵀB + I."""
        return dense.shifted(self.b.T @ self.b, 1.0)

    def slope(self, qdot, left):
        """Minus half the gradient, where B q̇ leaves so much of w."""
        return left @ self.b + self.rest - qdot

    def clip(self, qdot):
        """The nearest within the bounds."""
        return jnp.clip(qdot, self.low, self.high)

    def shut(self, qdot, slope):
        """Joints at a bound that would go beyond it, and joints of a single velocity."""
        out = ((qdot >= self.high) & (slope > 0)) | ((qdot <= self.low) & (slope < 0))
        return out | (self.low >= self.high)


def newton(hessian, shut):
    """Newton's step for a slope, of the joints that are not shut: a function.

    A pivot out of proportion locks a joint. The last joints are eliminated first: along a tree nothing is filled in.
    """
    size = lax.stop_gradient(jnp.diagonal(hessian))
    lock = jnp.where(shut, size / jnp.finfo(size.dtype).eps ** 2, 0.0)
    factor = dense.cholesky(dense.shifted(hessian, lock)[::-1, ::-1])

    def step(slope):
        made = dense.cholesky_solve(factor, jnp.where(shut, 0.0, slope)[::-1])[::-1]
        return jnp.where(shut, 0.0, made)

    return step


class _Pass(NamedTuple):
    """What a pass of the descent hands to the next."""

    qdot: Float[Array, " n"]  # within the bounds
    left: Float[Array, " m"]  # w − B q̇
    slope: Float[Array, " n"]
    held: Bool[Array, ""]  # whether no joint at a bound may leave it
    settled: Bool[Array, ""]
    passes: Int[Array, ""]


def descent(of: Problem, start, passes) -> _Pass:
    """The least within bounds, in at most so many passes from a start; in each the cost falls.

    A pass locks the joints that would go out and makes a Newton step of the others: whole where it stays within bounds,
    else clipped, or up to the first bound, whichever costs less. Where the first bound has won, no joint is let go
    before a whole step: without that, some are let go and locked for ever.
    """
    hessian, eps = of.hessian(), jnp.finfo(start.dtype).eps
    per_size, tolerance = 1.0 / jnp.diagonal(hessian), 1e-10 if eps < 1e-10 else 2e-5

    def reached(qdot, left, held, passes):
        slope = of.slope(qdot, left)
        goes = jnp.abs(of.clip(qdot + slope * per_size) - qdot)
        settled = jnp.max(goes) <= tolerance * (jnp.max(jnp.abs(qdot)) + eps * eps)
        return _Pass(qdot, left, slope, held, settled, passes)

    def one(at: _Pass) -> _Pass:
        above, below = at.qdot >= of.high, at.qdot <= of.low
        shut = of.shut(at.qdot, at.slope) | (at.held & (above | below))
        whole = newton(hessian, shut)(at.slope)
        along = jnp.where((above & (whole > 0)) | (below & (whole < 0)), 0.0, whole)
        clipped = of.clip(at.qdot + whole)
        step = clipped - at.qdot
        moved = of.b @ step

        def shorter():
            moves, bound, toward = along != 0, jnp.where(along > 0, of.high, of.low), of.b @ along
            share = jnp.where(moves, (bound - at.qdot) / jnp.where(moves, along, 1.0), 2.0)
            slope, curvature = at.slope @ along, toward @ toward + along @ along
            least = slope / jnp.where(curvature > 0, curvature, 1.0)
            taken = jnp.clip(jnp.minimum(jnp.min(share), least), 0.0, 1.0)
            won = taken * (0.5 * taken * curvature - slope) < 0.5 * (moved @ moved + step @ step) - at.slope @ step
            first = jnp.where(share <= taken, bound, of.clip(at.qdot + taken * along))
            return jnp.where(won, first, clipped), jnp.where(won, taken * toward, moved), won

        fits = jnp.all(clipped == at.qdot + whole)
        qdot, moved, held = lax.cond(fits, lambda: (clipped, moved, jnp.bool_(False)), shorter)
        return reached(qdot, at.left - moved, held, at.passes + 1)

    qdot = of.clip(start)
    first = reached(qdot, of.w - of.b @ qdot, jnp.bool_(False), jnp.int32(0))
    return lax.while_loop(lambda at: ~at.settled & (at.passes < passes), one, first)


@record
class Bounded:
    """See `bounded`."""

    rate: Number
    passes: int

    def __call__(self, inverse, chain, q, rows, velocity, null) -> Limited:
        plain = inverse(rows)
        if plain.shift is None:
            raise undamped(inverse)
        asked = through(plain.apply, rows, velocity, null)
        if not (chain.bounded or chain.slowed):
            return Limited(qdot=asked, apply=plain.apply, least=plain.least, limited=False)
        low, high = bounds(self.rate, chain, q)
        root = 1.0 / jnp.sqrt(jnp.maximum(plain.shift, LEAST * lax.stop_gradient(jnp.sum(rows**2))))
        rest = jnp.zeros_like(asked) if null is None else null + jnp.zeros_like(asked)
        of = Problem((root * rows.T).T, root * velocity, rest, low, high)

        def least():
            known, found = lax.stop_gradient((of, asked))
            found = descent(known, found, self.passes)
            shut = known.shut(found.qdot, found.slope)
            # One step more on the face has all derivatives of the least there, and takes away what rounding left. Of
            # a descent that was cut short it would lead anywhere, and has the derivatives alone.
            qdot = jnp.where(shut, jnp.where(found.qdot >= high, high, low), found.qdot)
            step = newton(of.hessian(), shut)(of.slope(qdot, of.w - of.b @ qdot))
            step = jnp.where(found.settled, step, step - lax.stop_gradient(step))
            return of.clip(qdot + step), shut.astype(asked.dtype), ~found.settled

        def locked(t):
            """J# of the joints that are not shut, once refined."""
            step = newton(of.hessian(), shut > 0)
            first = step((root * t) @ of.b)
            return first + step((root * t - of.b @ first) @ of.b - first)

        fits = jnp.all((low <= asked) & (asked <= high))
        qdot, shut, cut = lax.cond(fits, lambda: (asked, jnp.zeros_like(asked), jnp.bool_(False)), least)
        return Limited(
            qdot=qdot,
            apply=lambda t: lax.cond(fits, plain.apply, locked, t),
            least=plain.least,
            limited=jnp.any((shut > 0) & (low < high)),
            cut=cut,
        )


def undamped(inverse):
    """The error of an inverse without damping."""
    return errors.fail("inverse", "be damped, such as damped(0.05), with limits bounded()", f"is {brief(inverse)}")


def bounded(rate: Number = 10.0, passes: int = 40) -> Bounded:
    """Bounded least squares: of all joint velocities within bounds, those of the least weighted error.

    They are the minimum of Σ ((J q̇ − v)ᵢ/λᵢ)² + |q̇ − q̇₀|² within the bounds of `saturation`, q̇₀ the null-space
    velocity: inside of them what the law's damped inverse gives, and at them as near to the task as can be, its
    direction aside. Of `levels` the lower give way first, and the first as (λ₁/λ₂)². A descent from face to face of the
    box finds them, by projected Newton steps (Bertsekas 1982); derivatives are those of the least on its face.

    It needs an inverse with damping, best a constant one, or levels: where joints at their bounds leave the others
    singular, a damping by the whole arm's singular value is none, and joints may run from bound to bound.

    A step is AT_LIMIT where a joint moves at its bound, and NOT_CONVERGED where the descent at its start was cut short.

    Args:
      rate: see `saturation` [1/s].
      passes: Newton steps at most. One to four are the rule; of 60,000 postures of an arm and of a humanoid none took
        more than 17, and at levels of λ = 1e-4 and 0.1 none more than 28. With fewer than it takes velocities are
        within bounds and cost no more than the clipped ones, but are not the least.
    """
    return Bounded(rate=positive("rate", rate), passes=errors.integer("passes", passes, at_least=1))
