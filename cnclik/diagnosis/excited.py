"""Excited: finds the loop behind a recording that noise excites, by its one-step prediction errors.

A loop with dead time d, and perhaps a lag, obeys A(B) y = −z b(B) B^d y + C(B) w. B shifts by a sample, A is 1 − B, or
(1 − B)(1 − aB) with a lag, and w is white. C is 1 for noise in the motion, and like A for measurement noise.
"""

import itertools

import numpy as np

from cnclik.diagnosis.blocks import triangle
from cnclik.diagnosis.late import LateLoop, by_share
from cnclik.integrate.drive import Drive, sampled

DEAD = 60  # samples of dead time, at most
LAGS = (0.7, 1.0, 1.4, 1.9, 2.4, 3.0, 3.8, 4.7, 6.0, 8.0, 10.0, 13.0, 20.0)  # in samples
PARTS = (0.0, 0.25, 0.5, 0.75)  # fractions of a sample of dead time
DENSE = 7  # loops with a lag that together weigh as much as one without, at each dead time
COLOURS = (0.0, 0.5, 0.9, 0.98)  # θ of coloured noise, C = 1 − θB
WANDERS = (0.2, 0.4, 0.6, 0.7, 0.8, 0.85, 0.9, 0.93, 0.95, 0.97, 0.98, 0.99)  # θ of a random walk seen through noise
FREE = (0, 2, 3, 4, 6, 8, 12, 20)  # orders of an autoregression that a loop must beat: 0 is white noise, and an
# oscillating one of order 1 is a loop without dead time
PENALTY = 1.0  # of each fitted number, times the logarithm of the number of rows
UNMODELLED_STEPS = 1e-3  # share of a recording's steps that a linear loop cannot explain
MAIN = 3  # principal components of the columns, at most
NO_PART = 0.3  # share of the largest component below which one is ignored
SWINGS = 0.3  # share of an oscillation left after a period above which noise visibly excites a loop
OVERSHOOT = 0.1  # share of an error by which a loop overshoots above which its gain is too large
SURELY = 0.75  # share of the probability that such loops must have
BETTER = 10.0  # margin by which a hardly oscillating loop must beat motion without a loop, as many are tried


def excited(y, Ts, z=None, path=0) -> list:
    """Loops that noise excites visibly or that overshoot, the likeliest first; empty if none explains a recording.

    Args: y: (N, k) without offset and path. Ts: [s]. z: the loop's gain if known. path: numbers fitted to the path.
    """
    y = main_parts(y)
    N = len(y)
    most = min(DEAD, N // 8)
    rows = N - most - 3
    number = PENALTY * np.log(rows)
    floor = UNMODELLED_STEPS**2 * np.var(np.diff(y, axis=0), axis=0) + np.finfo(float).tiny
    tried, least = [], np.inf
    for lag, part in ((0.0, 0.0), *itertools.product(LAGS, PARTS)):
        keep, b = _drive(lag, part)
        a = np.convolve([1.0, -1.0], [1.0, -keep]) if lag else np.array([1.0, -1.0])
        for colour, c in _noises(keep, b):
            made = _over_dead_times(y, a, b, c, LateLoop(part, lag * Ts, 0.0), most, floor)
            # Fitted numbers: a gain, a lag, a colour; the dead time counts no more than an autoregression's order.
            least = min(least, min(loop.score for loop in made) + number * (1 + (lag > 0) + (colour > 0)))
            tried += made
    free = min(_autoregression(y, p, most + 3, floor) + number * p for p in FREE if p < min(rows // 4, most + 3))
    if least > free or min(tried, key=lambda loop: loop.score).z <= 0:
        return []
    found = by_share([loop for loop in tried if loop.z > 0], DENSE / (len(LAGS) * len(PARTS)), z)
    found = [loop for loop in found if loop.share > 1e-3]
    if not found:  # all are as likely, as where the last rows rest
        return []
    if _left(found[0], 2 * np.pi, Ts) > SWINGS:
        return found
    over = sum(loop.share for loop in found if _left(loop, np.pi, Ts) > OVERSHOOT)
    clear = least < min(free, _wandering(y, most + 3, floor) + number) - BETTER - path
    return found if clear and over > SURELY * sum(loop.share for loop in found) else []


def _left(loop, angle, Ts) -> float:
    """The share of an error that is left when it has turned by an angle; 0 if it does not turn."""
    factor = loop.slowest(Ts)
    turn = abs(np.angle(factor))
    return float(np.abs(factor) ** (angle / turn)) if turn else 0.0


def main_parts(y):
    """(N, c) principal components of columns: joints share a loop and its excitation."""
    y = y / np.maximum(np.std(y, axis=0), np.finfo(float).tiny)
    _, size, parts = np.linalg.svd(triangle(y))
    return y @ parts[: min(int(np.sum(size > NO_PART * size[0])), MAIN)].T


def _noises(keep, b):
    """(θ, C) of noise in the motion and, with a lag, of measurement noise; last of unrecorded measurement noise, which
    passes through the drive.
    """
    for colour in COLOURS:
        yield colour, np.array([1.0, -colour])
        if keep:
            yield colour, np.convolve([1.0, -colour], [1.0, -keep])
    if keep:
        zeros = np.roots(b)
        yield 0.0, np.poly(np.where(np.abs(zeros) > 1, 1 / zeros, zeros))


def _drive(lag, part):
    """(e^{−1/lag}, numerator in B without its first B) of the sampled lag after a fraction of a sample of dead time."""
    if not lag:
        return 0.0, np.array([1.0])
    model = sampled(Drive(delay=part, lag=lag), 1.0)
    (_, moves), (_, keep) = model.phi
    b = np.zeros(3)
    for at, by in enumerate((model.now, model.late)):
        if by is not None:
            b[at : at + 2] += by[0], moves * by[1] - keep * by[0]
    return keep, b if part else b[:2]


def _over_dead_times(y, a, b, c, start, most, floor) -> list:
    """For each dead time, the loop with the best gain."""
    from scipy.signal import lfilter

    first, N = most + 3, len(y)
    left = lfilter(a, c, y, axis=0)[first:]
    acts = lfilter(b, c, y, axis=0)
    late = np.lib.stride_tricks.sliding_window_view(acts[2 : N - 1], N - first, axis=0)[::-1]  # (d, k, rows)
    square = np.mean(left**2, axis=0)
    both, own = np.einsum("ni,din->di", left, late) / len(left), np.einsum("din,din->di", late, late) / len(left)
    z = -np.sum(both / (square + floor), 1) / np.maximum(np.sum(own / (square + floor), 1), 1e-300)
    power = np.maximum(square + z[:, None] * (2 * both + z[:, None] * own), 0.0)
    scores = len(left) * np.sum(np.log(power + floor), 1)
    return [
        start._replace(delay=delay + start.delay, z=float(gain), score=float(score))
        for delay, (gain, score) in enumerate(zip(z, scores, strict=True))
    ]


def _wandering(y, first, floor) -> float:
    """The criterion of a random walk, as of a hand or of drift, under measurement noise."""
    from scipy.signal import lfilter

    left = [lfilter([1.0, -1.0], [1.0, -theta], y, axis=0)[first:] for theta in WANDERS]
    return len(y[first:]) * min(float(np.sum(np.log(np.mean(v**2, axis=0) + floor))) for v in left)


def _autoregression(y, order, first, floor) -> float:
    """The criterion of y[k] = Σ aⱼ y[k−j] + w, with the same a for all columns."""
    power = np.var(np.diff(y, axis=0), axis=0) + floor
    lagged = np.stack([y[first - j : len(y) - j] / np.sqrt(power) for j in range(order + 1)], -1)
    now, past = lagged[..., 0], lagged[..., 1:]
    r = triangle(np.column_stack([past.reshape(now.size, order), now.ravel()]))
    left = (now - past @ np.linalg.lstsq(r[:, :order], r[:, order], rcond=None)[0]) ** 2
    return len(now) * float(np.sum(np.log(np.mean(left, axis=0) * power + floor)))
