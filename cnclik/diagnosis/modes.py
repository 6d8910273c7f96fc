"""Modes: a recording as a sum of factors to the power of the sample, a slow path, and noise.

Factors come from the shift of the signal space of Hankel matrices (ESPRIT, total least squares: Roy & Kailath 1989),
stacked for several columns, which share them. Offsets, drifts and slow paths are projected out of the Hankel matrices
beforehand, which leaves what is shifted as it is.
"""

from typing import NamedTuple

import numpy as np

from cnclik.diagnosis.blocks import orthogonal, product, triangle, within

ROWS = 128  # of a Hankel matrix, at most
ORDER = 12  # factors of a recording, at most
GROWTH = 4.0  # per sample, at most
DEGREE = 9  # of the polynomials that a path is compared with
WINDOWS = 8192  # columns of the Hankel matrices, at most: of a long recording with many columns every few
CLEAN = 0.1  # share of what it varies by which a clean column is measured: the others tell less
EXACT = 1e-8  # share of a column that is rounding
SHORT, LEFT = 64, 4  # rows of a recording that may be the beginning of a motion; and after that
PENALTY = 2.0  # on the logarithm of the number of samples, for each number that is fitted: modes are searched for


class Modes(NamedTuple):
    """A recording in parts: y = path + Σ parts + noise."""

    factors: np.ndarray  # (g,) complex, of each pair the one above the real axis
    parts: np.ndarray  # (g, N, k)
    path: np.ndarray  # (N, k): offset, drift, and what of it is slow
    noise: np.ndarray  # (k,) standard deviation of what is left
    score: float  # information criterion: the less the better


def trend(N: int, shortest=None) -> np.ndarray:
    """(N, t) offset and drift; and, for slow paths, sines and cosines down to a period in samples."""
    k = np.arange(N) / N
    columns = [np.ones(N), k - 0.5]
    for i in range(1, 0 if shortest is None else int(2 * N / shortest) + 1):
        columns += [np.cos(np.pi * i * k), np.sin(np.pi * i * k)]
    return np.stack(columns, 1)


def find_modes(y, slowest: float) -> Modes:
    """The modes of y (N, k) that an information criterion keeps.

    Args:
      slowest: period in samples from which on motion may belong to a path.
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
    while len(best.factors):  # what the criterion doesn't miss goes
        fewer = min((best.without(i) for i in range(len(best.factors))), key=lambda fit: fit.score)
        if fewer.score > best.score:
            break
        best = fewer
    return _in_parts(y, still, best)


class _Reduced(NamedTuple):
    """A recording and the motions of factors, both without their path and as a triangle: what fits need of them."""

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
        """As of `Modes`."""
        (N, k), c = self.y.shape, len(self.owner)
        left = self.r[:, c:] - self.r[:, :c] @ self.weights
        return misfit(np.sum(left**2, axis=0) / N, self.y) + PENALTY * np.log(N) * (c * (k + 1) + self.path * k)

    def without(self, i):
        """All but the i-th factor."""
        gone = np.flatnonzero(self.owner == i)
        owner = np.delete(self.owner, gone)
        r = np.delete(self.r, gone, axis=1)
        return self._replace(factors=np.delete(self.factors, i), owner=owner - (owner > i), r=r)


def _candidates(y, basis):
    """Factors for each order."""
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
    # The right singular vectors of its first columns, beside the same a sample later, are those of their triangle.
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

    Eigenvectors of the square tell no value below 1e-8 of the largest. What the windows make of as many again, once
    more, are those of all values (subspace iteration: Golub & Van Loan 2013, Section 8.2.4). LAPACK is called as it is:
    with the least of room it takes steps so small that no BLAS parts them among threads (`eigh` gives it more).
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
    """(k,) of each column: what it varies, of one that is mostly noise ten times as much as of a clean one."""
    size = np.maximum(CLEAN * np.std(y, axis=0), roughness(y))
    return np.where(size > 0, size, 1.0)


def roughness(y):
    """(k,) of white noise its standard deviation, of what is smooth next to nothing."""
    return np.std(np.diff(y, 3, axis=0), axis=0) / np.sqrt(20)


def columns_of(factors, N: int):
    """(N, c) real columns of factors, each at most 1, and which factor each belongs to (c,)."""
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
    """-2 log of the likelihood of what is left of y (N, k), of a mean square (k,): each column has its own noise."""
    N = len(y)
    floor = (EXACT * np.std(y, axis=0)) ** 2 + (1e-15 * np.abs(y).max(0)) ** 2 + np.finfo(float).tiny
    return float(N * np.sum(np.log(power + floor)))


def polynomials(y) -> float:
    """The information criterion of the polynomial that explains y (N, k) best, as `Modes.score` counts.

    Of a short recording also of those that begin after some rows at rest, as what a loop does after its dead time.
    """
    N = len(y)
    t = np.linspace(-1, 1, N)[:, None]
    scores = [_polynomials(t ** np.arange(DEGREE + 1), y, range(3, DEGREE + 2), 0)]
    for begins in range(1, N - LEFT if N <= SHORT else 0):
        after = np.maximum(t - t[begins], 0.0) ** np.arange(1, DEGREE - 2)
        scores.append(_polynomials(np.hstack([np.ones_like(t), after]), y, range(2, DEGREE - 1), 1))
    return min(scores)


def _polynomials(basis, y, counts, others) -> float:
    """The least criterion of the first columns of a basis (N, c), so many of them. others: numbers fitted beside."""
    (N, k), c = y.shape, basis.shape[1]
    r = triangle(np.hstack([basis, y]))[:, c:]
    return min(misfit(np.sum(r[n:] ** 2, axis=0) / N, y) + PENALTY * np.log(N) * (n * k + others) for n in counts)


def shape_of(y, found: Modes, i: int):
    """(k,) complex weights of the i-th mode in each column: y = … + Re(weight · factor^k), largest row 1."""
    columns, owner = columns_of(found.factors[[i]], len(y))
    q, r = orthogonal(columns)
    weights, *_ = np.linalg.lstsq(r, product(q.T, found.parts[i]), rcond=1e-13)
    return weights[0] - 1j * weights[1] if len(owner) == 2 else weights[0].astype(complex)
