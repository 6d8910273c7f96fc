"""Targets: the many ways to say where the tip shall be, read into 12 numbers each."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.law.task import Task, orientation, pose, position
from cnclik.robot import spatial as sp
from cnclik.robot.kinematics import Pose

TASKS = {"pose": pose, "position": position, "orientation": orientation}
_LAST = np.array([0.0, 0.0, 0.0, 1.0])  # row of a transform
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
      targets: see `cnclik.reach`. base: (4, 4) or (B, 4, 4), where the chain's base stands in the targets' frame.

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
    xp = _library(where, turn, base)
    where = xp.zeros((size, 3)) if where is None else where
    turn = xp.broadcast_to(xp.eye(3), (size, 3, 3)) if turn is None else turn
    if base is not None:
        base = errors.array("base", base, (4, 4), (None, 4, 4))
        if base.ndim == 3 and len(base) != size:
            raise errors.fail("base", f"be one transform or {size}, one per target", f"holds {len(base)}")
        _check_transform("base", base)
        back = xp.swapaxes(base[..., :3, :3], -1, -2)
        where = xp.einsum("...ij,...j->...i", back, where - base[..., :3, 3])
        turn = back @ turn
    made = xp.concatenate([where, turn.reshape(size, 9)], axis=1)
    return np.ascontiguousarray(made, float) if xp is np else made, single


def _parts(targets, task):
    """Positions (..., 3) or None, rotations (..., 3, 3) or None."""
    if isinstance(targets, Pose):
        targets = targets.position, targets.rotation
    if isinstance(targets, tuple) and len(targets) == 2 and not np.isscalar(targets[0]):
        return _position(targets[0], task), _rotation(targets[1], task)
    found = errors.array("targets", targets, finite=False)
    shape = found.shape
    quaternions = shape == (4, 4) and not task.position and not _is_transform(found)
    if shape[-2:] == (4, 4) and len(shape) in (2, 3) and not quaternions:
        _check_transform("targets", found)
        return found[..., :3, 3], found[..., :3, :3]
    if task.position and task.orientation and shape[-1:] == (7,) and len(shape) in (1, 2):
        return found[..., :3], _rotation(found[..., 3:], task)
    if not task.orientation and shape[-1:] == (3,) and len(shape) in (1, 2):
        return found, None
    if not task.position:
        return None, _rotation(found, task)
    kind = "pose" if task.orientation else "position"
    raise errors.fail("targets", f"be {_FORMS[kind]}, one or an array of them", f"has shape {shape}")


def _position(value, task):
    if value is None and not task.position:
        return None
    return errors.array("targets", value, (3,), (None, 3), finite=False)


def _rotation(value, task):
    """Rotations of an array of rotation matrices or quaternions (w, x, y, z)."""
    if value is None and not task.orientation:
        return None
    value = errors.array("targets", value, (3, 3), (None, 3, 3), (4,), (None, 4), finite=False)
    if value.shape[-1] == 3:
        _check_rotation("targets", value)
        return value
    xp = _library(value)
    largest = xp.max(xp.abs(value), axis=-1, keepdims=True)  # a norm of huge or tiny numbers would be inf or 0
    if errors.concrete(value) and (np.asarray(largest) == 0).any():
        raise errors.fail("targets", "hold quaternions other than 0", "holds one")
    value = xp.where(xp.isfinite(largest), value, xp.nan) / xp.where(xp.isfinite(largest), largest, 1.0)
    rows = sp.rotation_from_quaternion(xp.moveaxis(value / xp.linalg.norm(value, axis=-1, keepdims=True), -1, 0))
    return xp.moveaxis(xp.stack([xp.stack(row) for row in rows]), (0, 1), (-2, -1))


def _is_transform(found) -> bool:
    """Whether a 4×4 array, of an orientation task, is a transform and not four quaternions."""
    return not errors.concrete(found) or np.array_equal(np.asarray(found)[3], [0, 0, 0, 1])


def _check_transform(name, found):
    """Raise ArgumentError unless 4×4 matrices, where they are finite, are rigid transforms."""
    _check_rotation(name, found[..., :3, :3])
    if not errors.concrete(found):
        return
    last = np.asarray(found)[..., 3, :].reshape(-1, 4)
    if (last == _LAST).all():
        return
    wrong = np.isfinite(last).all(axis=1) & (last != _LAST).any(axis=1)
    if wrong.any():
        shown = " ".join(f"{v:g}" for v in last[np.argmax(wrong)])
        raise errors.fail(name, "have the last row 0 0 0 1", f"has {shown} at index {np.argmax(wrong)}")


def _check_rotation(name, r):
    if not errors.concrete(r):
        return
    r = np.asarray(r, float)
    right = _are_rotations(r)
    if np.all(right):
        return
    wrong = np.atleast_1d(np.isfinite(r).all(axis=(-1, -2)) & np.logical_not(right))  # else the status tells
    if wrong.any():
        where = f" at index {np.flatnonzero(wrong)[0]}" if r.ndim > 2 else ""
        raise errors.fail(name, "hold rotations, with rows of length 1 at right angles", f"does not{where}")


def _are_rotations(r):
    """Which of (..., 3, 3) have rows of length 1 at right angles, and are right-handed.

    Written out: of ten thousand a product and a determinant from the library take twenty times as long, and of one
    Python's own numbers are quicker than NumPy's.
    """
    a, b, c, d, e, f, g, h, i = r.reshape(9).tolist() if r.ndim == 2 else np.ascontiguousarray(r.reshape(-1, 9).T)
    with np.errstate(over="ignore", invalid="ignore"):
        lengths = a * a + b * b + c * c, d * d + e * e + f * f, g * g + h * h + i * i
        angles = a * d + b * e + c * f, a * g + b * h + c * i, d * g + e * h + f * i
        right = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0
    for gap in (*(length - 1.0 for length in lengths), *angles):
        right = right & (abs(gap) <= 1e-5)
    return right


def _library(*arrays):
    """NumPy where all is known, JAX's where something is traced."""
    return np if all(map(errors.concrete, jax.tree.leaves(arrays))) else jnp
