"""Rebased: position commands that begin at the measured joints, and the drives with which no small gain is stable.

In the limit of small gains such a loop sends the joints where they were measured: q̈ + 2ζω₀q̇ + ω₀²(q − q(t − τ)) = 0, τ
the dead time and half a sample. Its equation s² + 2ζω₀s + ω₀²(1 − e^{−sτ}) = 0 has a root iΩ ≠ 0 where
Ω² = ω₀²(2 − 4ζ²) and e^{−iΩτ} = 4ζ² − 1 + 2iζ√(2 − 4ζ²) alone: the loop is unstable from τ = (2π − arccos(4ζ² − 1))/Ω
on, and never for ζ ≥ 1/√2. Smaller gains do not help. Large ones may, but not in the null space, nor where damping or
limits leave little of them.
"""

import numpy as np

from cnclik.integrate.drive import Drive
from cnclik.stability.drives import SPARE, each_drive

INERTIA = 2.0  # largest ratio between a joint's measured inertia and that in another posture
SHARES = np.geomspace(1 / INERTIA, INERTIA, 33)  # of that inertia
WHERE = 'Begin each command at the last one (feedback="commanded"), or send velocities'


def critical_delay(natural_frequency, damping_ratio):
    """Dead time [s] from which on a loop whose commands begin at the measured joints is unstable at any small gain.

    Args: ω₀ [rad/s] and ζ of the servo, numbers or arrays. Returns: τ, of which half a sample is the hold's; inf for
      ζ ≥ 1/√2.
    """
    w, ratio = np.broadcast_arrays(*(np.asarray(v, float) for v in (natural_frequency, damping_ratio)))
    swings = np.maximum(2 - 4 * ratio**2, 0.0)
    with np.errstate(divide="ignore"):
        return (2 * np.pi - np.arccos(np.minimum(4 * ratio**2 - 1, 1.0))) / (w * np.sqrt(swings))


def bearable_delay(drive: Drive, Ts: float) -> float:
    """Dead time [samples] below which some small gain is safe, whatever the inertia is within a factor of INERTIA: k_p
    and k_v stay, and ω₀ and ζ fall with its root. With a sample to spare; inf where commands begin elsewhere."""
    if drive.feedback != "rebased" or drive.order < 2:
        return np.inf
    heavier = np.sqrt(SHARES)
    least = min(
        float(np.min(critical_delay(one.natural_frequency / heavier, one.damping_ratio / heavier)))
        for one in each_drive(drive)
    )
    return max(least / Ts - 0.5 - SPARE, 0.0)


def runs_away(drive: Drive, Ts: float) -> bool:
    """Whether such a loop may be unstable at any gain."""
    return drive.lumped.delay >= bearable_delay(drive, Ts)


def astray(drive: Drive, Ts: float) -> str:
    """A sentence on a loop that runs away; "" for other loops."""
    if not runs_away(drive, Ts):
        return ""
    return (
        "each position command begins at the measured joints, and with this servo and dead time the loop may swing and "
        f"grow however small alpha is, if not in this posture then in one of another inertia. {WHERE}"
    )
