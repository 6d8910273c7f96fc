"""Gain: properties of a loop at rest with one gain, from its modes through their drives."""

from __future__ import annotations

import numpy as np

from cnclik.record import record
from cnclik.stability import driven
from cnclik.stability.drives import each_drive, side_by_side

KEPT = 1e-3  # share of a speed up to which a lag is settled


@record
class Gain:
    """Properties of a loop with one gain: linear, at rest, for the worst task direction and the worst drive.

    Attributes:
      alpha: [1/s], the largest |eigenvalue| of a gain matrix. z: alpha·Ts.
      damping_ratio: of the slowest pair of factors; 1 where it is real and positive.
      overshoot: of a step, as a share of it. settling_time: until the response stays within 2 % of a step [s].
      gain_margin: factor by which alpha may still grow. delay_margin: additional dead time that the loop tolerates,
        with what a null-space velocity moves [samples].
      noise_gain: standard deviation of the motion per unit of white measurement noise. velocity_noise_gain: of the
        commanded velocity per unit of it [1/s].
      lag: delay behind a target at constant speed without feed-forward [s].
      lag_fed_forward: the same with feed-forward. start_error: largest error after a target starts at 1 m/s, with
        feed-forward [s]; multiplied by a speed it is an error.
    """

    alpha: float
    z: float
    damping_ratio: float
    overshoot: float
    settling_time: float
    gain_margin: float
    delay_margin: float
    noise_gain: float
    velocity_noise_gain: float
    lag: float
    lag_fed_forward: float
    start_error: float


def gain_of(steps, drive, Ts, z, z_largest, null=()) -> Gain:
    """Of modes (r, p), see `modes_of`. Args: z_largest: the largest stable z. null: modes of the null space."""
    several = side_by_side(drive)
    motion, speed = driven.noise_gain(steps, several, Ts)
    behind, forward, start = _following(driven.outermost(steps), several, Ts)
    return Gain(
        alpha=z / Ts,
        z=z,
        damping_ratio=driven.damping_ratio(steps, several, Ts),
        overshoot=driven.overshoot(steps, several, Ts),
        settling_time=driven.settling(steps, several, Ts),
        gain_margin=z_largest / z,
        delay_margin=min(driven.delay_margin(m, one, Ts) for m in (steps, null) if len(m) for one in each_drive(drive)),
        noise_gain=motion,
        velocity_noise_gain=speed,
        lag=behind,
        lag_fed_forward=forward,
        start_error=start,
    )


def _following(steps, drive, Ts) -> tuple:
    """Behind a target at speed 1: at last, without and with feed-forward, and at most with it [s]; of some modes."""
    N, r = driven.until_settled(steps, drive, Ts, KEPT), len(steps)
    twice, fed = np.concatenate([steps, steps]).real, np.repeat([0.0, 1.0], r)
    q, _ = driven.respond(twice, drive, Ts, N, speed=1.0, forward=fed)
    late = Ts * np.arange(N + 1).reshape(-1, *(1,) * (q.ndim - 1)) - q
    most = np.abs(late[..., r:]).max(0)
    at_last = np.where(np.abs(late[-1, ..., r:]) < KEPT * most, 0.0, late[-1, ..., r:])
    return float(late[-1, ..., :r].max()), float(at_last.max()), float(most.max())
