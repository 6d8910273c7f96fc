"""Paths: the references that cnclik builds."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.cache import bounded_jit
from cnclik.law.curves import Circle, Hold, Line, Lissajous, Path, Rotation, Spline, cubic, hermite, timed
from cnclik.law.reference import A_REFERENCE, Reference, References, of_each, references
from cnclik.record import Array, ArrayLike, Float, Number, leaf, replace
from cnclik.robot import poses
from cnclik.robot.chain import Chain
from cnclik.robot.model import modelled
from cnclik.robot.rotations import log_so3
from cnclik.task.parts import At
from cnclik.task.task import Task

Target = poses.PoseLike | None  # see `hold`


def hold(
    target: Target = None, rotation: ArrayLike | None = None, *, values: Float[ArrayLike, " k"] | None = None
) -> Reference:
    """Stay at one target: x_d(t) = target, velocity 0 (Case I of Drexler 2016).

    Args:
      target: (d,) position [m], d ≤ 3; or a whole pose: a `Pose`, a (4, 4) homogeneous matrix, [x, y, z, w, x, y, z],
        or an object with `translation` and `rotation` such as Pinocchio's SE3; or None for an orientation alone.
      rotation: (3, 3) rotation, or a (4,) unit quaternion w, x, y, z.
      values: (k,) in place of them, of a task of joints or a function.
    """
    if values is not None:
        if target is not None or rotation is not None:
            raise errors.fail("values", "be left out where a `target` or `rotation` is given", "is given")
        return Reference(curve=Hold(position=errors.array("values", values, (None,)), rotation=None))
    target, rotation = _split("target", target, rotation)
    if target is None and rotation is None:
        raise errors.fail("target", "be a position or come with a `rotation`", "is None")
    return Reference(curve=Hold(position=target, rotation=rotation))


def line(
    start: Target,
    end: Target,
    *,
    duration: Number,
    rotation: ArrayLike | None = None,
    rotation_end: ArrayLike | None = None,
) -> Reference:
    """Move along a straight line at constant velocity, then hold (Case II of Drexler 2016, eqs. 15 and 18).

    x_d(t) = start + (t/duration)(end − start) for t ≤ duration. With two rotations, the tip turns at
    constant angular velocity about a fixed axis on the shorter way.

    Args:
      start, end: (d,) positions [m], or whole poses as for `hold`.
      duration: [s], positive.
      rotation, rotation_end: (3, 3) rotations or (4,) unit quaternions at start and end.
    """
    start, rotation = _split("start", start, rotation)
    end, rotation_end = _split("end", end, rotation_end, "rotation_end")
    errors.number("duration", duration, positive=True)
    first, last = (() if v is None else v.shape for v in (start, end))
    if first != last:
        raise errors.fail("end", "have the shape of `start`", f"has shape {last}")
    turn = None
    if rotation_end is not None:
        if rotation is None:
            raise errors.fail("rotation", "be given with `rotation_end`", "is None")
        turn = _turn(rotation, rotation_end)
    return Reference(curve=Line(start=start, end=end, rotation=rotation, turn=turn, duration=leaf(duration)))


def circle(
    center: Float[ArrayLike, " d"],
    radius: Number,
    *,
    period: Number,
    normal: Float[ArrayLike, " 3"] | None = None,
    phase: Number = 0.0,
    rotation: ArrayLike | None = None,
) -> Reference:
    """Move along a circle at constant speed 2π·radius/period.

    Args:
      center: (2,) or (3,) [m].
      radius: [m].
      period: time of one turn [s]; negative for the other sense.
      normal: (3,) normal of the circle's plane for a 3-D centre, z by default.
      phase: angle on the circle at t = 0 [rad].
      rotation: constant orientation, (3, 3) or (4,) quaternion.
    """
    center = errors.array("center", center, (2,), (3,))
    radius = 1.0 * errors.number("radius", radius, at_least=0)
    phase = 1.0 * errors.number("phase", phase)
    period = _period(period)
    if center.shape[0] == 2:
        if normal is not None:
            raise errors.fail("normal", "be left out for a circle in a plane", f"is {normal!r}")
        u, v = np.eye(2)
    else:
        w = np.asarray(errors.array("normal", (0.0, 0.0, 1.0) if normal is None else normal, (3,)), float)
        if not np.linalg.norm(w) > 0:
            raise errors.fail("normal", "not be the zero vector", f"is {w.tolist()}")
        w = w / np.linalg.norm(w)
        u = np.cross(np.eye(3)[1] if abs(w[1]) < 0.9 else np.eye(3)[2], w)
        u = u / np.linalg.norm(u)
        v = np.cross(w, u)
    xp = np if errors.concrete(phase) else jnp  # NumPy compiles nothing
    c, s = xp.cos(phase), xp.sin(phase)
    curve = Circle(
        center=center,
        first=radius * (c * u + s * v),
        second=radius * (c * v - s * u),
        rotation=rotation_matrix("rotation", rotation),
        period=period,
    )
    return Reference(curve=curve)


def lissajous(
    center: Float[ArrayLike, " d"],
    amplitude: Float[ArrayLike, " d"],
    *,
    period: Number,
    frequency: Float[ArrayLike, " d"] | None = None,
    phase: Float[ArrayLike, " d"] | None = None,
    rotation: ArrayLike | None = None,
) -> Reference:
    """Move along a Lissajous figure, x_d(t) = center + amplitude · sin(2π frequency t/period + phase), per axis.

    Args:
      center, amplitude: (d,) [m].
      period: [s] of frequency 1.
      frequency: (d,) whole numbers close the curve; 1, 2, 3 … by default.
      phase: (d,) [rad], 0 by default.
      rotation: constant orientation.
    """
    center = errors.array("center", center, (None,))
    d = center.shape[0]
    amplitude = errors.array("amplitude", amplitude, (d,))
    frequency = errors.array("frequency", np.arange(1.0, d + 1) if frequency is None else frequency, (d,))
    phase = errors.array("phase", np.zeros(d) if phase is None else phase, (d,))
    curve = Lissajous(
        center=center,
        amplitude=amplitude,
        frequency=frequency,
        phase=phase,
        rotation=rotation_matrix("rotation", rotation),
        period=_period(period),
    )
    return Reference(curve=curve)


def waypoints(
    times: Float[ArrayLike, " K"],
    positions: Float[ArrayLike, "K d"] | None = None,
    rotations: Float[ArrayLike, "K ..."] | None = None,
    *,
    closed: bool = False,
) -> Reference:
    """Move through waypoints on a C² path: velocity and acceleration are continuous.

    Positions follow the cubic spline through the points. Orientations follow the cubic spline of their
    quaternions (signs aligned), normalised: it passes through every waypoint and does not depend on the
    frame the rotations are given in. It starts and ends at rest; `closed` makes it periodic instead.

    Args:
      times: (K,) increasing [s].
      positions: (K, d) [m], or None.
      rotations: (K, 3, 3) rotations or (K, 4) unit quaternions w, x, y, z, or None; neighbours less than
        180° apart.
      closed: the last waypoint equals the first; the path passes through it smoothly and repeats.
    """
    closed = errors.truth("closed", closed)
    times, *points = timed(times, positions, rotations)
    named = zip(("positions", "rotations"), points, strict=True)
    pieces = [None if v is None else cubic(times, _known(v), closed, name) for name, v in named]
    return _spline(times, pieces, closed)


def resampled(
    times: Float[ArrayLike, " K"],
    positions: Float[ArrayLike, "K d"] | None = None,
    rotations: Float[ArrayLike, "K ..."] | None = None,
) -> Reference:
    """Follow a stream of targets, such as a policy's at 30 Hz, in a loop at 1 kHz that knows only past targets.

    The path is straight from target to target, averaged over about a period: its velocity is continuous, and it cuts
    corners and smooths jitter. It comes 1.5 times the longest period late, so that no target is used before it arrives,
    and holds the last one. Quaternions are interpolated, then normalised.

    Args:
      times: (K,) arrival times of the targets [s], increasing.
      positions, rotations: as for `waypoints`.
    Returns: `Reference` whose future a step does not use, as with `causal`.
    """
    times, *points = timed(times, positions, rotations)
    gap = np.max(np.diff(times))
    times = np.concatenate([times[:1] - gap, times, times[-1:] + gap])
    knots, h = (times[1:] + times[:-1]) / 2, np.diff(times)[:, None]

    def smooth(points):
        xp = poses.library(points)  # NumPy compiles nothing
        points = xp.concatenate([points[:1], points, points[-1:]])
        middle, velocity = (points[1:] + points[:-1]) / 2, xp.diff(points, axis=0) / h
        return jnp.asarray(hermite(np.diff(knots), middle, velocity))

    pieces = [None if v is None else smooth(_known(v)) for v in points]
    return replace(_spline(knots + 1.5 * gap, pieces), known=False)


def _spline(times, pieces, closed=False):
    position, quaternion = pieces
    curve = Spline(times=jnp.asarray(times), position=position, quaternion=quaternion, rotation=None, closed=closed)
    return Reference(curve=curve)


def _known(values):
    """Return a known value in NumPy, which compiles nothing."""
    return np.asarray(values) if errors.concrete(values) else values


def path(fn: Callable) -> Reference:
    """Follow any differentiable function t -> position (array or tuple of length d), or t -> `Pose`.

    The function is compiled into the programs that use it, as under `jax.jit`: values that it closes over are read
    then.
    """
    if not callable(fn):
        raise errors.fail("fn", "be a function of time", f"is {fn!r}")
    return Reference(curve=Path(fn=fn))


def causal(reference: Reference) -> Reference:
    """Return the same path for a controller that does not know the future, such as a hand in front of a camera.

    A step then uses x_d and ẋ_d at its start only, and assumes that the target continues with that velocity.
    """
    errors.kind("reference", reference, Reference, A_REFERENCE)
    return replace(reference, known=False)


def hold_at(
    chain: Chain, task: Task, q: Float[ArrayLike, " n"], **others: Reference | References
) -> Reference | References:
    """Hold the pose at q (n,): a constant reference for each target of a task; other references are given by name.

    `hold_at(robot, task, q0, hands=circle(...))` moves the hands only.

    Returns: `Reference`, or `References` for a task with several targets.
    """
    q, task = errors.array("q", q, (chain.n,), of="joint values"), task.on(chain)
    if all(map(errors.concrete, jax.tree.leaves((chain, q)))):
        q = np.asarray(q, float)  # NumPy compiles nothing
    robot = At(modelled(chain), q)

    def held_for(_, parts):
        target: dict = {"position": None, "rotation": None}
        for part in parts.parts:
            target["rotation" if part.turns else "position"] = part.here(robot)
        return Reference(curve=Hold(**target))

    held = of_each(held_for, None, task)
    if not others:
        return held
    if isinstance(held, Reference):
        if not task.tasks:
            raise errors.fail("others", "be left out for one task that is no stack", f"are {', '.join(others)}")
        held = references(**{task.tasks[0][0]: held})
    for name in others:
        errors.one_of("others", name, held.names)
    return references(**(dict(zip(held.names, held.each, strict=True)) | others))


# --- reading arguments --------------------------------------------------------------------------------


def _period(period):
    """Return a period, which is not 0, as a field of a record."""
    if errors.concrete(errors.number("period", period)) and float(period) == 0:
        raise errors.fail("period", "not be 0", "is 0")
    return leaf(period)


def _split(name, target, rotation, called="rotation") -> tuple[Float[Array, " d"] | None, Rotation]:
    """Return a target's position and rotation, from a whole pose or given separately; both checked."""
    if (whole := poses.whole(name, target)) is not None:
        if rotation is not None:
            raise errors.fail(called, f"be left out where `{name}` is a whole pose", "is given")
        if whole[0].ndim != 1:
            raise errors.fail(name, "be one pose", f"holds {len(whole[0])}")
        return whole
    if target is not None:
        target = errors.array(name, target, (None,))
        if not 1 <= target.shape[0] <= 3:
            joints = " (joint values are given by hold(values=...))" * (name == "target")
            raise errors.fail(name, f"have 1 to 3 coordinates{joints}", f"has {target.shape[0]}")
    return target, rotation_matrix(called, rotation)


def rotation_matrix(name, value):
    """Return a (3, 3) rotation from a rotation or a (4,) unit quaternion."""
    if value is None:
        return None
    return poses.rotations(name, errors.array(name, value, (3, 3), (4,)))


@bounded_jit  # jitted as a whole, as each of its many small operations would be compiled on first use
def _turn(first, last):
    """Return the rotation vector, in the base frame, from one rotation to another."""
    return log_so3(last @ first.T)
