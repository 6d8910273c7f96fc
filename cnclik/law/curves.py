"""Curves: functions of time that return a target, a position and a rotation, or None for one.

They are records, so that points, periods and durations are parameters; `cnclik.law.reference` builds and samples them.
Targets are arrays: positions (d,), rotations (3, 3).
"""

import contextlib
import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.cache import bounded_jit
from cnclik.record import Array, Float, record
from cnclik.robot import poses
from cnclik.robot.model import Pose
from cnclik.robot.rotations import exp_so3, library, quaternion_from_rotation, rotation_from_quaternion

Rotation = Float[Array, "3 3"] | None


def interval(times, t):
    """Return k, 0 … K − 2, with times[k] ≤ t < times[k + 1] for rising times (K,); the first or last one outside.

    By bisection with basic operations, as the primitives of `jnp.searchsorted` differ between versions of JAX. Written
    out, as XLA for GPUs fails where a loop reads a table at an index that a loop inside it finds (openxla/xla #49299).
    """
    times, last = jnp.asarray(times), times.shape[0] - 1
    low, high = jnp.int32(0), jnp.int32(last)
    for _ in range(max(last, 1).bit_length()):
        middle = (low + high) >> 1
        later = times[middle] <= t
        low, high = jnp.where(later, middle, low), jnp.where(later, high, middle)
    return low


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
        s = _progress(t, self.duration)
        position = None if self.start is None else self.start + s * (self.end - self.start)
        return position, self.rotation if self.turn is None else exp_so3(s * self.turn) @ self.rotation


@record
class Lissajous:
    center: Float[Array, " d"]
    amplitude: Float[Array, " d"]
    frequency: Float[Array, " d"]
    phase: Float[Array, " d"]
    rotation: Rotation
    period: Float[Array, ""]

    def __call__(self, t):
        omega = 2 * math.pi / self.period
        return self.center + self.amplitude * jnp.sin(self.frequency * omega * t + self.phase), self.rotation


@record
class Circle:
    center: Float[Array, " d"]
    first: Float[Array, " d"]  # radius vector at t = 0
    second: Float[Array, " d"]  # and a quarter period later
    rotation: Rotation
    period: Float[Array, ""]

    def __call__(self, t):
        angle = 2 * math.pi / self.period * t
        return self.center + jnp.cos(angle) * self.first + jnp.sin(angle) * self.second, self.rotation


@record
class Spline:
    times: Float[Array, " K"]
    position: Float[Array, "K-1 4 d"] | None  # coefficients of the powers of t − t_k, a row for each knot
    quaternion: Float[Array, "K-1 4 4"] | None  # and of unnormalised quaternions
    rotation: Rotation  # constant
    closed: bool

    def __call__(self, t):
        if self.closed:
            t = self.times[0] + jnp.mod(t - self.times[0], self.times[-1] - self.times[0])
        times, k = jnp.asarray(self.times), interval(self.times, t)  # NumPy arrays take no traced index
        inside = (t >= self.times[0]) & (t <= self.times[-1] * (1 + 1e-9))
        # Constant beyond both ends; the jvp of a clip would halve the velocity exactly at an end.
        dt = jnp.where(inside, t, jnp.clip(jax.lax.stop_gradient(t), self.times[0], self.times[-1])) - times[k]

        def at(c):
            a, b, c, d = jnp.asarray(c)[k]
            return a + dt * (b + dt * (c + dt * d))

        rotation = self.rotation
        if self.quaternion is not None:
            q = at(self.quaternion)
            rotation = jnp.array(rotation_from_quaternion(q / jnp.sqrt(q @ q)))
        return (None if self.position is None else at(self.position)), rotation


@record
class Path:
    fn: Callable

    def __call__(self, t):
        target, dtype = self.fn(t), jnp.result_type(t)
        rotation = None
        if isinstance(target, Pose):
            target, rotation = target.position, jnp.asarray(target.rotation, dtype)
        if isinstance(target, (tuple, list)):
            if any(map(jnp.ndim, target)):
                must = "give a position, or a pose as ck.Pose(position=..., rotation=...)"
                raise errors.fail("fn", must, f"gives a {type(target).__name__} of arrays")
            target = jnp.stack([jnp.asarray(v, dtype) for v in target])
        return jnp.asarray(target, dtype), rotation


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


def _progress(t, duration):
    """Return t/duration up to 1, then constant; it still moves at t = duration, up to rounding of k·Ts."""
    return jnp.where(t > duration * (1 + 1e-6), 1.0, t / duration)


def cubic(times, values, closed, name):
    """Return coefficients (K−1, 4, d) of the interpolating C² cubic spline, at rest at both ends or periodic."""
    from scipy.interpolate import CubicSpline  # here, as most references are no waypoints

    count = len(times) - 1
    # After a full turn the quaternion has the other sign, which is the same rotation: its period is two turns.
    turned = closed and name == "rotations" and values[0] @ values[-1] < 0

    def spline(points, sign):
        knots = times
        if closed:
            points = np.concatenate([points[:-1], sign * points[:-1], points[:1]])
            knots = np.concatenate([times[:-1], times + times[-1] - times[0]])
        pieces = CubicSpline(knots, points, bc_type="periodic" if closed else "clamped").c[::-1, :count]
        return np.moveaxis(pieces, 0, 1)

    if not errors.concrete(values):  # they are linear in the values
        same, other = (jnp.einsum("kpj,jd->kpd", spline(np.eye(count + 1), sign), values) for sign in (1.0, -1.0))
        return jnp.where(turned, other, same)
    sign = -1.0 if turned else 1.0
    if closed and np.abs(values[0] - sign * values[-1]).max() > 1e-6:
        raise errors.fail(name, "end where it starts for a closed path", "does not")
    pieces = np.array(np.nan)
    with contextlib.suppress(ValueError), np.errstate(all="ignore"):  # SciPy's, of what is not finite
        pieces = spline(values, sign)
    if not np.isfinite(pieces).all():
        raise errors.fail(name, "be such that a smooth path leads through them", f"is {values.tolist()}")
    return jnp.asarray(pieces)


def hermite(h, values, v):
    """Return coefficients (K−1, 4, d) of the cubics with values and velocities v (K, d), at knots h (K−1,) apart."""
    xp, h = library(values, v), h[:, None]
    slope = xp.diff(values, axis=0) / h
    second, third = (3 * slope - 2 * v[:-1] - v[1:]) / h, (v[:-1] + v[1:] - 2 * slope) / h**2
    return xp.stack([values[:-1], v[:-1], second, third], axis=1)


def timed(times, positions, rotations) -> tuple:
    """Return checked times (K,), and for them positions (K, d) and unit quaternions (K, 4), either of them None."""
    if not errors.concrete(times):
        raise errors.fail("times", "be known numbers", "is traced")
    times = np.asarray(errors.array("times", times, (None,)), float)
    count = len(times)
    if count < 2:
        raise errors.fail("times", "hold at least two times", f"holds {count}")
    if not np.all(times[1:] > times[:-1]):
        raise errors.fail("times", "increase", f"is {times.tolist()}")
    if positions is None and rotations is None:
        raise errors.fail("positions", "be given, or `rotations`", "is None")
    if positions is not None:
        positions = errors.array("positions", positions, (count, None))
    if rotations is not None:
        rotations = errors.array("rotations", rotations, (count, 4), (count, 3, 3))
        rotations = quaternions(poses.rotations("rotations", rotations))
    return times, positions, rotations


@bounded_jit
def quaternions(rotations):
    """Return unit quaternions (K, 4) of rotations (K, 3, 3), each with the sign nearer to the one before."""
    q = jax.vmap(quaternion_from_rotation)(rotations)
    flips = jnp.where(jnp.sum(q[1:] * q[:-1], axis=1) < 0, -1.0, 1.0)
    return q * jnp.concatenate([jnp.ones(1), jnp.cumprod(flips)])[:, None]
