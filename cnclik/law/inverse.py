"""J#: how a task velocity becomes joint velocities.

An inverse is a record that, called with the rows of J, factors them once and returns a `Factored`: a
function to apply J# to any number of task velocities, and what the factorisation says of singularity.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax

from cnclik import errors
from cnclik.law import dense
from cnclik.record import leaf, record
from cnclik.shapes import Array, Float, Number


class Factored(NamedTuple):
    """What an inverse makes of J: `apply` maps m task components to n joint components."""

    apply: Callable
    least: Float[Array, ""]  # estimate of the least singular value of J; no derivative
    shift: Number | None = None  # λ² where this is Jᵀ (J Jᵀ + λ² I)⁻¹
    memory: Callable | None = None  # () to what is to be remembered of J#, for `remembered`; None: its columns


# Of the trace of J Jᵀ, below which a shift leaves no pivot of a singular one surely positive: from 1 on they are in all
# but some of 100,000 products of random matrices of rank 1 to 5, from 2 on in all.
_ROUNDINGS = 4
_OF_NONE = 1e-6  # [m², 1] trace that a J J^T of zeros counts as: of a joint with a millimetre of arm


def remembered(rows, factor, t):
    """J# t from what an inverse wants remembered: its columns (m, n) alone, or those of Jᵀ, and the factors between."""
    return (t if factor is None else dense.packed_solve(factor, t)) @ rows


def through(apply, rows, velocity, null):
    """J# v + (I − J# J) q̇₀, with one application of J#; q̇₀ may be None."""
    return apply(velocity) if null is None else apply(velocity - rows @ null) + null


@record
class Pseudoinverse:
    """See `pseudoinverse`."""

    def __call__(self, rows) -> Factored:
        columns, least = dense.pinv(rows)
        wide = len(rows) <= rows.shape[1]
        apply = functools.partial(dense.pinv_applied, rows, columns) if wide else lambda t: t @ columns
        return Factored(apply, lax.stop_gradient(least), memory=lambda: (columns, None))


@record
class Damped:
    """See `damped`."""

    factors = True  # whether `memory` has factors, for a task of no more rows than joints
    damping: Number  # λ, never λ²

    def __call__(self, rows) -> Factored:
        apply, factor, shift = damped_apply(rows, self.damping * self.damping)
        return Factored(apply, _least(factor, shift), shift, _memory(rows, factor))


@record
class ManipulabilityDamped:
    """See `manipulability_damped`."""

    factors = True
    damping: Number  # λ₀, never λ₀²
    threshold: Number  # w₀

    def __call__(self, rows) -> Factored:
        wide = dense.wide_side(rows)
        tiny = tiny_shift(wide)
        factor = dense.cholesky(dense.shifted(wide @ wide.T, tiny))
        w = jnp.sqrt(jnp.prod(jnp.maximum(jnp.diagonal(factor) ** 2, tiny)))
        below = self.damping * jnp.maximum(1.0 - w / self.threshold, 0.0)
        shift = jnp.maximum(below * below, tiny)
        apply, damped, shift = damped_apply(rows, shift)
        return Factored(apply, _least(factor, tiny), shift, _memory(rows, damped))


@record
class SingularDamped:
    """See `singular_damped`."""

    factors = True
    damping: Number  # λ_max, never λ_max²
    threshold: Number  # ε

    def __call__(self, rows) -> Factored:
        wide = dense.wide_side(rows)
        tiny = tiny_shift(wide)
        squared = dense.least_squared(wide)
        share = jnp.maximum(1.0 - squared / (self.threshold * self.threshold), 0.0)
        shift = jnp.maximum(share * self.damping * self.damping, tiny)
        apply, damped, shift = damped_apply(rows, shift)
        return Factored(apply, jnp.sqrt(lax.stop_gradient(squared)), shift, _memory(rows, damped))


def _memory(rows, factor):
    """What is remembered of Jᵀ (J Jᵀ + λ² I)⁻¹."""
    return (lambda: (rows, dense.packed(factor))) if len(rows) <= rows.shape[1] else None


def damped_apply(rows, shift):
    """Application of Jᵀ (J Jᵀ + shift·I)⁻¹, the factors behind it, and the shift: no less than what rounding needs."""
    wide = dense.wide_side(rows)
    gram = wide @ wide.T
    trace = lax.stop_gradient(jnp.trace(gram))
    shift = jnp.maximum(shift, _ROUNDINGS * jnp.finfo(jnp.result_type(trace)).eps * (trace + _OF_NONE))
    factor = dense.cholesky(dense.shifted(gram, shift))
    if wide is rows:
        return lambda t: dense.cholesky_solve(factor, t) @ rows, factor, shift

    # The smaller of the two equal forms: (JᵀJ + λ²I)⁻¹ Jᵀ.
    return lambda t: dense.cholesky_solve(factor, wide @ t), factor, shift


def tiny_shift(rows):
    """A shift at the rounding of J Jᵀ: too small to be seen away from singularities, and no division by 0 at one."""
    trace = jnp.sum(rows**2)
    return lax.stop_gradient(64 * jnp.finfo(jnp.result_type(trace)).eps * (trace + _OF_NONE))


@record
class Transpose:
    """See `transpose`."""

    def __call__(self, rows) -> Factored:
        shift = 1e-12  # only so that the factorisation behind the estimate never divides by 0
        wide = dense.wide_side(rows)
        factor = dense.cholesky(dense.shifted(wide @ wide.T, shift))
        return Factored(lambda t: t @ rows, _least(factor, shift), memory=lambda: (rows, None))


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


def damped(damping: Number) -> Damped:
    """Damped least squares, J# = Jᵀ (J Jᵀ + λ² I)⁻¹ (Wampler 1986; Nakamura & Hanafusa 1986).

    Args:
      damping: λ (not λ²), in the unit of J's singular values; positive.
    """
    return Damped(damping=positive("damping", damping))


def manipulability_damped(damping: Number, threshold: Number) -> ManipulabilityDamped:
    """Singularity-robust inverse: damped only where the manipulability w = √det(J Jᵀ) is low.

    λ = λ₀ (1 − w/w₀) for w < w₀, else 0, in Jᵀ (J Jᵀ + λ² I)⁻¹ (Nakamura & Hanafusa 1986, eq. 18, who write
    the factor of the identity, λ² here, as k = k₀ (1 − w/w₀)²). Exact where w ≥ w₀.

    Args:
      damping: λ₀ (not λ₀²), reached at the singularity; in the unit of J's singular values; positive.
      threshold: w₀, in the unit of w: for a task of r rotations and p positions m^p.
    """
    return ManipulabilityDamped(damping=positive("damping", damping), threshold=positive("threshold", threshold))


def singular_damped(damping: Number, threshold: Number) -> SingularDamped:
    """Damped only where the least singular value σ_m of J is below a threshold.

    λ² = (1 − (σ_m/ε)²) λ_max² for σ_m < ε, else 0 (Chiaverini 1997, eq. 23; Maciejewski & Klein 1988). σ_m
    comes from a one-sided Jacobi iteration, and its derivative from the Rayleigh quotient: no decomposition is
    differentiated. Exact where σ_m ≥ ε.

    Args:
      damping: λ_max (not λ_max²), reached at the singularity; in the unit of J's singular values; positive.
      threshold: ε, in the same unit; positive.
    """
    return SingularDamped(damping=positive("damping", damping), threshold=positive("threshold", threshold))


def positive(name, value):
    """A positive number as a field of a record."""
    return leaf(errors.number(name, value, positive=True))


def transpose() -> Transpose:
    """Jacobian transpose, J# = Jᵀ: stable for alpha·Ts < 2/σ_max² (Sciavicco & Siciliano 1988)."""
    return Transpose()
