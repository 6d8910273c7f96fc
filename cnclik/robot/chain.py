"""Chain: a robot from base to tip, or a tree with several tips, and the functions that build one.

Geometry in Python floats is compiled in. Geometry in arrays (link lengths to calibrate, a tool to sweep) stays a
parameter. See `cnclik.record`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import jax
import numpy as np

from cnclik import errors
from cnclik.record import ArrayLike, Float, Number, record
from cnclik.robot import poses
from cnclik.robot.fixed import Offset, Triple, compose, is_number, turn
from cnclik.robot.tree import BALL, MOST

Names = Sequence[str] | None
Masses = tuple[tuple[Number, Triple], ...]  # masses [kg] and their centres in the frame of what carries them [m]
REVOLUTE, PRISMATIC = "revolute", "prismatic"


@record
class Joint:
    """One joint. Its value is `multiplier · q[coordinate] + offset`: mimic joints share a coordinate."""

    kind: str  # "revolute", "prismatic", or "rotation" for three in a row that form one, see `cnclik.robot.chart`
    axis: Triple  # unit vector in the joint's own frame
    origin: Offset
    coordinate: int
    multiplier: Number = 1.0
    offset: Number = 0.0
    parent: int | None = None  # index of the joint that carries it, −1 for the base; None: the previous one
    follower: str = ""  # the name of a mimic joint


@record
class Tip:
    """A frame that a task can control."""

    name: str
    joint: int  # index of the joint that carries it
    offset: Offset  # its pose relative to that joint


@record
class Chain:
    """A robot with `n` joint coordinates q [rad for revolute joints, m for prismatic ones]: an arm, or a tree."""

    joints: tuple[Joint, ...]  # in topological order; mimic joints share a coordinate
    tips: tuple[Tip, ...]  # an arm has one tip
    joint_names: tuple[str, ...]  # (n,) of the joint coordinates
    lower: tuple[Number, ...]  # (n,) lower limits [rad or m], −inf where unlimited
    upper: tuple[Number, ...]  # (n,) upper limits [rad or m], inf where unlimited
    velocity_limit: tuple[Number, ...]  # (n,) [rad/s or m/s], inf where unlimited
    masses: Masses = ()  # of the base, then of each joint, with all links fixed to it; () if they are unknown

    def __post_init__(self):
        known = {}
        for name, least in (("lower", None), ("upper", None), ("velocity_limit", 0)):
            parts = values if isinstance(values := getattr(self, name), (tuple, list)) else ()
            if any(map(np.ndim, parts)) or not all(map(errors.concrete, (values, *parts))):
                continue  # traced, or of several lanes
            known[name] = np.asarray(errors.array(name, values, (self.n,), finite=False, at_least=least))
            if np.isnan(known[name]).any():
                raise errors.fail(name, "hold no NaN", f"is {tuple(known[name].tolist())}")
        for name, low, high in zip(self.joint_names, known.get("lower", ()), known.get("upper", ()), strict=False):
            if low > high:
                raise errors.fail("lower", "not exceed `upper`", f"is {low:g} > {high:g} at joint {name}")

    @property
    def n(self) -> int:
        """Number of joint coordinates."""
        return len(self.joint_names)

    @property
    def parents(self) -> tuple[int, ...]:
        """For each joint the index of the joint that carries it; −1 for the base."""
        return tuple(i - 1 if joint.parent is None else joint.parent for i, joint in enumerate(self.joints))

    def tip_number(self, tip: str | None = None) -> int:
        """Return the index of the tip with this name; None: the only tip. Raises: ArgumentError."""
        names = [t.name for t in self.tips]
        if tip is not None:
            return names.index(errors.one_of("tip", tip, names))
        if len(names) > 1:
            raise errors.fail("tip", "be given for a robot with several", f"is not; the tips are {', '.join(names)}")
        return 0

    def way(self, tip: int) -> list[int]:
        """Return the indices of the joints from the base to the tip with this index."""
        indices, parents, i = [], self.parents, self.tips[tip].joint
        while i >= 0:
            indices.append(i)
            i = parents[i]
        return indices[::-1]

    @property
    def balls(self) -> tuple[tuple[int, int], ...]:
        """(index of the first joint, its coordinate) for each rotation made of three joints."""
        return tuple((i, j.coordinate) for i, j in enumerate(self.joints) if j.kind == BALL)[::3]

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each joint coordinate, "rad" or "m": that of the first joint it drives."""
        kinds = {joint.coordinate: joint.kind for joint in reversed(self.joints)}
        return tuple("m" if kinds.get(i) == PRISMATIC else "rad" for i in range(self.n))

    @property
    def periodic(self) -> tuple[bool, ...]:
        """For each coordinate, whether a whole turn changes nothing: its joints all rotate, by whole multiples."""
        whole = [is_number(j.multiplier) and float(j.multiplier).is_integer() for j in self.joints]
        slow = {j.coordinate for j, by in zip(self.joints, whole, strict=True) if j.kind != REVOLUTE or not by}
        return tuple(i not in slow for i in range(self.n))

    def __repr__(self):
        kinds = "".join({REVOLUTE: "R", PRISMATIC: "P", BALL: "B"}[j.kind] for j in self.joints)
        tips = f", tips={[t.name for t in self.tips]}" if len(self.tips) > 1 else ""
        return f"Chain({kinds}, joint_names={list(self.joint_names)}{tips})"


def planar_arm(lengths: Float[ArrayLike, " n"], *, clockwise: bool = False, joint_names: Names = None) -> Chain:
    """Return a planar arm of revolute joints about z; at q = 0 it lies along +y (Drexler 2016, Section V).

    Args:
      lengths: (n,) link lengths [m]. A list of floats is compiled in, an array is a differentiable leaf.
      clockwise: positive angles turn clockwise seen from +z (axes along −z). The paper's text does not fix
        the sense; only the clockwise one starts its Case II on the path.
      joint_names: names, by default q1 … qn.
    """
    lengths = _scalars("lengths", lengths)
    for i, length in enumerate(lengths):
        errors.number(f"lengths[{i}]", length, at_least=0)
    axis = (0.0, 0.0, -1.0 if errors.truth("clockwise", clockwise) else 1.0)
    origins = [Offset(position=(0.0, step, 0.0)) for step in (0.0, *lengths[:-1])]
    joints = [Joint(kind=REVOLUTE, axis=axis, origin=origin, coordinate=i) for i, origin in enumerate(origins)]
    return assemble(joints, Offset(position=(0.0, lengths[-1], 0.0)), joint_names=joint_names)


def from_dh(
    a: Float[ArrayLike, " n"],
    alpha: Float[ArrayLike, " n"],
    d: Float[ArrayLike, " n"],
    theta: Float[ArrayLike, " n"] | None = None,
    *,
    convention: str = "standard",
    kinds: str | None = None,
    joint_names: Names = None,
    lower: Float[ArrayLike, " n"] | None = None,
    upper: Float[ArrayLike, " n"] | None = None,
    velocity_limit: Float[ArrayLike, " n"] | None = None,
) -> Chain:
    """Return the chain of Denavit-Hartenberg parameters; `with_base` and `with_tool` put fixed poses around it.

    standard: Rot_z(θ) Trans_z(d) Trans_x(a) Rot_x(α) per joint (Siciliano et al. 2009, eq. 2.52);
    modified: Rot_x(α) Trans_x(a) Rot_z(θ) Trans_z(d) (Craig 2005, eq. 3.6).

    Args:
      a, d: (n,) link lengths and offsets [m].
      alpha: (n,) link twists [rad] (no relation to the gain).
      theta: (n,) joint angle offsets [rad], 0 by default; the fixed angle of a prismatic joint.
      convention: "standard" or "modified".
      kinds: string such as "RRP", by default all revolute; for P, q adds to d.
      joint_names, lower, upper, velocity_limit: (n,) names, joint limits and velocity limits.
    """
    a = _scalars("a", a)
    n = len(a)
    alpha, d = _scalars("alpha", alpha, n), _scalars("d", d, n)
    theta = _scalars("theta", (0.0,) * n if theta is None else theta, n)
    modified = errors.one_of("convention", convention, ("standard", "modified")) == "modified"
    kinds = "R" * n if kinds is None else kinds
    if not isinstance(kinds, str) or len(kinds) != n or not set(kinds) <= {"R", "P"}:
        raise errors.fail("kinds", f"be {n} letters R or P", f"is {kinds!r}")
    joints, before = [], Offset()
    for i, letter in enumerate(kinds):
        along_x = Offset(position=(a[i], 0.0, 0.0), rotation=turn((1.0, 0.0, 0.0), alpha[i]))
        along_z = Offset(position=(0.0, 0.0, d[i]), rotation=turn((0.0, 0.0, 1.0), theta[i]))
        before = compose(before, along_x) if modified else before
        # Rot_z(θ + q) Trans_z(d) commute with the joint's own motion about or along z.
        kind = REVOLUTE if letter == "R" else PRISMATIC
        joints.append(Joint(kind=kind, axis=(0.0, 0.0, 1.0), origin=before, coordinate=i))
        before = along_z if modified else compose(along_z, along_x)
    return assemble(joints, before, joint_names=joint_names, lower=lower, upper=upper, velocity_limit=velocity_limit)


def assemble(
    joints: Iterable[Joint],
    tip: Offset | tuple[Tip, ...] | None = None,
    *,
    joint_names: Names = None,
    lower: Float[ArrayLike, " n"] | None = None,
    upper: Float[ArrayLike, " n"] | None = None,
    velocity_limit: Float[ArrayLike, " n"] | None = None,
    masses: Masses = (),
) -> Chain:
    """Return a chain of joints built one by one, with its arguments checked.

    Args: tip: an `Offset` from the last joint, or the `Tip`s.
    """
    joints = tuple(joints)
    if not joints:
        raise errors.fail("joints", "hold at least one joint", "is empty")
    n = 1 + max(j.coordinate for j in joints)
    names = tuple(f"q{i + 1}" for i in range(n)) if joint_names is None else joint_names
    texts = isinstance(names, (list, tuple)) and all(isinstance(v, str) for v in names)
    if not texts or len(names) != n or len(set(names)) != n:
        raise errors.fail("joint_names", f"hold {n} different names", f"is {joint_names!r}")
    limits = {"lower": (lower, -math.inf), "upper": (upper, math.inf), "velocity_limit": (velocity_limit, math.inf)}
    bounds = {
        name: (default,) * n if values is None else tuple(map(float, errors.array(name, values, (n,), finite=False)))
        for name, (values, default) in limits.items()
    }
    tips = tip if isinstance(tip, tuple) else (Tip(name="tip", joint=len(joints) - 1, offset=tip or Offset()),)
    return Chain(joints=joints, tips=tips, joint_names=tuple(names), masses=masses, **bounds)


# --- reading arguments --------------------------------------------------------------------------------


def _scalars(name, values, size=None) -> tuple:
    """Return a sequence as a tuple of scalars: Python numbers stay literal, entries of an array stay leaves."""
    scalars = tuple(values if isinstance(values, (list, tuple)) else errors.array(name, values, (None,)))
    if not scalars or (size is not None and len(scalars) != size):
        raise errors.fail(name, f"have shape ({size or 'n'},)", f"has shape ({len(scalars)},)")
    for i, value in enumerate(scalars):
        errors.number(f"{name}[{i}]", value)
        if is_number(value) and abs(value) > MOST:
            raise errors.fail(f"{name}[{i}]", f"be within ±{MOST:g}", f"is {value:g}")
    return tuple(float(v) if is_number(v) else v for v in scalars)


def offset_of(name, transform) -> Offset:
    """Return the offset of a pose (see `poses.whole`), or a position (3,); None is the identity. Lists stay literal."""
    if transform is None or isinstance(transform, Offset):
        return transform or Offset()
    pose = poses.whole(name, transform)
    if pose is None and len(poses.shape_of(transform)) == 1:
        return Offset(position=_scalars(name, transform, 3))
    if pose is None or np.ndim(pose[0]) != 1:
        raise errors.fail(name, f"be one pose: {poses.FORMS}, or a position (3,)", f"is {transform!r}")
    if all(map(is_number, jax.tree.leaves(transform))):
        pose = [part.tolist() for part in pose]
    position, rotation = pose
    return Offset(position=_scalars(name, position, 3), rotation=tuple(_scalars(name, row, 3) for row in rotation))
