"""Targets: the accepted forms of a target, read into 12 numbers for each tip."""

from collections.abc import Mapping

import jax
import numpy as np

from cnclik import errors
from cnclik.law.paths import Reference
from cnclik.law.reference import References, aims_of
from cnclik.record import xp_for
from cnclik.robot import poses
from cnclik.robot.model import Pose
from cnclik.task.task import Task, aims, of_tips


def read(targets, task: Task):
    """Return targets, see `cnclik.reach`, as (B, t) position and rows of the rotation of each aim, and if it was one.

    Coordinates that the task does not have are 0.

    Raises: ArgumentError for shapes that don't fit, and rotations that are none; numbers that are not finite pass.
    """
    each = [(name, aim, *_parts(name, target, aim)) for name, target, aim in _each(targets, aims(task))]
    sizes = {len(v) for *_, where, turn in each for v, own in ((where, 1), (turn, 2)) if v is not None and v.ndim > own}
    if len(sizes) > 1:
        raise errors.fail("targets", "be as many of each, or one", f"are {' and '.join(map(str, sorted(sizes)))}")
    alone, size, xp, made = not sizes, max(sizes, default=1), xp_for([row[2:] for row in each]), []
    if size == 0:
        raise errors.fail("targets", "hold at least one target", "hold none")
    for _, aim, where, turn in each:
        where = xp.zeros(3) if where is None else xp.where(np.array([k in aim.linear for k in range(3)]), where, 0.0)
        turn = xp.eye(3) if turn is None else turn
        made += [xp.broadcast_to(own.reshape(-1, k), (size, k)) for own, k in ((where, 3), (turn, 9))]
    made = xp.concatenate(made, axis=1)
    return np.ascontiguousarray(made, float) if xp is np else made, alone


def wanted_at(reference: Reference | References, task: Task, t):
    """(what a task wants of tips, its targets as `reach` takes them) where the paths are at a time."""
    of, each, found = of_tips(task), [], jax.jit(aims_of)(reference, task, t)  # else op by op
    values = iter([v for v, part in zip(found, task.parts, strict=True) if hasattr(part, "axes")])
    for aim in aims(of):
        own = {part.turns: next(values) for part in aim.parts}
        each.append((own.get(False), own.get(True)))
    return of, each[0] if len(each) == 1 else dict(zip(_names(aims(of)), each, strict=True))


def _names(every) -> list:
    """The names of a stack's tasks, with the tip's where one has several: left, hands.left."""
    first = [aim.path[0] for aim in every]
    return [name if first.count(name) == 1 else ".".join(aim.path) for name, aim in zip(first, every, strict=True)]


def _each(targets, every):
    """(name, target, aim) for each aim of a task, from targets given by the names of tasks and tips."""
    if len(every) == 1 and not isinstance(targets, Mapping):
        return [("targets", targets, every[0])]
    names = _names(every)
    if not isinstance(targets, Mapping) or set(targets) != set(names):
        found = ", ".join(map(str, targets)) if isinstance(targets, Mapping) else type(targets).__name__
        raise errors.fail("targets", f"be a dict with {' and '.join(names)}", f"is {found or 'empty'}")
    return [(f"targets[{name!r}]", targets[name], aim) for name, aim in zip(names, every, strict=True)]


def _parts(name, target, aim):
    """Positions (..., 3) or None, rotations (..., 3, 3) or None, of a target in any form."""
    if isinstance(target, tuple) and len(target) == 2 and not np.isscalar(target[0]):
        where, turn = target
        where = None if where is None and not aim.linear else _positions(name, where, aim)
        return where, None if turn is None and not aim.angular else poses.rotations(name, turn, finite=False)
    four = not aim.linear and poses.shape_of(target) == (4, 4) and errors.concrete(target)
    if four and not np.array_equal(np.asarray(target, float)[3], [0, 0, 0, 1]):  # quaternions, and no transform
        return None, poses.rotations(name, target, finite=False)
    if isinstance(target, list) and target and all(isinstance(one, Pose) for one in target):
        target = jax.tree.map(lambda *each: xp_for(each).stack(each), *target)
    whole = poses.whole(name, target, finite=False)
    if whole is not None:
        return whole
    if not aim.linear:
        return None, poses.rotations(name, target, finite=False)
    return _positions(name, target, aim, alone=not aim.angular), None


def _positions(name, value, aim, alone=True):
    """Positions (..., 3), of which the task's coordinates may stand alone. Args: alone: whether a position is all."""
    value, size = errors.array(name, value, finite=False), len(aim.linear)
    if not alone or value.ndim not in (1, 2) or value.shape[-1] not in (3, size):
        needed = f"{size} numbers, {' '.join('xyz'[i] for i in aim.linear)} [m]" if size else "3 numbers, x y z [m]"
        needed = needed if alone else "7 numbers, x y z [m] and a quaternion w x y z"
        held = f"holds {value.shape[-1]}" if value.ndim in (1, 2) else f"has shape {value.shape}"
        held += ", as for the task position" * (value.shape[-1:] == (3,))
        raise errors.fail(name, f"hold {needed}", held)
    xp, value = xp_for(value), np.asarray(value, float) if errors.concrete(value) else value
    if value.shape[-1] == 3:
        return value
    each = dict(zip(aim.linear, xp.moveaxis(value, -1, 0), strict=True))
    return xp.stack([each.get(axis, xp.zeros(value.shape[:-1])) for axis in range(3)], -1)
