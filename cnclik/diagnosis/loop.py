"""Loop: the mode of the loop behind a log, by prediction errors, and the drives that have this mode.

An error that is fed back late obeys A(B) y = −z b(B) B^(d+1) y + C(B) w, z = alpha·Ts (Ljung 1999). B shifts by a row,
A is 1 − B, or (1 − B)(1 − aB) with a lag, and w is white. C is 1 for noise of the motion and A for noise of its
measurement, which the loop feeds back. Dead time, lag and C are on a grid; z, and what a path adds, by least squares.

Of these loops only the mode counts. Dead time alone and dead time with a lag may have the same mode; the
gain that does not overshoot differs little among them, as all have the same phase where the loop swings.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cnclik.diagnosis.recording import line
from cnclik.integrate.drive import MOST, Drive

ROWS = 2000  # rows that are read, those that move most: more change no digit of a gain
PER_PERIOD, DEAD = 24, 16  # rows of a period that are kept, and of dead time, which is below a quarter of it
ROUND, COHERENT = (
    0.6,
    0.8,
)  # |vᵀv| of a shape v, ‖v‖ = 1, of columns that circle: 0 for a circle, 1 in phase; its energy
LAGS = (0.0, 1.0, 2.5, 6.0, 15.0)  # of these rows; the phase at the limit changes by 20° from one to the next
COLOURS = (0.8, 1.0)  # θ of C = 1 − θB, besides 0: of noise of the motion and of its measurement together
PIECE = 512  # rows: 512 × 18 numbers
PATHS = (0, 1, 2, 4, 8, 12, 16)  # columns of a path's basis: offset, drift, bends, slow sines
UNMODELLED = 0.005  # share of the steps that no linear loop explains
VISIBLE = 0.1  # of an error, by which a loop passes its target if its gain is too large
ALONE, AS_WELL = 15.0, 8.0  # decrease of the criterion by which dead time alone, or a dead time, is better than others
USUAL = 0.05  # [s] of a usual lag: larger ones count less
EVIDENCE = 45.0  # decrease of the criterion from which on an oscillation is a loop's
SURELY = 0.9  # share of the probability that loops which swing must have
OVERTONE = 0.12  # relative deviation of an overtone's period, which large motions shift
GROWN = 2.0  # factor over the rows read by which a mode does not grow in a log whose steps end smaller
KNOWN = 0.15  # relative deviation of the loop's gain from a known one
CAREFUL, TAIL = 0.25, 0.1  # shares of the likely drives that tolerate less than the one chosen, and than those said


class Loop(NamedTuple):
    """What is read in a log. Rows are those of the log."""

    mode: complex  # s [1/row] of the oscillation or decay that ends last
    evidence: float  # decrease of the information criterion by this loop
    swings: float  # share of the probability of loops that pass their target by VISIBLE
    dead: tuple  # dead time in rows of the best loop without a lag, and its ends
    alone: bool  # whether dead time alone explains the log much better than any lag
    rests: bool  # whether its steps are smaller in the end
    first: int  # rows that were read
    last: int

    @property
    def period(self) -> float:
        return 2 * np.pi / self.mode.imag if self.mode.imag > 1e-9 else np.inf

    @property
    def growth(self) -> float:
        """Per row."""
        return float(np.exp(self.mode.real))

    @property
    def overshoot(self) -> float:
        """Share of an error that is on its other side half a period later."""
        return float(np.exp(0.5 * self.mode.real * self.period)) if np.isfinite(self.period) else 0.0


# --- rows and columns ---------------------------------------------------------------------------------


def noise_of(y):
    """(k,) standard deviation of white noise in columns that are smooth otherwise."""
    return np.median(np.abs(np.diff(y, 3, axis=0)), axis=0) / (0.6745 * np.sqrt(20))


def resolution_of(y):
    """(k,) the step of which all steps of a column are multiples; 0 where there is none."""
    found = []
    for column in y.T:
        step = np.abs(np.diff(column))
        step = step[step > 1e-12 * np.abs(column).max()]
        least = step.min(initial=np.inf)
        whole = len(step) and np.all(np.abs(step / least - np.round(step / least)) < 0.05)
        found.append(least if whole and np.median(step) < 50 * least else 0.0)
    return np.array(found)


def prepared(y):
    """Columns that move by more than noise and resolution, in units of these or a tenth of their deviation."""
    size, step = np.std(y, axis=0), resolution_of(y)
    moves = (np.ptp(y, axis=0) > 1e-12 * np.abs(y).max(0)) & (np.ptp(y, axis=0) > 3.5 * step)
    unit = np.maximum(np.maximum(0.1 * size, noise_of(y)), step)
    return ((y - y[0]) / np.where(unit > 0, unit, 1.0))[:, moves]


def window(y):
    """(first row of the motion after a push, last one before it rests, whether the push is a jump in the error)."""
    N, span = len(y), np.ptp(y, axis=0)
    first, last = 0, N
    step = np.max(np.abs(np.diff(y, axis=0)) / span, axis=1)
    jump = int(np.argmax(step))
    jumped = jump < N // 2 and step[jump] > 0.2 and step[jump] > 4 * np.max(np.delete(step, jump))
    if jumped:
        first = jump + 1
    else:
        away = np.any(np.abs(y - y[0]) > 6 * noise_of(y) + 2e-3 * span, axis=1)
        first = int(np.argmax(away)) if np.argmax(away) < 0.6 * N else 0
    tail = y[-max(N // 5, 8) :]
    rest = free(line(len(tail)), tail)
    left, away = np.sqrt(np.mean(np.sum(rest**2, 1))), np.linalg.norm(y - np.median(tail, axis=0), axis=1)
    if left < 0.03 * away.max():
        moving = np.flatnonzero(away > max(4 * left, 0.01 * away.max()))[-1]
        last = int(min(max(moving + 10 + 0.3 * (moving - first), first + 16), N))
    if last - first > ROWS and not jumped:
        power = np.concatenate([[0.0], np.cumsum(np.sum(np.diff(y[first:last], axis=0) ** 2, 1))])
        first += int(np.argmax(power[ROWS:] - power[:-ROWS]))
        last = first + ROWS
    return first, min(last, first + 2 * ROWS), jumped


def main_parts(y):
    """(N, 1 or 2) the main directions of the columns: all share a loop and its excitation."""
    u, s, _ = np.linalg.svd(y - y.mean(0), full_matrices=False)
    parts = u[:, :2] * s[:2]
    return (parts - parts[0])[:, : 1 + (len(s) > 1 and s[1] > 0.2 * s[0])]


def averaged(y, m):
    return y[: len(y) // m * m].reshape(-1, m, y.shape[1]).mean(1)


def pieces(N):
    """Slices of N rows, so short that OpenBLAS gives no part of a product to its threads, which wait for each other."""
    return [slice(i, i + PIECE) for i in range(0, N, PIECE)]


def product(a, b):
    """a (m, N) times b (N, c)."""
    return sum((a[:, piece] @ b[piece] for piece in pieces(len(b))), np.zeros(()))


def combined(basis, weights):
    """basis (N, m) times weights (m, c)."""
    return np.concatenate([basis[piece] @ weights for piece in pieces(len(basis))])


def orthonormal(basis):
    """Orthonormal columns that span a basis (N, c), by Cholesky's factor."""
    for _ in range(2):  # the second time is for rounding
        square = product(basis.T, basis)
        factor = np.linalg.inv(np.linalg.cholesky(square + 1e-14 * np.trace(square) * np.eye(len(square)))).T
        basis = combined(basis, factor)
    return basis


def free(basis, a):
    """Columns a (N, c) without what a basis (N, t) explains."""
    q = orthonormal(basis)
    return a - combined(q, product(q.T, a))


def path_basis(N, period=np.inf):
    """(N, up to 16) orthonormal: offset, drift, bends, and sines slower than 2.5 periods of the oscillation."""
    t = np.linspace(-1, 1, N)
    many = min(int(2 * N / (2.5 * period)), 6) if 4 * period < N else 0
    sines = [f(np.pi * i * (t + 1) / 2) for i in range(1, many + 1) for f in (np.cos, np.sin)]
    return orthonormal(np.stack([*(t**i for i in range(4)), *sines], 1)[:, : max(N // 3, 2)])


def analytic(y, low=0.0, high=0.5):
    """(N, k) complex: columns between two frequencies [1/row], of which the real part is seen."""
    f = np.fft.fftfreq(4 * len(y))[:, None]
    return np.fft.ifft(np.where((f > low) & (f < high), 2 * np.fft.fft(y, 4 * len(y), axis=0), 0), axis=0)[: len(y)]


def around(y, period):
    """Analytic columns around a period [rows], without what is slower."""
    return analytic(free(path_basis(len(y), period), y), 0.35 / period, 2.5 / period)


def circles(wave) -> bool:
    """Whether analytic columns follow each other by a quarter turn; those of a loop with dead time swing in phase."""
    energy, shapes = np.linalg.eigh(np.einsum("ni,nj->ij", wave, np.conj(wave)))
    return bool(energy[-1] > COHERENT * np.sum(energy) and abs(np.sum(shapes[:, -1] ** 2)) < ROUND)


def periods_of(y) -> list:
    """Periods [rows] that the oscillation of y (N, k) may have: of its autocovariance and of its spectrum."""
    N = len(y)
    still = free(line(N), y)
    shared = np.fft.irfft(np.sum(np.abs(np.fft.rfft(still, 2 * N, axis=0)) ** 2, 1))[:N]
    size = min(N // 2, N - 8)
    every = max(1, -(-size // 120))
    shared = shared[1:size:every]
    still = free(path_basis(N), y)
    power = np.sum(np.abs(np.fft.rfft(still, 4 * N, axis=0)) ** 2, 1) * np.arange(2 * N + 1)
    found = [4 * N / (6 + int(np.argmax(power[6:])))]
    fast = 4 * N / (6 + int(np.argmax((power * np.arange(2 * N + 1) ** 2)[6:])))  # beside a path that moves more
    found += [fast] if fast < found[0] / 1.6 else []
    hankel = np.lib.stride_tricks.sliding_window_view(shared, max(len(shared) - len(shared) // 2 + 1, 1))
    if len(hankel) < 4:
        return found
    space, values, _ = np.linalg.svd(hankel, full_matrices=False)
    space = space[:, : min(6, int(np.sum(values > 1e-9 * values[0])))]
    factors = np.linalg.eigvals(np.linalg.lstsq(space[:-1], space[1:], rcond=None)[0]) + 1e-300
    powers = factors ** np.arange(len(shared))[:, None]
    powers = powers / np.maximum(np.abs(powers).max(0), 1e-300)
    weights = np.linalg.lstsq(powers, shared.astype(complex), rcond=None)[0]
    turn = np.abs(np.angle(factors))
    swings = (turn > 5.6 / len(shared)) & (np.abs(np.log(np.abs(factors))) < 0.75 * turn)
    if not swings.any():
        return found
    best = np.argmax(np.where(swings, np.sum(np.abs(powers * weights) ** 2, 0), 0))
    period = 2 * np.pi / turn[best] * every
    return [period, *(other for other in found if not 1 / 1.6 < period / other < 1.6)]


# --- prediction errors --------------------------------------------------------------------------------


def polynomials(lag, part):
    """(A, b) in powers of B of a velocity that follows with a lag [rows], after a part of a row of dead time."""
    late = np.array([1 - part, part]) if part else np.ones(1)
    if not lag:
        return np.array([1.0, -1.0]), late
    a = np.exp(-1 / lag)
    return np.array([1.0, -1 - a, a]), np.convolve([1 - lag * (1 - a), lag * (1 - a) - a], late)


def noises(A, b):
    """(C, poles that the time before the log excites, whether C has a fitted number) of each kind of noise."""
    yield np.ones(1), (), 0
    slow = () if len(A) == 2 else (A[2],)
    for theta in COLOURS:
        yield np.array([1.0, -theta]), (theta,) * (theta < 1), 1
        if slow:
            yield np.convolve([1.0, -theta], [1.0, -A[2]]), (theta,) * (theta < 1) + slow, 1
    if slow:  # noise that was fed back and is not in the log passes through the drive
        zeros = np.roots(b)
        zeros = zeros[zeros != 0]
        yield np.real(np.poly(np.where(np.abs(zeros) > 1, 1 / zeros, zeros))), (), 0


def fits(y, period):
    """({dead times, lags, z, deviations of z, scores} of all loops of the grid (n,), score of no loop) of y (N, k)."""
    N, k = y.shape
    most = int(min(DEAD, N // 5, period / 3 + 3))
    first = most + 4
    rows, found, none = N - first, [], np.inf
    path = path_basis(rows, period)
    floor = (UNMODELLED**2 * np.var(np.diff(y, axis=0), axis=0) + 1e-12)[:, None]
    for lag in LAGS:
        for part in (0.0, 0.5):
            A, b = polynomials(lag, part)
            for C, before, coloured in noises(A, b):
                basis = path
                if before:
                    basis = orthonormal(np.hstack([np.power.outer(before, np.arange(rows)).T, path]))
                sizes = np.array([q for q in PATHS if q <= path.shape[1]]) + len(before)
                left, acts = filtered(A, C, y)[first:].T, filtered(b, C, y)
                on = product(left, basis)
                v0 = np.maximum((np.sum(left**2, 1)[:, None] - _sums(on**2, sizes)) / rows, 0.0) + floor
                both, own = (np.empty((most + 1, k, len(sizes))) for _ in range(2))
                for c in range(k):
                    late = np.lib.stride_tricks.sliding_window_view(acts[first - 1 - most : N - 1, c], rows)[::-1]
                    across = product(late, basis)
                    both[:, c] = (product(late, left[c][:, None]) - _sums(across * on[c], sizes)) / rows
                    own[:, c] = (np.einsum("di,di->d", late, late)[:, None] - _sums(across**2, sizes)) / rows
                own, v = np.maximum(own, 1e-300), v0
                for _ in range(3):  # columns weigh by what is left of them
                    z = -np.sum(both / v, 1) / np.sum(own / v, 1)
                    v = np.maximum(v0 + z[:, None] * (2 * both + z[:, None] * own), floor)
                numbers = np.log(rows) * ((lag > 0) + coloured + k * sizes)
                score = rows * np.sum(np.log(v), 1) + numbers + np.log(rows)
                none = min(none, np.min(rows * np.sum(np.log(v0), 0) + numbers))
                d, q = np.arange(most + 1), np.argmin(score, 1)
                deviation = 1 / np.sqrt(np.sum(rows * own / v, 1))
                found.append(np.stack([d + part, 0 * d + lag, z[d, q], deviation[d, q], score[d, q]]))
    return np.concatenate(found, 1), none


def _sums(a, sizes):
    """Sums of the first columns of a (..., c), for each size."""
    return np.concatenate([np.zeros((*a.shape[:-1], 1)), np.cumsum(a, -1)], -1)[..., sizes]


def filtered(over, under, y):
    from scipy.signal import lfilter

    return lfilter(over, under, y, axis=0)


def slowest(dead, lag, z) -> complex:
    """The largest factor of a loop per row, above the real axis."""
    A, b = polynomials(lag, dead % 1)
    rule = np.zeros(max(len(A), 1 + int(dead) + len(b)))
    rule[: len(A)] = A
    rule[1 + int(dead) : 1 + int(dead) + len(b)] += z * b
    found = np.roots(rule)
    found = found[found.imag >= -1e-12]
    return complex(found[np.argmax(np.abs(found))])


def read(y) -> Loop | None:
    """The loop behind y (N, k), columns as `prepared` gives them; None if it is too short.

    Of the periods it may have, that with the most evidence; an overtone of a loop that clearly swings is none.
    """
    first, last, jumped = window(y)
    best = None
    for period in periods_of(main_parts(y[first:last])) if last - first > 15 else ():
        loop = _read_at(y, period, first, last, jumped)
        if loop is None or (best is not None and (loop.evidence <= best.evidence or _is_overtone(loop, best))):
            continue
        best = loop
    return best


def _is_overtone(loop, of) -> bool:
    """Whether a loop swings twice or three times in a period of one that clearly swings."""
    clear = of.evidence > EVIDENCE and of.swings > SURELY
    return clear and any(abs(of.period / loop.period / n - 1) < OVERTONE for n in (2, 3))


def _read_at(y, period, first, last, jumped) -> Loop | None:
    """The loop that predicts rows first to last best, on the grid of a period [rows]."""
    m = max(1, min(int(period / PER_PERIOD), (last - first) // 40))
    past = 0 if jumped else min(first, (int(min(DEAD, period / m / 3 + 3)) + 4) * m)
    parts = main_parts(averaged(y[first - past : last], m))
    if len(parts) <= 15:
        return None
    if circles(around(parts, period / m)):
        return None
    loops, none = fits(parts, period / m)
    loops = loops[:, loops[2] > 0]
    if not loops.size:
        return None
    dead, lag, _, _, score = loops
    odds = np.exp(-0.25 * (score - score.min()))
    likely = np.flatnonzero(odds > 1e-3)
    modes = np.array([np.log(slowest(*loops[:3, i]) + 1e-300) / m for i in likely])
    power = np.sum(np.diff(y[first:last], axis=0) ** 2, 1)
    rests = bool(np.sum(power[-len(power) // 3 :]) < np.sum(power[: len(power) // 3]))
    if rests and (decays := modes.real * (last - first) < np.log(GROWN)).any():
        likely, modes = likely[decays], modes[decays]
    swings = modes.imag > 1e-9
    over = np.exp(np.pi * np.minimum(modes.real / np.where(swings, modes.imag, 1.0), 10)) * swings > VISIBLE
    alone, least = lag == 0, score[lag == 0].min(initial=np.inf)
    near = dead[alone & (score < least + AS_WELL)]
    interval = (dead[score == least][0], near.min() - 0.25, near.max() + 0.25) if len(near) else (0.0, 0.0, DEAD)
    return Loop(
        mode=complex(modes[np.argmax(odds[likely])]),
        evidence=float(none - score.min()),
        swings=float(np.sum(odds[likely] * over) / np.sum(odds[likely])),
        dead=tuple(float(max((end + 0.5) * m - 0.5, 0.0)) for end in interval),
        alone=bool(least < score[~alone].min(initial=np.inf) - ALONE),
        rests=rests,
        first=first,
        last=last,
    )


# --- drives that have a mode --------------------------------------------------------------------------


class Found(NamedTuple):
    """Drives that may be behind a mode."""

    drive: Drive  # of which a careful share of the likely drives tolerate less
    alpha: float  # gain of the loop [1/s], the mean of the likely drives
    most: float  # and the largest of nearly all of them
    off: float  # least factor between a known gain and that of a drive with this mode
    ends: tuple  # two drives, between which most of the likely ones are


def drives_of(mode, Ts, alpha=None, *, clipped=False, alone=False) -> Found:
    """Drives with dead time, and a lag, whose loop s + α e^(−Ds)/(τs + 1) has a mode s [1/row].

    Args: alpha: the loop's gain [1/s] if known. clipped: whether that of the mode may be lower. alone: dead time only.
    """
    s = mode / Ts
    whole = max((np.pi - np.angle(s)) / s.imag, 0.5 * Ts)  # of dead time alone, with half a sample
    dead = whole * (np.ones(1) if alone else np.linspace(1, 0, 25))
    turn = np.tan(np.angle(-np.exp(-s * dead) / s))  # of τs + 1
    lag = np.where(dead < whole, turn / (s.imag - s.real * turn), 0.0)
    dead, lag = dead[lag >= 0], lag[lag >= 0]
    gain = np.abs(s * np.exp(s * dead) * (1 + lag * s))
    late = dead + Ts  # where two real poles −x meet nothing overshoots
    x = 2 / (2 * lag + late + np.sqrt(4 * lag**2 + late**2))
    calm = x * (1 - lag * x) * np.exp(-x * late)
    off = np.zeros(len(lag)) if alpha is None else np.log(gain / alpha)
    off = np.maximum(off, 0.0) if clipped else off
    odds = np.exp(-0.5 * np.minimum((off / KNOWN) ** 2, 60.0)) / (1 + (lag / USUAL) ** 2) * np.where(lag > 0, 1.0, 3.0)
    order = np.argsort(calm)
    total = np.cumsum(odds[order]) / np.sum(odds)
    places = order[np.minimum(np.searchsorted(total, [CAREFUL, TAIL, 1 - TAIL]), len(order) - 1)]
    drives = [Drive(delay=float(np.clip(dead[i] / Ts - 0.5, 0, MOST - 1)), lag=float(lag[i])) for i in places]
    mean, least = np.sum(odds * gain) / np.sum(odds), np.exp(np.min(np.abs(off)))
    order = np.argsort(gain)
    most = np.interp((1 - TAIL) * np.sum(odds), np.cumsum(odds[order]), gain[order])
    return Found(drives[0], float(mean), float(most), float(least), tuple(drives[1:]))
