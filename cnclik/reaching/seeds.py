"""Seeds: postures to start a search from, and which of them is nearest to a target.

A start near the target is worth more than anything else: of 256 postures that fill the joint space evenly the nearest
one halves the evaluations of a search, and doubles the share of first tries that arrive. There are sixteen times 256 of
them, one set for each try; tries beyond start from single ones.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np

from cnclik.record import kept, record
from cnclik.robot.chain import Chain
from cnclik.robot.model import frames, modelled
from cnclik.robot.posture import arm_length, evenly
from cnclik.shapes import Float

SETS, SIZE = 16, 256
STRETCHES = 1.0, 4.0, 1.0, 2.0  # of tries beyond the sets, by their number: half begin with most joints at limits
TURN = 0.2  # of an arm's length, that a radian or so of orientation counts for when seeds are compared


@record
class Seeds:
    """Postures, and where their tips are."""

    postures: Float[np.ndarray, "K n"]  # K = SETS · SIZE: sets, each of which fills the joint space by itself
    tips: Float[np.ndarray, "K 12"]  # position [arm lengths], and rotation times TURN
    middle: Float[np.ndarray, " n"]  # of the ranges that they fill
    width: Float[np.ndarray, " n"]
    scale: float  # what a target's position is multiplied with [1/m]


def seeds(chain: Chain) -> Seeds:
    """The seeds of a chain, made once for it."""
    return kept(chain, "_seeds", _made)


def spans(chain: Chain):
    """Lower and upper ends (n,) of where seeds are: the limits, of which at most one turn about the middle."""
    lower, upper = np.array(chain.lower, float), np.array(chain.upper, float)
    turn = 2 * math.pi
    low = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper - turn, -math.pi))
    high = np.where(np.isfinite(upper), upper, low + turn)
    middle = np.clip(0.0, np.minimum(low + math.pi, (low + high) / 2), np.maximum(high - math.pi, (low + high) / 2))
    wide = (high - low > turn) & np.array(chain.periodic)
    return np.where(wide, middle - math.pi, low), np.where(wide, middle + math.pi, high)


def turned(q, about, periods, low, high, xp=np):
    """Joint values (..., n) by whole turns as near to `about` as the bounds let them be.

    Args: periods: (n,) what a joint turns by to the same posture, 0 of one that does not.
    """
    period = xp.where(periods > 0, periods, 1.0)
    few, most = xp.ceil((low - q) / period), xp.floor((high - q) / period)
    turns = xp.clip(xp.round((about - q) / period), few, most)
    return q + xp.where(few <= most, periods * turns, 0.0)


def starts(seed, near, periods, ends, low, high, stretch=1.0, xp=np):
    """Postures to start from: seeds (..., n), turned to where `near` is, if there is one, and within the bounds.

    Of a joint whose value is beyond them, its place in the range of the seeds becomes its place between the bounds: all
    that is between them is tried, however far from the seeds it is, and not their corners alone.

    An answer with several joints at limits has few postures about it from which a search arrives, and most of them have
    joints there, too: seeds stretched by 4 have three in four joints at one of their bounds.

    Args: ends: of the range of the seeds, see `spans`. stretch: of each seed (...,) about the middle of the bounds.
    """
    q = seed if near is None else turned(seed, near, periods, low, high, xp)
    beyond, width = (q < low) | (q > high), np.maximum(ends[1] - ends[0], 1e-9)
    stretch = xp.asarray(stretch)[..., None]
    beyond = beyond | (stretch > 1) & xp.isfinite(high - low)
    place = 0.5 + stretch * ((seed - ends[0]) / width - 0.5)
    between = low + xp.where(beyond, high - low, 0.0) * place
    return xp.clip(xp.where(beyond, between, q), low, high)


def _made(chain: Chain) -> Seeds:
    low, high = spans(chain)
    postures = low + (high - low) * evenly(SETS * SIZE, chain.n)
    at = frames(modelled(chain), postures)
    scale = 1.0 / arm_length(chain)
    tips = np.concatenate([at.position * scale, TURN * at.rotation.reshape(-1, 9)], axis=1)
    return Seeds(postures=postures, tips=tips, middle=(low + high) / 2, width=high - low, scale=scale)


@record
class Compared:
    """What targets are compared by: (distance to a seed)² is features · [factors · target, 1], and what all share."""

    features: Float[np.ndarray, "SETS 13 SIZE"]
    factors: Float[np.ndarray, 12]


def compared(found: Seeds, task) -> Compared:
    """What the seeds are to targets of a task, made once for them."""
    name = f"_compared_{task.position}_{bool(task.orientation)}"
    return kept(found, name, lambda found: _compared(found, task))


def _compared(found, task):
    counts = np.array([i in task.linear for i in range(3)] + [bool(task.orientation)] * 9, float)
    tips = found.tips * counts
    features = np.concatenate([-2.0 * tips, np.sum(tips * tips, axis=1)[:, None]], axis=1)
    features = np.ascontiguousarray(features.reshape(SETS, SIZE, 13).transpose(0, 2, 1), np.float32)
    factors = counts * np.concatenate([[found.scale] * 3, [TURN] * 9])
    return Compared(features=features, factors=factors.astype(np.float32))


def nearest(to: Compared, target, number):
    """Index of the seed of set `number` that is nearest to a target (12,), in float32; traced."""
    asked = jnp.concatenate([target * to.factors, jnp.ones(1, target.dtype)]).astype(np.float32)
    distances = jnp.einsum("ij,i->j", jnp.asarray(to.features)[number], asked, precision="highest")
    return jnp.argmin(distances) + SIZE * number
