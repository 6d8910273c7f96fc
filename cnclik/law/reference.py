"""References: the desired path x_d(t) and, from it, its exact velocity.

A curve is a function of time that returns a target: a position (d,), a rotation (3, 3), or both. Its velocity comes
from `jax.jvp`, so path and feed-forward can't disagree, unless an explicit feed-forward overrides it.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.cache import bounded_jit
from cnclik.engine.constants import of_the_model
from cnclik.engine.tracing import is_read
from cnclik.law.curves import Circle, Hold, Line, Lissajous, Path, Rotation, Spline, Tangent, cubic, quaternions_of
from cnclik.law.task import Task
from cnclik.record import brief, leaf, record, replace
from cnclik.robot import poses
from cnclik.robot.rotations import log_so3, safe_norm, safe_sqrt
from cnclik.shapes import Array, ArrayLike, Float, Number

Target = poses.PoseLike | None  # see `hold`

A_REFERENCE = "be a Reference such as hold(...)"


@record
class Reference:
    """A desired path. Build one with hold, line, circle, lissajous, waypoints, or from any `path`."""

    curve: Callable  # t -> (position (d,) or None, rotation (3, 3) or None)
    feedforward: Float[Array, " m"] | None = None  # held constant; None: the curve's own velocity
    known: bool = True  # whether a step may look at the target ahead of its start, see `causal`

    def __repr__(self):
        told = "" if self.feedforward is None else f", told velocity {brief(self.feedforward)}"
        return f"Reference: {brief(self.curve)}{told}{'' if self.known else ', future unknown'}"


# --- sampling -----------------------------------------------------------------------------------------


def sample(reference: Reference, task: Task, t):
    """Target and task velocity at time t in the task's coordinates: (position, rotation, xdot_d).

    xdot_d holds linear velocities [m/s], then components of the angular velocity vee(Ṙ Rᵀ) [rad/s].
    """
    position, rotation, velocity, drotation = _moving(reference, task, t)
    if reference.feedforward is not None:
        return position, rotation, reference.feedforward
    if task.orientation:
        velocity = jnp.concatenate([velocity, _spin(rotation, drotation)[np.array(task.angular)]])
    return position, rotation, velocity


def _moving(reference, task, t):
    """Position, in the task's coordinates, rotation, and their derivatives."""
    t = jnp.asarray(t)

    def curve(t):
        position, rotation = reference.curve(t)
        return controlled(task, position, t.dtype), rotation

    target, motion = jax.jvp(curve, (t,), (jnp.ones_like(t),))
    if isinstance(reference.curve, Hold):
        motion = of_the_model(motion)  # zeros, and zero times anything is zero
    return *target, *motion


def _spin(rotation, drotation):
    """Angular velocity vee(Ṙ Rᵀ) in the base frame."""
    turning = drotation @ rotation.T
    return jnp.stack([turning[2, 1], turning[0, 2], turning[1, 0]])


def tangent(reference: Reference, task: Task, t) -> Reference:
    """The reference as it is known at time t and no later: from there on at the velocity it has, or is said to have."""
    position, rotation, velocity, drotation = _moving(reference, task, t)
    told, spin = reference.feedforward, None
    if told is not None:
        velocity = told[: len(position)]
        if task.orientation:
            spin = jnp.zeros(3, told.dtype).at[np.array(task.angular)].set(told[len(position) :])
    elif task.orientation:
        spin = _spin(rotation, drotation)
    curve = Tangent(t=t, position=position, velocity=velocity, rotation=rotation, spin=spin)
    return replace(reference, curve=curve)


def controlled(task, position, dtype=None):
    """The coordinates of a position that the task controls: given as such, or as x, y, z; none, of a dtype."""
    if not task.position:
        return jnp.zeros(0, dtype)
    return position if len(position) == len(task.position) else position[np.array(task.linear)]


def motion(reference: Reference, task: Task, t):
    """How far the target moves, or is said to move, from each instant of t (N + 1,) to the next, from above: (N,).

    Rotations count by their chord ‖R₂ − R₁‖ (Frobenius), whose angle is at most π/√8 times it.
    """

    def coordinates(t):
        position, rotation = reference.curve(t)
        turned = 1.111 * rotation.ravel() if task.orientation else jnp.zeros(0, t.dtype)
        return jnp.concatenate([controlled(task, position, t.dtype), turned]).astype(t.dtype)

    # A user's own function may do what can't be done to many instants at once; the engine keeps a loop as one.
    in_turn = is_read() or isinstance(reference.curve, Path)
    found = jax.lax.map(coordinates, t) if in_turn else jax.vmap(coordinates)(t)
    moved = safe_sqrt(jnp.sum((found[1:] - found[:-1]) ** 2, axis=1))
    if reference.feedforward is None:
        return moved
    return moved + (t[1:] - t[:-1]) * safe_norm(reference.feedforward)


def check(reference: Reference, task: Task) -> None:
    """Raise ArgumentError where the reference's target does not fit the task."""
    position, rotation = jax.eval_shape(reference.curve, 0.0)
    if task.position:
        m = len(task.position)
        if position is None or len(position) not in (m, 3):
            size = "no position" if position is None else f"{len(position)} coordinates"
            wanted = f"{m} coordinates ({task.position!r})" + (" or 3" if m != 3 else "")
            raise errors.fail("reference", f"give positions of {wanted}", f"gives {size}")
    if task.orientation and rotation is None:
        raise errors.fail("reference", "give a rotation for this task", "gives a position only")
    if reference.feedforward is not None:
        errors.array("feedforward", reference.feedforward, (task.m,))


def with_feedforward(reference: Reference, velocity: Float[ArrayLike, " m"]) -> Reference:
    """The same path with an explicit task velocity (m,) in place of its own, constant in time.

    For what a controller is told rather than what the path does: zeros for pure feedback, or a misprint.
    """
    errors.kind("reference", reference, Reference, A_REFERENCE)
    velocity = errors.array("velocity", velocity, (None,))
    return replace(reference, feedforward=velocity)


def causal(reference: Reference) -> Reference:
    """The same path for a controller that doesn't know its future, such as a person's hand before a camera.

    A step then sees x_d and ẋ_d at its start alone, and takes the target to move on with that velocity.
    """
    errors.kind("reference", reference, Reference, A_REFERENCE)
    return replace(reference, known=False)


# --- builders -----------------------------------------------------------------------------------------


def hold(target: Target, rotation: ArrayLike | None = None) -> Reference:
    """Stay at one target: x_d(t) = target, velocity 0 (Case I of Drexler 2016).

    Args:
      target: (d,) position [m], d ≤ 3; or a whole pose: a `Pose`, a (4, 4) homogeneous matrix, [x, y, z, w, x, y, z],
        or an object with `translation` and `rotation` such as Pinocchio's SE3; or None for an orientation alone.
      rotation: (3, 3) rotation, or a (4,) unit quaternion w, x, y, z.
    """
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
    """Straight line at constant velocity, then hold (Case II of Drexler 2016, eqs. 15 and 18).

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
    duration = leaf(duration)
    curve = Line(start=start, end=end, rotation=rotation, turn=turn, duration=duration)
    return Reference(curve=curve)


def circle(
    center: Float[ArrayLike, " d"],
    radius: Number,
    *,
    period: Number,
    normal: Float[ArrayLike, " 3"] | None = None,
    phase: Number = 0.0,
    rotation: ArrayLike | None = None,
) -> Reference:
    """Circle at constant speed 2π·radius/period.

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
    _nonzero("period", period)
    if center.shape[0] == 2:
        if normal is not None:
            raise errors.fail("normal", "be None for a 2-D centre", f"is {normal!r}")
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
        period=leaf(period),
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
    """Lissajous figure x_d(t) = center + amplitude · sin(2π frequency t/period + phase), per axis.

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
    _nonzero("period", period)
    curve = Lissajous(
        center=center,
        amplitude=amplitude,
        frequency=frequency,
        phase=phase,
        rotation=rotation_matrix("rotation", rotation),
        period=leaf(period),
    )
    return Reference(curve=curve)


def waypoints(
    times: Float[ArrayLike, " K"],
    positions: Float[ArrayLike, "K d"] | None = None,
    rotations: Float[ArrayLike, "K ..."] | None = None,
    *,
    closed: bool = False,
) -> Reference:
    """C² path through waypoints: velocity and acceleration are continuous.

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
    times, closed = errors.array("times", times, (None,)), errors.truth("closed", closed)
    count = times.shape[0]
    if count < 2:
        raise errors.fail("times", "hold at least two times", f"holds {count}")
    if errors.concrete(times) and not np.all(np.asarray(times)[1:] > np.asarray(times)[:-1]):
        raise errors.fail("times", "increase", f"is {np.asarray(times).tolist()}")
    if positions is None and rotations is None:
        raise errors.fail("positions", "be given, or `rotations`", "is None")
    position = quaternion = None
    if positions is not None:
        positions = errors.array("positions", positions, (count, None))
        position = cubic(times, positions, closed, "positions")
    if rotations is not None:
        quaternion = cubic(times, quaternions_of("rotations", rotations, count), closed, "rotations")
    times = jnp.asarray(times)
    curve = Spline(times=times, position=position, quaternion=quaternion, rotation=None, closed=closed)
    return Reference(curve=curve)


def path(fn: Callable) -> Reference:
    """Any differentiable function t -> position (array or tuple of d), or t -> `Pose`, as a reference.

    It is a part of the programs that run it, as under `jax.jit`: what it closes over is read when they are made.
    """
    if not callable(fn):
        raise errors.fail("fn", "be a function of time", f"is {fn!r}")
    return Reference(curve=Path(fn=fn))


# --- reading arguments --------------------------------------------------------------------------------


def _nonzero(name, value):
    errors.number(name, value)
    if errors.concrete(value) and float(value) == 0:
        raise errors.fail(name, "not be 0", "is 0")


def _split(name, target, rotation, called="rotation") -> tuple[Float[Array, " d"] | None, Rotation]:
    """A target's position and rotation: those of a whole pose, or what is given as they are; both checked."""
    found = poses.whole(name, target)
    if found is None:
        return _position(name, target), rotation_matrix(called, rotation)
    if rotation is not None:
        raise errors.fail(called, f"be left out where `{name}` is a whole pose", "is given")
    if found[0].ndim != 1:
        raise errors.fail(name, "be one pose", f"holds {len(found[0])}")
    return found


def _position(name, value):
    if value is None:
        return None
    value = errors.array(name, value, (None,))
    if not 1 <= value.shape[0] <= 3:
        raise errors.fail(name, "have 1 to 3 coordinates", f"has {value.shape[0]}")
    return value


def rotation_matrix(name, value):
    """A (3, 3) rotation from a rotation or a (4,) unit quaternion."""
    if value is None:
        return None
    return poses.rotations(name, errors.array(name, value, (3, 3), (4,)))


@bounded_jit  # as a whole: one by one, its many small operations would each be compiled on first use
def _turn(first, last):
    """Rotation vector, in the base frame, from one rotation to another."""
    return log_so3(last @ first.T)
