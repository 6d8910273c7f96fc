"""The rolled form: the joints are an axis of arrays, and geometry is a parameter.

The unrolled form writes a robot out, number by number: its programs are as quick as can be, and take seconds to
compile. Rolled, a robot is a handful of arrays that a short loop over the joints reads: a hundred times slower to run
side by side, ten to a hundred times sooner ready, and one program serves all robots with as many joints. Between the
two stands the unrolled form, compiled `quickly`. Joint i's transform is affine in the sine and cosine of its value and
in the value itself,

  Tᵢ(v) = Aᵢ + sin(v) Bᵢ + cos(v) Cᵢ + v Dᵢ  (4×4),

so it is known from four of its values, and these come from the unrolled form's own code.
"""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.cache import bounded_jit
from cnclik.hints import form, in_a_kernel, quick_jit, use_form, use_hints
from cnclik.record import kept, mapped, record
from cnclik.robot import spatial as sp
from cnclik.robot.chain import REVOLUTE, Chain
from cnclik.robot.frames import Frames, frames, jacobian_rows, link

# Evaluations of f, for each joint and each task coordinate, up to which, compiling included, the sooner one is: of the
# rolled form compiled with fewest passes, the rolled form, and the unrolled one compiled with fewest passes.
ROLLED_QUICK = 1 << 10
ROLLED = 1 << 14
QUICK = 1 << 20


@record
class RolledChain:
    """A `Chain` as arrays: j joints, n coordinates."""

    transforms: tuple  # A, B, C, D as above, (j, 4, 4) each; D is None where all joints are revolute
    axes: object  # (j, 3) unit vectors in the joints' own frames
    turning: object  # (j,) true for revolute joints; None where all are
    mimic: object  # (multipliers (j, n), offsets (j,)) of the joint values; None where they are the coordinates
    tip: object  # (4, 4)
    lower: object  # (n,) as in `Chain`
    upper: object
    velocity_limit: object

    @property
    def n(self) -> int:
        """Number of joint coordinates."""
        return self.lower.shape[-1]


def pays(evaluations, law=None) -> bool:
    """Whether a call of so many evaluations of a law's f, None for unknown, should run in the rolled form.

    `cnclik.use_form` overrides it. A GPU's kernel is always unrolled, as it has no arrays to index, and so is what runs
    on one unasked: small operations one after the other are what it is slow at.
    """
    if in_a_kernel():
        return False
    if form():
        return form() == "rolled"
    if evaluations is None or jax.default_backend() != "cpu":
        return False
    return evaluations <= ROLLED * _size(law)


def quickly(evaluations, law) -> bool:
    """Whether a program of many lanes, for so many evaluations of a law's f, should be compiled `quick`.

    See `cnclik.lanes`. Not where `cnclik.use_form` asks for the quicker form to run.
    """
    most = ROLLED_QUICK if pays(evaluations, law) else QUICK
    return form() != "unrolled" and jax.default_backend() == "cpu" and evaluations <= most * _size(law)


def _size(law) -> int:
    return law.chain.n * law.task.m if hasattr(law, "task") else 1


def in_form(law, q, evaluations=None):
    """A law, or a chain, and q (n,) in the form that pays: rolled, or unrolled with a tuple for q."""
    if isinstance(getattr(law, "chain", law), RolledChain):
        return law, q
    return (roll(law), q) if pays(evaluations, law) else (law, tuple(q))


def roll(tree):
    """The tree with every `Chain` in it rolled."""
    if not hasattr(tree, "__dataclass_fields__"):
        return mapped(tree, Chain, roll)
    return kept(tree, "_rolled", _rolled if isinstance(tree, Chain) else lambda tree: mapped(tree, Chain, roll))


def sooner():
    """Context manager: programs of a question that is asked once, in the rolled form unless `use_form` differs."""
    return use_form(form() or "rolled")


def one_off(fn=None, *, as_given=False, **options):
    """`jax.jit`, with its arguments, for programs that are run `sooner`.

    Chains among the arguments are rolled before the call, so that one program serves all robots of a shape; unless
    they are wanted `as_given`, by a function that changes their links or has one for each lane.
    """
    if fn is None:
        return functools.partial(one_off, as_given=as_given, **options)
    jitted, quick = bounded_jit(fn, **options), quick_jit(fn, **options)

    @functools.wraps(fn)
    def call(*args, **named):
        if not all(map(errors.concrete, jax.tree.leaves((args, named)))):
            return jitted(*args, **named)  # part of another program, whose form it takes
        with sooner():
            if not pays(1):
                return jitted(*args, **named)
            return quick(*(args if as_given else map(roll, args)), **named)

    return call


def _rolled(chain: Chain) -> RolledChain:
    known = all(map(errors.concrete, jax.tree.leaves(chain)))
    xp = np if known else jnp  # NumPy compiles nothing
    if known:
        chain = jax.tree.map(np.asarray, chain)

    def matrix(position, rotation):
        rows = [[*row, p] for row, p in zip(rotation, position, strict=True)]
        return xp.array([*rows, [0.0, 0.0, 0.0, 1.0]])

    def at(*motion):  # value, sine, cosine
        with use_hints(False):
            return xp.stack([matrix(*link(j, sp.ZERO, sp.IDENTITY, *motion)[:2]) for j in chain.joints])

    zero = at(0.0, 0.0, 0.0)
    turning = np.array([j.kind == REVOLUTE for j in chain.joints])
    slide, turning = (None, None) if turning.all() else (at(1.0, 0.0, 0.0) - zero, turning)
    mimic = None
    if [(j.coordinate, j.multiplier, j.offset) for j in chain.joints] != [(i, 1.0, 0.0) for i in range(chain.n)]:
        onto = np.eye(chain.n)[[j.coordinate for j in chain.joints]]
        multipliers, offsets = (xp.array([getattr(j, name) for j in chain.joints]) for name in ("multiplier", "offset"))
        mimic = onto * multipliers[:, None], offsets
    return RolledChain(
        transforms=(zero, at(0.0, 1.0, 0.0) - zero, at(0.0, 0.0, 1.0) - zero, slide),
        axes=xp.array([j.axis for j in chain.joints]),
        turning=turning,
        mimic=mimic,
        tip=matrix(chain.tip.position, chain.tip.rotation),
        **{name: xp.asarray(getattr(chain, name), float) for name in ("lower", "upper", "velocity_limit")},
    )


@frames.register
def _(chain: RolledChain, q) -> Frames:
    """All frames of the chain at q (n,), as arrays: NumPy's where all are numbers, and then also of (..., n)."""
    xp = sp.library(q, chain.tip)
    values = q if chain.mimic is None else sp.combine(q, chain.mimic[0].T) + chain.mimic[1]
    factors = (xp.ones_like(values), xp.sin(values), xp.cos(values), values)
    parts = zip(factors, chain.transforms, strict=True)
    own = sum(f[..., None, None] * part for f, part in parts if part is not None)

    at = list(itertools.accumulate((own[..., i, :, :] for i in range(own.shape[-3])), sp.matmul))
    tip = sp.matmul(at[-1], chain.tip)
    at = xp.stack(at, -3)
    axes = xp.sum(at[..., :3, :3] * chain.axes[:, None, :], axis=-1)
    return Frames(position=tip[..., :3, 3], rotation=tip[..., :3, :3], axes=axes, points=at[..., :3, 3])


@jacobian_rows.register
def _(chain: RolledChain, at: Frames, linear, angular):
    xp = sp.library(at.axes, at.points)
    velocity, spin = xp.cross(at.axes, at.position[..., None, :] - at.points), at.axes
    if chain.turning is not None:
        turning = chain.turning[:, None]
        velocity, spin = xp.where(turning, velocity, at.axes), xp.where(turning, spin, 0.0)
    rows = xp.swapaxes(xp.concatenate([velocity, spin], axis=-1), -1, -2)
    asked = (*linear, *(3 + i for i in angular))
    rows = sp.pick(rows, asked) if rows.ndim == 2 else rows[..., asked, :]
    return rows if chain.mimic is None else sp.matmul(rows, chain.mimic[0])
