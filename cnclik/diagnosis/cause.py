"""Cause: what no smaller gain ends, a wrong sign and turned frames; and what is no loop, a sweep."""

import numpy as np

from cnclik.diagnosis.loop import DEAD, UNMODELLED, averaged, fits, free, path_basis, slowest, window
from cnclik.diagnosis.recording import line

LEFT = 0.1  # share of the steps' power that turned frames leave unexplained, at most
BETTER = 12.0  # decrease of the information criterion that is more than strong evidence (Raftery 1995)
ALIKE = 25.0  # of the criterion, within which another dead time explains a spiral as well
STEADY = 1.1  # ratio of the sizes in the last thirds of a circle, at most; the first one may be a push
PARTS = 250  # rows to which a spiral or a growth is averaged
WAY = 1.05  # of a growth, its way over its distance: noise apart it never turns back
FASTER = 1.3  # least ratio of the last two quarters of a growth


def turned(y, gain=None) -> tuple | None:
    """The rotation R of Δe[k] = −z R e[k − d] (Kabsch 1976) of two or three coordinates, or of both halves of six.

    Returns its rotation vector (3,) [degrees], z per row, and whether its size stays as of a circle; None where a z of
    any sign for each column explains the log as well. A spiral leaves d open, as a turn by the angle of d rows looks
    alike: of those that explain it as well that is taken whose z is next to a known gain, or else the least d.
    """
    from scipy.signal import lfilter
    from scipy.spatial.transform import Rotation

    blocks = {2: [[0, 1]], 3: [[0, 1, 2]], 6: [[0, 1, 2], [3, 4, 5]]}.get(y.shape[1], [])
    first, last = window(y)
    y = y[max(first - 1, 0) : last]
    m = max(1, len(y) // PARTS)
    y = averaged(y, m)
    most = min(DEAD, len(y) // 5)
    N = len(y) - most - 4
    if not blocks or N < 12:
        return None
    y = y / np.concatenate([np.full(len(b), np.sqrt(np.mean(np.var(y[:, b], axis=0))) + 1e-300) for b in blocks])
    floor = UNMODELLED**2 * np.mean(np.var(np.diff(y, axis=0), axis=0)) + 1e-12
    level, plain = line(N), np.inf
    spins: list = []
    for theta in (0.0, 0.8, 1.0):
        over = [1.0, -theta]
        left, acts = free(level, lfilter([1.0, -1.0], over, y, axis=0)[-N:]), lfilter([1.0], over, y, axis=0)
        for d in range(most + 1):
            late = free(level, acts[-N - 1 - d : -1 - d])
            each = -np.sum(left * late, 0) / np.maximum(np.sum(late**2, 0), 1e-300)
            u, _, vt = np.linalg.svd(-sum(left[:, b].T @ late[:, b] for b in blocks))
            u[:, -1] *= np.sign(np.linalg.det(u @ vt))
            moved = late @ np.kron(np.eye(len(blocks)), u @ vt).T
            z = -np.sum(left * moved) / max(np.sum(moved**2), 1e-300)
            rests = left + each * late, left + z * moved
            alone, score = (N * np.sum(np.log(np.mean(rest**2, 0) + floor)) for rest in rests)
            plain = min(plain, alone + np.log(N) * (len(each) + (theta != 0)))
            if z > 0:
                score += np.log(N) * (4 + (theta != 0))
                spins.append((score, d, z / m, u @ vt, np.sum(rests[1] ** 2) / np.sum(left**2)))
    least = min((spin[0] for spin in spins), default=0.0)
    alike = sorted((spin for spin in spins if spin[0] <= least + ALIKE), key=lambda spin: spin[1::-1])
    if not alike or alike[0][4] > LEFT or plain - alike[0][0] < BETTER:
        return None
    if gain is not None:
        alike.sort(key=lambda spin: abs(np.log(spin[2] / gain)))
    turn = np.eye(3)
    turn[: len(alike[0][3]), : len(alike[0][3])] = alike[0][3]
    wave = free(line(len(y)), y)
    sizes = [float(np.linalg.norm(wave[-i * (len(y) // 3) :][: len(y) // 3])) for i in (3, 2, 1)]
    steady = 1 / STEADY < sizes[2] / max(sizes[1], 1e-300) < STEADY and sizes[2] > 0.5 * sizes[0]
    return Rotation.from_matrix(turn).as_rotvec(degrees=True), alike[0][2], steady


def growth(y) -> float:
    """Growth per row without oscillation of y (N, k); 0 for none."""
    N, near = len(y), max(len(y) // 10, 2)
    way = y[-near:].mean(0) - y[int(0.6 * N) - near // 2 : int(0.6 * N) + near].mean(0)
    m = max(1, N // PARTS)
    if N // m < 16 or not way.any():
        return 0.0
    x = y @ way / np.linalg.norm(way)
    at, near = np.linspace(0, N - 1, 5).astype(int), max(N // 40, 1)
    steps = np.diff([x[max(i - near, 0) : i + near + 1].mean() for i in at])
    half = x[N // 2 :: max(N // 24, 1)]
    if np.sum(np.abs(np.diff(half))) > WAY * abs(half[-1] - half[0]) or not steps[3] > FASTER * steps[2]:
        return 0.0
    loops, none = fits(averaged(x[:, None] - x[0], m), np.inf)
    wrong, right = loops[:, loops[2] < 0], loops[:, loops[2] > 0]
    if min(none, right[3].min(initial=np.inf)) - wrong[3].min(initial=np.inf) < BETTER / 2:
        return 0.0
    rate = float(abs(slowest(*wrong[:3, np.argmin(wrong[3])])) ** (1 / m))
    seen = np.log(steps[3] / max(steps[2], 1e-3 * steps[3]))  # in a quarter, by noise and offsets not all of the mode's
    return rate if seen > 0.5 * N / 4 * np.log(rate) else 0.0


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
    half = int(np.clip(np.searchsorted(total, total[-1] / 2), period / 2, max(N - 1 - period / 2, period / 2)))
    if not 0 < half < N - 1:
        return 1.0, 1.0, 1.0
    turn = np.angle(wave[1:] * np.conj(wave[:-1])) * energy
    speed = [np.sum(turn[p]) / max(np.sum(energy[p]), 1e-300) for p in (slice(half), slice(half, None))]
    larger = np.sqrt(np.mean(energy[half:]) / max(np.mean(energy[:half]), 1e-300))
    size = np.sqrt(energy[N // 4 : 3 * N // 4])
    return float(speed[1] / speed[0]), float(larger), float(np.std(size) / max(np.mean(size), 1e-300))
