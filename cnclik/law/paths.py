"""Paths: the references that cnclik builds, of curves.

A curve is a record, so that points and periods are parameters. It gives a position (d,) and a rotation (3, 3), or None.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.cache import bounded_jit
from cnclik.record import Array, ArrayLike, Float, Number, brief, leaf, record, replace, xp_for
from cnclik.robot import poses
from cnclik.robot.model import Pose
from cnclik.robot.rotations import exp_so3, log_so3, quaternion_from_rotation, rotation_from_quaternion

A_REFERENCE = "be a Reference such as hold(...), or references(name=...) for several"
_JOINTS = " (joint values are given by hold(values=...))"
Target = poses.PoseLike | None  # see `hold`
Rotation = Float[Array, "3 3"] | None


@record
class Reference:
    """A desired path. Build one with hold, line, circle, lissajous, waypoints, or from any `path`."""

    curve: Callable  # t -> (position (d,) or None, rotation (3, 3) or None)
    known: bool = True  # whether a step knows the path ahead, see `causal`

    @property
    def still(self) -> bool:
        """Whether the target is constant."""
        return isinstance(self.curve, Hold)

    def __repr__(self):
        return f"Reference: {brief(self.curve)}{'' if self.known else ', future unknown'}"


# --- curves -------------------------------------------------------------------------------------------


@record
class Hold:
    position: Float[Array, " d"] | None
    rotation: Rotation

    def __call__(self, t):
        return self.position, self.rotation


@record
class Line:
    start: Float[Array, " d"] | None
    end: Float[Array, " d"] | None
    rotation: Rotation
    turn: Float[Array, " 3"] | None  # rotation vector from the first to the last orientation, in the base frame
    duration: Float[Array, ""]

    def __call__(self, t):
        # Constant beyond the end; it still moves there, up to rounding of k·Ts.
        s = jnp.where(t > self.duration * (1 + 1e-6), 1.0, t / self.duration)
        position = None if self.start is None else self.start + s * (self.end - self.start)
        return position, self.rotation if self.turn is None else exp_so3(s * self.turn) @ self.rotation


@record
class Circle:
    """A circle, or by several frequencies a Lissajous figure."""

    center: Float[Array, " d"]
    first: Float[Array, " d"]  # from the centre at t = 0
    second: Float[Array, " d"]  # and a quarter of a cycle later
    rotation: Rotation
    period: Float[Array, ""]
    frequency: float | Float[Array, " d"] = 1.0  # cycles per period

    def __call__(self, t):
        angle = 2 * math.pi / self.period * t * self.frequency
        return self.center + jnp.cos(angle) * self.first + jnp.sin(angle) * self.second, self.rotation


@record
class Spline:
    times: Float[Array, " K"]
    position: Float[Array, "K-1 4 d"] | None  # coefficients of the powers of t − t_k, a row for each knot
    quaternion: Float[Array, "K-1 4 4"] | None  # and of unnormalised quaternions

    def __call__(self, t):
        times, k = jnp.asarray(self.times), interval(self.times, t)  # NumPy arrays take no traced index
        dt = jnp.clip(t, self.times[0], self.times[-1]) - times[k]  # constant beyond both ends, at which it rests

        def at(c):
            a, b, c, d = jnp.asarray(c)[k]
            return a + dt * (b + dt * (c + dt * d))

        rotation = None
        if self.quaternion is not None:
            q = at(self.quaternion)
            rotation = jnp.array(rotation_from_quaternion(q / jnp.sqrt(q @ q)))
        return (None if self.position is None else at(self.position)), rotation


@record
class Path:
    fn: Callable

    def __call__(self, t):
        target, dtype = self.fn(t), jnp.result_type(t)
        if isinstance(target, Pose):
            return jnp.asarray(target.position, dtype), jnp.asarray(target.rotation, dtype)
        if isinstance(target, (tuple, list)) and any(map(jnp.ndim, target)):
            must = "give a position, or a pose as ck.Pose(position=..., rotation=...)"
            raise errors.fail("fn", must, f"gives a {type(target).__name__} of arrays")
        return jnp.asarray(target, dtype), None


@record
class Tangent:
    t: Float[Array, ""]  # where it touches the path
    position: Float[Array, " d"] | None
    velocity: Float[Array, " d"] | None
    rotation: Rotation
    spin: Float[Array, " 3"] | None  # angular velocity in the base frame

    def __call__(self, t):
        on = t - self.t
        turned = self.rotation if self.spin is None else exp_so3(on * self.spin) @ self.rotation
        return None if self.position is None else self.position + on * self.velocity, turned


def interval(times, t):
    """Return k, 0 … K − 2, with times[k] ≤ t < times[k + 1] for rising times (K,); the first or last one outside.

    By bisection, written out: XLA for GPUs fails where a loop reads a table at an index that a loop inside it finds
    (openxla/xla #49299), and the primitives of `jnp.searchsorted` differ between versions of JAX.
    """
    times, last = jnp.asarray(times), times.shape[0] - 1
    low, high = jnp.int32(0), jnp.int32(last)
    for _ in range(max(last, 1).bit_length()):
        middle = (low + high) >> 1
        later = times[middle] <= t
        low, high = jnp.where(later, middle, low), jnp.where(later, high, middle)
    return low


# --- references ---------------------------------------------------------------------------------------


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
    try:
        target, rotation = _split("target", target, rotation)
    except errors.ArgumentError as error:  # seven numbers may be joint values
        joints = _JOINTS * (rotation is None and "quaternion w x y z" in str(error))
        raise errors.ArgumentError(f"{str(error).removesuffix('.')}{joints}.") from None
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
    if rotation is None and rotation_end is not None:
        raise errors.fail("rotation", "be given with `rotation_end`", "is None")
    turn = None if rotation_end is None else _turn(rotation, rotation_end)
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
    u, v = np.eye(2)
    if len(center) == 3:
        w = np.asarray(errors.array("normal", (0.0, 0.0, 1.0) if normal is None else normal, (3,)), float)
        if not np.linalg.norm(w) > 0:
            raise errors.fail("normal", "not be the zero vector", f"is {w.tolist()}")
        w = w / np.linalg.norm(w)
        u = np.cross(np.eye(3)[1] if abs(w[1]) < 0.9 else np.eye(3)[2], w)
        u = u / np.linalg.norm(u)
        v = np.cross(w, u)
    elif normal is not None:
        raise errors.fail("normal", "be left out for a circle in a plane", f"is {normal!r}")
    xp = xp_for(phase)  # NumPy compiles nothing
    c, s = xp.cos(phase), xp.sin(phase)
    first, second = radius * (c * u + s * v), radius * (c * v - s * u)
    return _periodic(period, rotation, center=center, first=first, second=second)


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
    d = len(center)
    frequency = errors.array("frequency", np.arange(1.0, d + 1) if frequency is None else frequency, (d,))
    phase = errors.array("phase", np.zeros(d) if phase is None else phase, (d,))
    amplitude, xp = errors.array("amplitude", amplitude, (d,)), xp_for(phase)
    first, second = amplitude * xp.sin(phase), amplitude * xp.cos(phase)
    return _periodic(period, rotation, center=center, first=first, second=second, frequency=frequency)


def _periodic(period, rotation, **fields):
    """Return the reference of a periodic curve."""
    if errors.concrete(errors.number("period", period)) and float(period) == 0:
        raise errors.fail("period", "not be 0", "is 0")
    return Reference(curve=Circle(rotation=_rotation("rotation", rotation), period=leaf(period), **fields))


def waypoints(
    times: Float[ArrayLike, " K"],
    positions: Float[ArrayLike, "K d"] | None = None,
    rotations: Float[ArrayLike, "K ..."] | None = None,
) -> Reference:
    """Move through waypoints on a C² path, from rest to rest.

    Positions follow the cubic spline through the points, orientations that of their quaternions (signs aligned),
    normalised, which does not depend on the frame the rotations are given in.

    Args:
      times: (K,) increasing [s].
      positions: (K, d) [m], or None.
      rotations: (K, 3, 3) rotations or (K, 4) unit quaternions w, x, y, z, or None; neighbours less than 180° apart.
    """
    if not errors.concrete(times):
        raise errors.fail("times", "be known numbers", "is traced")
    times = np.asarray(errors.array("times", times, (None,)), float)
    if (count := len(times)) < 2 or not np.all(times[1:] > times[:-1]):
        raise errors.fail("times", "be two or more that increase", f"is {times.tolist()}")
    if positions is None and rotations is None:
        raise errors.fail("positions", "be given, or `rotations`", "is None")
    position = quaternion = None
    if positions is not None:
        position = _cubic(times, errors.array("positions", positions, (count, None)))
    if rotations is not None:
        rotations = errors.array("rotations", rotations, (count, 4), (count, 3, 3))
        quaternion = _cubic(times, _quaternions(poses.rotations("rotations", rotations)))
    return Reference(curve=Spline(times=jnp.asarray(times), position=position, quaternion=quaternion))


def _cubic(times, values):
    """Return coefficients (K−1, 4, d) of the interpolating C² cubic spline, at rest at both ends."""
    from scipy.interpolate import CubicSpline  # here, as most references are no waypoints

    def spline(points):
        return np.moveaxis(CubicSpline(times, points, bc_type="clamped").c[::-1], 0, 1)

    if errors.concrete(values):
        return jnp.asarray(spline(np.asarray(values)))
    return jnp.einsum("kpj,jd->kpd", spline(np.eye(len(times))), values)  # they are linear in the values


@bounded_jit
def _quaternions(rotations):
    """Return unit quaternions (K, 4) of rotations (K, 3, 3), each with the sign nearer to the one before."""
    q = jax.vmap(quaternion_from_rotation)(rotations)
    flips = jnp.where(jnp.sum(q[1:] * q[:-1], axis=1) < 0, -1.0, 1.0)
    return q * jnp.concatenate([jnp.ones(1), jnp.cumprod(flips)])[:, None]


def path(fn: Callable) -> Reference:
    """Follow any differentiable function t -> position (array or tuple of length d), or t -> `Pose`.

    It is compiled into the programs that use it, as under `jax.jit`: values that it closes over are read then.
    """
    if not callable(fn):
        raise errors.fail("fn", "be a function of time", f"is {fn!r}")
    return Reference(curve=Path(fn=fn))


def causal(reference: Reference) -> Reference:
    """Return the same path for a controller that does not know the future, such as a hand in front of a camera.

    A step then uses x_d and ẋ_d at its start only, and assumes that the target continues with that velocity.
    """
    return replace(errors.kind("reference", reference, Reference, A_REFERENCE), known=False)


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
        if not 1 <= len(target) <= 3:
            raise errors.fail(name, f"have 1 to 3 coordinates{_JOINTS * (name == 'target')}", f"has {len(target)}")
    return target, _rotation(called, rotation)


def _rotation(name, value):
    """Return a (3, 3) rotation from a rotation or a (4,) unit quaternion; None stays."""
    return None if value is None else poses.rotations(name, errors.array(name, value, (3, 3), (4,)))


@bounded_jit  # jitted as a whole, as each of its many small operations would be compiled on first use
def _turn(first, last):
    """Return the rotation vector, in the base frame, from one rotation to another."""
    return log_so3(last @ first.T)
