"""Targets: the many ways to say where the tip shall be, read into 12 numbers each."""

import functools

import jax
import numpy as np

from cnclik import errors
from cnclik.robot import poses
from cnclik.task.task import Task, orientation, pose, position

TASKS = {"pose": pose, "position": position, "orientation": orientation}
_FORMS = {
    "pose": "4×4 transforms, [x, y, z, w, x, y, z] (position and quaternion), or a pair (positions, rotations)",
    "position": "positions (3,), 4×4 transforms, or a pair (positions, None)",
    "orientation": "rotations (3, 3), quaternions (4,), 4×4 transforms, or a pair (None, rotations)",
}


def task_of(task) -> Task:
    """A task from its name, or as it is."""
    return task if isinstance(task, Task) else _named(errors.one_of("task", task, TASKS))


@functools.cache
def _named(name):
    return TASKS[name]()


def read(targets, task: Task, base=None):
    """Targets as ((B, 12) position and rows of the rotation, whether it was one alone).

    Args:
      targets: see `cnclik.reach`. base: where the chain's base stands in the targets' frame, a pose or one per target.

    Raises: ArgumentError for shapes that don't fit, and rotations that are none; numbers that are not finite pass.
    """
    where, turn = _parts(targets, task)
    counts = {None if v.ndim == own else len(v) for v, own in ((where, 1), (turn, 2)) if v is not None}
    if len(counts) > 1:
        found = " and ".join("one" if c is None else f"{c}" for c in sorted(counts, key=lambda c: c or 0))
        raise errors.fail("targets", "have as many positions as rotations", f"have {found}")
    (size,) = counts
    single, size = size is None, 1 if size is None else size
    where, turn = (None if v is None else v[None] if single else v for v in (where, turn))
    if size == 0:
        raise errors.fail("targets", "hold at least one target", "hold none")
    xp = poses.library(where, turn, base)
    where = xp.zeros((size, 3)) if where is None else where
    turn = xp.broadcast_to(xp.eye(3), (size, 3, 3)) if turn is None else turn
    if base is not None:
        stands = poses.whole("base", base)
        if stands is None:
            raise errors.fail("base", f"be {poses.FORMS}, or one of them per target", f"has shape {np.shape(base)}")
        if stands[0].ndim == 2 and len(stands[0]) != size:
            raise errors.fail("base", f"be one pose or {size}, one per target", f"holds {len(stands[0])}")
        back = xp.swapaxes(stands[1], -1, -2)
        where = xp.einsum("...ij,...j->...i", back, where - stands[0])
        turn = back @ turn
    made = xp.concatenate([where, turn.reshape(size, 9)], axis=1)
    return np.ascontiguousarray(made, float) if xp is np else made, single


def _parts(targets, task):
    """Positions (..., 3) or None, rotations (..., 3, 3) or None."""
    if isinstance(targets, tuple) and len(targets) == 2 and not np.isscalar(targets[0]):
        where, turn = targets
        where = None if where is None and not task.position else _positions(where)
        turn = None if turn is None and not task.orientation else poses.rotations("targets", turn, finite=False)
        return where, turn
    four = not task.position and poses.shape_of(targets) == (4, 4) and _are_quaternions(targets)
    found = None if four else poses.whole("targets", targets, finite=False)
    if found is not None:
        return found
    targets = errors.array("targets", targets, finite=False)
    shape = targets.shape
    if not task.orientation and shape[-1:] == (3,) and len(shape) in (1, 2):
        return _positions(targets), None
    if not task.position:
        return None, poses.rotations("targets", targets, finite=False)
    if shape[-1:] == (3,) and len(shape) in (1, 2):
        must = f"be {_FORMS['pose']}, one or an array of them"
        raise errors.fail("targets", must, "holds positions alone, which are for task position (--task position)")
    kind = "pose" if task.orientation else "position"
    raise errors.fail("targets", f"be {_FORMS[kind]}, one or an array of them", f"has shape {shape}")


def _positions(value):
    value = errors.array("targets", value, (3,), (None, 3), finite=False)
    return np.asarray(value, float) if errors.concrete(value) else value


def _are_quaternions(found) -> bool:
    """Whether a 4×4 array is four unit quaternions and no transform. Raises ArgumentError where it could be both."""
    if not all(map(errors.concrete, jax.tree.leaves(found))):
        return False
    found = np.asarray(errors.array("targets", found, finite=False), float)
    with np.errstate(all="ignore"):
        off = np.abs(np.sqrt((found * found).sum(axis=1)) - 1).max()
    if not np.array_equal(found[3], [0, 0, 0, 1]):
        return off <= poses.NORM
    if off <= poses.ROUGH:  # such as the identity
        must = "say whether it is a transform, T[None], or four quaternions, (None, quaternions)"
        raise errors.fail("targets", must, "could be both")
    return False
