"""Descent: from one posture to a target, or to the nearest pose: one try of a search, as a function of one lane.

With the error e (in units of length, then radians), the Jacobian J without the columns of joints that push against a
bound, and λ² = τ (0.03 ‖e‖² + λ₀²), a step is

  q ← clip(q + clip(Jᵀ (J Jᵀ + λ² I)⁻¹ e, ±1), low, high)

(Levenberg 1944; damping by the square of the error after Sugihara 2011). Plain descents have τ = 1. Careful ones reject
steps that raise the error, and raise τ (Marquardt 1963): they converge at bounds and singularities, and to the nearest
pose. The orientation's error is 2 sin(θ/2) times the axis: monotone up to half a turn, without an arctangent.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.engine.plan import in_c
from cnclik.integrate.lanes import Batches
from cnclik.law import dense
from cnclik.law.inverse import tiny_shift
from cnclik.precision import precise
from cnclik.reaching.result import ReachStatus
from cnclik.reaching.starts import Starts, start, starts_of, turned
from cnclik.record import Array, Bool, Float, Int, cast, memoized
from cnclik.robot.model import modelled
from cnclik.robot.posture import arm_length
from cnclik.robot.rotations import quaternion_from_rotation
from cnclik.task.parts import At, places
from cnclik.task.task import WIDTH, Task, aims, rows, told_apart

PLAIN, CAREFUL = 9, 24  # looks, at most, of plain descents and of careful ones
DOWNHILL = 150  # of those to the nearest pose
COARSE, SLOW = 2e-5, 30  # careful descents that are so close to the target have so many looks more
STUCK, STILL = 1e-5, 1e-10  # of `State.steep`: careful descents whose error falls so slowly end; to the nearest pose
OF_ERROR = 0.03  # λ² per squared error
LEAST_DAMPING = {32: 1e-6, 64: 1e-9}  # λ₀² by the bits of a number
LONGEST = 1.0  # [rad, m] largest joint step
SHRINK, GROW, LEAST_TRUST, MOST_TRUST = 0.5, 4.0, 1e-3, 1e12  # factors of τ after accepted and rejected steps; bounds
SHORT = 100.0  # of ‖J‖²: damped by more, steps are so short that an error which still grows with them is at a kink
CLOSE = 0.5  # [rad, m] from `near`: so close the first answer is the one that is wanted
AHEAD = 64  # targets that one call goes along a path
SMALLEST = 1e-5  # [m] shorter arms, such as a wrist alone, keep the metre


def unit_of(chain) -> float:
    """Return the length [m] that counts as much as a radian: a metre, but of arms of < 25 cm or > 4 m theirs."""
    length = arm_length(chain, least=0.0)
    revolute = errors.concrete(length) and "m" not in chain.units
    return float(length) if revolute and (SMALLEST < length < 0.25 or length > 4.0) else 1.0


class Terms(NamedTuple):
    """What all descents of a search share: numbers, or traced ones."""

    lower: Float[Array, " n"]
    upper: Float[Array, " n"]
    jump: Float[Array, ""]  # largest distance of a joint from `near` [rad, m]; infinite without one
    tolerance: Float[Array, " 2"]  # [m], chord of an angle [rad]
    roots: Float[Array, " m"]  # of the weights of the task's coordinates, lengths in units

    def box(self, near):
        """Return the bounds (n,) of answers about `near`: those of the limits nearest to it where it is beyond."""
        low = jnp.minimum(jnp.maximum(self.lower, near - self.jump), self.upper)
        return low, jnp.maximum(jnp.minimum(self.upper, near + self.jump), self.lower)


class State(NamedTuple):
    q: Float[Array, " n"]  # the next posture
    best: Float[Array, " n"]  # the posture with the least error so far
    squares: Float[Array, " 2"]  # its squared position and orientation error, the largest of all tips
    cost: Float[Array, ""]  # and their weighted sum; infinite before the first look
    steep: Float[Array, ""]  # squared length of the cost's free gradient there, over ‖e‖² ‖J‖²; 0 where no step helps
    trust: Float[Array, ""]  # τ
    looks: Int[Array, ""]
    arrived: Bool[Array, ""]


@precise
def look(chain, task: Task, q, target):
    """Return the error (m,), the robot there, and the squared errors of position and orientation of each tip.

    Args: target: (t,) twelve numbers of each of the task's aims [m].
    """
    at, each, squares = At(cast(modelled(chain), q.dtype), q), [], []
    for aim, wanted in zip(aims(task), target.reshape(-1, WIDTH), strict=True):
        place, turn = wanted[:3] - at.position(aim.tip, aim.to), wanted[3:].reshape(3, 3)
        chord = 2.0 * quaternion_from_rotation(turn @ at.rotation(aim.tip, aim.to).T)[1:]
        own = [(chord if part.turns else place)[places(part.axes)] for part in aim.parts]
        kinds = [[e @ e for e, part in zip(own, aim.parts, strict=True) if part.turns == turns] for turns in (0, 1)]
        each += own
        squares.append(jnp.stack([sum(some, 0.0 * q[0]) for some in kinds]))
    return jnp.concatenate(each), at, squares


@precise
def _step(chain, task, terms: Terms, s: State, target, bounds, careful) -> State:
    """Look at `q` and step from there; a descent that has arrived does not move."""
    e, at, squares = look(chain, task, s.q, target)
    j, squares = rows(task, at), functools.reduce(jnp.maximum, squares)
    if task.weights is not None or unit_of(chain) != 1.0:
        e, j = terms.roots * e, terms.roots[:, None] * j
    cost, size, here = e @ e, jnp.sum(j**2), (squares <= terms.tolerance**2).all()
    better, (low, high) = (cost <= s.cost) | ~careful | here, bounds
    helped = jnp.where(cost < s.cost, jnp.maximum(s.trust * SHRINK, LEAST_TRUST), s.trust)
    changed = jnp.where(better, helped, jnp.minimum(s.trust * GROW, MOST_TRUST))
    trust = jnp.where(careful, changed, s.trust)
    damping = trust * (OF_ERROR * cost + LEAST_DAMPING[jnp.finfo(cost.dtype).bits]) + tiny_shift(j)
    downhill = e @ j
    pushes = ((s.q <= low) & (downhill < 0)) | ((s.q >= high) & (downhill > 0))
    downhill, left = jnp.where(pushes, 0.0, downhill), jnp.where(pushes, 0.0, j)
    step = dense.cholesky_solve(dense.cholesky(dense.shifted(left @ left.T, damping)), e) @ left
    steep = downhill @ downhill / jnp.where(cost * size > 0, cost * size, 1.0)
    steep = jnp.where((trust > 1) & (damping > SHORT * size), 0.0, steep)  # at a kink
    best = jnp.where(better, s.q, s.best)
    onward = jnp.where(better, jnp.clip(s.q + jnp.clip(step, -LONGEST, LONGEST), low, high), best)
    pairs = (squares, s.squares), (cost, s.cost), (steep, s.steep)
    squares, cost, steep = (jnp.where(better, new, old) for new, old in pairs)
    return State(jnp.where(here, s.q, onward), best, squares, cost, steep, trust, s.looks + 1, here)


def descend(chain, task: Task, terms: Terms, q, target, near, most) -> Array:
    """Descend from a posture (n,) by at most `most` looks. Returns: the row of `result.Row`.

    Args: near: (n,), NaN where there is none.
    """
    careful, around, zero = most > PLAIN, jnp.where(jnp.isnan(near), 0.0, near), 0.0 * q[0]
    low, high = terms.box(around)
    q = jnp.clip(q, low, high)

    def goes_on(s):
        close = careful & (s.cost <= COARSE**2)  # as next to singularities, where errors fall slowly
        stuck = careful & ~close & (s.steep <= jnp.where(most <= CAREFUL, STUCK, STILL))
        return ~s.arrived & (s.looks < most + jnp.where(close, SLOW, 0)) & ~stuck

    far = zero + jnp.inf
    begin = State(q, q, jnp.stack([far, far]), far, far, zero + 1.0, 0 * most, zero > 1)
    s = lax.while_loop(goes_on, lambda s: _step(chain, task, terms, s, target, (low, high), careful), begin)
    q = jnp.clip(turned(s.best, around, np.array(chain.periodic), low, high, jnp), low, high)
    distance, (position, chord) = jnp.max(jnp.abs(q - near)), jnp.sqrt(s.squares)
    arrived = s.arrived & ~(distance > terms.jump * (1 + 1e-9))  # as where `near` is beyond the limits
    status = jnp.where(arrived, int(ReachStatus.SOLVED), int(ReachStatus.OUT_OF_BUDGET))
    turn, cost = 2.0 * jnp.arcsin(jnp.minimum(chord / 2, 1.0)), jnp.where(s.arrived & ~arrived, jnp.inf, s.cost)
    rest = status, position, turn, distance, cost, s.steep
    return jnp.concatenate([q, jnp.stack([jnp.asarray(v, q.dtype) for v in rest])])


def attempt(chain, task, starts: Starts, terms: Terms, target, near, given, away, k, most) -> Array:
    """Make try `k`, see `starts.start`, by at most `most` looks. Returns: the row of `result.Row`."""
    low, high = terms.box(jnp.where(jnp.isnan(near), 0.0, near))
    q = start(chain, task, starts, target, given, away, low, high, k)
    return descend(chain, task, terms, q, target, near, most)


def along(chain, task, terms: Terms, target, near):
    """Go along targets (N, t), plainly from each answer to the next one.

    Returns: rows (N, width); those after the first that is no answer, or not CLOSE, mean nothing.
    """

    def once(near, target):
        row = descend(chain, task, terms, near, target, near, np.int32(PLAIN))
        return row[: chain.n], row

    return lax.scan(once, near, target)[1]


def programs(chain, task, path=False) -> Batches:
    """Return `attempt`, or `along` AHEAD targets, for batches of the leaves of their arguments from the third on.

    They are made once for a chain, a task's aims and the engine that is chosen.
    """
    q, target, number = np.zeros(chain.n), np.zeros(WIDTH * len(aims(task))), np.int32(0)
    starts, terms = starts_of(chain, task), Terms._make((q, q, 0.0, np.zeros(2), np.zeros(task.m)))
    of_try, of_path = (starts, terms, target, q, q, 0.0, number, number), (terms, np.tile(target, (AHEAD, 1)), q)
    fn, args = (along, of_path) if path else (attempt, of_try)
    (leaves, tree), made = jax.tree.flatten(args), jax.tree.unflatten
    avals = [jax.ShapeDtypeStruct(np.shape(v), np.asarray(v).dtype) for v in leaves]
    key = f"_{fn.__name__}_{told_apart(task)}_{task.weights is None}_{in_c()}"
    return memoized(chain, key, lambda _: Batches(lambda *v: fn(chain, task, *made(tree, v)), avals, single=path))
