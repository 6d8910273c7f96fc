"""J#: how a task velocity becomes joint velocities.

An inverse is a record that, called with the rows of J, factors them once and returns a `Factored`: a
function to apply J# to any number of task velocities, and what the factorisation says of singularity.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.hints import opaque
from cnclik.law import dense
from cnclik.record import record
from cnclik.robot import spatial as sp


class Factored(NamedTuple):
    """What an inverse makes of J: `apply` maps m task components to n joint components."""

    apply: Callable
    least: object  # estimate of the least singular value of J; no derivative


@record
class Pseudoinverse:
    """See `pseudoinverse`."""

    def __call__(self, rows) -> Factored:
        inverse, least = dense.pinv(rows)
        return Factored(lambda t: _apply(inverse, t), lax.stop_gradient(least))


@record
class Damped:
    """See `damped`."""

    damping: object  # λ, never λ²

    def __call__(self, rows) -> Factored:
        m, n = len(rows), len(rows[0])
        shift = self.damping * self.damping
        if m <= n:
            factor = dense.ldl(dense.gram(rows, shift))
            apply = lambda t: _apply(sp.transpose(rows), dense.ldl_solve(factor, t))  # noqa: E731
        else:  # the smaller of the two equal forms: (JᵀJ + λ²I)⁻¹ Jᵀ
            factor = dense.ldl(dense.gram(sp.transpose(rows), shift))
            apply = lambda t: dense.ldl_solve(factor, _apply(sp.transpose(rows), t))  # noqa: E731
        return Factored(apply, _least(factor, shift))


@record
class Transpose:
    """See `transpose`."""

    def __call__(self, rows) -> Factored:
        shift = 1e-12  # only so that the factorisation behind the estimate never divides by 0
        thin = rows if len(rows) <= len(rows[0]) else sp.transpose(rows)
        factor = dense.ldl(dense.gram(thin, shift))
        return Factored(lambda t: _apply(sp.transpose(rows), t), _least(factor, shift))


@opaque
def _apply(matrix, vector):
    return sp.matvec(matrix, vector)


def _least(factor, shift):
    """Lower estimate of σ_min, within √m of it: σ_min² + λ² lies between 1 and m times 1/tr (JJᵀ + λ²I)⁻¹."""
    squared = lax.stop_gradient(1.0 / dense.inverse_trace(factor) - shift)
    return jnp.sqrt(jnp.maximum(squared, 0.0))


def pseudoinverse() -> Pseudoinverse:
    """Moore-Penrose pseudoinverse J#, rank-deficient J included (Drexler 2016, eq. 2).

    As numpy.linalg.pinv gives it, with finite derivatives; next to a singularity its joint velocities are
    large, as they are by definition. See `cnclik.law.dense.pinv`.
    """
    return Pseudoinverse()


def damped(damping) -> Damped:
    """Damped least squares, J# = Jᵀ (J Jᵀ + λ² I)⁻¹ (Wampler 1986; Nakamura & Hanafusa 1986).

    Args:
      damping: λ (not λ²), in the unit of J's singular values; positive.
    """
    errors.number("damping", damping, positive=True)
    return Damped(damping=np.asarray(damping, float) if sp.is_number(damping) else damping)


def transpose() -> Transpose:
    """Jacobian transpose, J# = Jᵀ: stable for alpha·Ts < 2/σ_max² (Sciavicco & Siciliano 1988)."""
    return Transpose()
