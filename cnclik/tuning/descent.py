"""Descent: minimize a loss between bounds, under constraints, with the updates of an optax transformation.

Free numbers u are values, or their logarithms where bounds are positive. What leaves the bounds is put back on them
(projected gradient, Bertsekas 1982). A penalty keeps the constraints, with a little to spare. A trial that does not
descend is rejected, and its step shortened.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik.cache import bounded_jit

FORWARD_UP_TO = 8  # numbers: forward mode costs a run for each, reverse mode a few runs and their memory
PENALTY, SPARE = 1e3, 5e-3  # of a squared excess, for a loss of 1; share of a bound that is kept free
KEPT = 1e-9  # excess of a constraint that is rounding
LONGEST = 2.0  # step: a factor e² of a gain
SHORTENED, SHORTENINGS = 0.3, 10  # of a rejected step
FLAT, SETTLED = 1e-8, 1e-10  # slope, and relative change of the merit in a step, that end a descent
NOTHING = 1e-13  # loss and slope that are rounding


class Bounds(NamedTuple):
    """Bounds of all values (p,)."""

    lower: np.ndarray
    upper: np.ndarray

    def free(self, values):
        """Return the free numbers of values."""
        return np.where(self.lower > 0, np.log(np.maximum(values, 1e-300)), values)

    def values(self, u):
        """Return the values of free numbers, with a derivative."""
        positive = self.lower > 0
        return jnp.where(positive, jnp.exp(jnp.where(positive, u, 0.0)), u)

    def within(self, u):
        """Return the nearest free numbers within the bounds."""
        return np.clip(u, self.free(self.lower), self.free(self.upper))


class Point(NamedTuple):
    """An evaluated point; `seen` is what the objective returns besides loss and excess."""

    u: np.ndarray  # (p,)
    merit: float
    slope: np.ndarray  # (p,) of the merit
    loss: float
    excess: float  # of the worst constraint, relative; at most 0 if all are kept
    seen: Any

    @property
    def rank(self) -> tuple:
        """Points of a lower rank are better: they keep the constraints, or exceed them less; then the loss counts."""
        finite = np.isfinite(self.merit) and np.isfinite(self.slope).all()
        return (self.excess * (self.excess > KEPT), self.loss) if finite else (np.inf, np.inf)


@bounded_jit
def _evaluated(objective, bounds, u, scale):
    def merit(u):
        loss, excess, seen = objective(bounds.values(u))
        value = scale * loss + PENALTY * jnp.sum(jnp.maximum(excess + SPARE, 0.0) ** 2)
        return value, (value, loss, jnp.max(excess, initial=-1.0), seen)

    derivative = jax.jacfwd if len(u) <= FORWARD_UP_TO else jax.grad
    return derivative(merit, has_aux=True)(u)


def evaluate(objective, bounds, u, scale=1.0) -> Point:
    """Evaluate an objective, called as objective(values) -> (loss, excess of each constraint (c,), anything)."""
    slope, (merit, loss, excess, seen) = _evaluated(objective, bounds, u, np.asarray(scale))
    return Point(u, float(merit), np.asarray(slope), float(loss), float(excess), seen)


@functools.lru_cache(maxsize=8)
def _compiled(optimizer):
    """(init, update) of an optimizer; None: L-BFGS (Liu & Nocedal 1989), with the line search of `descend`."""
    import optax

    optimizer = optax.lbfgs(memory_size=10, linesearch=None) if optimizer is None else optimizer
    return jax.jit(optimizer.init), jax.jit(optimizer.update)


def descend(objective, bounds: Bounds, u, *, optimizer=None, steps=100, progress=None) -> tuple[Point, int, str]:
    """Descend from u (p,); return the best point, the number of evaluations, at most `steps`, and the status.

    Args: progress: called with (evaluations, steps, words), or None.
    """
    init, update = _compiled(optimizer)
    best, count = evaluate(objective, bounds, u), 1
    scale = 1.0 / abs(best.loss) if best.loss else 1.0
    if not np.isfinite(best.rank).all():
        return best, count, "non-finite"
    if max(abs(best.loss), *abs(best.slope)) < NOTHING:
        return best, count, "nothing"
    here, state, count = evaluate(objective, bounds, u, scale), init(u), 2
    while True:
        stays = bounds.within(here.u - here.slope) == here.u
        slope = np.where(stays, 0.0, here.slope)
        if np.max(abs(slope)) < FLAT:
            return best, count, "converged"
        direction, state = update(slope, state, here.u)
        direction = np.where(stays, 0.0, direction)
        if not direction @ slope < 0:
            direction, state = -slope, init(here.u)
        direction = direction * min(1.0, LONGEST / np.max(abs(direction)))
        for shorter in SHORTENED ** np.arange(SHORTENINGS):
            if count >= steps:
                return best, count, "steps"
            trial = evaluate(objective, bounds, bounds.within(here.u + shorter * direction), scale)
            best, count = min(best, trial, key=lambda point: point.rank), count + 1
            if progress is not None:
                progress(count, steps, f"loss {best.loss:.5g}")
            descends = trial.merit <= here.merit + 1e-4 * slope @ (trial.u - here.u)
            if descends and np.isfinite(trial.rank).all():
                break
        else:
            return best, count, "converged"
        if here.merit - trial.merit <= SETTLED * abs(here.merit):
            return best, count, "converged"
        here = trial
