"""MJCF: the kinematic tree of a MuJoCo model. MuJoCo is loaded with the first model."""

from __future__ import annotations

import dataclasses
import importlib
import math
import os
import pathlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from cnclik import errors
from cnclik.reading import read_bytes
from cnclik.robot.chain import Chain
from cnclik.robot.fixed import ZERO, Offset, compose, scale, snapped, vsub
from cnclik.robot.rotations import rotation_from_quaternion
from cnclik.robot.tree import MOST, MOVING, Edge, Tree, text_of
from cnclik.robot.urdf import chain, moved

_TYPES = ("floating", "ball", "prismatic", "revolute")  # by mjtJoint


def load_mjcf(
    model: str | os.PathLike | Any,
    tip: str | None = None,
    base: str | None = None,
    *,
    tips: Sequence[str] | dict | None = None,
    freeze: dict[str, float] | None = None,
) -> Chain:
    """Load a robot from an MJCF model, as MuJoCo reads it: the chain from base to tip, or the tree to several tips.

    Bodies and sites are the links. Joint values are MuJoCo's `qpos`; MJCF has no velocity limits. A joint that an
    active equality constraint couples linearly to another one is a mimic joint of it. A free joint is a free base, see
    `load_urdf`; with the body behind it as the base the robot stands. A ball joint is its rotation vector, and its
    velocity the angular velocity in the body's own axes. Masses are those of bodies that hang on joints.

    Args:
      model: the file, its text, which begins with "<", a `mujoco.MjSpec` or a `mujoco.MjModel`.
      tip: name of a body or a site; default: the only leaf that the joints move.
      base: name of the first body; default: the world; or how that moves, "planar" or "free", as for `load_urdf`.
      tips, freeze: as for `load_urdf`.
    Raises: ArgumentError as `load_urdf`, and where MuJoCo is not installed or cannot read the model.
    """
    return chain(read_mjcf(model), tip, base, tips=tips, freeze=freeze)


def read_mjcf(model) -> Tree:
    """Return the whole kinematic tree of a model. Args and raises: as `load_mjcf`."""
    file, compiled = _compiled(model)
    bodies = [compiled.body(i).name or f"body{i}" for i in range(compiled.nbody)]
    joints = [compiled.joint(i).name or f"joint{i}" for i in range(compiled.njnt)]
    coupled, edges = _couplings(file, compiled, joints), []
    for i, body in enumerate(bodies[1:], 1):
        edges += _joints_of(compiled, i, bodies[compiled.body_parentid[i]], body, joints, coupled)
    known = {"world", *bodies, *(edge.child for edge in edges)}
    for i in range(compiled.nsite):
        name = compiled.site(i).name or f"site{i}"
        name = f"{name} (site)" if name in known else name
        parent = bodies[compiled.site_bodyid[i]]
        edges.append(_edge(name, "fixed", parent, name, _offset(compiled.site_pos[i], compiled.site_quat[i])))
    return Tree(
        file=file,
        name=bytes(compiled.names).partition(b"\0")[0].decode(errors="replace") or file,
        root=bodies[0],
        links=(bodies[0], *(edge.child for edge in edges)),
        edges=tuple(edges),
        inertials=_inertials(compiled, bodies),
    )


def _compiled(model) -> tuple:
    """Return (name, MjModel)."""
    try:
        mujoco: Any = importlib.import_module("mujoco")
    except ImportError:
        need = "A model in MJCF needs the package mujoco, which is not installed: pip install 'cnclik[mjcf]'"
        raise errors.ArgumentError(need) from None
    if isinstance(model, mujoco.MjModel):
        return "the model", model
    text = text_of(model)
    if text is None and not isinstance(model, mujoco.MjSpec):
        read_bytes("model", model, "an MJCF file")  # reports an unreadable file in our words
    try:
        if isinstance(model, mujoco.MjSpec):
            return "the spec", model.copy().compile()
        if text is not None:
            return "the text", mujoco.MjModel.from_xml_string(text)
        return pathlib.Path(model).name, mujoco.MjModel.from_xml_path(os.fspath(model))
    except (ValueError, mujoco.FatalError) as error:
        raise errors.fail("model", "be one that MuJoCo reads", f"it finds: {error}") from None


def _offset(position, quaternion) -> Offset:
    rows = rotation_from_quaternion(map(float, quaternion))
    return Offset(position=snapped(map(float, position)), rotation=tuple(map(snapped, rows)))


def _edge(name, kind, parent, child, origin: Offset, *rest) -> Edge:
    return Edge(name, kind, parent, child, (origin.position, origin.rotation), *rest)


def _joints_of(model, i, parent, body, joints, coupled) -> list:
    """Return the joints from a body's parent to it: one for each of its own, about its place in the body's frame.

    A joint's value is MuJoCo's qpos, which moves the body by the difference to its reference, qpos0.
    """
    edges, at, before = [], _offset(model.body_pos[i], model.body_quat[i]), ZERO
    first = model.body_jntadr[i]
    for k in range(first, first + model.body_jntnum[i]):
        kind = _TYPES[model.jnt_type[k]]
        place, axis = (snapped(map(float, v[k])) for v in (model.jnt_pos, model.jnt_axis))
        origin = compose(at, Offset(position=vsub(place, before)))
        (leader, *mimic), bounds = coupled.get(joints[k], ("",)), (-math.inf, math.inf)
        origin = Offset() if kind == "floating" else origin  # its values are the body's place in the world
        if kind in MOVING:
            rest = (mimic[1] if leader is None else 0.0) - float(model.qpos0[model.jnt_qposadr[k]])
            origin = compose(origin, moved(kind, axis, rest))
            bounds = tuple(map(float, model.jnt_range[k])) if model.jnt_limited[k] else bounds
        child, kind = f"{joints[k]} of {body}", "fixed" if leader is None else kind
        mimic = (leader, *mimic) if leader else None
        edges.append(_edge(joints[k], kind, parent, child, origin, axis, *bounds, math.inf, mimic))
        parent, before, at = child, place, Offset()
    if edges and not any(before):
        return [*edges[:-1], dataclasses.replace(edges[-1], child=body)]
    return [*edges, _edge(body, "fixed", parent, body, compose(at, Offset(position=scale(-1.0, before))))]


def _couplings(file, model, joints) -> dict:
    """Return {joint: (the joint that it follows, multiplier, offset)}; None instead of a joint for a constant value."""
    follows, left = {}, False
    for k in np.flatnonzero(model.eq_active0):
        one, other = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        shift, factor, *higher = map(float, model.eq_data[k][:5])
        if model.eq_type[k] != 2 or (other >= 0 and any(higher)):  # mjEQ_JOINT
            left = True
            continue
        rest, its = (float(model.qpos0[model.jnt_qposadr[j]]) if j >= 0 else 0.0 for j in (one, other))
        leader, factor = (joints[other], factor) if other >= 0 else (None, 0.0)
        follows[joints[one]] = leader, factor, rest + shift - factor * its
    if left:
        errors.remark(f"{file} has constraints beside linear couplings of joints: they are left out.")
    return follows


def _inertials(model, bodies) -> dict:
    """Return the masses of the bodies below a joint."""
    jointed = set(model.body_rootid[model.jnt_bodyid].tolist())
    return {
        name: (float(model.body_mass[i]), tuple(map(float, model.body_ipos[i])))
        for i, name in enumerate(bodies)
        if model.body_rootid[i] in jointed and 0 < model.body_mass[i] <= MOST
    }
