"""Model: a chain as arrays, its frames and its geometric Jacobian; every loop runs on it.

The transform of joint i is affine in the sine and cosine of its value v and in v itself,

  Tᵢ(v) = Aᵢ + sin(v) Bᵢ + cos(v) Cᵢ + v Dᵢ  (4×4).
"""

from __future__ import annotations

import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.cache import bounded_jit
from cnclik.engine.constants import of_the_model
from cnclik.record import AnyArray, Array, ArrayLike, Bool, Float, cast, mapped, memoized, record, replace
from cnclik.robot import fixed
from cnclik.robot.chain import PRISMATIC, REVOLUTE, Chain
from cnclik.robot.rotations import library, product, quaternion, rotation_from_quaternion, safe_sqrt


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
    standing: tuple[Float[Array, "j 4 4"], Float[Array, "j 4 4 n"]] | None = None  # see `standing`

    def tip_number(self, tip: str | None = None) -> int:
        """Index of the tip with this name; None: the only one."""
        return 0 if self.tip_names is None else self.tip_names.index(errors.one_of("tip", tip, self.tip_names))


@record
class Frames:
    """A tip's pose, and for each joint its axis and a point on it, in the base frame."""

    position: Float[Array, " 3"]  # [m]
    rotation: Float[Array, "3 3"]
    axes: Float[Array, "j 3"]
    points: Float[Array, "j 3"]  # [m]
    support: Float[np.ndarray, " j"] | None = None  # 1 for the joints that move the tip, else 0; None if all do


def joint_frames(chain: Model, q):
    """The joints' frames (..., j, 4, 4) in the base frame, each after its joint's motion, at q (..., n)."""
    if chain.standing is not None:
        return _standing(*chain.standing, q)
    xp = library(q, chain.tips[0])
    values = q if chain.mimic is None else q @ chain.mimic[0].T + chain.mimic[1]
    still, sine, cosine, slide = chain.transforms
    own = still + xp.sin(values)[..., None, None] * sine + xp.cos(values)[..., None, None] * cosine
    if slide is not None:
        own = own + values[..., None, None] * slide
    at: list = []
    starts = [first for first, _ in chain.balls]
    for i, parent in enumerate(chain.parents):
        if i - 1 in starts or i - 2 in starts:  # the three axes of a rotation are those of its frame
            at.append(at[-1])
            continue
        frame = own[..., i, :, :] if parent < 0 else product(at[parent], own[..., i, :, :])
        at.append(frame if i not in starts else product(frame, _turn(values[..., i : i + 3])))
    return xp.stack(at, -3)


def _turn(w):
    """Rotations by rotation vectors (..., 3), as transforms (..., 4, 4)."""
    xp, (cosine, v) = library(w), quaternion(w)
    none, one = xp.zeros_like(cosine), xp.ones_like(cosine)
    rows = rotation_from_quaternion((cosine, v[..., 0], v[..., 1], v[..., 2]))
    return xp.stack([xp.stack(row, -1) for row in (*([*row, none] for row in rows), [none, none, none, one])], -2)


def frames(chain: Model, q, tip: int = 0) -> Frames:
    """All frames at q (n,), as arrays; as NumPy arrays if all are numbers, and then also for q (..., n).

    Args: tip: index of the tip.
    """
    return tip_frames(*moved(chain, q), tip)


def moved(chain: Model, q) -> tuple[Model, AnyArray, AnyArray]:
    """The chain as constants, its joints' frames and their axes (..., j, 3) in the base frame, for `tip_frames`."""
    xp = library(q, *chain.tips)
    chain = chain if xp is np else of_the_model(chain)
    at = joint_frames(chain, q)
    return chain, at, xp.sum(at[..., :3, :3] * chain.axes[:, None, :], axis=-1)


def tip_frames(chain: Model, at, axes, tip: int) -> Frames:
    """The frames of a tip, from those of `moved`."""
    support = None if chain.supports is None else chain.supports[tip]
    tip = product(at[..., chain.carriers[tip], :, :], chain.tips[tip])
    place, turn = tip[..., :3, 3], tip[..., :3, :3]
    return Frames(position=place, rotation=turn, axes=axes, points=at[..., :3, 3], support=support)


def mass_frames(chain: Model, bodies: Float[Array, "j+1 4"], q) -> Frames:
    """The centre of mass at q (n,) as a tip: `jacobian_rows` gives its rows of the Jacobian.

    Joint i moves it by sᵢ aᵢ × (cᵢ − pᵢ), or sᵢ aᵢ, where cᵢ is the centre and sᵢ the share of the mass that it
    carries.
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
    share, points = carried[..., 3], at[..., :3, 3]
    own = carried[..., :3] / xp.where(share > 0, share, 1.0)[..., None]
    axes = xp.sum(at[..., :3, :3] * chain.axes[:, None, :], axis=-1)
    points = place[..., None, :] - own + points  # common centre − point = own − axis point
    turn = xp.broadcast_to(xp.eye(3, dtype=place.dtype), (*place.shape, 3))
    return Frames(position=place, rotation=turn, axes=axes, points=points, support=share)


def standing(chain: Model, q) -> Model:
    """The chain with constant frames as at q (n,), and with their derivatives by the joint values there.

    For functions that are differentiated only at q: many loops at rest there share the computation of the frames.
    """
    at = functools.partial(joint_frames, chain)
    return replace(chain, standing=(at(q), jax.jacfwd(at)(q)))


@jax.custom_jvp
def _standing(at, by_joint, q):
    return at


@_standing.defjvp
def _standing_jvp(primals, tangents):
    (moved, _, turned), by_joint = tangents, primals[1]
    return _standing(*primals), moved + by_joint @ turned


def jacobian_rows(chain: Model, at: Frames, linear, angular):
    """Rows of the geometric Jacobian (..., m, n), those of the axes `linear` and `angular` among 0, 1, 2.

    A revolute joint moves the tip by a × (p − pᵢ) and turns it by a; a prismatic one moves it by a.
    """
    xp = library(at.axes, at.points)
    velocity, spin = xp.cross(at.axes, at.position[..., None, :] - at.points), at.axes
    if chain.turning is not None:
        turning = chain.turning[:, None]
        velocity, spin = xp.where(turning, velocity, at.axes), xp.where(turning, spin, 0.0)
    if at.support is not None:
        velocity, spin = at.support[..., None] * velocity, at.support[..., None] * spin
    rows = xp.swapaxes(xp.concatenate([velocity, spin], axis=-1), -1, -2)
    rows = rows[..., np.array([*linear, *(3 + i for i in angular)], int), :]
    return rows if chain.mimic is None else rows @ chain.mimic[0]


def modelled(tree):
    """The tree with every `Chain` in it as a `Model`."""
    if isinstance(tree, Model):
        return tree
    if not hasattr(tree, "__dataclass_fields__"):
        return mapped(tree, Chain, modelled)
    return memoized(
        tree, "_modelled", _model if isinstance(tree, Chain) else lambda tree: mapped(tree, Chain, modelled)
    )


def _model(chain: Chain) -> Model:
    xp = np if all(map(errors.concrete, jax.tree.leaves(chain))) else jnp  # NumPy does not compile
    nothing = ((0.0,) * 3,) * 3

    def matrix(rotation, position=fixed.ZERO, last=0.0):
        return [*([*row, p] for row, p in zip(rotation, position, strict=True)), [0.0, 0.0, 0.0, last]]

    def parts(joint):
        """A, B, C and D."""
        own = [fixed.matmul(joint.origin.rotation, part) for part in fixed.rotation_parts(joint.axis)]
        still, sine, cosine = own if joint.kind == REVOLUTE else (joint.origin.rotation, nothing, nothing)
        away = fixed.ZERO if joint.kind != PRISMATIC else fixed.matvec(joint.origin.rotation, joint.axis)
        return matrix(still, joint.origin.position, 1.0), matrix(sine), matrix(cosine), matrix(nothing, away)

    *turns, slide = (xp.array(part) for part in zip(*map(parts, chain.joints), strict=True))
    turning = np.array([j.kind != PRISMATIC for j in chain.joints])
    slide, turning = (None, None) if turning.all() else (slide, turning)
    mimic = None
    if [(j.coordinate, j.multiplier, j.offset) for j in chain.joints] != [(i, 1.0, 0.0) for i in range(chain.n)]:
        onto = np.eye(chain.n)[[j.coordinate for j in chain.joints]]
        multipliers, offsets = (xp.array([getattr(j, name) for j in chain.joints]) for name in ("multiplier", "offset"))
        mimic = onto * multipliers[:, None], offsets

    limits = {name: getattr(chain, name) for name in ("lower", "upper", "velocity_limit")}

    def some(*names):
        return not all(type(x) is float and math.isinf(x) for name in names for x in limits[name])

    ways = [chain.way(i) for i in range(len(chain.tips))]
    moving = np.array([[float(i in way) for i in range(len(chain.joints))] for way in ways])
    return Model(
        n=chain.n,
        transforms=(*turns, slide),
        axes=xp.array([j.axis for j in chain.joints], float),
        turning=turning,
        mimic=mimic,
        balls=chain.balls,
        parents=chain.parents,
        tips=tuple(xp.array(matrix(t.offset.rotation, t.offset.position, 1.0)) for t in chain.tips),
        carriers=tuple(t.joint for t in chain.tips),
        tip_names=None if len(ways) == 1 else tuple(t.name for t in chain.tips),
        supports=None if moving.all() else moving,
        **{name: xp.array(bound, float) for name, bound in limits.items()},
        bounded=some("lower", "upper"),
        slowed=some("velocity_limit"),
    )


def one_off(fn=None, **options):
    """`jax.jit`, with its arguments. Chains become `Model`s before the call: one program serves robots of a shape."""
    if fn is None:
        return functools.partial(one_off, **options)
    jitted = bounded_jit(fn, **options)

    @functools.wraps(fn)
    def call(*args, **named):
        return jitted(*map(modelled, args), **named)

    return call


# --- forward kinematics: pose of a tip, geometric Jacobian, manipulability ----------------------------


@record
class Pose:
    """Position and orientation of a tip in the base frame."""

    position: Float[Array, " 3"]  # [m]
    rotation: Float[Array, "3 3"]  # the columns are the tip's axes


def as_joint_values(chain: Chain | Model, q, name="q", *, finite=False) -> Float[Array, " n"]:
    """q as a floating array (n,), checked."""
    n = errors.kind("chain", chain, (Chain, Model)).n
    q = errors.array(name, q, (n,), finite=finite)
    return q if isinstance(q, jax.Array) else jax.device_put(q)  # jnp.asarray would compile a program


def _computed(fn):
    """The arrays of fn(model, q), in a list: by NumPy, which does not compile, if all are numbers."""
    program = bounded_jit(lambda chain, q, tip: fn(cast(modelled(chain), q.dtype), q, tip), static_argnames="tip")

    def call(chain, q, tip):
        q, number = as_joint_values(chain, q), chain.tip_number(tip)
        if not all(map(errors.concrete, jax.tree.leaves((chain, q)))):
            return program(chain, q, tip=number)
        return [jax.device_put(v.astype(q.dtype)) for v in fn(modelled(chain), np.asarray(q, float), number)]

    return call


@_computed
def _pose(chain, q, tip):
    at = frames(chain, q, tip)
    return at.position, at.rotation


@_computed
def _jacobian(chain, q, tip):
    return [jacobian_rows(chain, frames(chain, q, tip), (0, 1, 2), (0, 1, 2))]


def forward(chain: Chain, q: Float[ArrayLike, " n"], *, tip: str | None = None) -> Pose:
    """Pose of a tip in the base frame, g(q) of Drexler (2016), Section II.

    Args:
      q: (n,) joint values [rad, m].
      tip: its name; None: the only one.
    Returns: `Pose`: position (3,) [m] and rotation (3, 3).
    Raises: ArgumentError if q does not have shape (n,), for an unknown tip, and for a missing name among several tips.
    """
    position, rotation = _pose(chain, q, tip)
    return Pose(position=position, rotation=rotation)


def jacobian(chain: Chain, q: Float[ArrayLike, " n"], *, tip: str | None = None) -> Float[Array, "6 n"]:
    """Geometric Jacobian J(q), (6, n): tip velocity (v, ω) = J q̇ in the base frame, linear rows first.

    Column i is (aᵢ × (p − pᵢ), aᵢ) for a revolute joint and (aᵢ, 0) for a prismatic one (Siciliano et al. 2009, eq.
    3.30). Units: m/s and rad/s per unit of q̇. A joint that does not move the tip has a column of zeros.

    Args: q, tip: as for `forward`.
    Raises: as `forward`.
    """
    return _jacobian(chain, q, tip)[0]


def manipulability(
    chain: Chain, q: Float[ArrayLike, " n"], task: Any = None, *, tip: str | None = None
) -> Float[Array, ""]:
    """Yoshikawa's measure w = √det(J Jᵀ), 0 at a singularity (Yoshikawa 1985, eq. 9).

    Args:
      q, tip: as for `forward`.
      task: a law's task, which names its own tips; default: the whole 6-row geometric Jacobian.
    """
    if not (task is None or isinstance(getattr(task, "targets", None), tuple)):  # a task's class is in a later room
        raise errors.fail("task", "be a Task such as position(), or None", f"is {task!r}")
    q = as_joint_values(chain, q)
    if task is None:
        return _manipulability(chain, None, q, tip=chain.tip_number(tip))
    task = task.about(tip)
    return _manipulability(chain, task.on(chain) if isinstance(chain, Chain) else task, q, tip=0)


@functools.partial(one_off, static_argnames="tip")
def _manipulability(chain, task, q, *, tip):
    chain = cast(modelled(chain), q.dtype)
    every = 0, 1, 2
    rows = jacobian_rows(chain, frames(chain, q, tip), every, every) if task is None else task.rows_at(chain, q)
    rows = rows if len(rows) <= chain.n else rows.T
    return safe_sqrt(jnp.maximum(jnp.linalg.det(rows @ rows.T), 0.0))
