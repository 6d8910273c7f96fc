"""Loop: the mode of the loop behind a log, by prediction errors, and the drives that have this mode; or no such loop.

An error that is fed back late obeys A(B) y = −z b(B) B^(d+1) y + C(B) w, z = alpha·Ts (Ljung 1999). B shifts by a row,
A is 1 − B, or (1 − B)(1 − aB) with a lag, and w is white. C is 1 for noise of the motion and A for noise of its
measurement, which the loop feeds back. Dead time, lag and C are on a grid; z, and what a path adds, by least squares.

Only the mode counts. Many drives have it, from dead time alone to a lag alone: they tolerate other shares of a gain,
and differ in how soon they answer a push. Turned frames and growth are what no smaller gain ends; a sweep is no loop.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cnclik.diagnosis.check import APART, around
from cnclik.diagnosis.recording import LARGEST
from cnclik.integrate.drive import MOST, Drive

ROWS = 2000  # rows that are read, those that move most: more change no digit of a gain
PER_PERIOD, DEAD = 24, 16  # rows of a period that are kept, and of dead time, which is below a quarter of it
LAGS = (0.0, 1.0, 2.5, 6.0, 15.0)  # of these rows; the phase at the limit changes by 20° from one to the next
PATHS = (0, 1, 2, 4, 8, 12, 16)  # columns of a path's basis: offset, drift, bends, slow sines
COUNTS = 6.0  # of an encoder each, that the joints below a tip make at rest
UNMODELLED = 0.005  # share of the steps that no linear loop explains
VISIBLE = 0.1  # of an error, by which a loop passes its target if its gain is too large
ALONE, AS_WELL = 15.0, 8.0  # decrease of the criterion by which dead time alone, or a dead time, is better than others
USUAL = 0.05  # [s] of a usual lag: larger ones count less
PUSHED = 0.05  # share of all its way by which an error jumps when the target is pushed, at least
PART = np.array([0.3, 0.6])  # of a push: how long the motion takes to make up for the first tells dead time from a lag
LINEAR = 1.35  # ratio of the time from the first to the second to a loop's, up to which no limit or other jump made it
SOONER, ABOUT = 0.05, 0.1  # shares of that time, mean and deviation: servos of ζ 0.7 to 1.3 take −13 to 3 % more
GIVEN, SELDOM = 0.15, 0.03  # relative deviation of the loop's gain from a known one; how often a limit lowers it
TAIL, MIDDLE = 0.1, 0.6  # share of the likely drives beyond each end; where between the ends' shares that chosen is
LEFT = 0.1  # share of the power of the motion that turned frames leave unexplained, at most
BETTER = 12.0  # decrease of the information criterion that is more than strong evidence (Raftery 1995)
ALIKE = 60.0  # of the criterion, within which another dead time explains a spiral as well
CURVED = 15.0  # ratio of what wrong signs and a turn leave of a growth, up to which an arm's curvature may make it
STEADY = 1.1  # ratio of the sizes in the last thirds of a circle, at most; the first one may be a push
CIRCLE = 0.33  # |Σv²| over Σ|v|² of an ellipse of ratio 0.7; those of arms whose joints differ have 0.49 at least
PARTS = 250  # rows to which a spiral or a growth is averaged
WAY = 1.05  # of a growth, its way over its distance: noise apart it never turns back
FASTER = 37 / 19  # ratio of the last two quarters of a cubic from rest: what bends no more may be a path,
EVEN = 0.25  # unless the last three quarters grow as the mode does, up to this share


class Loop(NamedTuple):
    """What is read in a log. Rows are those of the log."""

    mode: complex  # s [1/row] of the oscillation or decay that ends last
    period: float  # of it [rows]
    evidence: float  # decrease of the information criterion by this loop
    swings: float  # share of the probability of loops that pass their target by VISIBLE
    dead: tuple | None  # ends of the rows of dead time, where that alone explains the log much better than any lag
    lags: np.ndarray  # (2, n) lags [rows] and how likely they are
    first: int  # rows that were read
    last: int
    begins: np.ndarray | None  # (2,) rows until PART of a push of the target is made up for; None without one


def noise_of(y):
    """(k,) standard deviation of white noise in columns that are smooth otherwise."""
    return np.median(np.abs(np.diff(y, 3, axis=0)), axis=0) / (0.6745 * np.sqrt(20))


def resolution_of(column) -> float:
    """The step of which all steps of a column are multiples; 0 where there is none."""
    step = np.abs(np.diff(column))
    step = step[step > 1e-12 * np.abs(column).max()]
    least = step.min(initial=np.inf)
    whole = len(step) and np.all(np.abs(step / least - np.round(step / least)) < 0.05)
    return float(least) if whole and np.median(step) < 50 * least else 0.0


def prepared(y):
    """Columns that move by more than noise and resolution, in units of these or a tenth of their deviation."""
    step, span = np.array([resolution_of(column) for column in y.T]), np.ptp(y, axis=0)
    moves = (span > 1e-12 * np.abs(y).max(0)) & (span > 3.5 * step)
    steps = np.linalg.norm(np.diff(y, axis=0), axis=1)
    at = np.flatnonzero(steps > 1e-12 * np.abs(y).max())
    apart = np.diff(at, prepend=-1)
    if 0 < 2 * len(at) < len(steps) and np.ptp(apart) > 1 < np.median(apart):  # counts, no slow sensor, no rest
        moves &= np.linalg.norm(span) > COUNTS * np.median(steps[at])
    unit = np.maximum(np.maximum(0.1 * np.std(y, axis=0), noise_of(y)), step)
    return ((y - y[0]) / np.where(unit > 0, unit, 1.0))[:, moves]


def window(y) -> tuple:
    """(first row of the motion after a push, last one that is read, rows until PART of a jump of y is made up for)."""
    N, span, steps = len(y), np.ptp(y, axis=0), np.linalg.norm(np.diff(y, axis=0), axis=1)
    noise = 6 * noise_of(y)
    least = PUSHED * np.linalg.norm(span) + np.linalg.norm(noise)
    jumps = steps * (steps > np.maximum(APART * around(steps), least))
    first, last, begins = int(np.argmax(jumps)) + 1, N, None
    if jumps[first - 1] > 0 and first < 0.6 * N:
        jump = y[first] - y[first - 1]
        back = (y[first] - y[first:]) @ jump / (jump @ jump)
        begins = np.interp(PART, np.maximum.accumulate(back), np.arange(N - first)) if max(back) > PART[1] else None
    else:
        away = np.argmax(np.any(np.abs(y - y[0]) > noise + 2e-3 * span, axis=1))
        first = int(away) if away < 0.6 * N else 0
    if last - first > ROWS:
        power = np.concatenate([[0.0], np.cumsum(np.sum(np.diff(y[first:last], axis=0) ** 2, 1))])
        first += int(np.argmax(power[ROWS:] - power[:-ROWS]))
        last = first + ROWS
    return first, last, begins


def main_parts(y):
    """(N, 1 or 2) the main directions of the columns: all share a loop and its excitation."""
    u, s, _ = np.linalg.svd(y - y.mean(0), full_matrices=False)
    parts = u[:, :2] * s[:2]
    return (parts - parts[0])[:, : 1 + (len(s) > 1 and s[1] > 0.2 * s[0])]


def averaged(y, m):
    return y[: len(y) // m * m].reshape(-1, m, y.shape[1]).mean(1)


def free(basis, a):
    """Columns a (N, c) without what a basis (N, t) explains."""
    q = np.linalg.qr(basis)[0]
    return a - q @ (q.T @ a)


def path_basis(N, period=np.inf):
    """(N, up to 16) orthonormal: offset, drift, bends, and sines slower than 2.5 periods of the oscillation."""
    t = np.linspace(-1, 1, N)
    many = min(int(2 * N / (2.5 * period)), 6) if 4 * period < N else 0
    sines = [f(np.pi * i * (t + 1) / 2) for i in range(1, many + 1) for f in (np.cos, np.sin)]
    return np.linalg.qr(np.stack([*(t**i for i in range(4)), *sines], 1)[:, : max(N // 3, 2)])[0]


def period_of(y) -> float:
    """The period [rows] of the most steps of y (N, k) beside a path."""
    power = np.sum(np.abs(np.fft.rfft(free(path_basis(len(y)), y), 4 * len(y), axis=0)) ** 2, 1)
    return 4 * len(y) / (6 + int(np.argmax((power * np.arange(len(power)))[6:])))


def polynomials(lag, part):
    """(A, b) in powers of B of a velocity that follows with a lag [rows], after a part of a row of dead time."""
    late = np.array([1 - part, part]) if part else np.ones(1)
    a = np.exp(-1 / lag) if lag else 0.0
    return np.array([1.0, -1 - a, a]), np.convolve([1 - lag * (1 - a), lag * (1 - a) - a], late)


def filtered(rule, y):
    """(N, k) each row of y with those before it, by the shares of a rule; SciPy's filters take a second to load."""
    return np.stack([np.convolve(column, rule)[: len(y)] for column in y.T], 1)


def fits(y, period):
    """({dead times, lags, z, scores} of all loops of the grid (4, n), score of no loop) of y (N, k)."""
    (N, k), whole = y.shape, np.cumsum(y, axis=0)
    most = int(min(DEAD, N // 5, period / 3 + 3))
    first, rows, loops, none = most + 4, N - most - 4, [], np.inf
    path = path_basis(rows, period)
    floor = (UNMODELLED**2 * np.var(np.diff(y, axis=0), axis=0) + 1e-12)[:, None]
    for lag, part in ((lag, part) for lag in LAGS for part in (0.0, 0.5)):
        A, b = polynomials(lag, part)
        lagged = filtered(A[2] ** np.arange(40 * lag + 1), whole)
        # C is 1, 1 − B or A: how many terms it has, A/C, and y/C
        for terms, rule, moved in ((1, A, y), (2, [1.0, -A[2]], whole), (3, [1.0], lagged))[: 2 + (lag > 0)]:
            start = [A[2] ** np.arange(rows)] * (terms // 3)  # the time before the log decays as the lag
            basis = np.pad(np.linalg.qr(np.column_stack([*start, path]))[0], ((0, 0), (1, 0)))  # 0: no path
            sizes = len(start) + np.array([size for size in PATHS if size <= path.shape[1]])
            left, acts = filtered(rule, y)[first:].T, filtered(b, moved)
            on = left @ basis
            v0 = np.maximum((np.sum(left**2, 1)[:, None] - np.cumsum(on**2, -1)[:, sizes]) / rows, 0.0) + floor
            both, square = np.empty((2, most + 1, k, len(sizes)))
            for c in range(k):
                late = np.lib.stride_tricks.sliding_window_view(acts[first - 1 - most : N - 1, c], rows)[::-1]
                across = late @ basis
                both[:, c] = ((late @ left[c])[:, None] - np.cumsum(across * on[c], -1)[:, sizes]) / rows
                square[:, c] = (np.einsum("di,di->d", late, late)[:, None] - np.cumsum(across**2, -1)[:, sizes]) / rows
            square, v = np.maximum(square, 1e-300), v0
            for _ in range(3):  # columns weigh by what is left of them
                z = -np.sum(both / v, 1) / np.sum(square / v, 1)
                v = np.maximum(v0 + z[:, None] * (2 * both + z[:, None] * square), floor)
            numbers = np.log(rows) * ((lag > 0) + (terms > 1) + k * sizes)
            score = rows * np.sum(np.log(v), 1) + numbers + np.log(rows)
            none = min(none, np.min(rows * np.sum(np.log(v0), 0) + numbers))
            d, best = np.arange(most + 1), np.argmin(score, 1)
            loops.append(np.stack([d + part, 0 * d + lag, z[d, best], score[d, best]]))
    return np.concatenate(loops, 1), none


def slowest(dead, lag, z) -> complex:
    """The largest factor of a loop per row, above the real axis."""
    A, b = polynomials(lag, dead % 1)
    rule = np.append(A, np.zeros(int(dead) + len(b)))
    rule[1 + int(dead) : 1 + int(dead) + len(b)] += z * b
    factors = np.roots(rule)
    factors = factors[factors.imag >= -1e-12]
    return complex(factors[np.argmax(np.abs(factors))])


def read(y) -> Loop | None:
    """The loop that predicts y (N, k) best, columns as `prepared` gives them; None if it is too short."""
    first, last, begins = window(y)
    period = period_of(main_parts(y[first:last]))
    m = max(1, min(int(period / PER_PERIOD), (last - first) // 40))
    past = min(first, (int(min(DEAD, period / m / 3 + 3)) + 4) * m)
    parts = main_parts(averaged(y[first - past : last], m))
    if len(parts) <= 15:
        return None
    loops, none = fits(parts, period / m)
    loops = loops[:, loops[2] > 0]
    if not loops.size:
        return None
    dead, lag, _, score = loops
    odds = np.exp(-0.25 * (score - score.min()))
    likely = np.flatnonzero(odds > 1e-3)
    modes = np.array([np.log(slowest(*loops[:3, i]) + 1e-300) / m for i in likely])
    swings = modes.imag > 1e-9
    over = np.exp(np.pi * np.minimum(modes.real / np.where(swings, modes.imag, 1.0), 10)) * swings > VISIBLE
    least, interval = score[lag == 0].min(initial=np.inf), None
    if least < score[lag > 0].min(initial=np.inf) - ALONE:
        near = dead[(lag == 0) & (score < least + AS_WELL)]
        interval = tuple(max((end + 0.5) * m - 0.5, 0.0) for end in (near.min() - 0.25, near.max() + 0.25))
    share = float(np.sum(odds[likely] * over) / np.sum(odds[likely]))
    # Evidence tells of lags only where dead time alone explains the log best: else a lag may stand for a servo.
    lags = [odds[lag == each].max(initial=0.0) if lag[np.argmin(score)] == 0 else 1.0 for each in LAGS]
    lags = np.array([np.array(LAGS) * m, lags])
    mode = modes[np.argmax(odds[likely])]
    period = 2 * np.pi / mode.imag if mode.imag > 1e-9 else np.inf
    if mode.real * (last - first) > np.log(LARGEST):
        return None
    return Loop(mode, period, float(none - score.min()), share, interval, lags, first, last, begins)


def drives_of(read, mode, Ts, alpha, *, clipped) -> tuple:
    """Drives with dead time, and a lag, whose loop s + α e^(−Ds)/(τs + 1) has a mode s [1/row].

    Returns one that tolerates a share of its gain between those of the ends; the ends, between which most of the likely
    ones are; its loop's gain [1/s], the least of all, the larger one of the ends; and the ratio of the shares.
    Args: alpha: the loop's gain [1/s] or None; clipped: or more than that of the mode.
    """
    s, step = mode / Ts, 2 * np.sinh(mode / 2) / Ts  # step: of the motion from sample to sample, s of slow modes
    whole = max((np.pi - np.angle(step)) / s.imag, 0.5 * Ts)  # of dead time alone, with half a sample
    dead = whole * (np.ones(1) if read.dead is not None else np.linspace(1, 0, 25))
    turn = np.tan(np.angle(-np.exp(-s * dead) / step))  # of τs + 1
    lag = np.where(dead < whole, np.minimum(turn / (s.imag - s.real * turn), 1e4 * whole), 0.0)
    dead, lag = dead[lag >= 0], lag[lag >= 0]
    gain = np.abs(step * np.exp(s * dead) * (1 + lag * s))
    late = dead + Ts  # where two real poles −x meet nothing overshoots
    x = 2 / (2 * lag + late + np.sqrt(4 * lag**2 + late**2))
    calm = x * (1 - lag * x) * np.exp(-x * late)
    off = np.zeros(len(lag)) if alpha is None else np.log(gain / alpha)
    odds = np.maximum(np.exp(-0.5 * np.minimum((off / GIVEN) ** 2, 60.0)), (1.0 if clipped else SELDOM) * (off < 0))
    odds = odds / (1 + (lag / USUAL) ** 2) * np.where(lag > 0, 1.0, 3.0) * np.interp(lag / Ts, *read.lags)
    if read.begins is not None:
        u = PART[:, None] / gain
        begins = dead + np.sqrt(u * (u + 2 * lag))  # of dead time and a lag 6 % short at most, of a lag alone 10 %
        rest = np.diff(read.begins) * Ts / (begins[1] - begins[0])
        if min(rest) < LINEAR and max(rest) > 1 / LINEAR:
            apart = np.log(read.begins[0] * Ts / begins[0]) + SOONER
            odds = odds * np.exp(-0.5 * np.minimum((apart / ABOUT) ** 2, 12.0))
    share = np.log(calm / gain if alpha is None else calm / alpha)
    odds, order = odds / np.sum(odds), np.argsort(share)
    ends = order[np.minimum(np.searchsorted(np.cumsum(odds[order]), [TAIL, 1 - TAIL]), len(order) - 1)]
    places = [np.argmin(np.abs(share - share[ends] @ [1 - MIDDLE, MIDDLE])), *ends]
    middle, *both = (Drive(delay=float(np.clip(dead[i] / Ts - 0.5, 0, MOST - 1)), lag=float(lag[i])) for i in places)
    return middle, tuple(both), float(gain[places[0]]), gain.min(), gain[ends].max(), np.exp(np.ptp(share[ends]))


def turned(y, gain, circle) -> tuple | None:
    """The rotation R of Δe[k] = −z R e[k − d] (Kabsch 1976) of two or three coordinates, or of both halves of six.

    Returns its rotation vector (3,) [degrees], z per row, and whether its size stays as of a circle; None where a z of
    any sign for each column explains the log as well, unless the columns swing on a circle. A spiral leaves d open, as
    a turn by the angle of d rows looks alike: of those that explain it as well that is taken whose z is next to a known
    gain, or else the least d.
    """
    from scipy.spatial.transform import Rotation

    blocks = {2: [[0, 1]], 3: [[0, 1, 2]], 6: [[0, 1, 2], [3, 4, 5]]}.get(y.shape[1], [])
    first, last, _ = window(y)
    m = max(1, (last - first) // PARTS)
    past = min(first // m, DEAD + 1)
    y = averaged(y[first - past * m : last], m)
    most = min(DEAD, len(y) // 5)
    N = len(y) - most - 1
    if not blocks or N < 12:
        return None
    y = y / np.concatenate([np.full(len(b), np.sqrt(np.mean(np.var(y[:, b], axis=0))) + 1e-300) for b in blocks])
    floor = UNMODELLED**2 * np.mean(np.var(np.diff(y, axis=0), axis=0)) + 1e-12
    level, plain, spins = path_basis(N)[:, :3], (np.inf, 1.0), []  # columns may drift
    left, acts = free(level, y[-N:]), np.cumsum(y, axis=0)  # both sides summed: noise of the measurement stays white
    for d in range(most + 1):
        late = free(level, acts[-N - 1 - d : -1 - d])
        each = -np.sum(left * late, 0) / np.maximum(np.sum(late**2, 0), 1e-300)
        u, _, vt = np.linalg.svd(-sum(left[:, b].T @ late[:, b] for b in blocks))
        u[:, -1] *= np.sign(np.linalg.det(u @ vt))
        moved = late @ np.kron(np.eye(len(blocks)), u @ vt).T
        z = -np.sum(left * moved) / max(np.sum(moved**2), 1e-300)
        rests = left + each * late, left + z * moved
        alone, score = (N * np.sum(np.log(np.mean(rest**2, 0) + floor)) for rest in rests)
        plain = min(plain, (alone + np.log(N) * len(each), np.sum(rests[0] ** 2) / np.sum(left**2)))
        if z > 0:
            spins.append((score + np.log(N) * 4, d, z / m, u @ vt, np.sum(rests[1] ** 2) / np.sum(left**2)))
    least = min((spin[0] for spin in spins), default=0.0)
    alike = [spin for spin in spins if spin[0] <= least + ALIKE]
    if not alike or alike[0][4] > LEFT or not (circle or plain[0] - alike[0][0] > BETTER):
        return None
    best = alike[0] if gain is None else min(alike, key=lambda spin: abs(np.log(spin[2] / gain)))
    turn = np.eye(3)
    turn[: len(best[3]), : len(best[3])] = best[3]
    if not circle and np.trace(turn) < 1 and plain[1] < min(LEFT, CURVED * best[4]):  # it grows as by a wrong sign
        return None
    wave = free(path_basis(len(y) - past)[:, :2], y[past:])
    sizes = [float(np.linalg.norm(third)) for third in np.array_split(wave, 3)]
    steady = 1 / STEADY < sizes[2] / max(sizes[1], 1e-300) < STEADY and sizes[2] > 0.5 * sizes[0]
    return Rotation.from_matrix(turn).as_rotvec(degrees=True), best[2], steady


def growth(y, least=0.0) -> float:
    """Growth per row without oscillation of the fastest column of y (N, k), by a z of at least `least`; 0 for none."""
    return max(_growth(x, least) for x in y.T)


def _growth(x, least) -> float:
    N, m = len(x), max(1, len(x) // PARTS)
    if N // m < 16:
        return 0.0
    x = x * np.sign(x[-1] - x[N // 2])
    at, near = np.linspace(0, N - 1, 5).astype(int), max(N // 40, 1)
    steps = np.diff([x[max(i - near, 0) : i + near + 1].mean() for i in at])
    half = x[N // 2 :: max(N // 24, 1)]
    if np.sum(np.abs(np.diff(half))) > WAY * abs(half[-1] - half[0]) or not steps[3] > steps[2]:
        return 0.0
    loops, none = fits(averaged(x[:, None] - x[0], m), np.inf)
    wrong, right = loops[:, loops[2] < 0], loops[:, loops[2] > 0]
    if min(none, right[3].min(initial=np.inf)) - wrong[3].min(initial=np.inf) < BETTER / 2:
        return 0.0
    if -wrong[2, wrong[3] <= wrong[3].min() + AS_WELL].min() < least * m:  # dead time is open where all grows alike
        return 0.0
    rate = float(abs(slowest(*wrong[:3, np.argmin(wrong[3])])) ** (1 / m))
    grown = np.diff(np.log(np.maximum(steps, 1e-3 * steps[3]))) / (N / 4 * np.log(rate))  # over what the mode grows
    return rate if (steps[3] > FASTER * steps[2] and grown[2] > 0.5) or np.all(np.abs(grown[1:] - 1) < EVEN) else 0.0


def wave(N, mode):
    """(N, 2) the swing of a mode s [1/row], as a cosine and a sine; the largest is about 1."""
    swing = np.exp(mode * (np.arange(N) - (N - 1) * (mode.real > 0)))
    return np.stack([swing.real, swing.imag], 1)


def on_a_circle(y, mode) -> bool:
    """Whether a mode s [1/row] is most of what columns y (N, k) show, for a turn at least, one after the other.

    Their complex amplitudes v have |Σv²| = Σ|v|² where they swing at once, as after a push, and Σv² = 0 on a circle.
    """
    y, basis = main_parts(y), np.column_stack([np.ones(len(y)), wave(len(y), mode)])
    amplitude = np.linalg.lstsq(basis, y, rcond=None)[0]
    v, left = amplitude[1] - 1j * amplitude[2], y - basis @ amplitude
    most = np.sum(left**2) < LEFT * np.sum((y - y.mean(0)) ** 2)
    return bool(mode.imag * len(y) > 2 * np.pi and most and abs(np.sum(v**2)) < CIRCLE * np.sum(np.abs(v) ** 2))


def swept(y, period) -> tuple[float, float, float]:
    """(how much faster, how much larger) an oscillation of y (N, k) is in the second half of its energy; its unrest.

    The unrest is the deviation of its size over the mean, of half the rows: 0.5 where noise excites it, 0 for a limit.
    """
    N = len(y)
    f = np.fft.fftfreq(4 * N)[:, None] * period
    power = np.where((f > 0.35) & (f < 2.5), np.fft.fft(free(path_basis(N, period), y), 4 * N, axis=0), 0)
    wave = np.fft.ifft(power, axis=0)[:N]  # analytic
    u, s, _ = np.linalg.svd(wave, full_matrices=False)
    wave = u[:, 0] * s[0]
    energy = np.abs(wave[1:]) ** 2
    total = np.cumsum(energy)
    side = min(period / 2, N / 2 - 1)
    half = int(np.clip(np.searchsorted(total, total[-1] / 2), side, N - 1 - side))
    turn = np.angle(wave[1:] * np.conj(wave[:-1])) * energy
    speed = [np.sum(turn[p]) / max(np.sum(energy[p]), 1e-300) for p in (slice(half), slice(half, None))]
    larger = np.sqrt(np.mean(energy[half:]) / max(np.mean(energy[:half]), 1e-300))
    size = np.sqrt(energy[N // 4 : 3 * N // 4])
    return float(speed[1] / speed[0]), float(larger), float(np.std(size) / max(np.mean(size), 1e-300))
