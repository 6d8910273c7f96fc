"""Exchange of joint values and velocities with models of Pinocchio and MuJoCo, matched by joint names.

For a free joint MuJoCo's velocities are those of `cnclik.robot.chart`; Pinocchio's are Rᵀṗ and ω.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cnclik import errors
from cnclik.record import ArrayLike, Float
from cnclik.robot.chain import Chain

_MODEL = "be a pinocchio.Model or a mujoco.MjModel"
_TURNS = ("rx", "ry", "rz")
_KINDS = {  # coordinates of a joint, how many of them are a position, how many numbers a model has for the rest
    "free": (("x", "y", "z", *_TURNS), 3, 4),
    "planar": (("x", "y", "yaw"), 2, 2),
    "ball": (_TURNS, 0, 4),
    "circle": (("",), 0, 2),
    "one": (("",), 1, 0),
}


def to_model_q(robot: Chain, model: Any, q: Float[ArrayLike, "... n"], qdot: Any = None) -> Any:
    """Return q as a `pinocchio.Model` or a `mujoco.MjModel` has it (..., model.nq), matched by joint names.

    A mimic joint of the robot that the model has as its own follows. Joints that the robot hasn't, frozen ones too, are
    neutral. The only free or planar joint of a model is the robot's base.

    Args:
      q: (..., n) joint values of the robot.
      qdot: (..., n) velocities, or None.
    Returns: q, or where velocities are given (q, v).
    """
    errors.kind("model", getattr(model, "nq", model), int, _MODEL)
    shape, q, rates = _rows("q", errors.kind("robot", robot, Chain).n, q, "qdot", robot.n, qdot)
    followers = [joint for joint in robot.joints if joint.follower]
    nothing = np.zeros((len(q), 1))  # the last column, of joints that the robot has not
    values = np.hstack([q, *(q[:, [j.coordinate]] * j.multiplier + j.offset for j in followers), nothing])
    rates = np.hstack([rates, *(rates[:, [j.coordinate]] * j.multiplier for j in followers), nothing])
    theirs, v = np.zeros((len(q), model.nq)), np.zeros((len(q), model.nv))
    for own, place, turn, velocity in _matched(robot, [*robot.joint_names, *(j.follower for j in followers)], model):
        count = place.stop - place.start
        theirs[:, place], v[:, velocity], angles = values[:, own[:count]], rates[:, own], values[:, own[count:]]
        rotation = _rotation(angles)
        if angles.shape[1] == 1:
            theirs[:, turn] = np.hstack([np.cos(angles), np.sin(angles)])
        elif angles.shape[1] == 3:
            theirs[:, turn] = rotation.as_quat(scalar_first=_is_mujoco(model))
        v[:, velocity] = _turned(model, v[:, velocity], count, rotation.inv())
    theirs, v = theirs.reshape(*shape, -1), v.reshape(*shape, -1)
    return theirs if qdot is None else (theirs, v)


def from_model_q(robot: Chain, model: Any, q: Float[ArrayLike, "... nq"], v: Any = None) -> Any:
    """Return joint values (..., n) of a robot from those of a `pinocchio.Model` or a `mujoco.MjModel`, by joint names.

    Returns: q, or where velocities v (..., nv) are given (q, qdot).
    """
    errors.kind("robot", robot, Chain)
    errors.kind("model", getattr(model, "nq", model), int, _MODEL)
    shape, q, v_rows = _rows("q", model.nq, q, "v", model.nv, v)
    values, rates = np.zeros((2, len(q), robot.n + 1))
    for own, place, turn, velocity in _matched(robot, robot.joint_names, model):
        count, angles = place.stop - place.start, q[:, turn]
        if angles.shape[1] == 2:
            angles = np.arctan2(angles[:, 1:], angles[:, :1])
        elif angles.shape[1] == 4:
            if not angles.any(axis=1).all():
                raise errors.fail("q", "hold a quaternion for each free or ball joint", "holds zeros in place of one")
            angles = Rotation.from_quat(angles, scalar_first=_is_mujoco(model)).as_rotvec()
        values[:, own] = np.hstack([q[:, place], angles])
        rates[:, own] = _turned(model, v_rows[:, velocity], count, _rotation(angles))
    values, rates = (each[:, :-1].reshape(*shape, -1) for each in (values, rates))
    return values if v is None else (values, rates)


def _rows(name, size, q, rate, count, v) -> tuple:
    """Return the shape before the last axis, joint values (B, size), and velocities (B, count), by default 0."""
    q = np.asarray(errors.array(name, q, (size,), (None, size)), float)
    v = np.zeros(count) if v is None else errors.array(rate, v, *dict.fromkeys(((count,), (*q.shape[:-1], count))))
    rows = q.reshape(-1, size)
    return q.shape[:-1], rows, np.broadcast_to(np.asarray(v, float), (len(rows), count))


def _is_mujoco(model) -> bool:
    return hasattr(model, "njnt")


def _joints(model) -> list:
    """Return (name, kind, first index in q, first index in the velocity) of a model's joints."""
    if _is_mujoco(model):
        kinds, every = ("free", "ball", "one", "one"), map(model.joint, range(model.njnt))
        return [(j.name or f"joint{j.id}", kinds[j.type[0]], int(j.qposadr[0]), int(j.dofadr[0])) for j in every]
    kinds, joints = {(7, 6): "free", (4, 3): "planar", (2, 1): "circle", (1, 1): "one"}, []
    for name, joint in list(zip(model.names, model.joints, strict=True))[1:]:  # the first is the universe
        kind = "ball" if "Spherical" in joint.shortname() else kinds.get((joint.nq, joint.nv))
        if joint.nq and kind is None:
            raise errors.fail("model", "have joints of one kind each", f"has {name!r}, {joint.shortname()}")
        joints += [(name, kind, joint.idx_q, joint.idx_v)] * (kind is not None)
    return joints


def _matched(robot, names, model) -> list:
    """Return (the robot's indices; the model's of position, rotation and velocity) of each of a model's joints."""
    joints, index, matched = _joints(model), {name: i for i, name in enumerate(names)}, []
    bases = [name for name, kind, _, _ in joints if kind in ("free", "planar")]
    for name, kind, i, j in joints:
        parts, count, size = _KINDS[kind]
        called = "base" if bases == [name] and f"{name}_x" not in index else name
        own = [index.get(f"{called}_{part}" if part else called, -1) for part in parts]
        own = own if -1 not in own else [-1] * len(own)
        matched.append((own, slice(i, i + count), slice(i + count, i + count + size), slice(j, j + len(own))))
    if missing := {*range(robot.n)}.difference(*(own for own, *_ in matched)):
        has_no = ", ".join(robot.joint_names[i] for i in sorted(missing))
        raise errors.fail("model", "have the robot's joints", f"has no {has_no}")
    return matched


def _turned(model, rates, count, rotation):
    """Return a joint's velocity with ṗ turned, which Pinocchio has along the body's axes."""
    if count < 2 or _is_mujoco(model):
        return rates
    place = np.pad(rates[:, :count], ((0, 0), (0, 3 - count)))
    return np.hstack([rotation.apply(place)[:, :count], rates[:, count:]])


def _rotation(angles):
    """Return rotations of rotation vectors (B, 3), of angles about z (B, 1), or of none (B, 0)."""
    return Rotation.from_rotvec(np.pad(angles, ((0, 0), (3 - angles.shape[1], 0))))
