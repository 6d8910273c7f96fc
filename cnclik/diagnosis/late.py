"""Late: dead time and gain of the loop e[k+1] = e[k] − z e[k−d] that a factor belongs to.

λ^(d+1) − λ^d + z = 0 is z = λ^d (1 − λ): its phase gives d, its size z.
"""

from typing import NamedTuple

import numpy as np

from cnclik.diagnosis.modes import misfit

NEIGHBOURS = 2  # on either side of the dead time that the phase gives, which are tried
PERIODS = 12  # of a recording that is looked at
WORSE = 4.0  # times the noise power that such a loop may leave, or:
PART = 1e-3  # this share of the recording's


class Late(NamedTuple):
    """A loop with dead time."""

    delay: int  # [samples]
    z: float
    confidence: float  # that no other whole number of samples does as well, 0 to 1
    phase: float  # dead time that the dominant factor alone says, not a whole number
    whole: bool  # whether the loop explains the whole recording, and not the dominant factor alone


def phase_delay(factor) -> float:
    """Dead time [samples] for which z is a positive number: −arg(1 − λ)/arg λ, the least."""
    return float(-np.angle(1 - factor) / np.angle(factor))


def gain_of(factor, delay) -> float:
    """|z| = |λ|^d |1 − λ|."""
    return float(np.abs(factor) ** delay * np.abs(1 - factor))


def loop_of(factor, y, basis, noise) -> Late:
    """The loop with dead time of a dominant factor, complex or negative.

    Whole numbers of samples next to what the phase says are tried: for each, all motions of such a loop are fitted to
    the recording, over z. Where none explains it, as with drives that lag, the factor alone is believed.

    Args:
      y: (N, k) recording. basis: (N, t) of its offset and path. noise: (k,) what the modes leave of it.
    """
    phase = phase_delay(factor)
    period = 2 * np.pi / np.angle(factor)
    N = min(len(y), int(PERIODS * period + 4 * (phase + 1)) + 24)
    y, basis = y[:N], basis[:N]
    tried = {}
    near = range(max(round(phase) - NEIGHBOURS, 0), round(phase) + NEIGHBOURS + 1)
    for delay in near if factor.imag else (0,):  # of a loop that is late, no negative factor is the dominant one
        if (delay + 1) + basis.shape[1] < N // 2:
            z, score = _fitted(y, basis, delay, gain_of(factor, delay))
            tried[delay] = score + np.log(N) * ((delay + 1) * y.shape[1] + 1), z
    alone = round(phase)
    if not tried:
        return Late(alone, gain_of(factor, alone), _nearness(phase), phase, False)
    best = min(tried, key=lambda d: tried[d][0])
    z, _ = _fitted(y, basis, best, tried[best][1], within=1e-2, to=1e-7)
    power = np.mean(_left(z, y, basis, best) ** 2, axis=0)
    if np.any(power > WORSE * noise**2 + PART * np.var(y, axis=0)):
        return Late(alone, gain_of(factor, alone), _nearness(phase), phase, False)
    odds = np.exp(-0.5 * (np.array([score for score, _ in tried.values()]) - tried[best][0]))
    return Late(best, z, float(1 / odds.sum()), phase, True)


def _nearness(phase) -> float:
    """1 for a whole number, 0 halfway between two."""
    return 1.0 - 2.0 * abs(phase - round(phase))


def _fitted(y, basis, delay, start, within=0.35, to=1e-3):
    """z about `start`, to a share, and the misfit that the loop with it has."""
    from scipy.optimize import minimize_scalar

    made = minimize_scalar(
        lambda z: misfit(_left(z, y, basis, delay), y),
        bounds=((1 - within) * start, (1 + within) * start),
        method="bounded",
        options={"xatol": to * start},
    )
    return float(made.x), float(made.fun)


def _left(z, y, basis, delay):
    """(N, k) what of y is no motion of the loop."""
    q, _ = np.linalg.qr(np.hstack([_motions(z, delay, len(y)), basis]))
    return y - q @ (q.T @ y)


def _motions(z, delay, N):
    """(N, d + 1) that span all motions of a loop: what it does of itself after one impulse, shifted."""
    alone = [0.0] * delay + [1.0]
    for _ in range(N - 1):
        alone.append(alone[-1] - z * alone[-1 - delay])
    return np.lib.stride_tricks.sliding_window_view(np.array(alone), N).T
