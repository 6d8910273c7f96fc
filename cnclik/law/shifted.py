"""Shifted: a reference moved by a vector in the task's coordinates."""

from cnclik.law.curves import whole
from cnclik.law.reference import Reference
from cnclik.law.task import Task
from cnclik.record import record, replace
from cnclik.robot import spatial as sp


@record
class Shifted:
    """A curve moved by w: (m,) in the task's coordinates [m, rad], or a record that gives it as a function of time."""

    base: object
    task: object
    w: object

    def __call__(self, t, unrolled=True):
        w = self.w(t) if callable(self.w) else self.w
        w = tuple(w[i] for i in range(self.task.m))
        position, rotation = self.base(t)
        linear, turn = w[: len(self.task.position)], w[len(self.task.position) :]
        if self.task.position:
            places = range(len(linear)) if len(position) == len(linear) else self.task.linear
            moved = dict(zip(places, linear, strict=True))
            position = tuple(sp.add(v, moved[i]) if i in moved else v for i, v in enumerate(position))
        if self.task.orientation:
            about = dict(zip(self.task.angular, turn, strict=True))
            rotation = sp.matmul(sp.exp_so3(tuple(about.get(i, 0.0) for i in range(3))), rotation)
        return (position, rotation) if unrolled else (whole(position), whole(rotation))


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
