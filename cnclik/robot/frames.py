"""Frames: where each joint and the tip are, and the rows of the Jacobian; the core that every loop runs on."""

import functools

from cnclik.hints import opaque
from cnclik.record import record
from cnclik.robot import spatial as sp
from cnclik.robot.chain import REVOLUTE, Chain, Joint
from cnclik.robot.trig import sincos


@record
class Frames:
    """Component form: the tip's pose, and for each joint its axis and a point on it, in the base frame."""

    position: tuple
    rotation: tuple
    axes: tuple
    points: tuple


@opaque
def link(joint: Joint, position, rotation, value, sine, cosine):
    """Carry the frame over one joint: its fixed offset, then its motion."""
    point = sp.vadd(position, sp.matvec(rotation, joint.origin.position))
    rotation = sp.matmul(rotation, joint.origin.rotation)
    axis = sp.matvec(rotation, joint.axis)
    if joint.kind == REVOLUTE:
        return point, sp.matmul(rotation, sp.rotation_about(joint.axis, sine, cosine)), axis, point
    return sp.vadd(point, sp.scale(value, axis)), rotation, axis, point


@functools.singledispatch
def frames(chain: Chain, q) -> Frames:
    """All frames of the chain at q, a tuple of n scalars; for a rolled chain (`robot.rolled`) an array (n,)."""
    values = [sp.add(sp.mul(j.multiplier, q[j.coordinate]), j.offset) for j in chain.joints]
    turning = [i for i, j in enumerate(chain.joints) if j.kind == REVOLUTE]
    sines, cosines = sincos(tuple(values[i] for i in turning)) if turning else ((), ())
    sine, cosine = dict(zip(turning, sines, strict=True)), dict(zip(turning, cosines, strict=True))
    position, rotation, axes, points = sp.ZERO, sp.IDENTITY, [], []
    for i, joint in enumerate(chain.joints):
        position, rotation, axis, point = link(joint, position, rotation, values[i], sine.get(i), cosine.get(i))
        axes.append(axis)
        points.append(point)
    return Frames(
        position=sp.vadd(position, sp.matvec(rotation, chain.tip.position)),
        rotation=sp.matmul(rotation, chain.tip.rotation),
        axes=tuple(axes),
        points=tuple(points),
    )


@functools.singledispatch
def jacobian_rows(chain: Chain, at: Frames, linear, angular):
    """Rows of the geometric Jacobian, each a vector over the joints in the chain's form.

    A revolute joint moves the tip by a × (p − pᵢ) and turns it by a; a prismatic one moves it by a.

    Args:
      linear, angular: which of the axes 0, 1, 2 to return; the rest is never computed.
    """
    columns = [[0.0] * chain.n for _ in (*linear, *angular)]
    for joint, axis, point in zip(chain.joints, at.axes, at.points, strict=True):
        if joint.kind == REVOLUTE:
            velocity, spin = sp.cross(axis, sp.vsub(at.position, point)), axis
        else:
            velocity, spin = axis, sp.ZERO
        entries = [velocity[i] for i in linear] + [spin[i] for i in angular]
        for row, entry in zip(columns, entries, strict=True):
            row[joint.coordinate] = sp.add(row[joint.coordinate], sp.mul(joint.multiplier, entry))
    return tuple(tuple(row) for row in columns)
