"""Stage: how the slope of an implicit stage is found, of k = g(k), g(k) = f(t + c·Ts, base + h·k), h = a·Ts.

It runs a fixed number of passes, of the same length in every lane, and returns the slope and its convergence.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.record import Array, Float, Int, record
from cnclik.robot.rotations import safe_norm

Count = int | Int[Array, ""]  # number of passes: compiled in, or one per lane


class Solved(NamedTuple):
    """An implicit slope and its convergence. `residual` and `contraction` carry no derivative."""

    slope: Float[Array, " n"]
    residual: Float[Array, ""]  # h·‖last change of the slope‖: a joint displacement [rad, m]
    contraction: Float[Array, ""]  # last change over the one before it; at 1 or more the iteration diverges


@record(kw_only=False)
class Stage:
    """A way to find an implicit slope: M passes k ← improved(k), at most `maximum`. Its text is "picard(5)"."""

    M: Count
    _: dataclasses.KW_ONLY
    maximum: int | None = None
    tolerance: float = 1e-3  # see `picard`
    improved: ClassVar[Callable]  # (g, h, k) to the next iterate

    def __post_init__(self):
        M, maximum = self.M, self.maximum
        errors.number("tolerance", self.tolerance, positive=True)
        if not (hasattr(M, "dtype") and not isinstance(M, np.integer)):
            M = maximum = errors.integer("M", M, at_least=0)
        elif not jnp.issubdtype(M.dtype, jnp.integer):
            raise errors.fail("M", "be an integer or an array of integers", f"has dtype {M.dtype}")
        elif errors.concrete(M):
            maximum = int(np.max(M)) if maximum is None else maximum
            if np.min(M) < 0 or np.max(M) > maximum:
                raise errors.fail("M", f"be 0 to `maximum`, {maximum}", f"is {np.min(M)} to {np.max(M)}")
        elif maximum is None:
            raise errors.fail("maximum", "be given where M is a traced array", "is None")
        maximum = errors.integer("maximum", maximum, at_least=0)
        vars(self).update(M=M, maximum=maximum, tolerance=float(self.tolerance))

    def __str__(self):
        return f"{type(self).__name__}({self.M})"

    def __call__(self, g, first, h, ahead) -> Solved:
        """Return the slope of g. Args: first: f at the step's start. ahead: the stage's base is q + h·ahead."""
        start = self.start(first, h, ahead)
        zero, counted = jnp.zeros((), start.dtype), type(self.M) is int
        # The start counts as the first change, from rest, so that M = 0 has a meaningful residual.
        size = safe_norm(start)

        def one_pass(carry, i):
            slope, change, before = carry
            new = self.improved(g, h, slope)
            moved = safe_norm(new - slope)
            if counted:
                return (new, moved, change), None
            # Lanes that have done their M passes keep their slope; the loop always runs `maximum` passes.
            live = i < self.M
            new = jnp.where(live, new, slope)
            return (new, jnp.where(live, moved, change), jnp.where(live, change, before)), None

        passes = self.M if counted else self.maximum
        (slope, change, before), _ = lax.scan(one_pass, (start, size, zero), jnp.arange(passes))
        change, before = lax.stop_gradient((change, before))
        # Two changes of rounding size, of the slope or of the joints, mean convergence: the contraction is 0.
        rounding = 8 * jnp.finfo(zero.dtype).eps
        known = (before > rounding * lax.stop_gradient(size)) & (jnp.abs(h) * before > rounding)
        ratio = jnp.where(known, change / jnp.where(known, before, 1.0), 0.0)
        return Solved(slope=slope, residual=jnp.abs(h) * change, contraction=ratio)

    def start(self, first, h, ahead):
        """Return the slope that passes start from."""
        return first.qdot

    def evaluations(self, n):
        """Return the evaluations of f in one implicit stage of n joints."""
        return self.M


@record(kw_only=False)
class picard(Stage):
    """Fixed-point iteration k ← g(k), M passes from the explicit slope (Drexler 2016, eqs. 6-8).

    It converges where h·‖∂f/∂q‖ < 1, near a target where a·alpha·Ts < 1, and costs M evaluations of f. Left
    short of convergence it is a polynomial in z: implicit Euler with M = 5 is stable only for z < 1.

    Args:
      M: number of passes, an int (compiled in), or an integer array (a lane's own number, masked).
      maximum: largest M that may occur, needed where M is a traced array.
      tolerance: a step whose last change h·‖Δk‖ exceeds it is marked NOT_CONVERGED [rad, m].
    """

    def improved(self, g, h, k):
        return g(k).qdot


@record(kw_only=False)
class chord(Stage):
    """Chord (simplified Newton) steps k ← k + (I + h J#KJ)⁻¹ (g(k) − k), M passes, at any z.

    −J#KJ is the derivative of f but for the curvature e brings in (Ortega & Rheinboldt 1970, 7.1; see
    `cnclik.law.law.newton`), so what contracts is the curvature, whatever alpha·Ts is. It starts from the law
    linearised at q, and costs M evaluations of f and as many products with J and J#.

    Args: M, maximum, tolerance: as for `picard`; M = 0 is the linearly implicit (Rosenbrock) step.
    """

    def start(self, first, h, ahead):
        # k = f(q) − D (h·ahead + h·k), D = J#KJ, and (I + h D)⁻¹ (f − h D s) = (I + h D)⁻¹ (f + s) − s for s = ahead:
        # the Newton step from the slope −s. From base = q (s = 0) it is f/(1 + a z) in the task's directions.
        return first.newton(h, -ahead)

    def improved(self, g, h, k):
        return g(k).newton(h, k)


@record(kw_only=False)
class newton(chord):
    """Newton's method k ← k + (I − ∂g/∂k)⁻¹ (g(k) − k), M passes, the derivative by `jax.jvp`.

    It converges quadratically where the start is near enough; a pass costs one evaluation
    of f and n directional derivatives of it (counted as n evaluations), and an n×n solve.

    Args: M, maximum, tolerance: as for `picard`.
    """

    def improved(self, g, h, k):
        value, push = jax.linearize(lambda k: g(k).qdot, k)
        matrix = jax.vmap(lambda v: v - push(v), out_axes=1)(jnp.eye(len(k), dtype=k.dtype))
        return k + jnp.linalg.solve(matrix, value - k)

    def evaluations(self, n):
        return self.M * (1 + n)
