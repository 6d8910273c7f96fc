"""References: the desired path x_d(t) and, from it, its exact velocity.

A curve is a function of time that returns a target: a position (tuple of scalars), a rotation (rows), or
both. Its velocity comes from `jax.jvp`, so path and feed-forward can't disagree, unless an explicit
feed-forward overrides it.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.law.task import Task
from cnclik.record import record
from cnclik.robot import spatial as sp
from cnclik.robot.kinematics import Pose


@record
class Reference:
    """A desired path. Build one with hold, line, circle, lissajous, waypoints, or from any `path`."""

    curve: object  # t -> (position tuple or None, rotation rows or None)
    feedforward: object = None  # None: the curve's own velocity; else (m,), held constant
    period: object = None  # [s] after which the path repeats or ends, None if it has no end


# --- sampling -----------------------------------------------------------------------------------------


def sample(reference: Reference, task: Task, t):
    """Target and task velocity at time t: (position, rotation, xdot_d), in the task's coordinates.

    xdot_d holds linear velocities [m/s], then components of the angular velocity vee(Ṙ Rᵀ) [rad/s].
    """
    t = jnp.asarray(t)
    (position, rotation), (dposition, drotation) = jax.jvp(reference.curve, (t,), (jnp.ones_like(t),))
    position = _pick(task, position)
    if reference.feedforward is not None:
        return position, rotation, tuple(reference.feedforward[i] for i in range(task.m))
    xdot_d = _pick(task, dposition)
    if task.orientation:
        spin = sp.matmul(drotation, sp.transpose(rotation))
        omega = (spin[2][1], spin[0][2], spin[1][0])
        xdot_d += tuple(omega[i] for i in task.angular)
    return position, rotation, xdot_d


def _pick(task, position):
    """The task's components of a position: given as such, or as x, y, z."""
    if not task.position:
        return ()
    if len(position) == len(task.position):
        return tuple(position)
    return tuple(position[i] for i in task.linear)


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


def with_feedforward(reference: Reference, velocity) -> Reference:
    """The same path with an explicit task velocity (m,) in place of its own, constant in time.

    For what a controller is told rather than what the path does: zeros for pure feedback, or a misprint.
    """
    velocity = errors.array("velocity", velocity, (None,))
    return Reference(curve=reference.curve, feedforward=velocity, period=reference.period)


# --- curves -------------------------------------------------------------------------------------------


@record
class _Hold:
    position: object
    rotation: object

    def __call__(self, t):
        # Through `t`, so that target and velocity have the loop's dtype.
        return _vector(self.position), _rows(self.rotation)


@record
class _Line:
    start: object
    end: object
    rotation: object
    turn: object  # rotation vector from the first to the last orientation, in the base frame
    duration: object

    def __call__(self, t):
        s = _progress(t, self.duration)
        position = None
        if self.start is not None:
            position = tuple(a + s * (b - a) for a, b in zip(_vector(self.start), _vector(self.end), strict=True))
        rotation = _rows(self.rotation)
        if self.turn is not None:
            rotation = sp.matmul(sp.exp_so3(tuple(s * w for w in _vector(self.turn))), rotation)
        return position, rotation


@record
class _Lissajous:
    center: object
    amplitude: object
    frequency: object
    phase: object
    rotation: object
    period: object

    def __call__(self, t):
        omega = 2 * math.pi / self.period
        parts = zip(*(_vector(v) for v in (self.center, self.amplitude, self.frequency, self.phase)), strict=True)
        return tuple(c + a * jnp.sin(f * omega * t + p) for c, a, f, p in parts), _rows(self.rotation)


@record
class _Circle:
    center: object
    first: object  # radius vector at t = 0
    second: object  # and a quarter period later
    rotation: object
    period: object

    def __call__(self, t):
        angle = 2 * math.pi / self.period * t
        c, s = jnp.cos(angle), jnp.sin(angle)
        parts = zip(*(_vector(v) for v in (self.center, self.first, self.second)), strict=True)
        return tuple(o + c * u + s * v for o, u, v in parts), _rows(self.rotation)


@record
class _Spline:
    times: object  # (K,)
    position: object  # (4, K−1, d) coefficients of the powers of t − t_k, or None
    quaternion: object  # (4, K−1, 4) of unnormalised quaternions, or None
    rotation: object  # constant rotation, or None
    closed: bool

    def __call__(self, t):
        if self.closed:
            t = self.times[0] + jnp.mod(t - self.times[0], self.times[-1] - self.times[0])
        k = jnp.clip(jnp.searchsorted(self.times, t, side="right") - 1, 0, self.times.shape[0] - 2)
        inside = (t >= self.times[0]) & (t <= self.times[-1] * (1 + 1e-9))
        # Held at both ends; the jvp of a clip would halve the velocity exactly at an end.
        dt = jnp.where(inside, t, jnp.clip(jax.lax.stop_gradient(t), self.times[0], self.times[-1])) - self.times[k]

        def at(c):
            return tuple(
                c[0, k, i] + dt * (c[1, k, i] + dt * (c[2, k, i] + dt * c[3, k, i])) for i in range(c.shape[-1])
            )

        rotation = _rows(self.rotation)
        if self.quaternion is not None:
            q = at(self.quaternion)
            length = jnp.sqrt(sp.dot(q, q))
            rotation = sp.rotation_from_quaternion(tuple(x / length for x in q))
        return (None if self.position is None else at(self.position)), rotation


@record
class _Path:
    fn: object

    def __call__(self, t):
        target, dtype = self.fn(t), jnp.result_type(t)
        if isinstance(target, Pose):
            return _vector(jnp.asarray(target.position, dtype)), _rows(jnp.asarray(target.rotation, dtype))
        if isinstance(target, (tuple, list)):
            return tuple(jnp.asarray(v, dtype) for v in target), None
        return _vector(jnp.asarray(target, dtype)), None


def _vector(array):
    """An array (d,) as a tuple of scalars."""
    return None if array is None else tuple(array[i] for i in range(array.shape[0]))


def _rows(rotation):
    return None if rotation is None else tuple(_vector(rotation[i]) for i in range(3))


def _progress(t, duration):
    """t/duration up to 1, then held: still moving at t = duration itself, up to rounding of k·Ts."""
    return jnp.where(t > duration * (1 + 1e-6), 1.0, t / duration)


# --- builders -----------------------------------------------------------------------------------------


def hold(target, rotation=None) -> Reference:
    """Stay at one target: x_d(t) = target, velocity 0 (Case I of Drexler 2016).

    Args:
      target: (d,) position [m], or a `Pose`, or None for an orientation alone.
      rotation: (3, 3) rotation, or a (4,) unit quaternion w, x, y, z.
    """
    if isinstance(target, Pose):
        target, rotation = target.position, target.rotation
    if target is None and rotation is None:
        raise errors.fail("target", "be a position or come with a `rotation`", "is None")
    return Reference(curve=_Hold(position=_position("target", target), rotation=_rotation("rotation", rotation)))


def line(start, end, *, duration, rotation=None, rotation_end=None) -> Reference:
    """Straight line at constant velocity, then hold (Case II of Drexler 2016, eqs. 15 and 18).

    x_d(t) = start + (t/duration)(end − start) for t ≤ duration. With two rotations, the tip turns at
    constant angular velocity about a fixed axis on the shorter way.

    Args:
      start, end: (d,) positions [m] (or `Pose`s).
      duration: [s], positive.
      rotation, rotation_end: (3, 3) rotations or (4,) unit quaternions at start and end.
    """
    if isinstance(start, Pose) and isinstance(end, Pose):
        rotation, rotation_end = start.rotation, end.rotation
        start, end = start.position, end.position
    errors.number("duration", duration, positive=True)
    start, end = _position("start", start), _position("end", end)
    if (start is None) != (end is None) or (start is not None and start.shape != end.shape):
        raise errors.fail("end", "have the shape of `start`", f"has shape {np.shape(end)}")
    rotation, rotation_end = _rotation("rotation", rotation), _rotation("rotation_end", rotation_end)
    turn = None
    if rotation_end is not None:
        if rotation is None:
            raise errors.fail("rotation", "be given with `rotation_end`", "is None")
        turn = _turn(rotation, rotation_end)
    duration = _leaf(duration)
    curve = _Line(start=start, end=end, rotation=rotation, turn=turn, duration=duration)
    return Reference(curve=curve, period=duration)


def circle(center, radius, *, period, normal=None, phase=0.0, rotation=None) -> Reference:
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
    errors.number("radius", radius, at_least=0)
    errors.number("phase", phase)
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
    c, s = jnp.cos(phase), jnp.sin(phase)
    curve = _Circle(
        center=center,
        first=radius * (c * u + s * v),
        second=radius * (c * v - s * u),
        rotation=_rotation("rotation", rotation),
        period=_leaf(period),
    )
    return Reference(curve=curve, period=_leaf(period))


def lissajous(center, amplitude, *, period, frequency=None, phase=None, rotation=None) -> Reference:
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
    curve = _Lissajous(
        center=center,
        amplitude=amplitude,
        frequency=frequency,
        phase=phase,
        rotation=_rotation("rotation", rotation),
        period=_leaf(period),
    )
    return Reference(curve=curve, period=_leaf(period))


def waypoints(times, positions=None, rotations=None, *, closed=False) -> Reference:
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
    times = errors.array("times", times, (None,))
    count = times.shape[0]
    if count < 2:
        raise errors.fail("times", "hold at least two times", f"holds {count}")
    if errors.concrete(times) and not np.all(np.diff(np.asarray(times)) > 0):
        raise errors.fail("times", "increase", f"is {np.asarray(times).tolist()}")
    if positions is None and rotations is None:
        raise errors.fail("positions", "be given, or `rotations`", "is None")
    position = quaternion = None
    if positions is not None:
        positions = errors.array("positions", positions, (count, None))
        position = _cubic(times, positions, closed, "positions")
    if rotations is not None:
        rotations = errors.array("rotations", rotations, (count, 4), (count, 3, 3))
        quaternion = _cubic(times, _quaternions(rotations), closed, "rotations")
    times = jnp.asarray(times)
    curve = _Spline(times=times, position=position, quaternion=quaternion, rotation=None, closed=bool(closed))
    return Reference(curve=curve, period=times[-1])


def path(fn) -> Reference:
    """Any differentiable function t -> position (array or tuple of d), or t -> `Pose`, as a reference."""
    if not callable(fn):
        raise errors.fail("fn", "be a function of time", f"is {fn!r}")
    return Reference(curve=_Path(fn=fn))


def _cubic(times, values, closed, name):
    """Coefficients (4, K−1, d) of the interpolating C² cubic spline, at rest at both ends or periodic."""
    known = errors.concrete(times) and errors.concrete(values)
    xp = np if known else jnp  # NumPy compiles nothing
    times, values = xp.asarray(times), xp.asarray(values)
    h = xp.diff(times)
    slope = xp.diff(values, axis=0) / h[:, None]
    zero, one = xp.zeros(1), xp.ones(1)
    # Unknown: the velocities v at the knots. Rows: continuity of acceleration, and the two end conditions.
    a = (
        xp.diag(xp.concatenate([one, 2 * (h[:-1] + h[1:]), one]))
        + xp.diag(xp.concatenate([h[1:], zero]), -1)
        + xp.diag(xp.concatenate([zero, h[:-1]]), 1)
    )
    b = 3 * (h[1:, None] * slope[:-1] + h[:-1, None] * slope[1:])
    rest = xp.zeros_like(values[:1])
    last = rest
    if closed:
        # A full turn comes back with the quaternion's other sign, which is the same rotation.
        sign = xp.where(xp.sum(values[0] * values[-1]) < 0, -1.0, 1.0) if name == "rotations" else 1.0
        if known and np.abs(values[0] - sign * values[-1]).max() > 1e-6:
            raise errors.fail(name, "end where it starts for a closed path", "does not")
        inner = a[1:-1]
        eye = xp.eye(times.shape[0])
        same_velocity = eye[-1] - sign * eye[0]
        same_acceleration = sign * h[-1] * (2 * eye[0] + eye[1]) + h[0] * (eye[-2] + 2 * eye[-1])
        a = xp.concatenate([same_velocity[None], inner, same_acceleration[None]])
        last = 3 * (sign * h[-1] * slope[:1] + h[0] * slope[-1:])
    v = xp.linalg.solve(a, xp.concatenate([rest, b, last]))
    hh = h[:, None]
    second = (3 * slope - 2 * v[:-1] - v[1:]) / hh
    third = (v[:-1] + v[1:] - 2 * slope) / hh**2
    return jnp.asarray(xp.stack([values[:-1], v[:-1], second, third]))


# --- reading arguments --------------------------------------------------------------------------------


def _leaf(value):
    """A number as an array, so that another value needs no new compilation."""
    return np.asarray(value, float) if sp.is_number(value) else value


def _nonzero(name, value):
    errors.number(name, value)
    if errors.concrete(value) and float(value) == 0:
        raise errors.fail(name, "not be 0", "is 0")


def _position(name, value):
    if value is None:
        return None
    return errors.array(name, value, (None,))


def _rotation(name, value):
    """A (3, 3) rotation from a rotation or a (4,) unit quaternion."""
    if value is None:
        return None
    value = errors.array(name, value, (3, 3), (4,))
    if errors.concrete(value):
        known = np.asarray(value, float)
        if known.ndim == 1 and abs(np.linalg.norm(known) - 1) > 1e-3:
            raise errors.fail(name, "be a unit quaternion", f"has norm {np.linalg.norm(known):.6g}")
        if known.ndim == 2 and (np.abs(known @ known.T - np.eye(3)).max() > 1e-3 or np.linalg.det(known) < 0):
            raise errors.fail(name, "be a rotation matrix", "is not orthogonal with determinant 1")
    return _from_quaternion(value) if value.ndim == 1 else value


# Compiled as wholes: one by one, their many small operations would each be compiled on first use.


@jax.jit
def _from_quaternion(q):
    rows = sp.rotation_from_quaternion(_vector(q / jnp.linalg.norm(q)))
    return jnp.stack([jnp.stack(row) for row in rows])


@jax.jit
def _turn(first, last):
    """Rotation vector, in the base frame, from one rotation to another."""
    return jnp.stack(sp.log_so3(_rows(last @ first.T)))


@jax.jit
def _quaternions(rotations):
    """Unit quaternions (K, 4) of rotations, each with the sign nearer to the one before."""
    if rotations.shape[1:] == (4,):
        q = rotations / jnp.linalg.norm(rotations, axis=1, keepdims=True)
    else:
        q = jax.vmap(lambda r: jnp.stack(sp.quaternion_from_rotation(_rows(r))))(rotations)
    flips = jnp.where(jnp.sum(q[1:] * q[:-1], axis=1) < 0, -1.0, 1.0)
    return q * jnp.concatenate([jnp.ones(1), jnp.cumprod(flips)])[:, None]
