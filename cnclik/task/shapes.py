"""Shapes carried by links, all points within a radius of a point or segment, and distances between them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.record import Array, ArrayLike, Float, Number, leaf, record, xp_for
from cnclik.robot.rotations import safe_norm
from cnclik.task.parts import At, Vector
from cnclik.task.task import Task


@record
class Rounded:
    """See `sphere` and `capsule`."""

    tip: str | None
    ends: Float[Array, "ends 3"]  # one or two, in the tip's frame
    radius: Number

    def placed(self, robot: At):
        """Return its ends in the base frame."""
        if self.tip is None:
            return self.ends
        at = robot.frames(self.tip)
        return at.position + self.ends @ at.rotation.T

    def along(self, robot: At, point, normal):
        """Return the velocity (n,) of its point, along a normal, by those of the joints; both in the base frame."""
        if self.tip is None:
            return jnp.zeros_like(robot.q)
        arm = point - robot.frames(self.tip).position
        return jnp.concatenate([normal, jnp.cross(arm, normal)]) @ robot.jacobian(self.tip)


@record
class Distance(Vector):
    """See `distance`."""

    one: Rounded
    other: Rounded
    names, units = ("distance",), ("m",)
    tip, to = "distance", None

    def on(self, chain):
        for shape in (self.one, self.other):
            if shape.tip is not None:
                chain.tip_number(shape.tip)
        return self

    def _seen(self, robot: At):
        """Return the distance, its nearest points, without radii, and the unit vector from the other to the one."""
        near, far = _nearest(self.one.placed(robot), self.other.placed(robot))
        apart = near - far
        length = safe_norm(apart)
        normal = apart / jnp.where(length > 0, length, 1.0)
        return length - self.one.radius - self.other.radius, near, far, normal

    def x(self, robot: At):
        return self._seen(robot)[0][None]

    def rows(self, robot: At):
        if robot.q.ndim > 1:
            return np.asarray(jax.vmap(lambda q: self.rows(At(robot.chain, q)))(robot.q))
        _, near, far, normal = self._seen(robot)
        return (self.one.along(robot, near, normal) - self.other.along(robot, far, normal))[None]


def _nearest(one, other):
    """Return the nearest points of two segments, each of which may be a point."""
    if len(one) == len(other) == 1:
        return one[0], other[0]
    if len(one) == 1:
        return one[0], _on(other, one[0])
    if len(other) == 1:
        return _on(one, other[0]), other[0]
    a, b, away = one[1] - one[0], other[1] - other[0], one[0] - other[0]
    aa, bb, ab, ac, bc = a @ a, b @ b, a @ b, a @ away, b @ away
    # On the first segment nearest to the other's line, where they are not parallel; then each on its own in turn.
    cross = aa * bb - ab * ab
    crosses = cross > jnp.finfo(cross.dtype).eps * aa * bb  # more would miss the nearest end of almost parallel ones
    s = jnp.clip(jnp.where(crosses, (ab * bc - ac * bb) / jnp.where(crosses, cross, 1.0), 0.0), 0.0, 1.0)
    far = _on(other, one[0] + s * a)
    near = _on(one, far)
    return near, far


def _on(segment, point):
    """Return the point of a segment that is nearest to a point."""
    along = segment[1] - segment[0]
    return segment[0] + jnp.clip((point - segment[0]) @ along / (along @ along), 0.0, 1.0) * along


def sphere(tip: str | None, radius: Number, center: Float[ArrayLike, " 3"] = (0.0, 0.0, 0.0)) -> Rounded:
    """Return a sphere on a link, which must be a tip of the robot, for `distance`.

    Args:
      tip: its name; None: fixed in the base frame.
      radius: [m].
      center: (3,) in the tip's frame [m].
    """
    ends, radius = errors.array("center", center, (3,))[None], errors.number("radius", radius, at_least=0)
    return Rounded(tip=tip, ends=ends, radius=leaf(radius))


def capsule(tip: str | None, radius: Number, start: Float[ArrayLike, " 3"], end: Float[ArrayLike, " 3"]) -> Rounded:
    """Return a capsule on a link, which must be a tip of the robot: all points within a radius of a segment.

    Args:
      tip, radius: as for `sphere`.
      start, end: (3,) ends of the segment in the tip's frame [m].
    """
    ends = [errors.array(name, value, (3,)) for name, value in (("start", start), ("end", end))]
    if all(map(errors.concrete, ends)) and not np.any(ends[0] != ends[1]):
        raise errors.fail("end", "be another point than `start`, or use ck.sphere", f"is {end!r}")
    return Rounded(tip=tip, ends=xp_for(ends).stack(ends), radius=leaf(errors.number("radius", radius, at_least=0)))


def distance(one: Rounded, other: Rounded) -> Task:
    """Control the distance between two shapes, a task of one coordinate [m], negative where they overlap.

    Use it in `wall(distance(...), above=0.02)`, or control it. For a capsule parallel to another one, the nearest point
    is not unique and the row of the Jacobian jumps. Use two spheres, or a wall for each end, to avoid that.
    """
    for name, shape in (("one", one), ("other", other)):
        errors.kind(name, shape, Rounded, "be ck.sphere(...) or ck.capsule(...)")
    if one.tip == other.tip:
        raise errors.fail("one", "be on another link than `other`", f"is on {one.tip or 'the base'}, too")
    return Task(parts=(Distance(one=one, other=other),))
