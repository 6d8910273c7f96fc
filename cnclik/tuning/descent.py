"""Descent: minimizes a loss under constraints c ≤ 0, and never accepts a point that is not finite.

The constraints enter an augmented Lagrangian (Nocedal & Wright 2006, eq. 17.65), whose multipliers are updated between
rounds of steps. Every step evaluates one trial point. If it is not finite or does not descend, it is rejected and the
step shortened. So a round is one compiled program of known length, the same for every start, and can be vmapped.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.cache import bounded_jit
from cnclik.record import AnyArray, Array, Bool, Float, Int, record
from cnclik.tuning.parameters import values_of

FORWARD_UP_TO = 8  # parameters: forward mode costs a run per parameter, reverse mode a few runs and their memory
REACH = 2.0  # largest change of a free number in a step: a factor e² for a gain far below its upper bound
SHORTER = 0.3  # factor of a step after a rejection
REJECTIONS = 12  # in a row that end a descent; half as many restart the optimizer
ROUNDING = 512  # growth of the merit, in eps of its size, that counts as rounding


@record
class Descent:
    """How to descend.

    Attributes:
      optimizer: an optax transformation; None: L-BFGS.
      steps: evaluations with gradient per start. rounds: how often the multipliers are updated in that time.
      starts: descents side by side: from the law's own values, and from random ones within the bounds.
      gradient: "forward", "reverse", or "auto" by the number of parameters.

    Raises: ArgumentError for values that do not fit.
    """

    optimizer: Any = None
    steps: int = 100
    rounds: int = 5
    starts: int = 1
    gradient: str = "auto"

    def __post_init__(self):
        errors.integer("steps", self.steps, at_least=2)
        errors.integer("rounds", self.rounds, at_least=1)
        errors.integer("starts", self.starts, at_least=1)
        errors.one_of("gradient", self.gradient, ("auto", "forward", "reverse"))


def _known(optimizer):
    """An optimizer; None is L-BFGS (Liu & Nocedal 1989) with ten pairs and the line search of `descend`.

    Later processes recognize a program with it in the cache; optax makes new functions each time, which they would not.
    """
    if optimizer is not None:
        return optimizer
    import optax

    return optax.lbfgs(memory_size=10, linesearch=None)


def gradient_mode(count: int, mode="auto") -> str:
    """How gradients of `count` free numbers are computed: "forward" up to 8, otherwise "reverse"."""
    return mode if mode != "auto" else "forward" if count <= FORWARD_UP_TO else "reverse"


class Carry(NamedTuple):
    u: Float[Array, " p"]
    merit: Float[Array, ""]  # augmented Lagrangian at u; inf: not yet known
    grad: Float[Array, " p"]
    loss: Float[Array, ""]
    constraints: Float[Array, " c"]
    direction: Float[Array, " p"]
    size: Float[Array, ""]
    failures: Int[Array, ""]
    state: Any  # state of the optimizer
    best: Float[Array, " p"]  # u of the lowest loss so far with all constraints kept
    best_loss: Float[Array, ""]


class History(NamedTuple):
    """The points of a round, one entry per evaluation."""

    loss: Float[AnyArray, " *steps"]
    violation: Float[AnyArray, " *steps"]  # largest constraint; at most 0 if all are kept
    accepted: Bool[AnyArray, " *steps"]


@bounded_jit(static_argnames=("optimizer", "constraints"))
def _begin(starts, *, optimizer, constraints: int) -> Carry:
    """Descents from (S, p) before any evaluation."""

    def begin(u):
        zero, inf = jnp.zeros_like(u), jnp.full((), jnp.inf, u.dtype)
        return Carry(
            u=u,
            merit=inf,
            grad=zero,
            loss=inf,
            constraints=jnp.full((constraints,), jnp.inf, u.dtype),
            direction=zero,
            size=jnp.ones((), u.dtype),
            failures=jnp.zeros((), jnp.int32),
            state=_known(optimizer).init(u),
            best=u,
            best_loss=inf,
        )

    return jax.vmap(begin)(starts)


@bounded_jit(static_argnames=("steps", "optimizer", "mode"))
def _rounds(objective, carry, multipliers, weight, scale, *, steps: int, optimizer, mode: str):
    """(`Carry`, `History` (S, steps)) of evaluations from each of S starts, each trying the optimizer's update.

    Args: multipliers: (S, c). weight: (S,) of the quadratic term. scale: (S,) of the loss. mode: of the gradient.
    """
    of_start = functools.partial(_round, objective, steps=steps, optimizer=optimizer, mode=mode)
    return jax.vmap(of_start)(carry, multipliers, weight, scale)


def _round(objective, carry, multipliers, weight, scale, *, steps, optimizer, mode):
    def merit(u):
        loss, constraints = objective(values_of(objective.parameters, u))
        beyond = jnp.maximum(constraints + multipliers / weight, 0.0)
        value = scale * loss + 0.5 * weight * (jnp.sum(beyond**2) - jnp.sum((multipliers / weight) ** 2))
        return value, (value, loss, constraints)

    limits = jnp.finfo(carry.u.dtype)
    derivative = jax.jacfwd(merit, has_aux=True) if mode == "forward" else jax.grad(merit, has_aux=True)
    optimizer = _known(optimizer)

    def step(c: Carry, _):
        trial = c.u + c.size * c.direction
        grad, (value, loss, constraints) = derivative(trial)
        finite = jnp.isfinite(value) & jnp.all(jnp.isfinite(grad))
        slope = jnp.vdot(c.grad, c.direction)
        enough = c.merit + 1e-4 * c.size * slope + ROUNDING * limits.eps * jnp.abs(c.merit)
        accepted = finite & ((value <= enough) | jnp.isinf(c.merit))
        grad = jnp.where(jnp.isfinite(grad), grad, 0.0)

        updates, state = optimizer.update(grad, c.state, trial)
        down = jnp.all(jnp.isfinite(updates)) & (jnp.vdot(updates, grad) < 0)
        steepest = -grad / jnp.maximum(jnp.linalg.norm(grad), 1.0)
        direction = jnp.where(down, updates, steepest)
        largest = jnp.max(jnp.abs(direction))
        direction = direction * jnp.minimum(1.0, REACH / jnp.where(largest > 0, largest, 1.0))
        state = _where(down, state, optimizer.init(trial))

        moved = c._replace(
            **dict(u=trial, merit=value, grad=grad, loss=loss, constraints=constraints, direction=direction),
            **dict(size=jnp.ones_like(c.size), failures=jnp.zeros_like(c.failures), state=state),
        )
        # After some rejections, clear the optimizer's memory and restart along the gradient.
        failures = c.failures + 1
        again = failures == REJECTIONS // 2
        fallback = -0.1 * c.grad / jnp.maximum(jnp.linalg.norm(c.grad), limits.tiny)
        stayed = c._replace(
            direction=jnp.where(failures < REJECTIONS, jnp.where(again, fallback, c.direction), 0.0),
            size=jnp.where(again, 1.0, jnp.where(finite, SHORTER, 0.1) * c.size),
            failures=failures,
            state=_where(again, optimizer.init(c.u), c.state),
        )
        kept = jnp.max(constraints, initial=-jnp.inf) <= 0
        better = finite & kept & (loss < c.best_loss)
        new = _where(accepted, moved, stayed)._replace(
            best=jnp.where(better, trial, c.best), best_loss=jnp.where(better, loss, c.best_loss)
        )
        return new, History(new.loss, jnp.max(new.constraints, initial=-jnp.inf), accepted)

    return lax.scan(step, carry, None, length=steps)


def _where(condition, a, b):
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), a, b)


class Descended(NamedTuple):
    """The ends of descents from S starts."""

    u: np.ndarray  # (S, p) last accepted points
    best: np.ndarray  # (S, p) points of lowest loss with all constraints kept
    best_loss: np.ndarray  # (S,) inf if there is none
    history: History  # (S, evaluations)
    why: str  # "converged", "steps" or "stuck"


def descend(objective, starts, scale, *, constraints, descent=Descent(), tolerance=1e-6, progress=None) -> Descended:
    """Descend from S starts (S, p) in rounds that share the evaluations; see the module.

    Args:
      objective: a record with `parameters`; called with their values, it returns (loss, constraints (c,)).
      scale: (S,) factors of the loss, so that it is about 1.
      constraints: how many there are.
      descent: settings; its `starts` are ignored here.
      tolerance: relative change of the loss over a round that counts as converged if the constraints are kept.
      progress: called after each round with (evaluations done, all, loss and violation of the best start), or None.
    """
    errors.progress(progress)
    starts = np.asarray(starts, jax.dtypes.canonicalize_dtype(float))
    (count, size), dtype = starts.shape, starts.dtype
    optimizer = descent.optimizer
    mode = gradient_mode(size, descent.gradient)
    carry = _begin(starts, optimizer=optimizer, constraints=constraints)
    scale = np.asarray(scale, dtype)
    multipliers = np.zeros((count, constraints), dtype)
    weight = np.full((count,), 10.0, dtype)
    per_round = max(2, descent.steps // descent.rounds)
    rounds = max(1, descent.steps // per_round)
    nothing = float(jnp.finfo(dtype).eps) ** 1.5  # a smaller scaled loss counts as 0
    pieces, why = [], "steps"
    before = violation_before = np.full(count, np.inf)
    for i in range(rounds):
        carry, history = _rounds(
            objective, carry, multipliers, weight, scale, steps=per_round, optimizer=optimizer, mode=mode
        )
        pieces.append(jax.tree.map(np.asarray, history))
        loss = np.asarray(carry.loss)
        violation = np.max(np.asarray(carry.constraints), axis=1, initial=-np.inf)
        if progress is not None:
            at = int(np.argmin(np.where(violation <= 1e-3, loss, np.inf)))
            kept = "kept" if violation[at] <= 0 else f"exceeded by {100 * violation[at]:.2g} %"
            progress((i + 1) * per_round, rounds * per_round, f"loss {loss[at]:.5g}, constraints {kept}")
        with np.errstate(invalid="ignore"):  # inf − inf for losses that stay infinite
            settled = np.abs(before - loss) <= tolerance * np.abs(loss)
        exact = loss * np.asarray(scale) < nothing
        stuck = np.asarray(carry.failures) >= REJECTIONS
        done = (violation <= 1e-4) & (settled | exact | stuck)
        if np.all(done | (stuck & settled)):
            why = "stuck" if np.all(stuck) and not np.any(done) else "converged"
            break
        excess = np.where(np.isfinite(carry.constraints), carry.constraints, 0.0)
        multipliers = np.maximum(multipliers + weight[:, None] * excess, 0.0)
        slow = (violation > 1e-4) & (violation > 0.25 * violation_before)
        weight = np.minimum(np.where(slow, 4.0 * weight, weight), 1e7)
        before, violation_before = loss, violation
        # The merit has changed: evaluate it again at u, and clear the optimizer's memory.
        fresh = _begin(carry.u, optimizer=optimizer, constraints=constraints)
        carry = fresh._replace(best=carry.best, best_loss=carry.best_loss, loss=carry.loss)
    history = History(*(np.concatenate(parts, axis=1) for parts in zip(*pieces, strict=True)))
    return Descended(np.asarray(carry.u), np.asarray(carry.best), np.asarray(carry.best_loss), history, why)
