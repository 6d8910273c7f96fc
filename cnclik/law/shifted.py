"""Shifted: a reference moved by a vector in the task's coordinates."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from cnclik.law.reference import Reference
from cnclik.law.task import Task
from cnclik.record import record, replace
from cnclik.robot.rotations import exp_so3
from cnclik.shapes import ArrayLike


@record
class Shifted:
    """A curve moved by w: (m,) in the task's coordinates [m, rad], or a record that gives it as a function of time."""

    base: Callable
    task: Task
    w: ArrayLike | Callable

    def __call__(self, t):
        w, p = self.w(t) if callable(self.w) else jnp.asarray(self.w), len(self.task.position)
        position, rotation = self.base(t)
        if p:
            places = range(p) if len(position) == p else self.task.linear
            position = position.at[np.array(places)].add(w[:p])
        if self.task.orientation:
            turn = jnp.zeros(3, w.dtype).at[np.array(self.task.angular)].set(w[p:])
            rotation = exp_so3(turn) @ rotation
        return position, rotation


def shifted(reference: Reference, task: Task, w) -> Reference:
    """The reference whose error is w more than the reference's own; to first order for rotations.

    Args:
      w: (m,) as an array or a tuple [m, rad]: the velocity stays the curve's own, turned by w's rotation; or a record
        called with t, whose velocity adds to the curve's.
    """
    return replace(reference, curve=Shifted(base=reference.curve, task=task, w=w))


def unshifted(reference: Reference) -> Reference:
    """The reference without what `shifted` adds: where the target is, whatever a measurement makes of the error."""
    return replace(reference, curve=reference.curve.base) if isinstance(reference.curve, Shifted) else reference
