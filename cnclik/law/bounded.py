"""Bounded least squares: the joint velocities within bounds that have the least weighted task error.

They minimize Σ ((J q̇ − v)ᵢ/λᵢ)² + |q̇ − q̇₀|² in low ≤ q̇ ≤ high by projected Newton steps (Bertsekas 1982). A violated
wall, floor − G q̇ > 0, costs its square over the wall's softness, so walls that contradict each other share the
violation. Multipliers y raise the floor by softness·y, and so keep the walls exactly (Hestenes 1969; Powell 1969).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.law import dense
from cnclik.law.inverse import by_shift, scaled, through
from cnclik.law.limits import Evaluation, bounds
from cnclik.law.walls import Rows, Wall, rows_at
from cnclik.record import Array, Bool, Float, Int, Number, leaf, record, replace

LEAST = 1e-10  # λ² over the trace of J Jᵀ, at least; below, rounding destroys the I in H = Jᵀ D⁻¹ J + I
_LEVER = 1e-6  # [m, rad] the smallest effect of joint velocities of cost 1 on a wall, for its softness
_ENOUGH = 0.1  # of the fall of the cost that the slope along a clipped step promises
_SWEEPS = 6  # before the descent: a sweep takes an eighth of a pass, and six save almost two passes of the slowest lane
_ROUNDS = 5  # descents, at most, while walls are violated


class Problem(NamedTuple):
    """Minimise |B q̇ − w|² + shift |q̇ − rest|² subject to low ≤ q̇ ≤ high and the walls."""

    b: Float[Array, "m n"]
    w: Float[Array, " m"]
    rest: Float[Array, " n"]
    low: Float[Array, " n"]
    high: Float[Array, " n"]
    shift: Float[Array, ""]
    walls: Rows
    soft: Float[Array, " k"]  # softness of the walls
    raised: Float[Array, " k"]  # added to their floor

    def hessian(self):
        """Return half the Hessian, BᵀB + shift I."""
        return dense.shifted(self.b.T @ self.b, self.shift)

    def slope(self, qdot):
        """Return minus half the gradient, without the forces of the walls."""
        return (self.w - self.b @ qdot) @ self.b + self.shift * (self.rest - qdot)

    def clip(self, qdot):
        """Return the nearest point within the bounds."""
        return jnp.clip(qdot, self.low, self.high)

    def shut(self, qdot, slope):
        """Return which joints are locked: at a bound and pushed outwards, or with equal bounds."""
        out = ((qdot >= self.high) & (slope > 0)) | ((qdot <= self.low) & (slope < 0))
        return out | (self.low >= self.high)

    def missing(self, qdot):
        """Return the violations (k,) of the raised floor."""
        return self.walls.floor + self.raised - self.walls.rows @ qdot

    def pushes(self, qdot):
        """Return the force (k,) of each wall: its violation, above rounding, over its softness."""
        missing, rounding = self.missing(qdot), 16 * jnp.finfo(qdot.dtype).eps * self.walls.size(qdot)
        return jnp.where(missing > rounding, missing / self.soft, 0.0)

    def pushed(self, slope, push):
        """Return minus half the gradient, with the forces of the walls."""
        return slope + push @ self.walls.rows if len(push) else slope


class Face(NamedTuple):
    """A face of the box: the joints that are not locked, and the walls that push."""

    of: Problem
    hessian: Float[Array, "n n"]  # H, large for locked joints; the last joints first: a tree then causes no fill-in
    factor: Float[Array, "n n"]  # L Lᵀ = H
    shut: Bool[Array, " n"]

    def free(self, slopes):
        """Return slopes, 0 for locked joints, the last joints first."""
        return jnp.where(self.shut, 0.0, slopes)[..., ::-1]

    def half(self, rows):
        """Return L⁻¹ Gᵀ of rows (k, n), or of one: H⁻¹ between two of them is a product."""
        return dense.triangular(self.factor, self.free(rows).T)

    def alone(self, slope):
        """Return Newton's step without walls."""
        step = dense.factored_solve(self.factor, lambda x: self.hessian @ x, self.free(slope))
        return jnp.where(self.shut, 0.0, step[::-1])

    def softened(self, push=0.0) -> Face:
        """Return the face with the walls' softness on it, and their floors raised by multipliers.

        It is √eps·gᵀ H⁻¹ g, so that violations and the rounding where walls contradict each other have the same size;
        as by each joint alone if all joints that move a wall are locked.
        """
        of = self.of
        rows, joints = of.walls.rows, 1.0 / (jnp.sum(of.b * of.b, axis=0) + of.shift)
        least = (rows * rows) @ joints + _LEVER**2 / of.shift
        soft = float(jnp.finfo(rows.dtype).eps) ** 0.5 * jnp.maximum(jnp.sum(self.half(rows) ** 2, axis=0), least)
        return self._replace(of=of._replace(soft=soft, raised=soft * push))

    def step(self, slope, missing, push, rounds=1):
        """Return Newton's step with the walls that push, and their new forces.

        In each further round the forces of the one before are multipliers. Args: slope: without the walls' forces.
        """
        if not len(push):
            return self.alone(slope), push
        on = push > 0
        rows = jnp.where(on[:, None], self.of.walls.rows, 0.0)
        half = self.half(rows)
        across = half.T @ half
        rounding = 8 * jnp.finfo(rows.dtype).eps * jnp.diagonal(across)
        matrix = dense.shifted(across, self.of.soft + rounding)
        factor, left = dense.cholesky(matrix), jnp.where(on, missing, 0.0) - half.T @ self.half(slope)
        push = 0.0
        for _ in range(rounds):
            push = dense.factored_solve(factor, lambda x: matrix @ x, left + self.of.soft * push)
        return self.alone(slope + push @ rows), push


def face(of: Problem, hessian, shut) -> Face:
    """Factor H of a face; a joint with a tiny pivot is locked."""
    size = lax.stop_gradient(jnp.diagonal(hessian))
    lock = jnp.where(shut, size / jnp.finfo(size.dtype).eps ** 2, 0.0)
    hessian = dense.shifted(hessian, lock)[::-1, ::-1]
    return Face(of, hessian, dense.cholesky(hessian), shut)


def nearest(slope, curvature, most, missing, goes, soft):
    """Return the t from 0 to `most` that minimizes ½ curvature t² − slope t + ½ Σ max(0, missing − t goes)²/soft.

    The derivative is linear between kinks, where a wall starts or stops pushing.
    """
    kink = jnp.clip(jnp.where(goes != 0, missing / jnp.where(goes != 0, goes, 1.0), 0.0), 0.0, most)
    times = jnp.concatenate([jnp.stack([jnp.zeros_like(most), most]), kink])
    rate = times * curvature - slope - jnp.maximum(missing - times[:, None] * goes, 0.0) @ (goes / soft)
    falls = (rate <= 0) | (times == 0)
    low, high = jnp.max(jnp.where(falls, times, 0.0)), jnp.min(jnp.where(falls, most, times))
    before, after = jnp.max(jnp.where(falls, rate, -jnp.inf)), jnp.min(jnp.where(falls, jnp.inf, rate))
    return low + (high - low) * before / (before - after)


class Pass(NamedTuple):
    """The state between passes of the descent."""

    qdot: Float[Array, " n"]  # within the bounds
    slope: Float[Array, " n"]  # without the forces of the walls
    held: Bool[Array, ""]  # whether joints at a bound must stay locked
    settled: Bool[Array, ""]
    passes: Int[Array, ""]
    push: Float[Array, " k"]  # forces of the walls


def swept(of: Problem, hessian, qdot, slope):
    """Move one joint after the other to its least within bounds (Gauss-Seidel)."""

    def moved(state, joint):
        (qdot, slope), (row, on, per_size, low, high) = state, joint
        here, push = (jnp.sum(jnp.where(on, x, 0.0)) for x in (qdot, slope))
        there = jnp.clip(here + push * per_size, low, high)
        return (jnp.where(on, there, qdot), slope - (there - here) * row), None

    joints = hessian, np.eye(len(qdot), dtype=bool), 1.0 / jnp.diagonal(hessian), of.low, of.high
    return lax.scan(moved, (qdot, slope), joints)[0]


def descent(of: Problem, start, passes) -> Pass:
    """Find the minimum within bounds, by at most `passes` passes from a start; the cost falls in each.

    A pass locks the joints that would leave the bounds and makes a Newton step of the others, clipped to the bounds; if
    that lowers the cost too little, up to the first bound. Then no joint is unlocked before a step that is enough, as
    some would unlock and lock for ever. Without walls, sweeps over the joints first find most that end at a bound.
    """
    hessian, eps, walled = of.hessian(), jnp.finfo(start.dtype).eps, len(of.walls.floor) > 0
    per_size, tolerance = 1.0 / jnp.diagonal(hessian), 1e-10 if eps < 1e-10 else 2e-5
    asked = jnp.abs(of.w) @ jnp.abs(of.b)

    def reached(qdot, slope, held, passes, push):
        goes = jnp.abs(of.clip(qdot + of.pushed(slope, push) * per_size) - qdot)
        sizes = asked + push @ jnp.abs(of.walls.rows) if walled else asked  # forces cancel, but for roundings
        settled = jnp.all(goes <= tolerance * (jnp.max(jnp.abs(qdot)) + eps * eps) + 4 * eps * per_size * sizes)
        return Pass(qdot, slope, held, settled, passes, push)

    def one(at: Pass) -> Pass:
        above, below = at.qdot >= of.high, at.qdot <= of.low
        slope, missing = of.pushed(at.slope, at.push), of.missing(at.qdot)
        shut = of.shut(at.qdot, slope) | (at.held & (above | below))
        whole, push = face(of, hessian, shut).step(at.slope, missing, at.push)
        clipped = of.clip(at.qdot + whole)
        step, over = clipped - at.qdot, clipped != at.qdot + whole
        along = jnp.where(step == 0, 0.0, whole)  # without joints at a bound that would leave it
        bent = hessian @ step
        gain = (at.slope - 0.5 * bent) @ step
        fits = ~jnp.any(over)
        if walled:  # and the same walls push before and after
            after = jnp.maximum(missing - of.walls.rows @ step, 0.0)
            gain -= 0.5 * jnp.sum((after**2 - jnp.maximum(missing, 0.0) ** 2) / of.soft)
            fits &= jnp.all((push > 0) == (at.push > 0)) & jnp.all((at.push > 0) | (of.pushes(clipped) == 0))

        def first():
            toward, crosses = hessian @ along, over & (step != 0)
            share = jnp.where(crosses, step, 2.0) / jnp.where(crosses, along, 1.0)
            most = jnp.clip(jnp.min(share), 0.0, 1.0)
            slope, curvature = at.slope @ along, toward @ along
            taken = jnp.clip(jnp.minimum(most, slope / jnp.where(curvature > 0, curvature, 1.0)), 0.0, 1.0)
            if walled:
                taken = nearest(slope, curvature, most, missing, of.walls.rows @ along, of.soft)
            return jnp.where(share <= taken, clipped, of.clip(at.qdot + taken * along)), taken * toward

        enough = fits | (gain > _ENOUGH * (slope @ step))
        qdot, bent = lax.cond(enough, lambda: (clipped, bent), first)
        push = jnp.where(fits, push, of.pushes(qdot))
        return reached(qdot, at.slope - bent, ~enough, at.passes + 1, push)

    qdot = of.clip(start)
    slope = of.w @ of.b + of.shift * of.rest - hessian @ qdot
    if not walled:
        qdot, slope = lax.fori_loop(0, _SWEEPS, lambda _, at: swept(of, hessian, *at), (qdot, slope))
    first = reached(qdot, slope, jnp.bool_(False), jnp.int32(0), of.pushes(qdot))
    return lax.while_loop(lambda at: ~at.settled & (at.passes < passes), one, first)


@functools.partial(jax.jit, static_argnames="passes", inline=True)  # laws of one shape read it once
def kept(of: Problem, start, passes) -> Pass:
    """Find the minimum behind walls: a descent, and more while walls are violated by more than their softness.

    Each uses the multipliers of the one before, and the softness on the face where that ended; the first has none.
    """
    if not len(of.walls.floor):
        return descent(of, start, passes)

    def again(at):
        end, rounds = at
        shut = of.shut(end.qdot, of.pushed(end.slope, end.push))
        return descent(face(of, of.hessian(), shut).softened(end.push).of, end.qdot, passes), rounds + 1

    def missed(at):
        end, rounds = at
        more = (rounds == 0) | (end.settled & jnp.any(of.walls.missed(end.qdot)))
        return (rounds < _ROUNDS) & more  # exports need a bound of the rounds

    no = jnp.bool_(False)
    first = Pass(start, jnp.zeros_like(start), no, no, jnp.int32(0), jnp.zeros_like(of.walls.floor))
    return lax.while_loop(missed, again, (first, jnp.int32(0)))[0]


@record(kw_only=False)
class bounded:
    """The joint velocities within bounds that have the least weighted error: bounded least squares.

    They minimize Σ ((J q̇ − v)ᵢ/λᵢ)² + |q̇ − q̇₀|² within the bounds ±Vᵢ and rate·(limit − qᵢ) of q̇ᵢ; q̇₀ is the
    null-space velocity. A joint approaches its limit exponentially, and one outside its limits comes back, whatever the
    task asks for. Within the bounds this is the result of the law's damped inverse. At the bounds it is as close to the
    task as possible, in a direction that may differ; of `levels` the lower ones give way first, and the first by about
    (λ₁/λ₂)². Derivatives are those of the minimum on its face of the box.

    It needs a damped inverse, best a constant one or levels; with `singular_damped` joints may jump between bounds. λ²
    is at least 1e-10 of the trace of J Jᵀ. A step is AT_LIMIT where a joint moves at its bound, and NOT_CONVERGED where
    the descent at its start was cut short.

    Args:
      rate: [1/s]; with rate·Ts ≤ 1 no step has to be cut short at a limit.
      passes: largest number of Newton steps; three are usual.
      walls: what no part of the robot may cross, see `wall`, before all levels of the task. `Trajectory.walls` shows
        which are active, and by how much contradicting ones are missed.
    """

    rate: Number = 10.0
    passes: int = 40
    walls: Sequence[Wall] = ()

    def __post_init__(self):
        if not isinstance(self.walls, Sequence) or not all(isinstance(item, Wall) for item in self.walls):
            raise errors.fail("walls", "be a list of ck.wall(...)", f"is {self.walls!r}")
        rate = leaf(errors.number("rate", self.rate, positive=True))
        walls = tuple(
            replace(item, name=item.name or str(i), rate=rate if item.rate is None else item.rate)
            for i, item in enumerate(self.walls, 1)
        )
        vars(self).update(rate=rate, passes=errors.integer("passes", self.passes, at_least=1), walls=walls)

    def on(self, chain) -> bounded:
        """Return the limits with their walls for this robot. Raises: ArgumentError for unknown tips and joints."""
        return replace(self, walls=tuple(wall.on(chain) for wall in self.walls)) if self.walls else self

    def __call__(self, shift, chain, q, rows, velocity, null) -> Evaluation:
        """Return J# v + (I − J# J) q̇₀ within the bounds, of an inverse with damping λ², one or one per row."""
        size = lax.stop_gradient(jnp.sum(scaled(rows, shift) ** 2))
        factored = by_shift(rows, shift * jnp.maximum(1.0, LEAST * size / jnp.min(jnp.asarray(shift))))
        unlimited = through(factored.apply, rows, velocity, null)
        if not (chain.bounded or chain.slowed or self.walls):
            return Evaluation(unlimited, factored)
        low, high = bounds(self.rate, chain, q)
        walls, shift = rows_at(self.walls, chain, q), factored.shift  # a shift that rounding needs, too
        still = jnp.zeros_like(walls.floor)

        def problem():  # most steps, which are within bounds, need none
            rest = jnp.zeros_like(unlimited) if null is None else null
            b, w = scaled(rows, shift), scaled(velocity, shift)
            return Problem(b, w, rest, low, high, jnp.min(shift), walls, still, still)

        def least():
            whole = problem()
            constant, start = lax.stop_gradient((whole, unlimited))
            end = kept(constant, start, self.passes)
            shut = constant.shut(end.qdot, constant.pushed(end.slope, end.push))
            # One more step on the face has all derivatives of the minimum there, and removes rounding and violations of
            # walls. Multipliers of walls that contradict grow in each round, so it makes its own, with derivatives.
            # After a descent that was cut short only its derivatives are used.
            qdot = jnp.where(shut, jnp.where(end.qdot >= high, high, low), end.qdot)
            on = face(whole, whole.hessian(), shut).softened()
            step, _ = on.step(whole.slope(qdot), on.of.missing(qdot), end.push, _ROUNDS)
            step = jnp.where(end.settled, step, step - lax.stop_gradient(step))
            return whole.clip(qdot + step), shut.astype(unlimited.dtype), ~end.settled, end.push

        def locked(t):
            """Apply J# of the joints that are not shut, along the walls that push."""
            whole = problem()
            on = face(whole, whole.hessian(), shut > 0).softened()
            return on.step(scaled(t, shift) @ whole.b, still, push)[0]

        fits = jnp.all((low <= unlimited) & (unlimited <= high)) & jnp.all(walls.rows @ unlimited >= walls.floor)
        free = unlimited, jnp.zeros_like(unlimited), jnp.bool_(False), still
        qdot, shut, cut, push = lax.cond(fits, lambda: free, least)
        return Evaluation(
            qdot=qdot,
            factored=factored._replace(apply=lambda t: lax.cond(fits, factored.apply, locked, t)),
            limited=jnp.any((shut > 0) & (low < high)) | jnp.any(push > 0),
            cut=cut,
            walls=walls.rows @ qdot - walls.floor if self.walls else None,
        )
