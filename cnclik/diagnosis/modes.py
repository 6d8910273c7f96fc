"""Modes: a recording as a sum of powers of factors, a slow path, and noise.

The factors come from the shift of the signal space of Hankel matrices (ESPRIT, total least squares: Roy & Kailath
1989), stacked for all columns, which share them. Offsets, drifts and slow paths are first projected out of the Hankel
matrices; this does not affect the shift.
"""

from typing import NamedTuple

import numpy as np

from cnclik.diagnosis.blocks import orthogonal, product, triangle, within

ROWS = 128  # of a Hankel matrix, at most
ORDER = 12  # factors of a recording, at most
GROWTH = 4.0  # per sample, at most
DEGREE = 9  # of polynomials that stand for a path
WINDOWS = 8192  # columns of the Hankel matrices, at most; larger recordings are subsampled
CLEAN = 0.1  # noise of a clean column as a share of its variation; noisier ones count less
EXACT = 1e-8  # share of a column that counts as rounding
SHORT, LEFT = 64, 4  # rows of a recording that may be the start of a motion, and rows after the start
PENALTY = 2.0  # of each fitted number, times the logarithm of the number of samples


class Modes(NamedTuple):
    """A recording in parts: y = path + Σ parts + noise."""

    factors: np.ndarray  # (g,) complex; of each pair the one above the real axis
    parts: np.ndarray  # (g, N, k)
    path: np.ndarray  # (N, k) offset, drift and slow motion
    noise: np.ndarray  # (k,) standard deviation of the residual
    score: float  # information criterion; less is better


def trend(N: int, shortest=None) -> np.ndarray:
    """(N, t) columns of offset and drift and, for slow paths, sines and cosines down to a period [samples]."""
    k = np.arange(N) / N
    columns = [np.ones(N), k - 0.5]
    for i in range(1, 0 if shortest is None else int(2 * N / shortest) + 1):
        columns += [np.cos(np.pi * i * k), np.sin(np.pi * i * k)]
    return np.stack(columns, 1)


def find_modes(y, slowest: float) -> Modes:
    """The modes of y (N, k) that an information criterion keeps.

    Args:
      slowest: period [samples] above which motion may belong to a path.
    """
    N = len(y)
    bases = [trend(N)]
    if 3 * slowest < N and 4 * N / slowest < N / 4:
        bases.append(trend(N, slowest))
    return min((_best(y, basis) for basis in bases), key=lambda found: found.score)


def _best(y, basis):
    still, _ = orthogonal(basis)
    sets = [np.zeros(0, complex), *_candidates(y, basis)]
    columns, owners = zip(*(columns_of(factors, len(y)) for factors in sets), strict=True)
    every = np.hstack([*columns, y])
    *columns, rest = np.split(every - within(still, every), np.cumsum([len(owner) for owner in owners]), axis=1)
    tried = [
        _Reduced(factors=factors, owner=owner, r=triangle(np.hstack([own, rest])), y=y, path=basis.shape[1])
        for factors, owner, own in zip(sets, owners, columns, strict=True)
    ]
    best = min(tried, key=lambda fit: fit.score)
    while len(best.factors):  # drop modes that do not improve the criterion
        fewer = min((best.without(i) for i in range(len(best.factors))), key=lambda fit: fit.score)
        if fewer.score > best.score:
            break
        best = fewer
    return _in_parts(y, still, best)


class _Reduced(NamedTuple):
    """A recording and the motions of factors, both without the path and reduced to a triangle, for fits."""

    factors: np.ndarray
    owner: np.ndarray  # (c,) the factor of each column
    r: np.ndarray  # (c + k, c + k) R of columns and recording
    y: np.ndarray
    path: int  # columns of the path

    @property
    def weights(self):
        """(c, k)."""
        c = len(self.owner)
        return np.linalg.lstsq(self.r[:, :c], self.r[:, c:], rcond=1e-13)[0]

    @property
    def score(self) -> float:
        """See `Modes`."""
        (N, k), c = self.y.shape, len(self.owner)
        left = self.r[:, c:] - self.r[:, :c] @ self.weights
        return misfit(np.sum(left**2, axis=0) / N, self.y) + PENALTY * np.log(N) * (c * (k + 1) + self.path * k)

    def without(self, i):
        """The same without the i-th factor."""
        gone = np.flatnonzero(self.owner == i)
        owner = np.delete(self.owner, gone)
        r = np.delete(self.r, gone, axis=1)
        return self._replace(factors=np.delete(self.factors, i), owner=owner - (owner > i), r=r)


def _candidates(y, basis):
    N = len(y)
    rows = min(int(0.4 * N), ROWS)
    width = N - rows + 1
    every = -(-width * y.shape[1] // WINDOWS)
    windows = np.lib.stride_tricks.sliding_window_view(y / _size(y), width, axis=0)[..., ::every]  # (rows, k, width)
    still, _ = orthogonal(basis[:width:every])
    windows = windows.reshape(-1, windows.shape[-1])
    windows = (windows - within(still, windows.T).T).reshape(rows, -1)
    space, values = _signal_space(windows)
    most = min(ORDER, rows // 2, int(np.sum(values > 1e-12 * values[0])))
    # The stacked columns and the same one sample later have the right singular vectors of their triangle.
    both = triangle(np.hstack([space[:-1, :most], space[1:, :most]]))
    for order in range(1, most + 1):
        _, _, v = np.linalg.svd(both[:, np.r_[:order, most : most + order]])
        v = v.T
        found = np.linalg.eigvals(-np.linalg.lstsq(v[order:, order:].T, v[:order, order:].T, rcond=None)[0].T)
        found = found[(found.imag >= 0) & (np.abs(found) < GROWTH) & (np.abs(found) > 1e-3)]
        found = np.where(np.abs(found.imag) < 1e-12, found.real, found)
        yield found[np.argsort(-np.abs(found))]


def _signal_space(windows):
    """(first left singular vectors, their values) of windows (rows, M).

    Eigenvectors of the square do not resolve values below 1e-8 of the largest, so a subspace iteration with twice as
    many vectors refines them (Golub & Van Loan 2013, Section 8.2.4). LAPACK is called directly with the smallest
    workspace: its blocks are then too small for BLAS to use threads (`eigh` provides a larger one).
    """
    from scipy.linalg.lapack import dsyevx

    rows = len(windows)
    _, space, *_ = dsyevx(
        product(windows, windows.T), range="I", il=max(rows - 2 * ORDER, 0) + 1, iu=rows, lwork=8 * rows
    )
    over, _ = orthogonal(product(windows.T, space[:, ::-1].copy()))
    space, values, _ = np.linalg.svd(product(windows, over), full_matrices=False)
    return space, values


def _size(y):
    """(k,) size of each column: its variation, ten times as much for a mostly noisy column as for a clean one."""
    size = np.maximum(CLEAN * np.std(y, axis=0), roughness(y))
    return np.where(size > 0, size, 1.0)


def roughness(y):
    """(k,) estimate of each column's noise: the standard deviation of white noise, nearly 0 for smooth columns."""
    return np.std(np.diff(y, 3, axis=0), axis=0) / np.sqrt(20)


def columns_of(factors, N: int):
    """(real columns (N, c) of factors, each at most 1; the factor of each column (c,))."""
    k = np.arange(N)
    columns, owner = [], []
    for i, factor in enumerate(factors):
        last = N - 1 if abs(factor) > 1 else 0
        power = np.abs(factor) ** (k - last) * np.exp(1j * np.angle(factor) * k)
        parts = [power.real] if factor.imag == 0 else [power.real, power.imag]
        columns += parts
        owner += [i] * len(parts)
    return np.stack(columns, 1) if columns else np.zeros((N, 0)), np.array(owner, int)


def _in_parts(y, still, best: _Reduced):
    columns, owner = columns_of(best.factors, len(y))
    each = [columns[:, owner == i] @ best.weights[owner == i] for i in range(len(best.factors))]
    parts = np.array(each).reshape(len(each), *y.shape)
    moving = y - parts.sum(0)
    path = within(still, moving)
    return Modes(best.factors, parts, path, noise=np.std(moving - path, axis=0), score=best.score)


def misfit(power, y) -> float:
    """-2 log-likelihood of a residual of y (N, k) with mean square (k,); each column has its own noise."""
    N = len(y)
    floor = (EXACT * np.std(y, axis=0)) ** 2 + (1e-15 * np.abs(y).max(0)) ** 2 + np.finfo(float).tiny
    return float(N * np.sum(np.log(power + floor)))


def polynomials(y) -> float:
    """The information criterion of the polynomial that explains y (N, k) best, as in `Modes.score`.

    For a short recording, polynomials that begin after some rows at rest are tried as well, as after a dead time.
    """
    N = len(y)
    t = np.linspace(-1, 1, N)[:, None]
    scores = [_polynomials(t ** np.arange(DEGREE + 1), y, range(3, DEGREE + 2), 0)]
    for begins in range(1, N - LEFT if N <= SHORT else 0):
        after = np.maximum(t - t[begins], 0.0) ** np.arange(1, DEGREE - 2)
        scores.append(_polynomials(np.hstack([np.ones_like(t), after]), y, range(2, DEGREE - 1), 1))
    return min(scores)


def _polynomials(basis, y, counts, others) -> float:
    """The least criterion over leading columns of a basis (N, c). counts: how many. others: other fitted numbers."""
    (N, k), c = y.shape, basis.shape[1]
    r = triangle(np.hstack([basis, y]))[:, c:]
    return min(misfit(np.sum(r[n:] ** 2, axis=0) / N, y) + PENALTY * np.log(N) * (n * k + others) for n in counts)


def shape_of(y, found: Modes, i: int):
    """(k,) complex weights of the i-th mode in each column: y = … + Re(weight · factor^k), largest row 1."""
    columns, owner = columns_of(found.factors[[i]], len(y))
    q, r = orthogonal(columns)
    weights, *_ = np.linalg.lstsq(r, product(q.T, found.parts[i]), rcond=1e-13)
    return weights[0] - 1j * weights[1] if len(owner) == 2 else weights[0].astype(complex)
