"""Posture: length of an arm, whether it is planar, and start postures."""

import functools
import math

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.robot.chain import REVOLUTE, Chain
from cnclik.robot.fixed import IDENTITY
from cnclik.robot.model import modelled
from cnclik.robot.rotations import safe_norm

_FAR = 1e6  # [rad, m] larger limits do not influence the start posture
_SINGULAR = 1e-9  # least singular values that are rounding


def arm_length(chain: Chain, least=1e-3, number=None):
    """Return the length of the stretched arm [m]: the distances from joint to joint to tip, at least 1 mm or `least`.

    Args: number: index of the tip; None: the farthest one's.
    """
    ways = [
        [*(chain.joints[i].origin.position for i in chain.way(k)[1:]), tip.offset.position]
        for k, tip in enumerate(chain.tips)
        if number in (None, k)
    ]
    if all(errors.concrete(x) for way in ways for p in way for x in p):
        return max(least, *(sum(math.hypot(*map(float, p)) for p in way) for way in ways))
    lengths = [sum(safe_norm(jnp.array(p, float)) for p in way) for way in ways]
    return functools.reduce(jnp.maximum, lengths, least)


def beyond_arm(chain: Chain, points, axes=(0, 1, 2), xp=np, number=0):
    """Return how far points (..., len(axes)) lie beyond the stretched arm, from its first joint along those axes [m].

    It is negative within reach; −∞ for arms with sliding joints. Args: number: index of the tip.
    """
    way = [chain.joints[i] for i in chain.way(number)]
    if any(joint.kind != REVOLUTE for joint in way):
        return xp.full(points.shape[:-1], -math.inf)
    away = points - xp.stack([xp.asarray(way[0].origin.position[i]) for i in axes])
    room = 1 + 64 * float(np.finfo(away.dtype).eps)  # for rounding
    return xp.linalg.norm(away, axis=-1) - room * arm_length(chain, least=0.0, number=number)


def is_planar(chain: Chain) -> bool:
    """Return whether the tip moves in a plane z = const and turns about z only, by the chain's literal geometry."""
    return all(
        joint.kind == REVOLUTE and tuple(joint.axis)[:2] == (0.0, 0.0) and joint.origin.rotation == IDENTITY
        for joint in chain.joints
    )


def start_posture(chain: Chain, *tasks):
    """Return a posture (n,) [rad, m] well within the limits and away from singularities of the tasks, each of one tip.

    The middle of the limits (0 for joints without limits) if the task Jacobians, and all of them together where there
    are joints enough, are well conditioned there. Otherwise, of 256 fixed postures around it, the one with the largest
    least singular value relative to each task's largest. Lengths are in the arm's own unit.
    """
    postures, each = _spread_postures(chain), []
    for task in tasks:  # a later room's, in NumPy, which does not compile
        each.append(np.array(task.rows_at(modelled(chain), postures)))
        each[-1][:, task.lengths] /= arm_length(chain)
    if len(each) > 1 and sum(j.shape[1] for j in each) <= chain.n:
        each.append(np.concatenate(each, axis=1))
    least = np.array([np.linalg.svd(j, compute_uv=False)[:, -1] for j in each]).reshape(-1, len(postures))
    most = least.max(axis=1, keepdims=True)
    least = np.where(most > _SINGULAR, least / np.maximum(most, _SINGULAR), 1.0).min(axis=0, initial=1.0)
    return postures[0] if least[0] > 0.3 * least.max() else postures[np.argmax(least)]


def evenly(count: int, n: int):
    """Return points (count, n) that fill the unit cube evenly (Roberts 2018), the first its centre; always the same."""
    base = 2.0
    for _ in range(50):
        base = (1 + base) ** (1 / (n + 1))
    return np.mod(0.5 + np.outer(np.arange(count), base ** -np.arange(1.0, n + 1)), 1.0)


def _spread_postures(chain: Chain):
    """Return 256 postures (256, n) well inside the limits, the same on every machine; the first is their middle."""
    lower, upper = np.array(chain.lower), np.array(chain.upper)
    lower, upper = np.where(lower < -_FAR, -np.inf, lower), np.where(upper > _FAR, np.inf, upper)
    bounded = np.isfinite(lower) & np.isfinite(upper)
    low = np.where(np.isfinite(lower), lower, np.minimum(-math.pi, upper - math.pi))
    high = np.where(np.isfinite(upper), upper, np.maximum(math.pi, low + math.pi))
    width = np.minimum((high - low) / 4, math.pi / 2)
    middle = np.where(bounded, (low + high) / 2, np.clip(0.0, low + width, high - width))
    return middle + width * (2 * evenly(256, chain.n) - 1)
