"""Late: dead time and gain of the loop e[k+1] = e[k] − z e[k−d] that a factor belongs to.

λ^(d+1) − λ^d + z = 0 is z = λ^d (1 − λ): its phase gives d, its size z.
"""

from typing import NamedTuple

import numpy as np

from cnclik.diagnosis.modes import misfit
from cnclik.integrate.drive import MOST, Drive, sampled
from cnclik.stability.driven import driven_factors
from cnclik.stability.linear import late_monotone, late_stable

NEIGHBOURS = 2  # on either side of the dead time that the phase gives, which are tried
PERIODS = 12  # of a recording that is looked at
SHORT = 150  # rows of a recording in which other dead times are tried as well where none of these explains it:
WIDE = 12  # so many, and twice as many as the phase gives
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


def slowest_of(z, delay) -> complex:
    """The largest factor of a loop, above the real axis."""
    rule = np.zeros(delay + 2)
    rule[:2] = 1.0, -1.0
    rule[-1] += z
    found = np.roots(rule)
    found = found[found.imag >= 0]
    return complex(found[np.argmax(np.abs(found))])


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
    alone = Late(round(phase), gain_of(factor, round(phase)), 1.0 - 2.0 * abs(phase - round(phase)), phase, False)
    near = range(max(round(phase) - NEIGHBOURS, 0), round(phase) + NEIGHBOURS + 1)
    if not factor.imag:  # of a loop that is late, no negative factor is the dominant one
        near = (0,)
    wide = [d for d in range(min(2 * round(phase) + WIDE, N // 4)) if d not in near]
    for delays in (near, wide if factor.imag and N <= SHORT else ()):
        found = _best(delays, y, basis, factor, noise, phase)
        if found is not None:
            return found
    return alone


def _best(delays, y, basis, factor, noise, phase):
    """The best of whole numbers of samples; None where it doesn't explain the recording."""
    N, tried = len(y), {}
    for delay in delays:
        if (delay + 1) + basis.shape[1] < N // 2:
            bounds = 0.65 * gain_of(factor, delay), 1.35 * gain_of(factor, delay)
            if abs(delay - phase) > 1 + NEIGHBOURS:  # then the factor is not its own
                bounds = late_monotone(delay), 1.2 * late_stable(delay)
            z, score = _fitted(y, basis, delay, bounds, 1e-3)
            tried[delay] = score + np.log(N) * ((delay + 1) * y.shape[1] + 1), z
    if not tried:
        return None
    best = min(tried, key=lambda d: tried[d][0])
    z = tried[best][1]
    z, _ = _fitted(y, basis, best, (0.97 * z, 1.03 * z), 1e-7)
    power = np.mean(_left(z, y, basis, best) ** 2, axis=0)
    if np.any(power > WORSE * noise**2 + PART * np.var(y, axis=0)):
        return None
    odds = np.exp(-0.5 * (np.array([score for score, _ in tried.values()]) - tried[best][0]))
    return Late(best, z, float(1 / odds.sum()), phase, True)


def _fitted(y, basis, delay, bounds, to):
    """z within bounds, found to a share, and the misfit that the loop with it has."""
    from scipy.optimize import minimize_scalar

    made = minimize_scalar(
        lambda z: misfit(_left(z, y, basis, delay), y),
        bounds=bounds,
        method="bounded",
        options={"xatol": to * bounds[1]},
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


# --- with a lag ---------------------------------------------------------------------------------------


def lag_of(factor, z, Ts):
    """The `Drive` with dead time and a lag with which a loop of gain z has this factor as its largest, or None."""
    from scipy.optimize import least_squares

    phase = max(phase_delay(factor), 0.1)

    def drive_of(values):
        return Drive(
            delay=float(min(abs(values[0]), 2 * phase + 2, MOST)), lag=float(np.exp(np.clip(values[1], -20, 5)))
        )

    def off(values):
        value = 1.0 + z / Ts * sampled(drive_of(values), Ts).transfer(factor)
        return [value.real, value.imag]

    for share in (0.5, 0.2, 0.8):
        made = least_squares(off, [share * phase, np.log((1 - share) * phase * Ts)], method="lm", max_nfev=200)
        if made.cost < 1e-16:
            drive = drive_of(made.x)
            largest = np.abs(driven_factors([-z], drive, Ts)).max()
            if abs(largest - np.abs(factor)) < 1e-3:
                return drive
    return None
