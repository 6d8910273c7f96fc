"""Shifted: a reference moved by a vector."""

from collections.abc import Callable

import jax.numpy as jnp

from cnclik.law.reference import by_target, of_each
from cnclik.record import record, replace
from cnclik.shapes import ArrayLike
from cnclik.task.task import Task


@record
class Shifted:
    """A curve moved by w: (w,) as a motion of the task's targets [m, rad], or a record that gives it over time."""

    base: Callable
    task: Task  # the parts that the curve is for
    first: int  # where their motion begins in w
    w: ArrayLike | Callable

    def __call__(self, t):
        w, target = self.w(t) if callable(self.w) else jnp.asarray(self.w), self.base(t)
        w = w[self.first :]
        for part, where in zip(self.task.parts, self.task.motions, strict=True):
            target = part.moved(*target, w[where])
        return target


def shifted(reference, task: Task, w):
    """The reference whose error is w more than the reference's own; to first order for rotations.

    Args:
      w: (w,) as an array or a tuple [m, rad]: the velocity stays the curve's own, turned by w's rotation; or a record
        called with t, whose velocity adds to the curve's.
    """
    first = 0

    def one(reference, parts):
        nonlocal first
        curve = Shifted(base=reference.curve, task=parts, first=first, w=w)
        first += parts.width
        return replace(reference, curve=curve)

    return of_each(one, reference, task)


def true_motion(reference, task: Task):
    """The reference without the shift of `shifted` and without a separate feed-forward."""
    if not any(isinstance(one.curve, Shifted) or one.feedforward is not None for one, _ in by_target(reference, task)):
        return reference

    def one(reference, _):
        curve = reference.curve
        return replace(reference, curve=curve.base if isinstance(curve, Shifted) else curve, feedforward=None)

    return of_each(one, reference, task)
