"""Stage: how the slope of one implicit stage is found.

An implicit slope solves k = g(k), g(k) = f(t + c·Ts, base + h·k), h = a·Ts. A stage is a record that,
called with g and a first guess, runs a fixed number of passes (a `lax.scan`: pure, differentiable, the same
length in every lane) and returns the slope with what is known of its convergence.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.hints import opaque
from cnclik.record import record
from cnclik.robot import spatial as sp


class Solved(NamedTuple):
    """An implicit slope and its convergence. `residual` and `contraction` carry no derivative."""

    slope: tuple
    residual: object  # h·‖last change of the slope‖: a joint displacement [rad, m]
    contraction: object  # last change over the one before it; at 1 or more the iteration diverges


@record
class Picard:
    """See `picard`."""

    M: object
    maximum: int
    tolerance: float

    def __call__(self, g, start, h) -> Solved:
        zero = jnp.zeros_like(start[0])
        # The start counts as the first change, from rest: so M = 0 has a residual that means something.
        size = sp.safe_norm(start)

        def one(carry, i):
            slope, change, before = carry
            new = g(slope).qdot
            moved = _distance(new, slope)
            if sp.is_number(self.M):
                return (new, moved, change), None
            # Lanes that have had their M passes keep what they have; the shape stays that of `maximum`.
            live = i < self.M
            new = tuple(jnp.where(live, a, b) for a, b in zip(new, slope, strict=True))
            return (new, jnp.where(live, moved, change), jnp.where(live, change, before)), None

        passes = self.M if sp.is_number(self.M) else self.maximum
        (slope, change, before), _ = lax.scan(one, (start, size, zero), jnp.arange(passes))
        change, before = lax.stop_gradient((change, before))
        ratio = jnp.where(before > 0, change / jnp.where(before > 0, before, 1.0), 0.0)
        return Solved(slope=slope, residual=jnp.abs(h) * change, contraction=ratio)


@opaque
def _distance(a, b):
    return sp.safe_norm(sp.vsub(a, b))


def picard(M, *, maximum=None, tolerance=1e-3) -> Picard:
    """Fixed-point iteration k ← g(k), M passes, started from the explicit Euler slope (Drexler 2016, eqs. 6-8).

    It converges where h·‖∂f/∂q‖ < 1, near a target where a·alpha·Ts < 1, and costs M evaluations of f. Left
    short of convergence it is a polynomial in z: implicit Euler with M = 5 is stable only for z < 1.

    Args:
      M: number of passes, an int (compiled in), or an integer array (a lane's own number, masked).
      maximum: largest M that may occur, needed where M is a traced array.
      tolerance: a step whose last change h·‖Δk‖ exceeds it is marked NOT_CONVERGED [rad, m].
    """
    errors.number("tolerance", tolerance, positive=True)
    if not (hasattr(M, "dtype") and not isinstance(M, np.integer)):
        M = errors.integer("M", M, at_least=0)
        return Picard(M=M, maximum=M, tolerance=float(tolerance))
    if not jnp.issubdtype(M.dtype, jnp.integer):
        raise errors.fail("M", "be an integer or an array of integers", f"has dtype {M.dtype}")
    if errors.concrete(M):
        if np.min(M) < 0:
            raise errors.fail("M", "be at least 0", f"is {np.min(M)}")
        maximum = int(np.max(M)) if maximum is None else maximum
        if np.max(M) > maximum:
            raise errors.fail("maximum", f"be at least M = {np.max(M)}", f"is {maximum}")
    if maximum is None:
        raise errors.fail("maximum", "be given where M is a traced array", "is None")
    return Picard(M=M, maximum=errors.integer("maximum", maximum, at_least=0), tolerance=float(tolerance))
