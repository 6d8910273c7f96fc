"""Units: searches measure lengths in a unit near the arm's own size, to which radians compare.

The unit is the power of sixteen, in metres, that is nearest to the arm's length, because dividing by it rounds nothing.
For arms between 25 cm and 4 m it is a metre. So an arm of 0.1 mm, or of 1,000 km, is searched as one of a metre.
"""

import jax
import numpy as np

from cnclik import errors
from cnclik.record import memoized
from cnclik.reaching.targets import WIDTH, aims
from cnclik.robot.posture import arm_length

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


def nearer(chain, task, pose, xp=np):
    """Return targets (B, t) [m], those beyond FAR moved towards the first joint, and by how much (B,), or None.

    Of a target so far off only the direction matters. Of several tips the one that moved most counts.
    """
    most = FAR * unit_of(chain)
    if xp is np and np.abs(pose).max() <= most:
        return pose, None
    places, moved, parts = pose.reshape(len(pose), -1, WIDTH)[..., :3], xp.zeros(len(pose), pose.dtype), []
    for k, aim in enumerate(aims(task)):
        where = places[:, k]
        first = xp.stack(chain.joints[aim.way(chain)[0]].origin.position if aim.to is None else [0.0] * 3)
        away = jax.lax.stop_gradient(where - first) if xp is not np else where - first
        size = xp.max(xp.abs(away[:, list(aim.linear)]), axis=1, initial=0.0)
        shrink = xp.where(size > most, most / xp.maximum(size, most), 1.0)[:, None]
        length = size * xp.sqrt(xp.sum((away[:, list(aim.linear)] / xp.maximum(size, 1e-9)[:, None]) ** 2, axis=1))
        moved = xp.maximum(moved, length - shrink[:, 0] * length)
        parts += [xp.where(shrink < 1, first + shrink * away, where), pose[:, WIDTH * k + 3 : WIDTH * (k + 1)]]
    return xp.concatenate(parts, axis=1), moved
