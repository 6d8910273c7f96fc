"""Units: targets are searched for in a unit of length near the arm's own size.

A search adds metres to radians. In a unit near the arm's size the two are comparable, whether the arm has 0.1 mm or
1,000 km. The unit is a power of sixteen, because dividing by it rounds nothing. For arms between 25 cm and 4 m it is a
metre.
"""

import functools

import jax
import numpy as np

from cnclik import errors
from cnclik.reaching.result import Reached, ReachStatus
from cnclik.reaching.targets import WIDTH, aims
from cnclik.record import memoized, replace
from cnclik.robot import fixed
from cnclik.robot.chain import PRISMATIC, Chain
from cnclik.robot.posture import arm_length

BASE = 16.0
SMALLEST = 1e-5  # [m] shorter arms keep the metre
FAR = 1e4  # [units] beyond it the nearest pose no longer changes, and squares would overflow


def in_units(chain: Chain):
    """The chain in a unit of its own, and that unit [m]; in metres where its geometry is traced."""
    return memoized(chain, "_in_units", _in_units)


def _in_units(chain):
    slides = [abs(v) for v, u in zip(chain.lower + chain.upper, chain.units * 2, strict=True) if u == "m"]
    size = arm_length(chain, least=0.0)
    if not errors.concrete(size):
        return chain, 1.0
    size = float(size) + max(filter(np.isfinite, slides), default=0.0)
    unit = float(BASE ** np.round(np.log2(size) / np.log2(BASE))) if size > SMALLEST else 1.0
    if unit == 1.0:
        return chain, unit
    per = of_joints(chain, 1.0 / unit)
    lower, upper = (tuple(map(fixed.mul, bound, per)) for bound in (chain.lower, chain.upper))
    joints = tuple(_joint(joint, unit, per[joint.coordinate]) for joint in chain.joints)
    tips = tuple(replace(tip, offset=_offset(tip.offset, unit)) for tip in chain.tips)
    return replace(chain, joints=joints, tips=tips, lower=lower, upper=upper), unit


def of_joints(chain: Chain, unit):
    """The unit of length of each joint value (n,); 1 for revolute joints."""
    return tuple(unit if u == "m" else 1.0 for u in chain.units)


def _joint(joint, unit, per):
    slides = joint.kind == PRISMATIC
    by = (1.0 / unit if slides else 1.0) / per  # of what follows a joint of the other kind
    offset = fixed.mul(1.0 / unit, joint.offset) if slides else joint.offset
    return replace(joint, origin=_offset(joint.origin, unit), multiplier=fixed.mul(by, joint.multiplier), offset=offset)


def _offset(offset, unit):
    return replace(offset, position=fixed.scale(1.0 / unit, offset.position))


def inward(asked, pose, near, xp=np):
    """The search's arguments in the chain's unit, and how far distant targets were moved.

    Args: pose: targets (B, t) [m]. near: (B, n) [rad, m] or None.

    Returns: pose, near, and (B,) [units] by how much each target was moved towards the first joint, or None: of one
      that is farther off than `FAR` only the direction matters. Of several tips' that of the one moved most.
    """
    every = aims(asked.task)
    if asked.unit != 1.0:
        pose = pose * xp.asarray(([1.0 / asked.unit] * 3 + [1.0] * 9) * len(every), pose.dtype)
        near = None if near is None else near / xp.asarray(of_joints(asked.chain, asked.unit), near.dtype)
    if not any(aim.linear for aim in every) or (xp is np and _is_close(pose)):
        return pose, near, None
    parts, moved = [], []
    for k, aim in enumerate(every):
        where, by = _nearer(asked.chain, aim, pose[:, WIDTH * k : WIDTH * k + 3], xp)
        parts += [where, pose[:, WIDTH * k + 3 : WIDTH * (k + 1)]]
        moved.append(by)
    return xp.concatenate(parts, axis=1), near, functools.reduce(xp.maximum, moved)


def _nearer(chain, aim, where, xp):
    """The positions (B, 3) of an aim, those nearer that are too far off, and by how much (B,)."""
    if not aim.linear:
        return where, xp.zeros(len(where), where.dtype)
    first = xp.stack(chain.joints[aim.way(chain)[0]].origin.position if aim.to is None else [0.0] * 3)
    first = first.astype(where.dtype)
    away = where - first
    counts = jax.lax.stop_gradient(away) if xp is not np else away
    counts = counts[:, np.array(aim.linear)]
    most = xp.max(xp.abs(counts), axis=1)
    shrink = xp.where(most > FAR, FAR / xp.maximum(most, FAR), 1.0)[:, None]
    length = most * xp.sqrt(xp.sum((counts / xp.maximum(most, 1.0)[:, None]) ** 2, axis=1))
    near_enough = xp.where(shrink < 1, first + shrink * away, where)
    return near_enough, xp.where(most > FAR, length - shrink[:, 0] * length, 0)


def _is_close(pose) -> bool:
    """Whether no target is so far off: of one alone by Python's numbers, which are quicker than NumPy's."""
    if pose.shape == (1, WIDTH):
        return max(map(abs, pose[0, :3].tolist())) <= FAR
    return not (np.abs(pose.reshape(-1, WIDTH)[:, :3]) > FAR).any()


def outward(asked, made: Reached, chain: Chain, near, moved, xp=np) -> Reached:
    """The results of a search in metres, for the user's chain.

    Args: near: as the user has it. moved: see `inward`; of several solutions each target's are together.
    """
    if asked.unit == 1.0 and moved is None:
        return made
    error, status = made.position_error, made.status
    if moved is not None:
        moved = moved.reshape(-1, *(1,) * (status.ndim - 1))
        error = error + moved
        claims = (status <= ReachStatus.AT_LIMIT) | (status == ReachStatus.JUMP)  # of a target that was nearer
        status = xp.where((moved > 0) & claims, int(ReachStatus.OUT_OF_BUDGET), status)
    q = made.q * xp.asarray(of_joints(chain, asked.unit), made.q.dtype)
    distance = made.distance
    if near is not None and "m" in chain.units:
        distance = xp.max(xp.abs(q - near.reshape(len(near), *(1,) * (q.ndim - 2), -1)), axis=-1)
    return replace(made, q=q, status=status, position_error=asked.unit * error, distance=distance, chain=chain)
