"""Targets: the accepted forms of a target, read into 12 numbers for each tip."""

import functools
from collections.abc import Mapping

import jax
import numpy as np

from cnclik import errors
from cnclik.law.reference import Reference, References, aims_of
from cnclik.robot import poses
from cnclik.task.build import orientation, pose, position
from cnclik.task.parts import places
from cnclik.task.task import WIDTH, Task, aims, of_tips

TASKS = {"pose": pose, "position": position, "orientation": orientation}
_FORMS = {
    "pose": "4×4 transforms, [x, y, z, w, x, y, z] (position and quaternion), or a pair (positions, rotations)",
    "position": "positions (3,), 4×4 transforms, or a pair (positions, None)",
    "orientation": "rotations (3, 3), quaternions (4,), 4×4 transforms, or a pair (None, rotations)",
}


def task_of(task) -> Task:
    return task if isinstance(task, Task) else _named(errors.one_of("task", task, TASKS))


@functools.cache
def _named(name):
    return TASKS[name]()


def read(targets, task: Task):
    """Return targets, see `cnclik.reach`, as (B, t) position and rows of the rotation of each aim, and if it was one.

    Coordinates that the task does not have are 0.

    Raises: ArgumentError for shapes that don't fit, and rotations that are none; numbers that are not finite pass.
    """
    each = [_counted(name, aim, *_parts(name, given, aim)) for name, given, aim in _each("targets", targets, task)]
    sizes = {size for *_, size in each if size is not None}
    if len(sizes) > 1:
        found = " and ".join(f"{size or 'one'} in {name}" for name, *_, size in each)
        raise errors.fail("targets", "have one target for each tip, or as many for each", f"have {found}")
    size, xp, made = sizes.pop() if sizes else 1, poses.library([row[2:4] for row in each]), []
    for _, aim, where, turn, _ in each:
        where = xp.zeros(3) if where is None else where
        where = where if len(aim.linear) == 3 else xp.where(np.isin(range(3), aim.linear), where, 0.0)
        turn = xp.eye(3) if turn is None else turn
        for own in (where.reshape(-1, 3), turn.reshape(-1, 9)):
            made.append(own if len(own) == size else xp.broadcast_to(own, (size, own.shape[1])))
    made = xp.concatenate(made, axis=1)
    alone = all(count is None for *_, count in each)
    return np.ascontiguousarray(made, float) if xp is np else made, alone


def transforms(pose) -> np.ndarray:
    """Transforms (B, 4, 4) from positions and rows of rotations (B, 12); (B, k, 4, 4) from those of k tips in a row."""
    rows = np.asarray(pose).reshape(len(pose), -1, WIDTH)
    out = np.tile(np.eye(4), (*rows.shape[:2], 1, 1))
    out[..., :3, 3], out[..., :3, :3] = rows[..., :3], rows[..., 3:].reshape(*rows.shape[:2], 3, 3)
    return out if rows.shape[1] > 1 else out[:, 0]


def by_name(task: Task, each):
    """Targets of a task's aims, one after the other, as `reach` takes them: by the names of tasks and tips."""
    every, made = aims(task), {}
    if len(every) == 1:
        return each[0]
    for aim, one in zip(every, each, strict=True):
        inner = made
        for key in aim.path[:-1]:
            inner = inner.setdefault(key, {})
        inner[aim.path[-1]] = one
    return made


def wanted_at(reference: Reference | References, task: Task, t):
    """(what a task wants of tips, its targets as `reach` takes them) where the paths are at a time, or times (k,)."""

    def of_tips_at(t):
        return [v for v, p in zip(aims_of(reference, task, t), task.parts, strict=True) if hasattr(p, "axes")]

    of, each = of_tips(task), []
    values = iter(jax.vmap(of_tips_at)(t) if np.ndim(t) else of_tips_at(t))
    for aim in aims(of):
        place, rotation = {}, None
        for part in aim.parts:
            value = next(values)
            rotation = value if part.turns else rotation
            axes = () if part.turns else places(part.axes)
            place |= {int(i): value[..., k] for k, i in enumerate(axes)}
        position, xp = None, poses.library(*place.values())
        if place:  # coordinates that the task does not control are arbitrary
            anywhere = xp.zeros_like(next(iter(place.values())))
            position = xp.stack([place.get(i, anywhere) for i in range(3)], -1)
        each.append((position, rotation))
    return of, by_name(of, each)


def _each(name, given, task):
    """(name, target, aim) for each aim of a task, from targets given by the names of tasks and tips."""
    every = aims(task)
    if len(every) == 1 and not isinstance(given, (Mapping, References)):
        return [(name, given, every[0])]
    return _by_name(name, given, [(aim.path, aim) for aim in every])


def _by_name(name, given, due):
    keys = list(dict.fromkeys(path[0] for path, _ in due if path))
    if isinstance(given, References):
        given = dict(zip(given.names, given.each, strict=True))
    if not isinstance(given, Mapping):
        if len(due) > 1:
            needed = ", ".join(f"{key!r}: ..." for key in keys)
            raise errors.fail(name, f"be a target for each tip, {{{needed}}}", f"is {type(given).__name__}")
        return [(name, given, due[0][1])]
    if set(given) != set(keys):
        others = ", ".join(map(str, given)) or "none"
        raise errors.fail(name, f"be for {' and '.join(keys) or 'a tip'}", f"is for {others}")
    under = {key: [(path[1:], aim) for path, aim in due if path[:1] == (key,)] for key in keys}
    return [found for key in keys for found in _by_name(f"{name}[{key!r}]", given[key], under[key])]


def _counted(name, aim, where, turn):
    """With how many there are; None of one alone. Raises: ArgumentError unless there are as many of both."""
    counts = {None if v.ndim == own else len(v) for v, own in ((where, 1), (turn, 2)) if v is not None}
    if len(counts) > 1:
        found = " and ".join("one" if c is None else f"{c}" for c in sorted(counts, key=lambda c: c or 0))
        raise errors.fail(name, "have as many positions as rotations", f"have {found}")
    (size,) = counts
    if size == 0:
        raise errors.fail(name, "hold at least one target", "hold none")
    return name, aim, where, turn, size


def _parts(name, targets, aim):
    """Positions (..., 3) or None, rotations (..., 3, 3) or None, of a target in any form."""
    if isinstance(targets, Reference):
        if not targets.still:
            raise errors.fail(name, "stand still, as ck.hold(...) does", f"is {targets!r}")
        targets = targets.curve.position, targets.curve.rotation
    if isinstance(targets, tuple) and len(targets) == 2 and not np.isscalar(targets[0]):
        where, turn = targets
        where = None if where is None and not aim.linear else _positions(name, where, aim)
        turn = None if turn is None and not aim.angular else poses.rotations(name, turn, finite=False)
        return where, turn
    four = not aim.linear and poses.shape_of(targets) == (4, 4) and _are_quaternions(targets)
    found = None if four else poses.whole(name, targets, finite=False)
    if found is not None:
        return found
    targets = errors.array(name, targets, finite=False)
    shape = targets.shape
    if not aim.angular and len(shape) in (1, 2) and shape[-1] in (3, len(aim.linear)):
        return _positions(name, targets, aim), None
    if not aim.linear:
        return None, poses.rotations(name, targets, finite=False)
    if shape[-1:] == (3,) and len(shape) in (1, 2):
        must = f"be {_FORMS['pose']}, one or an array of them"
        raise errors.fail(name, must, "holds positions alone, which are for task position (--task position)")
    if len(shape) in (1, 2):
        count = "7 numbers, x y z [m] and a quaternion w x y z" if aim.angular else "3 numbers, x y z [m]"
        alone = f"{len(aim.linear)} numbers, {' '.join('xyz'[i] for i in aim.linear)} [m], or "
        alone *= not aim.angular and len(aim.linear) < 3
        raise errors.fail(name, f"hold {alone}{count}", f"holds {shape[-1]}")
    kind = "pose" if aim.angular else "position"
    raise errors.fail(name, f"be {_FORMS[kind]}, one or an array of them", f"has shape {shape}")


def _are_quaternions(found) -> bool:
    """Whether a 4×4 array for an orientation is four quaternions: its last row is not that of a transform."""
    return errors.concrete(found) and not np.array_equal(np.asarray(found, float)[3], [0, 0, 0, 1])


def _positions(name, value, aim):
    """Positions (..., 3), of which the task's coordinates may stand alone; the others are arbitrary."""
    some = {3, len(aim.linear)}
    value = errors.array(name, value, *((size,) for size in some), *((None, size) for size in some), finite=False)
    value = np.asarray(value, float) if errors.concrete(value) else value
    if value.shape[-1] == 3:
        return value
    xp = poses.library(value)
    each = dict(zip(aim.linear, xp.moveaxis(value, -1, 0), strict=True))
    return xp.stack([each.get(axis, xp.zeros(value.shape[:-1])) for axis in range(3)], -1)
