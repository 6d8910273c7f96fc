"""Seeds: start postures of a search, and the one nearest to a target.

A start near the target helps most. The nearest of 256 postures that fill the joint space evenly halves the evaluations
of a search and doubles the share of first tries that succeed. There are sixteen sets of 256, one for each try; further
tries start from single postures.
"""

import math

import jax.numpy as jnp
import numpy as np

from cnclik.precision import precise
from cnclik.reaching.targets import aims, told_apart
from cnclik.record import Float, memoized, record
from cnclik.robot.chain import Chain
from cnclik.robot.model import modelled
from cnclik.robot.posture import arm_length, evenly
from cnclik.task.parts import At

SETS, SIZE = 16, 256
STRETCHES = 1.0, 4.0, 1.0, 8.0  # for tries beyond the sets: three in eight start with most joints, or all, at limits
TURN = 0.2  # [arm lengths] weight of a radian of orientation when seeds are compared


@record
class Seeds:
    """Postures that fill the joint space."""

    postures: Float[np.ndarray, "K n"]  # K = SETS · SIZE: sets, each of which fills the joint space by itself
    middle: Float[np.ndarray, " n"]  # of the ranges that they fill
    width: Float[np.ndarray, " n"]


def seeds(chain: Chain) -> Seeds:
    """The seeds of a chain, made once for it."""
    return memoized(chain, "_seeds", _made)


def spans(chain: Chain):
    """Lower and upper ends (n,) of where seeds are: the limits, of which at most one turn about the middle."""
    lower, upper = np.array(chain.lower, float), np.array(chain.upper, float)
    turn = 2 * math.pi
    low = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper - turn, -math.pi))
    high = np.where(np.isfinite(upper), upper, low + turn)
    middle = np.clip(0.0, np.minimum(low + math.pi, (low + high) / 2), np.maximum(high - math.pi, (low + high) / 2))
    wide = (high - low > turn) & np.array(chain.periodic)
    return np.where(wide, middle - math.pi, low), np.where(wide, middle + math.pi, high)


def periods(chain: Chain):
    """The period of each joint (n,), after which the posture is the same; 0 where there is none."""
    return np.where(chain.periodic, 2 * math.pi, 0.0)


def turned(q, about, periods, low, high, xp=np):
    """Joint values (..., n) shifted by whole periods, as near to `about` as the bounds allow.

    Args: periods: (n,) of the joints, 0 for none.
    """
    period = xp.where(periods > 0, periods, 1.0)
    few, most = xp.ceil((low - q) / period), xp.floor((high - q) / period)
    turns = xp.clip(xp.round((about - q) / period), few, most)
    return q + xp.where(few <= most, periods * turns, 0.0)


def starts(seed, near, periods, ends, low, high, stretch):
    """A posture to start from: a seed (n,), turned to where `near` is, if there is one, and within the bounds.

    Of a joint whose value is beyond them, its place in the range of the seeds becomes its place between the bounds: all
    that is between them is tried, however far from the seeds it is, and not their corners alone.

    An answer with several joints at limits has few postures about it from which a search arrives, and most of them have
    joints there, too: seeds stretched by 4 have three in four joints at one of their bounds, by 8 seven in eight.

    Args: ends: of the range of the seeds, see `spans`. stretch: of the seed about the middle of the bounds.
    """
    q = seed if near is None else turned(seed, near, periods, low, high, jnp)
    beyond = (q < low) | (q > high) | (stretch > 1) & jnp.isfinite(high - low)
    place = 0.5 + stretch * ((seed - ends[0]) / np.maximum(ends[1] - ends[0], 1e-9) - 0.5)
    between = low + jnp.where(beyond, high - low, 0.0) * place
    return jnp.clip(jnp.where(beyond, between, q), low, high)


def _made(chain: Chain) -> Seeds:
    low, high = spans(chain)
    postures = low + (high - low) * evenly(SETS * SIZE, chain.n)
    return Seeds(postures=postures, middle=(low + high) / 2, width=high - low)


@record
class Compared:
    """Data to compare targets with seeds: (distance to a seed)² = features · [factors · target, 1] + a common term.

    For each of the task's aims: a joint starts where it has the tip near that it moves, see `targets.owners`.
    """

    features: Float[np.ndarray, "A SETS 13 SIZE"]
    factors: Float[np.ndarray, "A 12"]


def compared(chain: Chain, task) -> Compared:
    """The `Compared` of a chain and a task, cached."""
    return memoized(chain, f"_compared_{told_apart(task)}", lambda chain: _compared(chain, task))


def _compared(chain, task):
    robot, scale = At(modelled(chain), seeds(chain).postures), 1.0 / arm_length(chain)
    features, factors = [], []
    for aim in aims(task):
        near = aim.linear
        counts = np.array([i in near for i in range(3)] + [bool(aim.angular)] * 9, float)
        turned = TURN * robot.rotation(aim.tip, aim.to).reshape(-1, 9)
        tips = counts * np.concatenate([robot.position(aim.tip, aim.to) * scale, turned], axis=1)
        own = np.concatenate([-2.0 * tips, np.sum(tips * tips, axis=1)[:, None]], axis=1)
        features.append(own.reshape(SETS, SIZE, 13).transpose(0, 2, 1))
        factors.append(counts * np.concatenate([[scale] * 3, [TURN] * 9]))
    features, factors = (np.ascontiguousarray(v, np.float32) for v in (features, factors))
    return Compared(features=features, factors=factors)


@precise
def nearest(to: Compared, target, number, xp=jnp):
    """Indices (..., aims) of the seeds of set `number` that are nearest to targets (..., t), in float32."""
    scaled = target.reshape(*target.shape[:-1], *to.factors.shape) * to.factors
    asked = xp.concatenate([scaled, xp.ones((*scaled.shape[:-1], 1), target.dtype)], axis=-1).astype(np.float32)
    distances = asked[..., None, :] @ xp.asarray(to.features)[:, number]  # row by row: no BLAS parts it among threads
    return xp.argmin(distances[..., 0, :], axis=-1) + SIZE * number
