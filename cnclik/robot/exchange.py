"""Exchange of joint values and velocities with models of Pinocchio and MuJoCo, matched by joint names.

Both count a posture from the neutral one by a velocity that leads there in a second, and write a rotation as a
quaternion. For a free joint, MuJoCo's velocities are those of `cnclik.robot.chart`, ṗ along the world's axes and ω in
the base's own; Pinocchio's are Rᵀṗ and ω, and Rᵀṗ for a planar joint.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from cnclik import errors
from cnclik.record import ArrayLike, Float
from cnclik.robot.chain import Chain

_TURNS = ("rx", "ry", "rz")
_PARTS = {"free": ("x", "y", "z", *_TURNS), "planar": ("x", "y", "yaw"), "ball": _TURNS, "one": ("",)}
_AXES = {"free": slice(6), "planar": [0, 1, 5]}  # of a free base's coordinates, those of a base


def to_model_q(robot: Chain, model: Any, q: Float[ArrayLike, "... n"], qdot: Any = None) -> Any:
    """Return q as a `pinocchio.Model` or a `mujoco.MjModel` has it (..., model.nq), matched by joint names.

    A mimic joint of the robot that the model has as its own follows. Joints that the robot hasn't, frozen ones too, are
    neutral. The only free or planar joint of a model is the robot's base.

    Args:
      q: (..., n) joint values of the robot.
      qdot: (..., n) velocities, or None.
    Returns: q, or where velocities are given (q, v).
    """
    q, rates = _given("q", errors.kind("robot", robot, Chain).n, q, "qdot", robot.n, qdot)
    followers = [joint for joint in robot.joints if joint.follower]
    coordinates = [joint.coordinate for joint in followers]
    factors, shifts = (np.array([getattr(j, name) for j in followers], float) for name in ("multiplier", "offset"))
    values = np.concatenate([q, q[..., coordinates] * factors + shifts], -1)
    rates = np.concatenate([rates, rates[..., coordinates] * factors], -1)
    displacements, speeds = np.zeros((2, *q.shape[:-1], model.nv))
    joints, posture, _, inward, _ = _library(model)
    for kind, own, at in _matched(robot, [*robot.joint_names, *(joint.follower for joint in followers)], joints):
        displacements[..., at], speeds[..., at] = _each(kind, inward, values[..., own], rates[..., own])
    theirs = np.apply_along_axis(posture, -1, displacements)
    return theirs if qdot is None else (theirs, speeds)


def from_model_q(robot: Chain, model: Any, q: Float[ArrayLike, "... nq"], v: Any = None) -> Any:
    """Return joint values (..., n) of a robot from those of a `pinocchio.Model` or a `mujoco.MjModel`, by joint names.

    Returns: q, or where velocities v (..., nv) are given (q, qdot).
    """
    errors.kind("robot", robot, Chain)
    q, speeds = _given("q", model.nq, q, "v", model.nv, v)
    values, rates = np.zeros((2, *q.shape[:-1], robot.n))
    joints, _, displacement, _, outward = _library(model)
    matched, displacements = _matched(robot, robot.joint_names, joints), np.apply_along_axis(displacement, -1, q)
    for kind, own, at in matched:
        values[..., own], rates[..., own] = _each(kind, outward, displacements[..., at], speeds[..., at])
    return values if v is None else (values, rates)


def _given(name, size, q, rate, count, v) -> tuple:
    """Return joint values (..., size) and velocities (..., count), 0 where none are given, checked."""
    q = np.asarray(errors.array(name, q, (size,), (None, size)), float)
    shape = (*q.shape[:-1], count)
    v = np.zeros(count) if v is None else errors.array(rate, v, *dict.fromkeys(((count,), shape)))
    return q, np.broadcast_to(np.asarray(v, float), shape)


def _library(model) -> tuple:
    """Return a model's joints, as (name, kind, index of its velocity), and four functions: its posture (nq,) by the
    displacement (nv,) from the neutral one, the inverse; of a base's values and velocities (6,) its own, the inverse.
    """
    return _mujoco(model) if hasattr(model, "njnt") else _pinocchio(model)


def _mujoco(model):
    mujoco: Any = importlib.import_module("mujoco")
    joints, neutral, turns = [], np.zeros(model.nq), []
    for joint in map(model.joint, range(model.njnt)):
        kind = ("free", "ball", "one", "one")[int(joint.type[0])]
        joints.append((joint.name or f"joint{joint.id}", kind, int(joint.dofadr[0])))
        turns += [int(joint.qposadr[0]) + 3 * (kind == "free")] * (kind != "one")
    neutral[turns] = 1.0

    def posture(displacement):
        q = neutral.copy()
        mujoco.mj_integratePos(model, q, displacement, 1.0)
        return q

    def displacement(q):
        if not all(q[i : i + 4].any() for i in turns):
            raise errors.fail("q", "hold a quaternion for each free or ball joint", "holds zeros in place of one")
        v = np.zeros(model.nv)
        mujoco.mj_differentiatePos(model, v, 1.0, neutral, q)
        return v

    return joints, posture, displacement, lambda *same: same, lambda *same: same


def _pinocchio(model):
    pin: Any = importlib.import_module("pinocchio")
    joints, neutral, kinds = [], pin.neutral(model), {(7, 6): "free", (4, 3): "planar", (2, 1): "one", (1, 1): "one"}
    for name, joint in zip(model.names, model.joints, strict=True):
        kind = "ball" if "Spherical" in joint.shortname() else kinds.get((joint.nq, joint.nv))
        if joint.nq and kind is None:
            raise errors.fail("model", "have joints of one kind each", f"has {name!r}, {joint.shortname()}")
        joints += [(name, kind, joint.idx_v)] * (kind is not None)

    def inward(values, rates):
        rotation = pin.exp3(values[3:])
        return pin.log6(pin.SE3(rotation, values[:3])).vector, [*rotation.T @ rates[:3], *rates[3:]]

    def outward(screw, rates):
        pose = pin.exp6(screw)
        return [*pose.translation, *pin.log3(pose.rotation)], [*pose.rotation @ rates[:3], *rates[3:]]

    return (
        joints,
        lambda v: pin.integrate(model, neutral, v),
        lambda q: pin.difference(model, neutral, q),
        inward,
        outward,
    )


def _matched(robot, names, joints) -> list:
    """Return (kind, indices of its names, and of its velocity) of each joint of a model that is named.

    All of the robot's own names must be in the model.
    """
    index, bases, matched = {name: i for i, name in enumerate(names)}, [j for j in joints if j[1] in _AXES], []
    for name, kind, at in joints:
        for called in (name, *["base"] * (len(bases) == 1 and kind in _AXES)):
            own = [index.get(f"{called}_{part}" if part else called) for part in _PARTS[kind]]
            if None not in own:
                matched.append((kind, own, list(range(at, at + len(own)))))
                break
    known = {i for _, own, _ in matched for i in own}
    if missing := [name for name in robot.joint_names if index[name] not in known]:
        raise errors.fail("model", "have the robot's joints", f"has no {', '.join(missing)}")
    return matched


def _each(kind, fn, values, rates):
    """Return fn(coordinates, velocities), each (6,), for each of a base's (..., k); other joints' as they are."""
    if kind not in _AXES:
        return values, rates
    rows = np.zeros((2, *values.shape[:-1], 6))
    rows[..., _AXES[kind]] = values, rates
    for i in np.ndindex(values.shape[:-1]):
        rows[(slice(2), *i)] = fn(*rows[(slice(2), *i)])
    return rows[..., _AXES[kind]]
