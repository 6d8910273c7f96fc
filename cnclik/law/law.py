"""Law: what the loop does at each instant, q̇ = f(q, t).

f(q, t) = J#(q) (ẋ_d + K e) + (I − J# J) q̇₀, the closed-loop inverse kinematics of Drexler (2016), eqs. 1-2,
with K the gain and q̇₀ an optional joint velocity in the null space of the task (Siciliano et al. 2009,
eq. 3.54).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.law import dense
from cnclik.law import reference as ref
from cnclik.law.bounded import Bounded, undamped
from cnclik.law.inverse import Factored, Levels, Pseudoinverse, Transpose, damped_apply, least_of, through
from cnclik.law.limits import Limited
from cnclik.law.null import Posture, evaluated
from cnclik.precision import precise
from cnclik.record import Array, ArrayLike, Bool, Float, Number, brief, leaf, record, replace
from cnclik.robot import chart
from cnclik.robot.chain import Chain
from cnclik.robot.model import Model, modelled
from cnclik.robot.rotations import safe_norm
from cnclik.task.parts import At
from cnclik.task.task import Task, coordinates, error, rows, velocity


@record(kw_only=False)
class Law:
    """A closed-loop inverse kinematics law on a chain: `Law(chain, task, alpha=5.0)`.

    Args:
      chain: the robot.
      task: what is controlled: position(...), orientation(...) or pose(...) of a tip, joints(...), several of them
        joined by `&`, or a stack(name=task, ...).
      alpha: gain of the error [1/s]: a number, (m,) per axis, or an (m, m) matrix; for a stack also {name of a task:
        gain}. It is a rate. The dimensionless gain per step of pink and mink is z = alpha·Ts.
      inverse: J#: pseudoinverse(), damped(λ), transpose(), manipulability_damped(...), singular_damped(...),
        error_damped(...), levels(...).
      limits: how joint limits are respected: velocity_scaling(), weighted_least_norm(), saturation(), bounded(), or
        None.
      null_velocity: desired joint velocity q̇₀ in the null space: (n,) [rad/s, m/s], or a function of q.
      feedforward: factor of the target's velocity ẋ_d: 1 tracks, 0 is pure feedback.
      error_clamp: largest (position [m], orientation [rad]) error that the gain multiplies, or None. A target that is
        far away or out of reach then acts like one at that distance; see `clamped`.
      near_singular: steps whose least singular value of the task Jacobian is below this are marked NEAR_SINGULAR [m or
        1]. The value is an estimate from below, within √m; it is exact for the pseudoinverse of one or two rows.

    Raises: ArgumentError naming the argument that does not fit.
    """

    chain: Chain
    task: Task
    _: dataclasses.KW_ONLY
    alpha: Any  # an array, after the constructor
    inverse: Callable[..., Factored] = Pseudoinverse()
    limits: Callable[..., Limited] | None = None
    null_velocity: Callable[[Array], Array] | ArrayLike | None = None
    feedforward: Number = 1.0
    error_clamp: tuple[Number, Number] | Float[Array, " 2"] | None = None
    near_singular: Number = 0.01

    def __post_init__(self):
        task, n = errors.kind("task", self.task, Task), errors.kind("chain", self.chain, (Chain, Model)).n
        if isinstance(self.chain, Chain):
            task = task.on(self.chain)
            object.__setattr__(self, "task", task)
            if hasattr(self.limits, "on"):
                object.__setattr__(self, "limits", self.limits.on(self.chain))
        m = task.m
        if m > n and isinstance(self.inverse, Pseudoinverse):
            must = f"have at most {n} coordinates, one per joint, such as position(), or an inverse such as damped(...)"
            raise errors.fail("task", must, f"has {m}: {', '.join(task.names)}")
        alpha = of_tasks(task, self.alpha) if isinstance(self.alpha, dict) else self.alpha
        alpha = errors.array("alpha", alpha, (), (m,), (m, m))
        object.__setattr__(self, "alpha", _within_tasks(task, _not_negative(alpha)))
        if hasattr(self.inverse, "on"):
            object.__setattr__(self, "inverse", self.inverse.on(task))
        for name, least in (("feedforward", None), ("near_singular", 0)):
            object.__setattr__(self, name, leaf(errors.number(name, getattr(self, name), at_least=least)))
        if self.error_clamp is not None:
            pair = errors.array("error_clamp", self.error_clamp, (2,))
            if errors.concrete(pair) and not np.all(np.asarray(pair) > 0):
                raise errors.fail("error_clamp", "be positive", f"is {np.asarray(pair).tolist()}")
            object.__setattr__(self, "error_clamp", pair)
        if not callable(self.inverse):
            raise errors.fail("inverse", "be pseudoinverse(), damped(...) or transpose()", f"is {self.inverse!r}")
        if self.limits is not None and not callable(self.limits):
            known = "velocity_scaling(), weighted_least_norm(), saturation() or bounded()"
            raise errors.fail("limits", f"be None, {known}", f"is {self.limits!r}")
        if isinstance(self.limits, Bounded) and isinstance(self.inverse, (Pseudoinverse, Transpose)):
            raise undamped(self.inverse)
        if isinstance(self.null_velocity, Posture):
            object.__setattr__(self, "null_velocity", self.null_velocity.on(self.chain))
        if self.null_velocity is not None and not callable(self.null_velocity):
            object.__setattr__(self, "null_velocity", errors.array("null_velocity", self.null_velocity, (n,)))

    def __repr__(self):
        lines = [f"Law q̇ = J#(ẋ_d + α e) of {self.task.m} coordinates on {self.chain.n} joints"]
        lines += [f"  {brief(self.task)}", f"  {brief(self.chain)}", f"  alpha {brief(self.alpha)} 1/s"]
        lines += [f"  inverse {brief(self.inverse)}", f"  limits {brief(self.limits)}"]
        for name in ("null_velocity", "error_clamp"):
            if getattr(self, name) is not None:
                lines.append(f"  {name} {brief(getattr(self, name))}")
        return "\n".join(lines)


def _not_negative(alpha):
    """The gain, checked not to push the error away from 0: entries, or real parts of eigenvalues, are at least 0."""
    if errors.concrete(alpha):
        rates = np.linalg.eigvals(np.asarray(alpha)).real if alpha.ndim == 2 else np.asarray(alpha)
        rounding = 0.0 if alpha.ndim < 2 else 100 * np.finfo(rates.dtype).eps * np.abs(alpha).max()
        if rates.min() < -rounding:
            what = "have no eigenvalue of negative real part" if alpha.ndim == 2 else "not be negative"
            raise errors.fail("alpha", what, f"{'has' if alpha.ndim == 2 else 'is'} {rates.min():g}")
    return alpha


def of_tasks(task: Task, values: dict):
    """Gains of a stack's tasks, by their names, as those of its coordinates: (m,), or (m, m) where one is a matrix."""
    task.require_each("alpha", "have a gain for each task", values)
    sizes = {name: at.stop - at.start for name, at in task.each}
    each = [errors.array(f"alpha[{k!r}]", values[k], (), (m,), (m, m)) for k, m in sizes.items()]
    xp = np if all(map(errors.concrete, each)) else jnp
    if all(one.ndim < 2 for one in each):
        return xp.concatenate([one * xp.ones(sizes[name]) for name, one in zip(sizes, each, strict=True)])
    blocks = [one if one.ndim == 2 else one * xp.eye(sizes[name]) for name, one in zip(sizes, each, strict=True)]
    zeros = [[xp.zeros((len(a), len(b))) for b in blocks] for a in blocks]
    return xp.block([[b if i == k else zeros[i][k] for k in range(len(blocks))] for i, b in enumerate(blocks)])


def _within_tasks(task: Task, alpha):
    """The gain of a stack: a symmetric matrix within each of its tasks, for rows of equal weight.

    The loop's rates are then real and between 0 and the largest gain, for any tasks, weights and damping. A gain matrix
    across tasks may be unstable in a conflict.
    """
    if not task.tasks or alpha.ndim < 2 or not all(map(errors.concrete, (alpha, task.weights))):
        return alpha
    left = np.array(alpha)
    for name, at in task.each:
        own, w = left[at, at].copy(), np.asarray(task.weight_of_each)[at]
        left[at, at] = 0
        mixed = np.ptp(w) > 0 and np.any(own - np.diag(np.diag(own)))
        if not np.allclose(own, own.T) or mixed:
            raise errors.fail("alpha", f"be symmetric in the task {name}, of equal weights there", "is not")
    if np.any(left):
        raise errors.fail("alpha", "act within each task of a stack", "connects tasks")
    return alpha


def check_loop(law, *references) -> None:
    """Raise ArgumentError unless `law` is a `Law` and each of the references a `Reference` for its task."""
    errors.kind("law", law, Law)
    for one in references:
        ref.check(errors.kind("reference", one, ref.REFERENCE, ref.A_REFERENCE), law.task)


class Evaluation(NamedTuple):
    """One evaluation of f(q, t) and its ingredients."""

    qdot: Float[Array, " n"]  # joint velocities
    e: Float[Array, " m"]  # task errors
    x: Callable  # x(): the task coordinates of the tip (m,)
    rows: Float[Array, "m n"]  # of the task Jacobian, weighted
    apply: Callable  # J#: task components (m,), weighted, to joint components (n,)
    least: Float[Array, ""]  # estimate of the least singular value; of a stack (tasks,)
    newton: Callable  # (h, k) to k + (I + h J#KJ)⁻¹ (f − k), see `newton`
    limited: bool | Bool[Array, ""] = False  # whether a limit changed the velocities
    cut: bool | Bool[Array, ""] = False  # whether the search within limits was cut short
    task_velocity: Float[Array, " m"] | None = None  # weighted task velocity
    memory: Callable | None = None  # memory(): the memory of J#, see `cnclik.law.inverse.remembered`
    walls: Float[Array, " k"] | None = None  # see `cnclik.law.limits.Limited`


def evaluate(law: Law, reference, t, q) -> Evaluation:
    """f(q, t) for q (n,), of a law whose chain is a `Model`."""
    return evaluate_at(law, q, observe(law, reference, t, q))


def evaluate_at(law: Law, q, at) -> Evaluation:
    """f at q, from an observation there."""
    task_velocity = law.feedforward * at.xdot_d + gain(law.alpha, clamped(law, at.e))
    return resolve(law, q, at, task_velocity, null_velocity(law, q))


@precise
def resolve(law: Law, q, at, velocity, null) -> Evaluation:
    """J# v + (I − J# J) q̇₀ within the law's limits, for a task velocity (m,) and a null-space velocity (n,) or None."""
    task, inverse = law.task, law.inverse
    rows, velocity = weighted(task, at.rows), weighted(task, velocity)
    if getattr(inverse, "by_error", False):
        inverse = replace(inverse, e=weighted(task, at.e))
    if law.limits is None:
        made = inverse(rows)
        qdot = through(made.apply, rows, velocity, null)
    else:
        made = law.limits(inverse, law.chain, q, rows, velocity, null)
        qdot = made.qdot
    return Evaluation(
        qdot=qdot,
        e=at.e,
        x=at.x,
        rows=rows,
        apply=made.apply,
        least=made.least if not task.tasks else least_of_tasks(task, at.rows),
        newton=lambda h, k: newton(law, q, rows, made, velocity, null, qdot, h, k),
        limited=getattr(made, "limited", False),
        cut=getattr(made, "cut", False),
        task_velocity=velocity,
        memory=getattr(made, "memory", None),
        walls=getattr(made, "walls", None),
    )


def least_of_tasks(task: Task, rows):
    """(tasks,) least singular value of each task's own rows: a conflict between tasks is no singularity."""
    return jnp.stack([least_of(rows[at]) for _, at in task.each])


def metric(law: Law):
    """Factor of each coordinate's error, at most 1: its weight over the damping of its level.

    In the norm of errors scaled in this way, the error of a loop with one gain for all tasks never grows, even if the
    tasks conflict.
    """
    weights = jnp.asarray(law.task.weight_of_each)
    if isinstance(law.inverse, Levels):
        weights = weights / jnp.stack([one.damping for one in law.inverse.damping])[np.array(law.inverse.level)]
    return weights / jnp.max(weights)


class Observation(NamedTuple):
    """The law's observation at an instant; for a stage that needs no error, only the rows."""

    rows: Float[Array, "m n"]  # of the task Jacobian, unweighted
    robot: At
    e: Float[Array, " m"] | None = None
    x: Callable | None = None  # x(): task coordinates (m,)
    xdot_d: Float[Array, " m"] | None = None
    aims: tuple[Array, ...] = ()  # the targets, of each part of the task
    motion: Float[Array, " w"] | None = None  # the targets' velocities: ẋ_d, except for parts in a tip's own frame


@precise
def observe(law: Law, reference, t, q) -> Observation:
    """The law's full observation at q and t."""
    aims, motion = ref.sample(reference, law.task, t)
    task, robot = law.task, At(modelled(law.chain), q)
    return Observation(
        rows=rows(task, robot, aims),
        robot=robot,
        e=error(task, robot, aims),
        x=lambda: coordinates(task, robot),
        xdot_d=velocity(task, robot, aims, motion),
        aims=aims,
        motion=motion,
    )


@precise
def rows_at(law: Law, q, aims=None) -> Observation:
    """An observation of the rows of J only."""
    robot = At(modelled(law.chain), q)
    return Observation(rows=rows(law.task, robot, aims), robot=robot)


def newton(law: Law, q, rows, made, v, null, f, h, k):
    """k + (I − h ∂f/∂q)⁻¹ (f − k) without the derivative of J#: the Newton step of an implicit stage for any alpha·Ts.

    With the weighted rows B = WJ, A = B# and C = WKW⁻¹ the derivative is −A C B, and by the push-through identity
    (I + h A C B)⁻¹ = I − h A (I + h C B A)⁻¹ C B, an m×m system. With scalar gain, f = A v and A = Bᵀ (B Bᵀ + λ² I)⁻¹
    the whole is Bᵀ (B Bᵀ + s λ² I)⁻¹ (s v + (1 − s) B k), s = 1/(1 + h alpha): one factor and one solve. For exact J#
    it is A (s v + (1 − s) B k). A null-space velocity that depends on q adds (I − A B) ∂q̇₀/∂q, and the system is n×n.

    Args: v: weighted task velocity (m,). null: q̇₀ (n,) or None. f: joint velocities (n,).
    """
    apply, exact = made.apply, isinstance(law.inverse, Pseudoinverse)
    if callable(law.null_velocity):
        return k + jnp.linalg.solve(_whole(law, q, rows, apply, h), f - k)
    if np.ndim(law.alpha) == 0 and law.limits is None and (exact or made.shift is not None):
        s = 1.0 / (1.0 + h * law.alpha)
        again = apply if exact else damped_apply(rows, s * made.shift)[0]
        return through(again, rows, s * v + (1.0 - s) * (rows @ k), null)
    c, task = weighted_gain(law), rows @ (f - k)
    inverse = jax.vmap(apply, out_axes=1)(jnp.eye(len(task), dtype=task.dtype))
    return f - h * apply(jnp.linalg.solve(dense.shifted(h * c @ rows @ inverse, 1.0), c @ task))


def _whole(law, q, rows, apply, h):
    """I + h (A C B − (I − A B) ∂q̇₀/∂q), (n, n)."""
    c = weighted_gain(law)
    _, push = jax.linearize(lambda y: null_velocity(law, chart.out(law.chain, q, y)), chart.centre(law.chain, q))

    def column(unit):
        turned = push(unit)
        return apply(c @ rows @ unit + rows @ turned) - turned

    return dense.shifted(h * jax.vmap(column, out_axes=1)(jnp.eye(len(q), dtype=q.dtype)), 1.0)


def weighted_gain(law):
    """C = W K W⁻¹ (m, m): the gain as it acts on weighted errors."""
    alpha, w = law.alpha, law.task.weights
    if alpha.ndim < 2:
        return alpha * jnp.eye(law.task.m, dtype=alpha.dtype)
    return alpha if w is None else w[:, None] * alpha / w


def clamped(law: Law, e):
    """The error that the gain multiplies: position and orientation parts shortened to `error_clamp` (Buss & Kim 2005).

    Of a part with both, as joints may be, what is in rad and what is not is shortened separately.

    At the edge of the workspace a damped step contracts while alpha·Ts·‖e‖·c < 2 λ², with c the curvature of x(q). With
    the error clamped to E, λ² > alpha·Ts·E·c/2 lets it settle in front of any target, however far; unclamped it shakes.
    """
    if law.error_clamp is None:
        return e
    found = []
    for part, where in zip(law.task.parts, law.task.slices, strict=True):
        turns = np.array([unit == "rad" for unit in part.units])
        several = ((those, law.error_clamp[i]) for i, those in enumerate((~turns, turns)) if those.any())
        found.append(sum(_shortened(jnp.where(those, e[where], 0.0), limit) for those, limit in several))
    return jnp.concatenate(found)


def _shortened(e, limit):
    """A vector of at most this length."""
    return limit / jnp.maximum(safe_norm(e), limit) * e


def gain(alpha, e):
    """K e for a scalar, per-axis or matrix gain."""
    return alpha @ e if alpha.ndim == 2 else alpha * e


def null_velocity(law: Law, q):
    """q̇₀ (n,), or None, see `evaluated`."""
    return None if law.null_velocity is None else evaluated(law.null_velocity, q)


def weighted(task: Task, items):
    """Rows (m, n) or components (m,) times the task's weights: the input of J#."""
    return items if task.weights is None else (task.weights * items.T).T
