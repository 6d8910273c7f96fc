"""One evaluation of a posture and the damped step from it: the iteration of every search for a pose.

With the error e (metres, then radians), the Jacobian J without the columns of joints that push against a bound, and
λ² = τ (0.03 ‖e‖² + λ₀²),

  q ← clip(q + clip(Jᵀ (J Jᵀ + λ² I)⁻¹ e, ±1), lower, upper)

(Levenberg 1944; damping by the square of the error after Sugihara 2011). Far from the pose
steps are short, near it they are Newton's. τ is normally 1. A `careful` search rejects steps that raise the error and
raises τ (Marquardt 1963). It converges at bounds and singularities, and to the nearest pose where there is no answer.
The orientation's error is 2 sin(θ/2) times the axis: monotone up to half a turn, without an arctangent.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from cnclik.law import dense
from cnclik.law.inverse import tiny_shift
from cnclik.precision import precise
from cnclik.reaching.targets import WIDTH, aims
from cnclik.record import Array, Bool, Float, cast
from cnclik.robot.model import modelled
from cnclik.robot.rotations import quaternion_from_rotation
from cnclik.task.parts import At, places
from cnclik.task.task import Task, rows

OF_ERROR = 0.03  # λ² per squared error
LEAST_DAMPING = 1e-6  # λ₀² of a search in float32; in float64 it is 1e-9
LONGEST = 1.0  # [rad, m] largest joint step
SHRINK, GROW, LEAST_TRUST = 0.5, 4.0, 1e-3  # factors of τ after an accepted and after a rejected step
MOST_TRUST = 1e12
SHORT = 100.0  # of ‖J‖²: damped by more, steps are so short that an error which still grows with them is at a kink
STATIONARY = 1e-3  # of ‖e‖ ‖J‖: a gradient smaller than that is none


class Search(NamedTuple):
    """The state of a search; a pytree of lanes."""

    q: Float[Array, " n"]  # the next posture
    best: Float[Array, " n"]  # the posture with the least error so far
    squares: Float[Array, " 2"]  # its squared position and orientation error [m², rad²], the largest of all tips
    cost: Float[Array, ""]  # and their weighted sum; infinite before the first look
    steep: Float[Array, ""]  # squared length of the cost's free gradient there, over ‖e‖² ‖J‖²; 0 where no step helps
    trust: Float[Array, ""]  # τ
    looks: Float[Array, ""]  # evaluations so far
    arrived: Bool[Array, ""]


def begin(q, zero) -> Search:
    """A search before its first evaluation. Args: zero: a 0 of a lane's dtype."""
    never, far = zero > 1, zero + jnp.inf
    return Search(q, q, jnp.stack([far, far]), far, far, zero + 1.0, zero, never)


def in_parts(task: Task, target):
    """The target of each part of a task, from the twelve numbers of each of its `aims`."""
    found = []
    for k, aim in enumerate(aims(task)):
        own = target[WIDTH * k : WIDTH * (k + 1)]
        found += [part.aim(own[:3], own[3:].reshape(3, 3)) for part in aim.parts]
    return tuple(found)


@precise
def iterate(chain, task: Task, at: Search, target, bounds, tolerance, careful, roots=None) -> Search:
    """Evaluate `q` and step; a search that has arrived does not move.

    Args:
      target: (t,). bounds: lower and upper (n,). tolerance: [m], [rad].
      careful: whether to reject steps that increase the error; may be traced.
      roots: of weights of the task's coordinates (m,); the task's own are not looked at.
    """
    _, j, squares, weighted = _look(cast(modelled(chain), at.q.dtype), task, at.q, in_parts(task, target), roots)
    low, high = bounds
    cost = weighted @ weighted
    here = (squares[0] <= tolerance[0] ** 2) & (squares[1] <= tolerance[1] ** 2)
    better = (cost <= at.cost) | ~careful
    helped = jnp.where(cost < at.cost, jnp.maximum(at.trust * SHRINK, LEAST_TRUST), at.trust)
    changed = jnp.where(better, helped, jnp.minimum(at.trust * GROW, MOST_TRUST))
    trust = jnp.where(careful, changed, at.trust)
    step, steep = damped_step(j, weighted, cost, at.q, low, high, trust)

    def choose(wanted, new, old):
        return jnp.where(wanted, new, old)

    best = choose(better, at.q, at.best)
    onward = jnp.clip(at.q + step, low, high)
    moved = Search(
        q=choose(here, at.q, choose(better, onward, at.best)),
        best=best,
        squares=choose(better, squares, at.squares),
        cost=jnp.where(better, cost, at.cost),
        steep=choose(better, steep, at.steep),
        trust=trust,
        looks=at.looks + 1.0,
        arrived=here,
    )
    return jax.tree.map(lambda old, new: jnp.where(at.arrived, old, new), at, moved)


@precise
def look(chain, task: Task, q, target):
    """Error e (m,) and its squares: position [m²] and orientation [rad²]."""
    e, _, squares, _ = _look(chain, task, q, target, None)
    return e, squares


def _look(chain, task, q, target, roots):
    """The error, the rows of J, the error's squares, and the error by its weights' roots, as the rows are."""
    at = At(chain, q)
    each = [_error(part, at, aim) for part, aim in zip(task.parts, target, strict=True)]
    j = rows(task, at)
    e, squares = jnp.concatenate(each), _squares(task, each)
    if roots is None:
        return e, j, squares, e
    return e, roots[:, None] * j, squares, roots * e


def _error(part, at, aim):
    """The error of a part; that of a rotation as a chord."""
    if not part.turns:
        return part.error(at, aim)
    return 2.0 * quaternion_from_rotation(aim @ at.rotation(part.tip, part.to).T)[1:][places(part.axes)]


def _squares(task, each):
    """The squared position and orientation errors (2,), each the largest of all tips."""
    found, rest, zero = [], iter(each), 0.0 * each[0][0]
    for aim in aims(task):
        own = [(part.turns, next(rest)) for part in aim.parts]
        kinds = [[e for turns, e in own if turns == kind] for kind in (False, True)]
        found.append(jnp.stack([sum((e @ e for e in some), zero) for some in kinds]))
    return functools.reduce(jnp.maximum, found)


def damped_step(rows, e, cost, q, low, high, trust):
    """The clipped step, and the steepness of the cost for the joints that may move."""
    least = LEAST_DAMPING if jnp.finfo(cost.dtype).bits <= 32 else 1e-9
    shift = trust * (OF_ERROR * cost + least) + tiny_shift(rows)
    downhill = e @ rows
    pushes = ((q <= low) & (downhill < 0)) | ((q >= high) & (downhill > 0))
    downhill, left = jnp.where(pushes, 0.0, downhill), jnp.where(pushes, 0.0, rows)
    step = dense.solved(dense.shifted(left @ left.T, shift), e) @ left
    scale = cost * jnp.sum(rows**2)
    steep = downhill @ downhill / jnp.where(scale > 0, scale, 1.0)
    kink = (trust > 1) & (shift > SHORT * jnp.sum(rows**2))
    return jnp.clip(step, -LONGEST, LONGEST), jnp.where(kink, 0.0, steep)
