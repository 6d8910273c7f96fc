"""Peers: the tasks of a pink or mink script as a law here, and gains from here as theirs.

Both minimise ½ Σ |W (J Δq + g e)|² + ½ μ |Δq|² in each step of dt, W the costs, g a gain per step, μ damping: explicit
Euler with weights W, alpha = g/dt and λ² = μ. Their limits are rates per step too.
"""

from __future__ import annotations

import functools
import operator
import re
from collections.abc import Callable

import numpy as np

from cnclik import errors
from cnclik.law.bounded import bounded
from cnclik.law.inverse import Levels, damped
from cnclik.law.law import Law
from cnclik.task.build import center_of_mass, joints, orientation, position, stack
from cnclik.task.task import Task

LEAST = 1e-6  # λ, where they have none
_PLANAR = ("base_x", "base_y", "base_yaw")  # of a base that `load_urdf` adds


def from_pink(robot, tasks, dt: float, *, limits=(), damping: float = 0.0) -> Law:
    """The law of a pink or mink script, of their own task objects: a stack, one task for each.

    Frames are controlled along their own axes; alpha = gain/dt, weights are costs, λ² = damping + Σ cost² of damping
    tasks. A damping task that leaves out a base, or whose costs differ, is a task of joints with a gain of 0.
    `lm_damping` depends on the error, is 0 at rest, and left out. Of limits, a `ConfigurationLimit` becomes
    bounded(rate = gain/dt); velocity limits are the robot's own. Others are left out, with a remark.

    Args:
      robot: with the frames of the tasks as tips, load_urdf(file, tips=[...]).
      tasks: FrameTask, RelativeFrameTask, ComTask, PostureTask, DampingTask. The last two are of all joints of this
        robot, without a base that moves. Under a fixed base the first link counts in the centre of mass, not in theirs.
      dt: of their solve_ik [s]. limits: those given to it. damping: the one given to it.
    Raises: ArgumentError for other tasks, and for what the robot has not.
    """
    dt = float(errors.number("dt", dt, positive=True))
    made: dict[str, Task] = {}
    alpha, shift = {}, float(errors.number("damping", damping, at_least=0))
    for one in tasks:
        kind = type(one).__name__
        if kind not in _KINDS:
            raise errors.fail("tasks", f"be {', '.join(_KINDS)}", f"hold a {kind}")
        name, task = _KINDS[kind](one, robot)
        cost = task.weight_of_each
        if kind == "DampingTask" and len(cost) == robot.n and np.ptp(cost) == 0:
            shift += float(cost[0]) ** 2
            continue
        name = re.sub(r"\W", "_", name)
        name = next(n for n in (name, *(f"{name}_{i}" for i in range(2, 2 + len(made)))) if n not in made)
        made[name], alpha[name] = task, 0.0 if kind == "DampingTask" else float(one.gain) / dt
    kinds = {type(one).__name__ for one in limits} - {"ConfigurationLimit", "VelocityLimit"}
    for kind in sorted(kinds):
        walls = "; collisions are walls here, bounded(walls=[wall(distance(...), above=..., rate=gain/dt)])"
        errors.remark(f"{kind} is left out{walls * ('Collision' in kind)}.")
    of_joints = [one for one in limits if type(one).__name__ == "ConfigurationLimit"]
    rates = [float(getattr(one, "config_limit_gain", None) or one.gain) / dt for one in of_joints]
    inverse = damped(max(np.sqrt(shift), LEAST))
    return Law(robot, stack(**made), alpha=alpha, inverse=inverse, limits=bounded(max(rates)) if rates else None)


def to_pink(law: Law, dt: float) -> dict:
    """{task: {"gain", "cost"}} of a law's tasks as pink and mink take them: gain = alpha·dt, one for a task.

    A level is a cost, too: a weight times the least λ over that of its level, where their damping is the least λ².
    """
    dt, found = float(errors.number("dt", dt, positive=True)), {}
    alpha = np.asarray(law.alpha, float)
    cost = np.asarray(law.task.weight_of_each, float)
    if isinstance(law.inverse, Levels):
        damping = np.array([float(one.damping) for one in law.inverse.damping])
        cost = cost * damping.min() / damping[list(law.inverse.level)]
    for name, at in law.task.each:
        own = np.broadcast_to(alpha, (law.task.m,))[at] if alpha.ndim < 2 else np.linalg.eigvalsh(alpha[at, at])
        if np.ptp(own) > 1e-9 * own.max():
            raise errors.fail("law", f"have one gain for {name}, as theirs do", f"has {own.tolist()}")
        found[name] = {"gain": float(own[0]) * dt, "cost": cost[at].tolist()}
    return found


def _frame(one, robot, **about):
    name = getattr(one, "frame", None) or one.frame_name
    parts = []
    for kind, cost in ((position, one.cost[:3]), (orientation, one.cost[3:])):
        axes = "".join(axis for axis, c in zip("xyz", cost, strict=True) if c > 0)
        if axes:
            parts.append(kind(axes, tip=name, weights=cost[cost > 0], **about))
    if not parts:
        raise errors.fail("tasks", f"have a cost for {name}", "have none")
    return name, functools.reduce(operator.and_, parts)


def _relative(one, robot):
    return _frame(one, robot, relative_to=getattr(one, "root", None) or one.root_name)


def _com(one, robot):
    cost = np.broadcast_to(np.asarray(one.cost, float), (3,))
    axes = "".join(axis for axis, c in zip("xyz", cost, strict=True) if c > 0)
    return "com", center_of_mass(axes, weights=cost[cost > 0])


def _posture(one, robot, name="posture"):
    """Of the joints with a cost, without a base that moves, as theirs."""
    cost = np.ravel(np.asarray(one.cost, float))
    if np.ptp(cost) > 0 and len(cost) != robot.n:
        must = f"have one cost of {name}, or {robot.n} for the joints of this robot"
        raise errors.fail("tasks", must, f"has {cost}")
    every = np.broadcast_to(cost[0] if np.ptp(cost) == 0 else cost, (robot.n,))
    costs = dict(zip(robot.joint_names, every, strict=True))
    own = [joint for joint in joints().on(robot).names if joint not in _PLANAR and costs[joint] > 0]
    return name, joints(own, weights=np.array([costs[joint] for joint in own]))


_KINDS: dict[str, Callable] = {
    "FrameTask": _frame,
    "RelativeFrameTask": _relative,
    "ComTask": _com,
    "PostureTask": _posture,
    "DampingTask": functools.partial(_posture, name="damping"),
}
