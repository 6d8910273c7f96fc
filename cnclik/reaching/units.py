"""Units: searches measure lengths in a unit near the arm's own size, to which radians compare.

The unit is the power of sixteen, in metres, that is nearest to the arm's length, because dividing by it rounds nothing.
For arms between 25 cm and 4 m it is a metre. So an arm of 0.1 mm, or of 1,000 km, is searched as one of a metre.
"""

import numpy as np

from cnclik import errors
from cnclik.record import memoized
from cnclik.robot.posture import arm_length
from cnclik.task.task import WIDTH

BASE = 16.0
SMALLEST = 1e-5  # [m] shorter arms keep the metre
FAR = 1e4  # [units] beyond it the nearest pose no longer changes, and squares would overflow


def unit_of(chain) -> float:
    """Return the unit of length [m] of a chain; a metre where its geometry is traced."""
    return memoized(chain, "_unit", _unit)


def _unit(chain):
    size = arm_length(chain, least=0.0)
    if not errors.concrete(size):
        return 1.0
    slides = [abs(v) for v, u in zip(chain.lower + chain.upper, chain.units * 2, strict=True) if u == "m"]
    size = float(size) + max(filter(np.isfinite, slides), default=0.0)
    return float(BASE ** np.round(np.log2(size) / np.log2(BASE))) if size > SMALLEST else 1.0


def per_unit(chain) -> np.ndarray:
    """Return (n,) of each joint value, [rad] or [m], in the chain's unit."""
    return np.where([unit == "m" for unit in chain.units], unit_of(chain), 1.0)


def nearer(chain, pose, xp=np):
    """Return targets (B, t) [m], those beyond FAR moved towards the base, and by how much (B,) [m], or None.

    Of a target so far off only the direction matters. Of several tips the one that moved most counts.
    """
    most = FAR * unit_of(chain)
    if xp is np and np.abs(pose).max() <= most:
        return pose, None
    every = pose.reshape(len(pose), -1, WIDTH)
    size = xp.maximum(xp.max(xp.abs(every[..., :3]), axis=2, keepdims=True), most)
    within, length = most / size * every[..., :3], size * xp.linalg.norm(every[..., :3] / size, axis=2, keepdims=True)
    moved = ((1 - most / size) * length)[..., 0].max(axis=1)
    return xp.concatenate([within, every[..., 3:]], axis=2).reshape(pose.shape), moved
