"""Law: what the loop does at each instant, q̇ = f(q, t).

f(q, t) = J#(q) (ẋ_d + K e) + (I − J# J) q̇₀, the closed-loop inverse kinematics of Drexler (2016), eqs. 1-2, with K the
gain and q̇₀ the pull of an optional posture in the null space of the task (Siciliano et al. 2009, eq. 3.54).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from types import NoneType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.law import dense
from cnclik.law import reference as ref
from cnclik.law.bounded import bounded
from cnclik.law.inverse import Damping, Levels, by_shift, least_of, pseudoinverse, through
from cnclik.law.limits import Evaluation, slowed, velocity_scaling
from cnclik.law.paths import A_REFERENCE
from cnclik.precision import precise
from cnclik.record import Array, ArrayLike, Float, Number, brief, leaf, record, xp_for
from cnclik.robot import chart
from cnclik.robot.chain import Chain
from cnclik.robot.model import Model, modelled
from cnclik.robot.rotations import safe_norm
from cnclik.task.parts import At
from cnclik.task.task import Task, coordinates, error, rows


@record(kw_only=False)
class posture:
    """A posture that draws the joints in the null space: q̇₀ = rate · (q_rest − q) (Liégeois 1977).

    Args:
      rest: (n,) joint values [rad, m], such as the middle of the limits.
      rate: [1/s].
    """

    rest: Float[ArrayLike, " n"]
    rate: Number = 1.0

    def __post_init__(self):
        rate = leaf(errors.number("rate", self.rate, positive=True))
        vars(self).update(rest=errors.array("rest", self.rest, (None,)), rate=rate)


@record(kw_only=False)
class Law:
    """A closed-loop inverse kinematics law on a chain: `Law(chain, task, alpha=5.0)`.

    Args:
      chain: the robot.
      task: what is controlled: position(...), orientation(...) or pose(...) of a tip, joints(...), several of them
        joined by `&`, or a stack(name=task, ...).
      alpha: gain of the error [1/s]: a number, or (m,) one per axis; for a stack also {name of a task: gain}. The
        dimensionless gain per step of pink and mink is z = alpha·Ts.
      inverse: J#: pseudoinverse(), damped(λ), singular_damped(...), error_damped(...), levels(...).
      limits: how joint limits are respected: velocity_scaling(), bounded(), or None.
      null_velocity: posture(q_rest, rate), whose joint velocity q̇₀ acts in the null space, or None.
      feedforward: factor of the target's velocity ẋ_d: 1 tracks, 0 is pure feedback.
      error_clamp: largest (position [m], orientation [rad]) error that the gain multiplies, or None. A target that is
        far away or out of reach then acts like one at that distance.
      near_singular: least singular value of the task Jacobian below which steps are NEAR_SINGULAR [m or 1], by an
        estimate from below, within √m.

    Raises: ArgumentError naming the argument that does not fit.
    """

    chain: Chain
    task: Task
    _: dataclasses.KW_ONLY
    alpha: Any  # an array () or (m,), after the constructor
    inverse: Any = pseudoinverse()  # a `Damping`, or any function of the rows and the error to a `Factored`
    limits: velocity_scaling | bounded | None = None
    null_velocity: posture | None = None
    feedforward: Number = 1.0
    error_clamp: tuple[Number, Number] | Float[Array, " 2"] | None = None
    near_singular: Number = 0.01

    def __post_init__(self):
        task, chain = errors.kind("task", self.task, Task), errors.kind("chain", self.chain, (Chain, Model))
        kinds = velocity_scaling, bounded, NoneType
        errors.kind("limits", self.limits, kinds, "be None, velocity_scaling() or bounded()")
        errors.kind("null_velocity", self.null_velocity, (posture, NoneType), "be None or posture(...)")
        limits, inverse, n = self.limits, self.inverse, chain.n
        if isinstance(chain, Chain):
            task = task.on(chain)
            limits = limits.on(chain) if isinstance(limits, bounded) else limits
        if not callable(inverse):
            raise errors.fail("inverse", "be pseudoinverse(), damped(...) or levels(...)", f"is {inverse!r}")
        if isinstance(inverse, pseudoinverse) and task.m > n:
            must = f"have at most {n} coordinates, one per joint, or an inverse with a `damping` such as 0.05"
            raise errors.fail("task", must, f"has {task.m}: {', '.join(task.names)}")
        if isinstance(limits, bounded) and not isinstance(inverse, Damping):
            must = "be damped with limits=bounded(), as in inverse=damped(0.05)"
            raise errors.fail("inverse", must, f"is {brief(inverse)}")
        if self.null_velocity is not None:
            errors.array("rest", self.null_velocity.rest, (n,), of="joint values")
        if self.error_clamp is not None:
            vars(self).update(error_clamp=errors.array("error_clamp", self.error_clamp, (2,), positive=True))
        vars(self).update(
            task=task,
            limits=limits,
            alpha=_gains(task, self.alpha),
            inverse=inverse.on(task) if isinstance(inverse, Levels) else inverse,
            feedforward=leaf(errors.number("feedforward", self.feedforward)),
            near_singular=leaf(errors.number("near_singular", self.near_singular, at_least=0)),
        )

    def __repr__(self):
        names = ("inverse", "limits", "null_velocity", "error_clamp")
        said = [f"{name} {brief(getattr(self, name))}" for name in names if getattr(self, name) is not None]
        whole = f"Law q̇ = J#(ẋ_d + α e) of {self.task.m} coordinates on {self.chain.n} joints"
        return "\n  ".join([whole, brief(self.task), brief(self.chain), f"alpha {brief(self.alpha)} 1/s", *said])


def _gains(task: Task, alpha):
    """Return the checked gain, () or (m,), from a number, one per coordinate, or {name of a stack's task: gain}."""
    if isinstance(alpha, dict):
        task.require_each("alpha", "have a gain for each task", alpha)
        sizes = {name: at.stop - at.start for name, at in task.each}
        each = [errors.array(f"alpha[{name!r}]", alpha[name], (), (m,)) * np.ones(m) for name, m in sizes.items()]
        alpha = xp_for(each).concatenate(each)
    return errors.array("alpha", alpha, (), (task.m,), at_least=0)


def check_loop(law, *references) -> None:
    """Raise ArgumentError unless `law` is a `Law` and each of the references a `Reference` for its task."""
    errors.kind("law", law, Law)
    for reference in references:
        ref.check(errors.kind("reference", reference, ref.REFERENCE, A_REFERENCE), law.task)


def evaluate(law: Law, reference, t, q, offset=None) -> Evaluation:
    """Return f(q, t) for q (n,), of a law whose chain is a `Model`. Args: offset: see `observe`."""
    return evaluate_at(law, q, observe(law, reference, t, q, offset))


def evaluate_at(law: Law, q, at) -> Evaluation:
    """Return f at q, from an observation there."""
    task_velocity = law.feedforward * at.xdot_d + law.alpha * clamped(law, at.e)
    return resolve(law, q, at, task_velocity, null_velocity(law, q))


@precise
def resolve(law: Law, q, at, velocity, null) -> Evaluation:
    """Return J# v + (I − J# J) q̇₀ within the law's limits, for a task velocity v (m,) and a pull q̇₀ (n,) or None."""
    task = law.task
    rows, velocity, e = (weighted(task, each) for each in (at.rows, velocity, at.e))
    if isinstance(law.limits, bounded):
        moved = law.limits(law.inverse.shift(rows, e), law.chain, q, rows, velocity, null)
    else:
        factored = law.inverse(rows, e)
        qdot, limited = through(factored.apply, rows, velocity, null), False
        if isinstance(law.limits, velocity_scaling):
            qdot, limited = slowed(law.chain, qdot)
        moved = Evaluation(qdot, factored, limited)
    # A conflict between the tasks of a stack is no singularity.
    each = [least_of(at.rows[where]) for _, where in task.each]
    return moved._replace(
        least=jnp.stack(each) if each else moved.factored.least,
        newton=lambda h, k: newton(law, rows, moved.factored, velocity, moved.qdot, h, k),
    )


def metric(law: Law):
    """Return a factor of each coordinate's error, at most 1: its weight over the damping of its level.

    In this norm the error of a loop with one gain never grows, even if tasks conflict.
    """
    xp, weights = xp_for(law.task, law.inverse), weighted(law.task, np.ones(law.task.m))
    if isinstance(law.inverse, Levels):
        weights = weights / xp.asarray(law.inverse.damping)[np.array(law.inverse.level)]
    return weights / xp.max(xp.asarray(weights))


class Observation(NamedTuple):
    """The law's observation at an instant."""

    rows: Float[Array, "m n"]  # of the task Jacobian, unweighted
    robot: At
    e: Float[Array, " m"]
    x: Callable  # x(): task coordinates (m,)
    xdot_d: Float[Array, " m"]
    aims: tuple[Array, ...]  # the targets, of each part of the task


@precise
def observe(law: Law, reference, t, q, offset=None) -> Observation:
    """Observe the robot at q, and the target at t. Args: offset: (m,) what a measurement adds to the error, or None."""
    aims, xdot_d = ref.sample(reference, law.task, t)
    task, robot = law.task, At(modelled(law.chain), q)
    e = error(task, robot, aims)
    return Observation(
        rows=rows(task, robot),
        robot=robot,
        e=e if offset is None else e + offset,
        x=lambda: coordinates(task, robot),
        xdot_d=xdot_d,
        aims=aims,
    )


def newton(law: Law, rows, factored, velocity, f, h, k):
    """Return k + (I − h ∂f/∂q)⁻¹ (f − k) without the derivative of J#: a Newton step of an implicit stage, at any gain.

    With the weighted rows B = WJ, task velocity v, A = B# and a posture's rate r, the slope is −A K B − r (I − A B).
    With s = 1 + h r and C = (h/s)(K − r), (s I + h A (K − r) B)⁻¹ = (I − A (I + C B A)⁻¹ C B)/s, an m×m system. With a
    scalar gain and no posture it is one solve, t = 1/(1 + h alpha): Bᵀ (B Bᵀ + t λ² I)⁻¹ (t v + (1 − t) B k).
    """
    exact, posture = isinstance(law.inverse, pseudoinverse), law.null_velocity
    plain = posture is None and law.limits is None and np.ndim(law.alpha) == 0
    if plain and (exact or factored.shift is not None):
        t = 1.0 / (1.0 + h * law.alpha)
        apply = factored.apply if exact else by_shift(rows, t * factored.shift).apply
        return apply(t * velocity + (1.0 - t) * (rows @ k))
    rate = 0.0 if posture is None else posture.rate
    s = 1.0 + h * rate
    gains, change = h / s * (jnp.broadcast_to(law.alpha, len(rows)) - rate), (f - k) / s
    inverse = jax.vmap(factored.apply, out_axes=1)(jnp.eye(len(rows), dtype=rows.dtype))
    system = dense.shifted(gains[:, None] * (rows @ inverse), 1.0)
    return k + change - factored.apply(jnp.linalg.solve(system, gains * (rows @ change)))


def clamped(law: Law, e):
    """Return the error that the gain multiplies: lengths and angles shortened to `error_clamp` (Buss & Kim 2005).

    At the edge of the workspace a damped step contracts while alpha·Ts·‖e‖·c < 2 λ², c the curvature of x(q). So with
    λ² > alpha·Ts·E·c/2 and the error clamped to E it settles in front of any target; unclamped it shakes.
    """
    if law.error_clamp is None:
        return e
    parts = []
    for part, where in zip(law.task.parts, law.task.slices, strict=True):
        angles = np.array([unit == "rad" for unit in part.units])
        kinds = ((which, law.error_clamp[i]) for i, which in enumerate((~angles, angles)) if which.any())
        each = ((jnp.where(which, e[where], 0.0), limit) for which, limit in kinds)
        parts.append(sum(limit / jnp.maximum(safe_norm(some), limit) * some for some, limit in each))
    return jnp.concatenate(parts)


def null_velocity(law: Law, q):
    """Return the pull q̇₀ (n,) of the law's posture, or None."""
    posture = law.null_velocity
    return None if posture is None else posture.rate * chart.between(law.chain, q, posture.rest)


def weighted(task: Task, items):
    """Return rows (m, n) or components (m,) times the task's weights: the input of J#."""
    return items if task.weights is None else (task.weights * items.T).T
