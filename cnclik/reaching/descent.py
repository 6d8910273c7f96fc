"""Descent: from one posture to a target, or to the nearest pose: one try of a search, as a function of one lane.

With the error e (in units of length, then radians), the Jacobian J without the columns of joints that push against a
bound, and λ² = τ (0.03 ‖e‖² + λ₀²), a step is

  q ← clip(q + clip(Jᵀ (J Jᵀ + λ² I)⁻¹ e, ±1), low, high)

(Levenberg 1944; damping by the square of the error after Sugihara 2011). Far from the pose steps are short, near it
they are Newton's. Plain descents have τ = 1. Careful ones reject steps that raise the error, and raise τ (Marquardt
1963): they converge at bounds and singularities, and to the nearest pose where there is no answer. The orientation's
error is 2 sin(θ/2) times the axis: monotone up to half a turn, without an arctangent.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik.engine.plan import in_c
from cnclik.integrate.batches import Batches
from cnclik.law import dense
from cnclik.law.inverse import tiny_shift
from cnclik.precision import precise
from cnclik.reaching.result import ReachStatus, row_of
from cnclik.reaching.starts import Starts, binned, empty, is_free, start, turned
from cnclik.reaching.units import per_unit, unit_of
from cnclik.record import Array, Bool, Float, Int, cast, memoized
from cnclik.robot.model import modelled
from cnclik.robot.rotations import quaternion_from_rotation
from cnclik.task.parts import At, places
from cnclik.task.task import WIDTH, Task, aims, rows, told_apart

PLAIN, CAREFUL, DOWNHILL = (
    9,
    24,
    150,
)  # looks, at most: of plain descents, of careful ones, of those to the nearest pose
COARSE, SLOW = 2e-5, 30  # careful descents that are so close to the target have so many looks more
STUCK, STILL = 1e-5, 1e-10  # of `State.steep`: careful descents whose error falls so slowly end; to the nearest pose
OF_ERROR = 0.03  # λ² per squared error
LEAST_DAMPING = {32: 1e-6, 64: 1e-9}  # λ₀² by the bits of a number
LONGEST = 1.0  # [rad, units] largest joint step
SHRINK, GROW, LEAST_TRUST = 0.5, 4.0, 1e-3  # factors of τ after an accepted and after a rejected step
MOST_TRUST = 1e12
SHORT = 100.0  # of ‖J‖²: damped by more, steps are so short that an error which still grows with them is at a kink
TOUCHING = 1e-9  # [rad, units] distance from a limit that counts as being at it
CLOSE = 0.5  # [rad, m] from `near`: so close the first answer is the one that is wanted
FREE = -1.0  # status of a descent that arrives where it is free of all bounds


class Terms(NamedTuple):
    """What all descents of a search share: numbers, or traced ones."""

    lower: Float[Array, " n"]
    upper: Float[Array, " n"]
    jump: Float[Array, ""]  # largest distance of a joint from `near` [rad, m]; infinite without one
    tolerance: Float[Array, " 2"]  # [units], chord of an angle [rad]
    roots: Float[Array, " m"]  # of the weights of the task's coordinates

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
    """Return the error (m,), J (m, n), and the squared errors of position and orientation, the largest of all tips.

    All are in the chain's unit, see `units`. Args: target: (t,) twelve numbers of each of the task's aims [m].
    """
    at, unit, each, squares = At(cast(modelled(chain), q.dtype), q), unit_of(chain), [], []
    for aim, wanted in zip(aims(task), target.reshape(-1, WIDTH), strict=True):
        place, turn = (wanted[:3] - at.position(aim.tip, aim.to)) / unit, wanted[3:].reshape(3, 3)
        chord = 2.0 * quaternion_from_rotation(turn @ at.rotation(aim.tip, aim.to).T)[1:]
        own = [(chord if part.turns else place)[places(part.axes)] for part in aim.parts]
        kinds = [[e @ e for e, part in zip(own, aim.parts, strict=True) if part.turns == turns] for turns in (0, 1)]
        each += own
        squares.append(jnp.stack([sum(some, 0.0 * q[0]) for some in kinds]))
    j = rows(task, at)
    if unit != 1.0:
        j = j * per_unit(chain) / np.where(np.isin(np.arange(task.m), task.lengths), unit, 1.0)[:, None]
    return jnp.concatenate(each), j, functools.reduce(jnp.maximum, squares)


@precise
def _step(chain, task, terms: Terms, s: State, target, bounds, careful) -> State:
    """Look at `q` and step from there; a descent that has arrived does not move."""
    e, j, squares = look(chain, task, s.q, target)
    if task.weights is not None:
        e, j = terms.roots * e, terms.roots[:, None] * j
    cost, size, (low, high) = e @ e, jnp.sum(j**2), bounds
    better, here = (cost <= s.cost) | ~careful, (squares <= terms.tolerance**2).all()
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
    step = jnp.asarray(per_unit(chain), step.dtype) * jnp.clip(step, -LONGEST, LONGEST)
    best = jnp.where(better, s.q, s.best)
    onward = jnp.where(better, jnp.clip(s.q + step, low, high), best)
    squares, cost, steep = jax.tree.map(
        lambda new, old: jnp.where(better, new, old), (squares, cost, steep), (s.squares, s.cost, s.steep)
    )
    return State(jnp.where(here, s.q, onward), best, squares, cost, steep, trust, s.looks + 1, here)


def descend(chain, task: Task, terms: Terms, q, target, near, most, free) -> Array:
    """Descend from a posture (n,) by at most `most` looks. Returns: the row of `result.Row`.

    Args: near: (n,), NaN where there is none. free: whether bounds are ignored: the row has the posture within them.
    """
    careful, around, zero = most > PLAIN, jnp.where(jnp.isnan(near), 0.0, near), 0.0 * q[0]
    low, high = terms.box(around)
    free = free & (jnp.isfinite(low) | jnp.isfinite(high)).any()
    bounds, q = (jnp.where(free, -jnp.inf, low), jnp.where(free, jnp.inf, high)), jnp.clip(q, low, high)

    def goes_on(s):
        close = careful & (s.squares <= COARSE**2).all()  # as next to singularities, where errors fall slowly
        stuck = careful & ~close & (s.steep <= jnp.where(most <= CAREFUL, STUCK, STILL))
        return ~s.arrived & (s.looks < most + jnp.where(close, SLOW, 0)) & ~stuck

    far = zero + jnp.inf
    begin = State(q, q, jnp.stack([far, far]), far, far, zero + 1.0, 0 * most, zero > 1)
    s = lax.while_loop(goes_on, lambda s: _step(chain, task, terms, s, target, bounds, careful), begin)
    q = jnp.clip(turned(s.best, around, np.array(chain.periodic), low, high, jnp), low, high)
    touching = jnp.asarray(TOUCHING * per_unit(chain), q.dtype)
    at_limit = (q <= terms.lower + touching) | (q >= terms.upper - touching)
    status = jnp.where(s.arrived, jnp.where(free, FREE, int(ReachStatus.SOLVED)), int(ReachStatus.OUT_OF_BUDGET))
    position, turn = unit_of(chain) * jnp.sqrt(s.squares[0]), jnp.minimum(jnp.sqrt(s.squares[1]) / 2, 1.0)
    cost = jnp.where(free, jnp.inf, s.cost)
    rest = status, position, 2.0 * jnp.arcsin(turn), s.looks, jnp.max(jnp.abs(q - near)), cost, s.steep
    return jnp.concatenate([q, at_limit.astype(q.dtype), jnp.stack([jnp.asarray(v, q.dtype) for v in rest])])


def attempt(chain, task, starts: Starts, terms: Terms, target, near, given, away, k, most, seed) -> Array:
    """Make one try. Returns: the row of `result.Row`.

    Args:
      near: (n,), NaN where there is none. given, away: see `starts.start`.
      k: int32, the number of the try. most: int32, looks. seed: int32.
    """
    low, high = terms.box(jnp.where(jnp.isnan(near), 0.0, near))
    q = start(chain, task, starts, target, given, away, low, high, k, seed)
    return descend(chain, task, terms, q, target, near, most, is_free(k))


def tips(chain, task, q):
    """Return the poses (t,) of a task's aims, as targets have them."""
    at = At(cast(modelled(chain), q.dtype), q)
    each = [(at.position(a.tip, a.to), at.rotation(a.tip, a.to).reshape(9)) for a in aims(task)]
    return jnp.concatenate([v for pair in each for v in pair])


def along(chain, task, terms: Terms, target, near):
    """Go along targets (N, t), plainly from each answer to the next one, until there is none that is CLOSE.

    Returns: rows (N, width); of targets beyond that one they mean nothing.
    """

    def once(carry, target):
        near, going = carry
        row = descend(chain, task, terms, near, target, near, jnp.where(going, PLAIN, 0).astype(np.int32), False)
        made = row_of(row, chain.n)
        going = going & (made.status == ReachStatus.SOLVED) & (made.distance <= CLOSE)
        return (jnp.where(going, made.q, near), going), row

    return lax.scan(once, (near, jnp.bool_(True)), target)[1]


# --- for batches of NumPy's numbers -----------------------------------------------------------------------


class Attempts:
    """`attempt` for batches, with the starts of a chain."""

    def __init__(self, chain, task):
        n, t, f, i = chain.n, WIDTH * len(aims(task)), np.float64, np.int32
        self.chain, self.task, self.kept, self.nowhere = chain, task, {}, np.full(n, np.nan)
        self.terms = [jax.ShapeDtypeStruct(shape, f) for shape in ((n,), (n,), (), (2,), (task.m,), (t,), (n,))]
        avals = [*(jax.ShapeDtypeStruct(v.shape, v.dtype) for v in empty(chain, task)), *self.terms]
        avals += [jax.ShapeDtypeStruct(*of) for of in (((n,), f), ((), f), ((), i), ((), i), ((), i))]

        def flat(*args):
            return attempt(chain, task, Starts(*args[:3]), Terms(*args[3:8]), *args[8:])

        self.starts, self.program = starts_of(chain, task), Batches(flat, avals)

    def __call__(self, terms: Terms, pose, near, given, away, k, most, seed, pool=None) -> np.ndarray:
        """Return the rows of tries k of targets (T, t), or of one target; see `attempt`.

        Args: near, given: or None. pool: threads for more than a few tries.
        """
        bound = self.kept.get(id(terms))
        if bound is None:
            bound = self.kept[id(terms)] = self.program.bound(*self.starts, *terms), terms
        near, given = self.nowhere if near is None else near, self.nowhere if given is None else given
        return bound[0]((pose, near, given, away, k, most, seed), len(k), pool)

    def along(self, terms: Terms, count):
        """Return `along` for `count` targets."""
        *shared, target, near = self.terms

        def flat(*args):
            return along(self.chain, self.task, Terms(*args[:5]), *args[5:])

        avals = [*shared, jax.ShapeDtypeStruct((count, *target.shape), target.dtype), near]
        program = memoized(self, f"_along_{count}", lambda _: Batches(flat, avals, single=True))
        return program.bound(*terms)


def starts_of(chain, task) -> Starts:
    """Return the starts of a chain, made once for it and a task's aims."""

    def make(chain):
        q = jax.ShapeDtypeStruct((chain.n,), np.float64)
        with jax.ensure_compile_time_eval():
            call = Batches(functools.partial(tips, chain, task), [q]).bound()
            return binned(chain, task, lambda q: call((q,), len(q)))

    return memoized(chain, f"_starts_{told_apart(task)}", make)


def attempts(chain, task) -> Attempts:
    """Return the tries of a chain, made once for it, a task's aims and the engine that is chosen."""
    name = f"_attempts_{told_apart(task)}_{task.weights is None}_{in_c()}"
    return memoized(chain, name, lambda chain: Attempts(chain, task))
