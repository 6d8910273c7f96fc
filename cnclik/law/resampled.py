"""Resampled: a path from targets that arrive more slowly than the loop runs. It uses past targets only."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.law.curves import Spline, timed
from cnclik.law.reference import Reference
from cnclik.record import ArrayLike, Float, Number
from cnclik.robot.poses import library

KINDS = {"hold": 0.0, "ramp": 1.0, "spline": 1.5}  # kinds, and the least delay of each [longest periods]


def resampled(
    times: Float[ArrayLike, " K"],
    positions: Float[ArrayLike, "K d"] | None = None,
    rotations: Float[ArrayLike, "K ..."] | None = None,
    *,
    kind: str = "spline",
    delay: Number | None = None,
) -> Reference:
    """Follow a stream of targets, such as a policy's at 30 Hz, in a loop at 1 kHz that knows only past targets.

    "hold": the last target; it jumps with each new one and has no velocity. "ramp": straight lines from target to
    target; the velocity jumps. "spline": the ramp averaged over about a period, from the middle of a line to the middle
    of the next one; its velocity is continuous, and it cuts corners and smooths jitter. Each kind uses the velocity of
    its own motion for the feed-forward. The last target is held. Rotations are interpolated by normalized quaternions:
    for neighbours 20° apart the speed of a ramp varies by 0.8 %.

    Args:
      times: (K,) arrival times of the targets [s], increasing.
      positions: (K, d) [m], or None.
      rotations: (K, 3, 3) rotations or (K, 4) unit quaternions w, x, y, z, or None.
      kind: "hold", "ramp" or "spline".
      delay: delay of the path [s]. The default, which is also the minimum, uses no target before it arrives: 0, 1 and
        1.5 times the longest period.

    Returns: `Reference` whose future a step does not use, as with `causal`.
    Raises: ArgumentError for shapes and values that do not fit.
    """
    errors.one_of("kind", kind, KINDS)
    times, *points = timed(times, positions, rotations)
    xp = library(times, points)  # NumPy compiles nothing
    times = xp.asarray(times)
    gap = xp.max(xp.diff(times))
    least = KINDS[kind] * gap
    if delay is None:
        delay = least
    elif errors.concrete(errors.number("delay", delay)) and xp is np and float(delay) < least * (1 - 1e-9):
        raise errors.fail("delay", f"be at least {least:g} s, for {kind} to use only what has come", f"is {delay:g}")
    pieces = [(None, None) if p is None else _pieces(xp, kind, times, xp.asarray(p), gap) for p in points]
    knots = next(knots for knots, _ in pieces if knots is not None)
    position, quaternion = (None if made is None else jnp.asarray(made) for _, made in pieces)
    times = jnp.asarray(knots + delay)
    curve = Spline(times=times, position=position, quaternion=quaternion, rotation=None, closed=False)
    return Reference(curve=curve, known=False)


def _pieces(xp, kind, times, points, gap):
    """Return knots (P + 1,) and coefficients (P, 4, d) of powers of the time since a knot; at rest before and after."""
    times = xp.concatenate([times[:1] - gap, times, times[-1:] + gap])
    points = xp.concatenate([points[:1], points, points[-1:]])
    h = xp.diff(times)[:, None]
    slope = xp.diff(points, axis=0) / h
    if kind != "spline":
        start, moves = points[:-1], slope if kind == "ramp" else 0 * slope
        return times, xp.stack([start, moves, 0 * start, 0 * start], axis=1)
    knots, middle = (times[1:] + times[:-1]) / 2, (points[1:] + points[:-1]) / 2
    h = xp.diff(knots)[:, None]
    mean = xp.diff(middle, axis=0) / h
    second, third = (3 * mean - 2 * slope[:-1] - slope[1:]) / h, (slope[:-1] + slope[1:] - 2 * mean) / h**2
    return knots, xp.stack([middle[:-1], slope[:-1], second, third], axis=1)
