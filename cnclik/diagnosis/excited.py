"""Excited: the loop behind a recording that noise keeps going, by the errors of its predictions, a sample ahead.

A loop with dead time d, and perhaps a lag, obeys A(B) y = −z b(B) B^d y + C(B) w: B shifts by a sample, A = 1 − B, or
(1 − B)(1 − aB) with a lag, w is white. C is 1 where the noise is in the motion, A-like where it is in what is measured.
"""

import itertools

import numpy as np

from cnclik.diagnosis.blocks import triangle
from cnclik.diagnosis.late import LateLoop, by_share
from cnclik.integrate.drive import Drive, sampled

DEAD = 60  # samples of dead time, at most
LAGS = (0.7, 1.0, 1.4, 1.9, 2.4, 3.0, 3.8, 4.7, 6.0, 8.0, 10.0, 13.0, 20.0)  # in samples
PARTS = (0.0, 0.25, 0.5, 0.75)  # of a sample of dead time
DENSE = 7  # loops with a lag that weigh as much as one without, at each dead time
COLOURS = (0.0, 0.5, 0.9, 0.98)  # of the noise, C = 1 − θB
WANDERS = (0.2, 0.4, 0.6, 0.7, 0.8, 0.85, 0.9, 0.93, 0.95, 0.97, 0.98, 0.99)  # θ of a random walk seen through noise
FREE = (0, 2, 3, 4, 6, 8, 12, 20)  # orders of an autoregression with which a loop must compete: 0 is white noise, and
# one of order 1 that swings is a loop without dead time
PENALTY = 1.0  # on the logarithm of the number of rows, for each number
UNMODELLED_STEPS = 1e-3  # share of a recording's steps by which a real loop differs from a linear one
MAIN = 3  # parts of the columns that are looked at, at most
NO_PART = 0.3  # share of the largest part, below which a part is none
SWINGS = 0.3  # of an oscillation that is left after a period, from which on noise keeps a loop swinging visibly
OVERSHOOT = 0.1  # of an error by which a loop lands beyond its target, from which on its gain is too large
SURELY = 0.75  # share of the probability that loops which do that must have
BETTER = 10.0  # by which one that hardly swings must be likelier than motion without a loop: so many are tried


def excited(y, Ts, z=None, path=0) -> list:
    """Loops, the likeliest first, that noise keeps swinging, or that overshoot; empty where none explains a recording.

    Args: y: (N, k) without offset and path. Ts: [s]. z: the loop's gain where it is known. path: numbers fitted to it.
    """
    y = _main(y)
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
            # Its gain is a number, and so are a lag and a colour; its dead time is what an order is to the other.
            least = min(least, min(loop.score for loop in made) + number * (1 + (lag > 0) + (colour > 0)))
            tried += made
    free = min(_autoregression(y, p, most + 3, floor) + number * p for p in FREE if p < min(rows // 4, most + 3))
    if least > free or min(tried, key=lambda loop: loop.score).z <= 0:
        return []
    found = by_share([loop for loop in tried if loop.z > 0], DENSE / (len(LAGS) * len(PARTS)), z)
    found = [loop for loop in found if loop.share > 1e-3]
    if _left(found[0], 2 * np.pi, Ts) > SWINGS:
        return found
    over = sum(loop.share for loop in found if _left(loop, np.pi, Ts) > OVERSHOOT)
    clear = least < min(free, _wandering(y, most + 3, floor) + number) - BETTER - path
    return found if clear and over > SURELY * sum(loop.share for loop in found) else []


def _left(loop, angle, Ts) -> float:
    """Which share of an error is left of it when it has turned by an angle; 0 where it does not turn."""
    factor = loop.slowest(Ts)
    turn = abs(np.angle(factor))
    return float(np.abs(factor) ** (angle / turn)) if turn else 0.0


def _main(y):
    """(N, c) of the main parts of columns: joints share a loop, and what excites it."""
    y = y / np.maximum(np.std(y, axis=0), np.finfo(float).tiny)
    _, size, parts = np.linalg.svd(triangle(y))
    return y @ parts[: min(int(np.sum(size > NO_PART * size[0])), MAIN)].T


def _noises(keep, b):
    """(θ, C) of noise in the motion and, with a lag, in what is measured; last of what is measured and not recorded,
    which comes through the drive."""
    for colour in COLOURS:
        yield colour, np.array([1.0, -colour])
        if keep:
            yield colour, np.convolve([1.0, -colour], [1.0, -keep])
    if keep:
        zeros = np.roots(b)
        yield 0.0, np.poly(np.where(np.abs(zeros) > 1, 1 / zeros, zeros))


def _drive(lag, part):
    """(e^{−1/lag}, numerator in B without its first B) of the sampled lag after a part of a sample of dead time."""
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
    """For each dead time the loop with the best gain."""
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
    """The criterion of a random walk, as of a hand or of drift, below the noise of what is measured."""
    from scipy.signal import lfilter

    left = [lfilter([1.0, -1.0], [1.0, -theta], y, axis=0)[first:] for theta in WANDERS]
    return len(y[first:]) * min(float(np.sum(np.log(np.mean(v**2, axis=0) + floor))) for v in left)


def _autoregression(y, order, first, floor) -> float:
    """The criterion of y[k] = Σ aⱼ y[k−j] + w, all columns alike."""
    power = np.var(np.diff(y, axis=0), axis=0) + floor
    lagged = np.stack([y[first - j : len(y) - j] / np.sqrt(power) for j in range(order + 1)], -1)
    now, past = lagged[..., 0], lagged[..., 1:]
    r = triangle(np.column_stack([past.reshape(now.size, order), now.ravel()]))
    left = (now - past @ np.linalg.lstsq(r[:, :order], r[:, order], rcond=None)[0]) ** 2
    return len(now) * float(np.sum(np.log(np.mean(left, axis=0) * power + floor)))
