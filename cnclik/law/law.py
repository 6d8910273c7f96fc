"""Law: what the loop does at each instant, q̇ = f(q, t).

f(q, t) = J#(q) (ẋ_d + K e) + (I − J# J) q̇₀, the closed-loop inverse kinematics of Drexler (2016), eqs. 1-2,
with K the gain and q̇₀ an optional joint velocity in the null space of the task (Siciliano et al. 2009,
eq. 3.54).
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors, markup
from cnclik.hints import opaque
from cnclik.law import dense
from cnclik.law import reference as ref
from cnclik.law.inverse import Pseudoinverse, damped_apply
from cnclik.law.null import evaluated
from cnclik.law.task import Task, coordinates, error_and_rows
from cnclik.record import brief, leaf, record
from cnclik.robot import spatial as sp
from cnclik.robot.chain import Chain
from cnclik.robot.frames import frames, jacobian_rows
from cnclik.robot.rolled import RolledChain


@record(kw_only=False)
class Law:
    """A closed-loop inverse kinematics law on a chain: `Law(chain, task, alpha=5.0)`.

    Args:
      chain: the robot.
      task: which coordinates of its tip are controlled: position(...), orientation(...), pose(...).
      alpha: gain of the error [1/s]: a number, (m,) per axis, or an (m, m) matrix. A rate, not the
        dimensionless gain per step of pink and mink, which is z = alpha·Ts.
      inverse: J#: pseudoinverse(), damped(λ), transpose(), manipulability_damped(...), singular_damped(...).
      limits: how joint limits are respected: velocity_scaling(), weighted_least_norm(), saturation(), or None
        for not at all.
      null_velocity: joint velocity q̇₀ asked for in the null space: (n,) [rad/s, m/s], or a function of q.
      feedforward: factor of the desired velocity ẋ_d: 1 tracks, 0 is pure feedback.
      error_clamp: (position [m], orientation [rad]) beyond which the error is shortened before the gain, or None.
        A target out of reach, or far away, then pulls no harder than one at that distance; see `clamped`.
      near_singular: steps whose least singular value of the task Jacobian (an estimate from below, within √m;
        exact with the pseudoinverse of one or two rows) is under this are marked NEAR_SINGULAR [m or 1].

    Raises: ArgumentError naming the argument that does not fit.
    """

    chain: Chain
    task: Task
    _: dataclasses.KW_ONLY
    alpha: object
    inverse: object = Pseudoinverse()
    limits: object = None
    null_velocity: object = None
    feedforward: object = 1.0
    error_clamp: object = None
    near_singular: object = 0.01

    def __post_init__(self):
        m = errors.kind("task", self.task, Task).m
        n = errors.kind("chain", self.chain, (Chain, RolledChain)).n
        if m > n and isinstance(self.inverse, Pseudoinverse):
            must = f"have at most {n} coordinates, one per joint, such as position(), or an inverse such as damped(...)"
            raise errors.fail("task", must, f"has {m}: {', '.join(self.task.names)}")
        alpha = errors.array("alpha", self.alpha, (), (m,), (m, m))
        object.__setattr__(self, "alpha", _not_negative(alpha))
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
            raise errors.fail(
                "limits", "be None, velocity_scaling(), weighted_least_norm() or saturation()", f"is {self.limits!r}"
            )
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

    def _repr_html_(self):
        """In a notebook: its sentence, and what it is made of."""
        sentence, *lines = repr(self).splitlines()
        rows = [line.strip().partition(" ")[::2] for line in lines[2:]]
        parts = [("task", brief(self.task)), ("chain", brief(self.chain)), *rows]
        return f"<p>{markup.escaped(sentence)}</p>{markup.table((), parts, left=2)}"


def _not_negative(alpha):
    """The gain, if it draws the error towards 0: entries, or real parts of a matrix's eigenvalues, of at least 0."""
    if errors.concrete(alpha):
        rates = np.linalg.eigvals(np.asarray(alpha)).real if alpha.ndim == 2 else np.asarray(alpha)
        rounding = 0.0 if alpha.ndim < 2 else 100 * np.finfo(rates.dtype).eps * np.abs(alpha).max()
        if rates.min() < -rounding:
            what = "have no eigenvalue of negative real part" if alpha.ndim == 2 else "not be negative"
            raise errors.fail("alpha", what, f"{'has' if alpha.ndim == 2 else 'is'} {rates.min():g}")
    return alpha


def check_loop(law, *references) -> None:
    """Raise ArgumentError unless `law` is a `Law` and each of the references a `Reference` for its task."""
    errors.kind("law", law, Law)
    for one in references:
        ref.check(errors.kind("reference", one, ref.Reference, ref.A_REFERENCE), law.task)


class Evaluation(NamedTuple):
    """One evaluation of f(q, t) in component form, and what it was made of."""

    qdot: tuple  # n joint velocities
    e: tuple  # m task errors
    x: Callable  # () to m task coordinates of the tip
    rows: tuple  # of the task Jacobian, weighted
    apply: Callable  # J#: m task components (weighted) to n joint components
    least: object  # estimate of the least singular value
    correct: Callable  # (h, r) to (I + h J#KJ)⁻¹ r, see `correct`
    held: object = False  # whether a limit changed what the task asked for
    asked: tuple = ()  # m task velocities, weighted
    kept: Callable | None = None  # () to what is to be remembered of J#, see `cnclik.law.inverse.remembered`


def evaluate(law: Law, reference, t, q) -> Evaluation:
    """f(q, t) for q a tuple of n scalars."""
    return respond(law, q, look(law, reference, t, q))


def respond(law: Law, q, at) -> Evaluation:
    """f at q, from what the law sees there."""
    velocity = sp.vadd(sp.scale(law.feedforward, at.xdot_d), gain(law.alpha, clamped(law, at.e)))
    return answer(law, q, at, velocity, null_velocity(law, q))


def answer(law: Law, q, at, velocity, wanted) -> Evaluation:
    """J# v + (I − J# J) q̇₀ within the law's limits, for a task velocity (m,) and a null-space velocity (n,) or None."""
    rows, velocity = weigh(law, at.rows), weigh(law, velocity)
    if sp.unrolled(rows) and all(sp.is_number(x) for row in rows for x in row):  # of sliders: nothing tells the dtype
        rows = tuple(_without_literals(row, q) for row in rows)
    held = False
    if law.limits is None:
        made = law.inverse(rows)
        qdot = made.apply(velocity)
        if wanted is not None:
            qdot = sp.vadd(qdot, sp.vsub(wanted, made.apply(sp.matvec(rows, wanted))))
    else:
        made = law.limits(law.inverse, law.chain, q, rows, velocity, wanted)
        qdot, held = made.qdot, made.held
    qdot = _without_literals(qdot, q)
    return Evaluation(
        qdot=qdot,
        e=at.e,
        x=at.x,
        rows=rows,
        apply=made.apply,
        least=made.least,
        correct=lambda h, r: correct(law, q, rows, made, h, r),
        held=held,
        asked=velocity,
        kept=getattr(made, "kept", None),
    )


def _without_literals(v, q):
    """A vector over the joints with no literal left, such as the 0 of a joint that the task doesn't see."""
    return sp.each(lambda x, like: jnp.full_like(like, x) if sp.is_number(x) else x, v, q) if sp.unrolled(q) else v


class Seen(NamedTuple):
    """What the law sees at an instant; of a stage that needs no error, the rows alone."""

    rows: tuple  # of the task Jacobian, unweighted
    e: tuple = None  # (m,)
    x: Callable = None  # () to (m,)
    xdot_d: tuple = None  # (m,)
    position: tuple = None  # the target's, in the task's coordinates
    rotation: tuple = None


def look(law: Law, reference, t, q) -> Seen:
    """All that the law sees at q and t."""
    position_d, rotation_d, xdot_d = target(law, reference, t, q)
    at = frames(law.chain, q)
    e, rows = error_and_rows(law.task, law.chain, at, position_d, rotation_d)
    return Seen(
        rows=rows,
        e=e,
        x=lambda: coordinates(law.task, at.position, at.rotation),
        xdot_d=xdot_d,
        position=position_d,
        rotation=rotation_d,
    )


def glance(law: Law, q) -> Seen:
    """The rows of J alone."""
    return Seen(rows=_rows(law.chain, frames(law.chain, q), law.task.linear, law.task.angular))


_rows = opaque(jacobian_rows)


def target(law: Law, reference, t, q):
    """The target's position, rotation and velocity at t, as `cnclik.law.reference.sample`, in the form of q."""
    return ref.sample(reference, law.task, t, sp.unrolled(q))


def correct(law: Law, q, rows, made, h, r):
    """(I − h ∂f/∂q)⁻¹ r with the derivative of J# left out: what an implicit stage needs at any alpha·Ts.

    With the weighted rows B = WJ, A = B# and C = WKW⁻¹ the derivative is −A C B, and by the push-through identity
    (I + h A C B)⁻¹ = I − h A (I + h C B A)⁻¹ C B, an m×m system. For exact J# and scalar gain, A B is a projection
    and this is I − (h alpha/(1 + h alpha)) A B. With scalar gain and A = Bᵀ (B Bᵀ + λ² I)⁻¹ it is the same with λ²
    divided by 1 + h alpha in A. A null-space velocity that depends on q adds (I − A B) ∂q̇₀/∂q, and the system
    is n×n.
    """
    apply = made.apply
    if callable(law.null_velocity):
        return dense.solve(_whole(law, q, rows, apply, h), r)
    task = sp.matvec(rows, r)
    exact = isinstance(law.inverse, Pseudoinverse)
    if law.alpha.ndim == 0 and law.limits is None and (exact or made.shift is not None):
        hz = h * law.alpha
        again = apply if exact else damped_apply(rows, made.shift / (1.0 + hz))[0]
        return sp.vsub(r, sp.scale(hz / (1.0 + hz), again(task)))
    c = _gain_rows(law)
    inverse = _each_row(apply, _identity(task))
    system = _plus_identity(h, sp.matmul(c, sp.products(rows, inverse)))
    return sp.vsub(r, sp.scale(h, apply(dense.solve(system, sp.matvec(c, task)))))


def _whole(law, q, rows, apply, h):
    """I + h (A C B − (I − A B) ∂q̇₀/∂q), rows of n scalars."""
    c = _gain_rows(law)
    _, push = jax.linearize(lambda q: null_velocity(law, q), q)

    def column(unit, moved):
        turned = push(unit)
        task = sp.vadd(sp.matvec(c, moved), sp.matvec(rows, turned))
        return sp.vsub(apply(task), turned)

    columns = _each_row(column, _identity(q), sp.transpose(rows))
    return _plus_identity(h, sp.transpose(columns))


def _gain_rows(law):
    """C = W K W⁻¹: the gain as it acts on weighted errors."""
    alpha, w, m = law.alpha, law.task.weights, law.task.m
    if isinstance(law.chain, RolledChain):
        return (
            alpha * jnp.eye(m, dtype=alpha.dtype) if alpha.ndim < 2 else alpha if w is None else w[:, None] * alpha / w
        )
    if alpha.ndim < 2:
        return tuple(tuple((alpha[i] if alpha.ndim else alpha) if i == j else 0.0 for j in range(m)) for i in range(m))
    return tuple(tuple(alpha[i, j] if w is None else alpha[i, j] * w[i] / w[j] for j in range(m)) for i in range(m))


def _identity(v):
    """The identity, in the form of a vector."""
    n = len(v)
    if not sp.unrolled(v):
        return jnp.eye(n, dtype=v.dtype)
    one, zero = jnp.ones_like(v[0]), jnp.zeros_like(v[0])
    return tuple(tuple(one if i == j else zero for j in range(n)) for i in range(n))


def _each_row(fn, *matrices):
    """fn of the rows of one or more matrices, row by row."""
    return tuple(map(fn, *matrices)) if sp.unrolled(matrices[0]) else jax.vmap(fn)(*matrices)


def _plus_identity(h, matrix):
    if not sp.unrolled(matrix):
        return h * matrix + jnp.eye(len(matrix), dtype=matrix.dtype)
    return tuple(
        tuple(sp.add(h * x, 1.0 if i == j else 0.0) for j, x in enumerate(row)) for i, row in enumerate(matrix)
    )


def clamped(law: Law, e):
    """The error as the gain sees it: position and orientation parts shortened to `error_clamp` (Buss & Kim 2005).

    At the edge of the workspace a damped step contracts while alpha·Ts·‖e‖·c < 2 λ², c the curvature of x(q): with
    the error clamped to E, λ² > alpha·Ts·E·c/2 settles in front of any target, however far; unclamped it shakes.
    """
    if law.error_clamp is None:
        return e
    p = len(law.task.position)
    parts = [
        sp.scale(limit / jnp.maximum(sp.safe_norm(part), limit), part)
        for limit, part in zip(law.error_clamp, (e[:p], e[p:]), strict=True)
        if len(part)
    ]
    return functools.reduce(sp.join, parts)


def gain(alpha, e):
    """K e for a scalar, per-axis or matrix gain; a matrix as an array, or as rows."""
    if sp.unrolled(alpha):
        return sp.matvec(alpha, e)
    if not sp.unrolled(e):
        return alpha * e if alpha.ndim < 2 else sp.matvec(alpha, e)
    if alpha.ndim == 0:
        return sp.scale(alpha, e)
    if alpha.ndim == 1:
        return tuple(alpha[i] * x for i, x in enumerate(e))
    return tuple(sp.total(alpha[i, j] * x for j, x in enumerate(e)) for i in range(len(e)))


def null_velocity(law: Law, q):
    """q̇₀ in the form of q, or None, see `evaluated`."""
    return None if law.null_velocity is None else evaluated(law.null_velocity, q)


def weigh(law: Law, items):
    """Rows or components times the task's weights: what J# takes."""
    weights = law.task.weights
    if weights is None:
        return items
    if not sp.unrolled(items):
        return (weights * items.T).T
    return tuple(sp.scale(weights[i], x) if sp.unrolled(x) else sp.mul(weights[i], x) for i, x in enumerate(items))
