"""Model: a chain as arrays, its frames and its geometric Jacobian; every loop runs on it.

The transform of joint i is affine in the sine and cosine of its value v and in v itself,

  Tᵢ(v) = Aᵢ + sin(v) Bᵢ + cos(v) Cᵢ + v Dᵢ  (4×4).
"""

from __future__ import annotations

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.cache import bounded_jit
from cnclik.engine.tracing import of_the_model
from cnclik.record import AnyArray, Array, ArrayLike, Bool, Float, cast, mapped, memoized, record, xp_for
from cnclik.robot.chain import PRISMATIC, REVOLUTE, Chain
from cnclik.robot.rotations import crossed, library, product, quaternion, rotation_from_quaternion


@record
class Model:
    """A `Chain` as arrays: j joints, n coordinates."""

    n: int  # joint coordinates
    transforms: tuple[Float[Array, "j 4 4"] | None, ...]  # A, B, C, D as above; D is None if all joints are revolute
    axes: Float[Array, "j 3"]  # unit vectors in the joints' own frames
    turning: Bool[AnyArray, " j"] | None  # true for revolute joints; None if all are
    mimic: tuple[Float[Array, "j n"], Float[Array, " j"]] | None  # multipliers and offsets of the joint values, if any
    balls: tuple[tuple[int, int], ...]  # see `Chain.balls`
    parents: tuple[int, ...]  # index of the joint that carries each joint, −1 for the base
    tips: tuple[Float[Array, "4 4"], ...]  # in the frames of the joints that carry them
    carriers: tuple[int, ...]  # indices of these joints
    tip_names: tuple[str, ...] | None  # None for one tip: equal shapes share programs
    supports: Float[np.ndarray, "tips j"] | None  # 1 for the joints that move a tip, else 0; None if all move all
    lower: Float[Array, " n"]  # as in `Chain`
    upper: Float[Array, " n"]
    velocity_limit: Float[Array, " n"]
    bounded: bool  # whether some joint has a position limit, as far as known
    slowed: bool  # whether some joint has a velocity limit, as far as known

    def tip_number(self, tip: str | None = None) -> int:
        """Return the index of the tip with this name; None: the only one."""
        return 0 if self.tip_names is None else self.tip_names.index(errors.one_of("tip", tip, self.tip_names))


@record
class Frames:
    """A tip's pose, and for each joint its frame, its axis there, and a point on it in the base frame."""

    position: Float[Array, " 3"]  # [m]
    rotation: Float[Array, "3 3"]
    joints: Float[Array, "j 4 4"]
    axes: Float[Array, "j 3"]
    points: Float[Array, "j 3"]  # [m]
    support: Float[np.ndarray, " j"] | None = None  # 1 for the joints that move the tip, else 0; None if all do


def joint_frames(chain: Model, q):
    """Return the joints' frames (..., j, 4, 4) in the base frame, each after its joint's motion, at q (..., n)."""
    xp = library(q, chain.tips[0])
    values = q if chain.mimic is None else q @ chain.mimic[0].T + chain.mimic[1]
    still, sine, cosine, slide = chain.transforms
    own = still + xp.sin(values)[..., None, None] * sine + xp.cos(values)[..., None, None] * cosine
    if slide is not None:
        own = own + values[..., None, None] * slide
    poses: list = []
    starts = [first for first, _ in chain.balls]
    for i, parent in enumerate(chain.parents):
        if i - 1 in starts or i - 2 in starts:  # the three axes of a rotation are those of its frame
            poses.append(poses[-1])
            continue
        frame = own[..., i, :, :] if parent < 0 else product(poses[parent], own[..., i, :, :])
        poses.append(frame if i not in starts else product(frame, _turn(values[..., i : i + 3])))
    return xp.stack(poses, -3)


def _turn(w):
    """Return the rotations by rotation vectors (..., 3), as transforms (..., 4, 4)."""
    xp, (cosine, v) = library(w), quaternion(w)
    rows = rotation_from_quaternion((cosine, v[..., 0], v[..., 1], v[..., 2]))
    rotation = xp.stack([xp.stack(row, -1) for row in rows], -2)
    return _transforms(xp, rotation, xp.zeros_like(w), 1.0)


def _transforms(xp, rotation, position, last):
    """Return matrices (..., 4, 4) of their blocks: rotation (..., 3, 3), position (..., 3), and the last entry."""
    top = xp.concatenate([rotation, position[..., None]], -1)
    row = xp.asarray([0.0, 0.0, 0.0, last], top.dtype)
    return xp.concatenate([top, xp.broadcast_to(row, (*top.shape[:-2], 1, 4))], -2)


def frames(chain: Model, q, tip: int) -> Frames:
    """Return all frames of a tip, by its index, at q (n,); where all are numbers in NumPy, also for q (..., n)."""
    return tip_frames(*moved(chain, q), tip)


def moved(chain: Model, q) -> tuple[Model, AnyArray]:
    """Return the chain as constants, and its joints' frames."""
    chain = chain if library(q, *chain.tips) is np else of_the_model(chain)
    return chain, joint_frames(chain, q)


def tip_frames(chain: Model, at, tip: int) -> Frames:
    """Return the frames of a tip, from those of `moved`."""
    support = None if chain.supports is None else chain.supports[tip]
    end = product(at[..., chain.carriers[tip], :, :], chain.tips[tip])
    place, turn, points = end[..., :3, 3], end[..., :3, :3], at[..., :3, 3]
    return Frames(position=place, rotation=turn, joints=at, axes=chain.axes, points=points, support=support)


def mass_frames(chain: Model, bodies: Float[Array, "j+1 4"], q) -> Frames:
    """Return the centre of mass at q (n,) as a tip: `jacobian_at` gives its rows of the Jacobian.

    Joint i moves it by sᵢ aᵢ × (cᵢ − pᵢ), or sᵢ aᵢ, by the share sᵢ of the mass that it carries and its centre cᵢ.
    """
    at = joint_frames(chain, q)
    xp = library(at, bodies)
    moments = (at @ bodies[1:, :, None])[..., 0]
    sums = [moments[..., i, :] for i in range(len(chain.parents))]
    whole = bodies[0]
    for i in reversed(range(len(sums))):
        if chain.parents[i] < 0:
            whole = whole + sums[i]
        else:
            sums[chain.parents[i]] = sums[chain.parents[i]] + sums[i]
    carried, place = xp.stack(sums, -2), whole[..., :3]
    share = carried[..., 3]
    centers = carried[..., :3] / xp.where(share > 0, share, 1.0)[..., None]
    points = place[..., None, :] - centers + at[..., :3, 3]  # common centre − point = own centre − axis point
    turn = xp.broadcast_to(xp.eye(3, dtype=place.dtype), (*place.shape, 3))
    return Frames(position=place, rotation=turn, joints=at, axes=chain.axes, points=points, support=share)


def jacobian_at(chain: Model, at: Frames):
    """Return the geometric Jacobian (..., 6, n) of a tip by its frames.

    A revolute joint moves the tip by a × (p − pᵢ) and turns it by a; a prismatic one moves it by a.
    """
    xp = library(at.joints, at.axes)
    axes = xp.sum(at.joints[..., :3, :3] * at.axes[:, None, :], axis=-1)
    velocity, spin = xp.cross(axes, at.position[..., None, :] - at.points), axes
    if chain.turning is not None:
        turning = chain.turning[:, None]
        velocity, spin = xp.where(turning, velocity, axes), xp.where(turning, spin, 0.0)
    if at.support is not None:
        velocity, spin = at.support[..., None] * velocity, at.support[..., None] * spin
    rows = xp.swapaxes(xp.concatenate([velocity, spin], axis=-1), -1, -2)
    return rows if chain.mimic is None else rows @ chain.mimic[0]


def modelled(tree):
    """Return the tree with every `Chain` in it as a `Model`."""
    if isinstance(tree, Model):
        return tree
    if isinstance(tree, Chain):
        return memoized(tree, "_modelled", _model)
    if not hasattr(tree, "__dataclass_fields__"):
        return mapped(tree, Chain, modelled)
    return memoized(tree, "_modelled", lambda tree: mapped(tree, Chain, modelled))


def _model(chain: Chain) -> Model:
    xp = xp_for(chain)
    joints, ways = chain.joints, [chain.way(i) for i in range(len(chain.tips))]
    mimic = None
    if [(j.coordinate, j.multiplier, j.offset) for j in joints] != [(i, 1.0, 0.0) for i in range(chain.n)]:
        onto = np.eye(chain.n)[[j.coordinate for j in joints]]
        mimic = onto * xp.array([j.multiplier for j in joints])[:, None], xp.array([j.offset for j in joints])
    turning = np.array([j.kind != PRISMATIC for j in joints])
    moving = np.zeros((len(ways), len(joints)))
    for row, way in zip(moving, ways, strict=True):
        row[way] = 1.0
    limits = {name: getattr(chain, name) for name in ("lower", "upper", "velocity_limit")}

    def some(*names):
        return not all(type(x) is float and math.isinf(x) for name in names for x in limits[name])

    rotations = xp.array([t.offset.rotation for t in chain.tips], float)
    positions = xp.array([t.offset.position for t in chain.tips], float)
    return Model(
        n=chain.n,
        transforms=_of_joints(xp, joints, turning),
        axes=xp.array([j.axis for j in joints], float),
        turning=None if turning.all() else turning,
        mimic=mimic,
        balls=chain.balls,
        parents=chain.parents,
        tips=tuple(_transforms(xp, rotations, positions, 1.0)),
        carriers=tuple(t.joint for t in chain.tips),
        tip_names=None if len(ways) == 1 else tuple(t.name for t in chain.tips),
        supports=None if moving.all() else moving,
        **{name: xp.array(bound, float) for name, bound in limits.items()},
        bounded=some("lower", "upper"),
        slowed=some("velocity_limit"),
    )


def _of_joints(xp, joints, turning):
    """Return A, B, C, and D (j, 4, 4) or None: a rotation is R = a aᵀ + (I − a aᵀ) cos + [a]× sin."""
    parts = zip(*((j.axis, j.origin.rotation, j.origin.position) for j in joints), strict=True)
    axes, rotation, position = (xp.array(part, float) for part in parts)
    if xp is jnp:
        axes, rotation = of_the_model((axes, rotation))
    revolute = np.array([joint.kind == REVOLUTE for joint in joints])[:, None, None]
    along = axes[:, :, None] * axes[:, None, :]
    sine, cosine = xp.moveaxis(crossed(axes.T), -1, 0), xp.eye(3) - along
    along, sine, cosine = (product(rotation, part) for part in (along, sine, cosine))
    nothing = xp.zeros_like(position)
    turns = (
        _transforms(xp, xp.where(revolute, along, rotation), position, 1.0),
        *(_transforms(xp, xp.where(revolute, part, 0.0), nothing, 0.0) for part in (sine, cosine)),
    )
    if turning.all():
        return *turns, None
    away = (rotation * axes[:, None, :]).sum(-1)
    return *turns, _transforms(xp, xp.zeros_like(rotation), xp.where(turning[:, None], 0.0, away), 0.0)


def one_off(fn, **options):
    """Return `jax.jit` of a function, with `options`; chains become `Model`s before: all of a shape share a program."""
    jitted = bounded_jit(fn, **options)
    return functools.wraps(fn)(lambda *args, **named: jitted(*map(modelled, args), **named))


# --- forward kinematics: pose of a tip, geometric Jacobian -------------------------------------


@record
class Pose:
    """Position and orientation of a tip in the base frame."""

    position: Float[Array, " 3"]  # [m]
    rotation: Float[Array, "3 3"]  # the columns are the tip's axes


def as_joint_values(chain: Chain | Model, q, *, finite=False) -> Float[Array, " n"]:
    """Return q as a floating array (n,), checked."""
    q = errors.array("q", q, (errors.kind("chain", chain, (Chain, Model)).n,), finite=finite, of="joint values")
    return q if isinstance(q, jax.Array) else jax.device_put(q)  # jnp.asarray would compile a program


def _computed(fn, chain, q, tip) -> list:
    """Return the arrays of fn(model, q, index of the tip), by NumPy, which does not compile, if all are numbers."""
    q, number = as_joint_values(chain, q), chain.tip_number(tip)
    if not all(map(errors.concrete, jax.tree.leaves((chain, q)))):
        return _program(chain, q, fn=fn, tip=number)
    return [jax.device_put(v.astype(q.dtype)) for v in fn(modelled(chain), np.asarray(q, float), number)]


_program = one_off(lambda chain, q, fn, tip: fn(cast(chain, q.dtype), q, tip), static_argnames=("fn", "tip"))


def _pose(chain, q, tip):
    at = frames(chain, q, tip)
    return at.position, at.rotation


def _jacobian(chain, q, tip):
    return [jacobian_at(chain, frames(chain, q, tip))]


def forward(chain: Chain, q: Float[ArrayLike, " n"], *, tip: str | None = None) -> Pose:
    """Return the pose of a tip in the base frame, g(q) of Drexler (2016), Section II.

    Args:
      q: (n,) joint values [rad, m].
      tip: its name; None: the only one.
    """
    position, rotation = _computed(_pose, chain, q, tip)
    return Pose(position=position, rotation=rotation)


def jacobian(chain: Chain, q: Float[ArrayLike, " n"], *, tip: str | None = None) -> Float[Array, "6 n"]:
    """Return the geometric Jacobian J(q), (6, n): tip velocity (v, ω) = J q̇ in the base frame, linear rows first.

    Column i is (aᵢ × (p − pᵢ), aᵢ) for a revolute joint and (aᵢ, 0) for a prismatic one (Siciliano et al. 2009, eq.
    3.30). Units: m/s and rad/s per unit of q̇. A joint that does not move the tip has a column of zeros.

    Args: q, tip: as for `forward`.
    """
    return _computed(_jacobian, chain, q, tip)[0]
