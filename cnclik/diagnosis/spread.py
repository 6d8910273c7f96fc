"""Spread: the range of gains in which a loop through a fitted drive becomes unstable, given the fit's uncertainty."""

import numpy as np

from cnclik.diagnosis.modes import EXACT
from cnclik.integrate.drive import sampled
from cnclik.record import replace

DRAWN = 40  # drives to be drawn
WIDE = 2.0  # range of the draws, in standard deviations
GAIN_SPREAD = 0.05  # relative error of such a gain even for a perfect fit
TASK = 6  # coordinates of a pose
SHARED_MOTION = 0.5  # share of their motion that commands must share to move the joints together
POINTS = 4000  # frequencies to be tried


def correlated(left) -> float:
    """The correlation length of a residual (N,) [samples]: 1 for white noise."""
    left = left - left.mean()
    power = float(left @ left)
    if power == 0.0:
        return 1.0
    N = len(left)
    share = np.fft.irfft(np.abs(np.fft.rfft(left, 2 * N)) ** 2, 2 * N)[: N // 2] / power
    last = int(np.argmax(share < 0.05)) or len(share)
    return float(max(1.0, 1.0 + 2.0 * np.sum(share[1:last])))


def stable_range(fit, deviations, gain, structured, command) -> tuple:
    """((low, high) alpha [1/s] or None, the reason) for explicit Euler with measured joints.

    Args: fit: a `Fit`; deviations (k, p) of its values; gain (k,) of the joints; structured: whether the residual has a
      structure; command (N, k).
    """
    if why := _unknown(fit, gain, structured, command):
        return None, f"The largest stable gain is not known{why}"
    rng, found = np.random.default_rng(0), []
    for i in range(DRAWN):
        off = deviations * rng.uniform(-WIDE, WIDE, deviations.shape if fit.own else deviations[:1].shape) * (i > 0)
        each = [fit.shape.drive(v) for v in fit.values + off]
        found.append(min(largest_stable(d, fit.shape.Ts) / max(abs(g), 1e-3) for d, g in zip(each, gain, strict=True)))
    low, high = min(found) / fit.shape.Ts, max(found) / fit.shape.Ts
    return (float(low * (1 - GAIN_SPREAD)), float(high * (1 + GAIN_SPREAD))), ""


def _unknown(fit, gain, structured, command) -> str:
    """Why a fit does not determine the largest stable gain; "" if it does."""
    velocity = fit.shape.start.command == "velocity"
    drives = [fit.shape.drive(values) for values in fit.values]
    quick = drives[0].delay < 1 or (fit.shape.order == 1 and min(d.lag for d in drives) < fit.shape.Ts)
    steps = np.abs(np.diff(command, axis=0)) > EXACT * np.ptp(command, axis=0)
    at_once = np.sum(steps.all(1)) >= SHARED_MOTION * np.sum(steps.any(1))
    if len(gain) == 1:
        return " from one joint: joints that move together are heavier. Record a step of all joints at once."
    if not at_once:
        return ", as joints moved one at a time: together they are heavier. Record a step of all joints at once."
    if len(gain) > TASK:
        return (
            f" of more than {TASK} joints: in the null space joints swing against each other, which a step of all of "
            "them does not show."
        )
    if velocity and fit.shape.order == 2:
        return " of a velocity drive of second order: it integrates, or filters."
    if velocity and quick:
        return ": with so little dead time and lag it depends on what the drive does within a sample."
    return "." if structured else ""


def largest_stable(drive, Ts) -> float:
    """The smallest z at which a factor of the loop reaches the unit circle, from its Nyquist curve on the real axis."""
    drive = replace(drive, feedback="measured")
    at = np.exp(1j * np.linspace(0, np.pi, POINTS + 1)[1:])
    curve = sampled(drive, Ts).transfer(at) * (at / (at - 1) if drive.steps_positions else 1 / Ts)
    turned = np.flatnonzero((np.imag(curve[:-1]) * np.imag(curve[1:]) <= 0) & (np.real(curve[1:]) < 0))
    if not len(turned):
        return float(-1 / curve[-1].real) if curve[-1].real < 0 else np.inf
    share = np.imag(curve[turned]) / (np.imag(curve[turned]) - np.imag(curve[turned + 1]) + 1e-300)
    real = curve[turned].real + share * (curve[turned + 1].real - curve[turned].real)
    return float(-1 / np.min(real))
