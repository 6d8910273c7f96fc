"""J#: turns a task velocity into joint velocities.

An inverse is a record, called with the rows of J and the error, both weighted; it returns a `Factored`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.law import dense
from cnclik.record import Array, ArrayLike, Float, Number, fields_of, leaf, record, replace


class Factored(NamedTuple):
    """A factored J: `apply` maps m task components to n joint components."""

    apply: Callable
    least: Float[Array, ""]  # estimate of the least singular value of J, without derivative
    shift: Any = None  # λ², or one per row, if J# is Jᵀ (J Jᵀ + D)⁻¹, D = diag(λ²)


_ROUNDINGS = 4  # smallest shift over the trace of J Jᵀ that keeps its pivots positive: 2 for 100,000 random products
# λ² over tr(J Jᵀ), by the bytes of a float. ROUNDED: a damping that rounding makes anyway. NEARLY_NONE: of the
# pseudoinverse; with less, two rows that ask for different motions of one joint would turn into rounding.
ROUNDED, NEARLY_NONE = {8: 2.0**-46, 4: 2.0**-17}, {8: 2.0**-46, 4: 2.0**-21}
_OF_NONE = 1e-6  # [m², 1] trace that stands for a J Jᵀ of zeros: that of a joint with an arm of 1 mm


def through(apply, rows, velocity, null):
    """Return J# v + (I − J# J) q̇₀, with one application of J#; q̇₀ may be None."""
    return apply(velocity) if null is None else apply(velocity - rows @ null) + null


@record
class pseudoinverse:
    """The Moore-Penrose pseudoinverse J# (Drexler 2016, eq. 2), as the limit of a damped inverse.

    J# = P + P (I − J P) with P = Jᵀ (J Jᵀ + λ² I)⁻¹ and λ² = 2⁻⁴⁶ tr(J Jᵀ) in float64, 2⁻²¹ tr(J Jᵀ) in float32. It
    errs by (λ²/(σ² + λ²))², by the least singular value σ: less than 1e-10 at σ = 1e-4 ‖J‖ and 0.2 % at 1e-6 ‖J‖, in
    float32 less than 0.1 % at 0.01 ‖J‖. Joint velocities near a singularity are large: use `damped` for a robot.
    """

    def __call__(self, rows, e) -> Factored:
        factored = by_shift(rows, tiny_shift(rows, NEARLY_NONE))

        def apply(t):
            qdot = factored.apply(t)
            return qdot + factored.apply(t - rows @ qdot)  # squares what the damping leaves, λ²/(σ² + λ²)

        return factored._replace(apply=apply)


class Damping:
    """What damped inverses share: Jᵀ (J Jᵀ + D)⁻¹, where D is λ² of all rows, or of each."""

    shift: Callable  # of the rows and the error: λ², or one per row

    def __post_init__(self):
        checked = {name: leaf(errors.number(name, value, positive=True)) for name, value in fields_of(self).items()}
        vars(self).update(checked)

    def __call__(self, rows, e) -> Factored:
        return by_shift(rows, self.shift(rows, e))


@record(kw_only=False)
class damped(Damping):
    """Damped least squares, J# = Jᵀ (J Jᵀ + λ² I)⁻¹ (Wampler 1986; Nakamura & Hanafusa 1986).

    Args: damping: λ (not λ²), in the unit of J's singular values; positive.
    """

    damping: Number

    def shift(self, rows, e):
        return self.damping * self.damping


@record(kw_only=False)
class singular_damped(Damping):
    """Damping only where the least singular value σ_m of J is below a threshold.

    λ² = (1 − (σ_m/ε)²) λ_max² for σ_m < ε, else 0 (Chiaverini 1997, eq. 23; Maciejewski & Klein 1988). σ_m is exact
    where it is alone, and up to 3 % less where others of six rows are as small.

    Args:
      damping: λ_max (not λ_max²), reached at the singularity; in the unit of J's singular values; positive.
      threshold: ε, in the same unit; positive.
    """

    damping: Number
    threshold: Number

    def __call__(self, rows, e) -> Factored:
        return super().__call__(rows, e)._replace(least=lax.stop_gradient(jnp.sqrt(least_squared(rows))))

    def shift(self, rows, e):
        part = jnp.maximum(1.0 - least_squared(rows) / (self.threshold * self.threshold), 0.0)
        return jnp.maximum(part * self.damping * self.damping, tiny_shift(rows))


@record(kw_only=False)
class error_damped(Damping):
    """Damping that grows with the error: λ² = λ₀² + ½ eᵀ W² e, W the task's weights (Sugihara 2011, eq. 17).

    A distant or unreachable target then moves the joints slowly, and near the target the damping is small.

    Args: damping: λ₀ (not λ₀²), in the unit of J's singular values; positive.
    """

    damping: Number

    def shift(self, rows, e):
        return self.damping * self.damping + 0.5 * (e @ e)


@record
class Levels(Damping):
    """See `levels`."""

    names: tuple[tuple[str, ...], ...]  # of the tasks of each level
    damping: Float[ArrayLike, " levels"]  # λ, never λ²; an array after the constructor
    level: tuple[int, ...] = ()  # of each row of the law's task

    def __post_init__(self):
        damping = errors.array("damping", self.damping, (len(self.names),), of="dampings")
        if errors.concrete(damping) and np.any(np.diff(np.asarray(damping), prepend=0.0) <= 0):
            must = "be positive and grow from level to level: a smaller one comes first"
            raise errors.fail("damping", must, f"is {np.asarray(damping).tolist()}")
        vars(self).update(damping=damping)

    def on(self, task) -> Levels:
        """Return the levels of a law's task. Raises: ArgumentError unless each of its tasks has one."""
        every = [name for names in self.names for name in names]
        task.require_each("inverse", "have each task of the law in one level", every)
        level = {name: i for i, names in enumerate(self.names) for name in names}
        return replace(self, level=tuple(level[name] for name, at in task.each for _ in range(at.start, at.stop)))

    def shift(self, rows, e):
        return (self.damping * self.damping)[np.array(self.level)]


def by_shift(rows, shift) -> Factored:
    """Factor Jᵀ (J Jᵀ + D)⁻¹, D = shift·I, or diag(shift) with one per row; a shift is at least what rounding needs."""
    m, n = rows.shape

    def rounding(trace):
        return lax.stop_gradient(_ROUNDINGS * jnp.finfo(jnp.result_type(trace)).eps * (trace + _OF_NONE))

    if jnp.ndim(shift):  # each alone, as raised together the lower levels would hardly move
        shift = jnp.maximum(shift, rounding(jnp.sum(scaled(rows, shift) ** 2)))
    even = scaled(rows, shift)
    wide = even if m <= n else even.T[::-1]  # the smaller form; the last joints first: a tree causes no fill-in
    gram = wide @ wide.T
    floor = jnp.maximum(jnp.min(jnp.asarray(shift)), rounding(jnp.trace(gram)))
    factor = dense.cholesky(dense.shifted(gram, floor))

    def apply(t):
        t = scaled(t, shift)
        solved = dense.factored_solve(factor, lambda x: wide @ (x @ wide) + floor * x, t if m <= n else wide @ t)
        return solved @ even if m <= n else solved[::-1]

    return Factored(apply, least_of(rows), shift if jnp.ndim(shift) else floor)


def scaled(items, shift):
    """Return rows (m, n) or components (m,) times λ/λᵢ, with the least λ."""
    return items if jnp.ndim(shift) == 0 else (jnp.sqrt(jnp.min(shift) / shift) * items.T).T


def least_of(rows):
    """Return an estimate of the least singular value σ of some rows: from below, and within √m.

    σ² + s lies between 1 and m times 1/tr (JJᵀ + s I)⁻¹; an s as large as a damping would hide σ.
    """
    wide, shift = _wide(rows), tiny_shift(rows, NEARLY_NONE)
    factor = dense.cholesky(dense.shifted(wide @ wide.T, shift))
    return jnp.sqrt(jnp.maximum(lax.stop_gradient(1.0 / dense.inverse_trace(factor) - shift), 0.0))


def tiny_shift(rows, share=ROUNDED):
    """Return a share of tr(J Jᵀ), by the dtype: negligible away from singularities, and no division by 0 at one."""
    trace = jnp.sum(rows**2)
    return lax.stop_gradient(share[trace.dtype.itemsize] * (trace + _OF_NONE))


@functools.partial(jax.jit, inline=True)
def least_squared(rows):
    """Return σ_min² of J, or up to m^(1/32) less where others are as small (6 % for six rows), with smooth derivatives.

    It is 1/tr((JJᵀ)⁻³²)^(1/32), by products, as a decomposition has no derivatives at equal values; 0 below rounding.
    """
    wide, tiny = _wide(rows), tiny_shift(rows)
    lower = dense.cholesky(dense.shifted(wide @ wide.T, tiny))
    power, sizes = dense.cholesky_solve(lower, jnp.eye(len(wide), dtype=rows.dtype)), []
    for _ in range(5):
        sizes.append(jnp.trace(power))
        power = power / sizes[-1]
        power = power @ power
    root = jnp.trace(power)
    for size in reversed(sizes):
        root = size * jnp.sqrt(root)
    return jnp.maximum(1.0 / root - tiny, 0.0)


def _wide(rows):
    """Return the matrix or its transpose, whichever has fewer rows."""
    return rows if len(rows) <= rows.shape[1] else rows.T


def levels(*names: Sequence[str], damping: Float[ArrayLike, " levels"]) -> Levels:
    """Put each task of a stack on a priority level, of which the first comes first; J# = Jᵀ (J Jᵀ + D)⁻¹.

    D holds λ² of each row's level: the recursion of Siciliano & Slotine (1991) with damped inverses and the matching
    projectors. A conflict disturbs level 1 by a share of about (λ₁/λ₂)². Near a singularity of its own, level 1 moves
    the joints by up to |v|/(2λ₁).

    Args:
      names: names of the tasks, a list for each level: levels(["feet"], ["hands", "rest"], damping=(1e-3, 0.05)).
      damping: λ (not λ²) of each level, positive. It grows from level to level: a smaller damping is what makes a level
        come first.
    """
    if not names or not all(isinstance(some, (list, tuple)) for some in names):
        raise errors.fail("names", 'be a list of names for each level, such as ["feet"]', f"is {names!r}")
    return Levels(names=tuple(map(tuple, names)), damping=damping)
