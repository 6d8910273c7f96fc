"""Exchange of joint values and velocities with models of Pinocchio and MuJoCo, matched by joint names.

Both write a free joint as a position and a unit quaternion, seven numbers: Pinocchio in the order x y z w, MuJoCo w x y
z. Pinocchio also writes the angle of a continuous or planar joint as cosine and sine. For a free joint, MuJoCo's
velocities are those of `cnclik.robot.chart`, ṗ along the world's axes and ω in the base's own; Pinocchio's are Rᵀṗ and
ω, and Rᵀṗ for a planar joint.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from cnclik import errors
from cnclik.record import ArrayLike, Float
from cnclik.robot.chain import Chain
from cnclik.robot.poses import quaternions
from cnclik.robot.rotations import quaternion, rotation_from_quaternion

_TURNS = ("rx", "ry", "rz")
_PARTS = {"free": ("x", "y", "z", *_TURNS), "planar": ("x", "y", "yaw"), "ball": _TURNS}
_REST = {"free": (0, 0, 0, 1, 0, 0, 0), "planar": (0, 0, 1, 0), "circle": (1, 0), "one": (0,), "ball": (1, 0, 0, 0)}
_COUPLED = 2  # mujoco.mjtEq.mjEQ_JOINT


class _Slot(NamedTuple):
    """The place of a joint in another library's model."""

    name: str
    kind: str  # a key of _REST
    q: int  # index of its first value, and of its first velocity
    v: int


def to_pinocchio_q(robot: Chain, model: Any, q: Float[ArrayLike, "... n"], qdot: Any = None) -> Any:
    """q as a `pinocchio.Model` has it (..., model.nq), by names; joints that it hasn't, frozen ones too, are neutral.

    A mimic joint of the robot that the model has as its own, as without Pinocchio's `mimic=True`, follows.

    Args:
      q: (..., n) joint values of the robot.
      qdot: (..., n) velocities, or None.
    Returns: q, or where velocities are given (q, v).
    """
    return _to(robot, _of_pinocchio(model), q, qdot, (model.nq, model.nv), (1, 2, 3, 0), own=True)


def from_pinocchio_q(robot: Chain, model: Any, q: Float[ArrayLike, "... nq"], v: Any = None) -> Any:
    """Joint values (..., n) of a robot from a `pinocchio.Model`'s, by names, and velocities where they are given."""
    return _from(robot, _of_pinocchio(model), q, v, (model.nq, model.nv), (1, 2, 3, 0), own=True)


def to_mujoco_q(robot: Chain, model: Any, q: Float[ArrayLike, "... n"], qdot: Any = None) -> Any:
    """q as a `mujoco.MjModel` has it, qpos (..., model.nq). Args and returns: as `to_pinocchio_q`.

    A joint that follows another by an equality of the model has the value that this gives it.
    """
    made = _to(robot, _of_mujoco(model), q, qdot, (model.nq, model.nv), (0, 1, 2, 3), own=False)
    _couple(robot, model, *(made if isinstance(made, tuple) else (made, None)))
    return made


def from_mujoco_q(robot: Chain, model: Any, q: Float[ArrayLike, "... nq"], v: Any = None) -> Any:
    """Joint values (..., n) of a robot from a `mujoco.MjModel`'s qpos, by names; velocities from qvel, where given."""
    return _from(robot, _of_mujoco(model), q, v, (model.nq, model.nv), (0, 1, 2, 3), own=False)


# --- others' models -----------------------------------------------------------------------------------


def _of_pinocchio(model) -> list:
    kinds = {(7, 6): "free", (4, 3): "planar", (2, 1): "circle", (1, 1): "one"}
    found = []
    for name, joint in zip(model.names, model.joints, strict=True):
        kind = "ball" if "Spherical" in joint.shortname() else kinds.get((joint.nq, joint.nv))
        if joint.nq and kind is None:
            raise errors.fail("model", "have joints of one kind each", f"has {name!r}, {joint.shortname()}")
        if joint.nq:
            found.append(_Slot(name, str(kind), joint.idx_q, joint.idx_v))
    return found


def _of_mujoco(model) -> list:
    kinds = "free", "ball", "one", "one"
    each = [model.joint(i) for i in range(model.njnt)]
    return [_Slot(j.name or f"joint{j.id}", kinds[int(j.type[0])], int(j.qposadr[0]), int(j.dofadr[0])) for j in each]


def _couple(robot, model, qpos, qvel):
    """Sets the joints that the robot has not and that follow another: y − y₀ = Σ aᵢ (x − x₀)ⁱ."""
    known = {slot.q for slot, places in _matched(robot.joint_names, _of_mujoco(model)) if places is not None}
    pairs = [i for i in range(model.neq) if model.eq_type[i] == _COUPLED and model.eq_active0[i]]
    for _ in pairs:  # as one that follows may lead another
        for i in pairs:
            own, other = (int(ids[i]) for ids in (model.eq_obj1id, model.eq_obj2id))
            y, x = model.jnt_qposadr[own], model.jnt_qposadr[other]
            if y in known:
                continue
            curve = np.polynomial.Polynomial(model.eq_data[i, : 5 if other >= 0 else 1])
            at = qpos[..., x] - model.qpos0[x]
            qpos[..., y] = model.qpos0[y] + curve(at)
            if qvel is not None:
                qvel[..., model.jnt_dofadr[own]] = curve.deriv()(at) * qvel[..., model.jnt_dofadr[other]]


def _matched(names, slots) -> Iterable:
    """(slot, our coordinates of it or None) for each joint of a model; its only free or planar joint is our base."""
    names = {name: i for i, name in enumerate(names)}
    alone = sum(slot.kind in ("free", "planar") for slot in slots) == 1
    for slot in slots:
        parts = _PARTS.get(slot.kind)
        called = [slot.name, *["base"] * (alone and slot.kind in ("free", "planar"))]
        own = [[names.get(f"{name}_{part}") for part in parts] if parts else [names.get(name)] for name in called]
        yield slot, next((places for places in own if None not in places), None)


def _to(robot, slots, q, qdot, sizes, order, own):
    errors.kind("robot", robot, Chain)
    q = np.asarray(errors.array("q", q, (robot.n,), (None, robot.n)), float)
    found, speeds = np.zeros((*q.shape[:-1], sizes[0])), np.zeros((*q.shape[:-1], sizes[1]))
    given = None if qdot is None else _velocities("qdot", qdot, q.shape)
    followers = [joint for joint in robot.joints if own and joint.follower]  # MuJoCo's are in the model's equalities
    matched = list(_matched([*robot.joint_names, *(joint.follower for joint in followers)], slots))
    _require_all(robot, {i for _, places in matched for i in places or ()})
    for joint in followers:
        one = slice(joint.coordinate, joint.coordinate + 1)
        q = np.concatenate([q, joint.multiplier * q[..., one] + joint.offset], -1)
        given = None if given is None else np.concatenate([given, joint.multiplier * given[..., one]], -1)
    for slot, places in matched:
        rest = np.array(_REST[slot.kind], float)
        values, rotation = (rest, None) if places is None else _theirs(slot.kind, q[..., places])
        if slot.kind in ("free", "ball"):
            values = np.concatenate([values[..., :-4], values[..., -4:][..., list(order)]], -1)
        found[..., slot.q : slot.q + len(rest)] = values
        if given is not None and places is not None:
            back = None if rotation is None or not own or slot.kind == "ball" else np.swapaxes(rotation, -1, -2)
            speeds[..., slot.v : slot.v + len(places)] = _turned(given[..., places], back)
    return found if qdot is None else (found, speeds)


def _from(robot, slots, q, v, sizes, order, own):
    errors.kind("robot", robot, Chain)
    q = np.asarray(errors.array("q", q, (sizes[0],), (None, sizes[0])), float)
    found, speeds = (np.full((*q.shape[:-1], robot.n), np.nan) for _ in range(2))
    given = None if v is None else _velocities("v", v, (*q.shape[:-1], sizes[1]))
    matched = [(slot, places) for slot, places in _matched(robot.joint_names, slots) if places is not None]
    _require_all(robot, {i for _, places in matched for i in places})
    for slot, places in matched:
        values = q[..., slot.q : slot.q + len(_REST[slot.kind])]
        if slot.kind in ("free", "ball"):
            values = np.concatenate([values[..., :-4], values[..., -4:][..., np.argsort(order)]], -1)
        found[..., places], rotation = _ours(slot.kind, values)
        if given is not None:
            speeds[..., places] = _turned(
                given[..., slot.v : slot.v + len(places)], rotation if own and slot.kind != "ball" else None
            )
    return found if v is None else (found, speeds)


def _velocities(name, given, shape):
    given = np.asarray(errors.array(name, given, *dict.fromkeys((shape[-1:], shape))), float)
    return np.broadcast_to(given, shape)


def _require_all(robot, places):
    missing = [name for i, name in enumerate(robot.joint_names) if i not in places]
    if missing:
        raise errors.fail("model", "have the robot's joints", f"has no {', '.join(missing)}")


# --- one joint's values -------------------------------------------------------------------------------


def _theirs(kind, mine):
    """(a joint's values in the other library's form, with w x y z; its rotation) from ours."""
    if kind == "one":
        return mine, None
    if kind in ("planar", "circle"):
        c, s = np.cos(mine[..., -1:]), np.sin(mine[..., -1:])
        return np.concatenate([mine[..., :-1], c, s], -1), _about_z(c, s)
    w, v = quaternion(mine[..., -3:])
    turned = _rotation(np.concatenate([w[..., None], v], -1))
    return np.concatenate([mine[..., :-3], quaternions(turned)], -1), turned


def _ours(kind, values):
    if kind == "one":
        return values, None
    if kind in ("planar", "circle"):
        c, s = values[..., -2:-1], values[..., -1:]
        return np.concatenate([values[..., :-2], np.arctan2(s, c)], -1), _about_z(c, s)
    norm = np.linalg.norm(values[..., -4:], axis=-1, keepdims=True)
    if np.any(norm == 0):
        raise errors.fail("q", "hold a quaternion for each free or ball joint", "holds zeros in place of one")
    unit = values[..., -4:] / norm
    unit = np.where(unit[..., :1] < 0, -unit, unit)
    size = np.linalg.norm(unit[..., 1:], axis=-1, keepdims=True)
    tiny = size < 1e-100
    share = np.where(tiny, 2.0, 2 * np.arctan2(size, unit[..., :1]) / np.where(tiny, 1.0, size))
    return np.concatenate([values[..., :-4], share * unit[..., 1:]], -1), _rotation(unit)


def _rotation(unit):
    return np.moveaxis(np.array(rotation_from_quaternion(np.moveaxis(unit, -1, 0))), (0, 1), (-2, -1))


def _about_z(c, s):
    zero = 0 * c[..., 0]
    rows = [[c[..., 0], -s[..., 0], zero], [s[..., 0], c[..., 0], zero], [zero, zero, zero + 1]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def _turned(velocity, rotation):
    """The velocity of a free or planar joint with its linear part rotated."""
    count = {6: 3, 3: 2}.get(velocity.shape[-1], 0)
    if rotation is None or not count:
        return velocity
    linear = (rotation[..., :count, :count] @ velocity[..., :count, None])[..., 0]
    return np.concatenate([linear, velocity[..., count:]], -1)
