"""Modes: a recording as a sum of factors to the power of the sample, a slow path, and noise.

Factors come from the shift of the signal space of Hankel matrices (ESPRIT, total least squares: Roy & Kailath 1989),
stacked for several columns, which share them. Offsets, drifts and slow paths are projected out of the Hankel matrices
beforehand, which leaves what is shifted as it is.
"""

from typing import NamedTuple

import numpy as np

ROWS = 128  # of a Hankel matrix, at most
ORDER = 12  # factors of a recording, at most
GROWTH = 4.0  # per sample, at most
DEGREE = 9  # of the polynomials that a path is compared with
WINDOWS = 8192  # columns of the Hankel matrices, at most: of a long recording with many columns every few
CLEAN = 0.1  # share of what it varies by which a clean column is measured: the others tell less
EXACT = 1e-8  # share of a column that is rounding
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
    found = _in_parts(y, basis, np.zeros(0, complex))
    for factors in _candidates(y, basis):
        other = _in_parts(y, basis, factors)
        found = other if other.score < found.score else found
    while len(found.factors):  # what the criterion doesn't miss goes
        fewer = [_in_parts(y, basis, np.delete(found.factors, i)) for i in range(len(found.factors))]
        best = min(fewer, key=lambda one: one.score)
        if best.score > found.score:
            break
        found = best
    return found


def _candidates(y, basis):
    """Factors for each order."""
    N = len(y)
    rows = min(int(0.4 * N), ROWS)
    width = N - rows + 1
    every = -(-width * y.shape[1] // WINDOWS)
    windows = np.lib.stride_tricks.sliding_window_view(y / _size(y), width, axis=0)[..., ::every]  # (rows, k, width)
    still, _ = np.linalg.qr(basis[:width:every])
    windows = windows - (windows @ still) @ still.T
    square = np.linalg.qr(windows.reshape(rows, -1).T, mode="r")  # its right singular vectors are all that is needed
    values, space = np.linalg.svd(square)[1:]
    space = space.T
    most = min(ORDER, rows // 2, int(np.sum(values > 1e-12 * values[0])))
    for order in range(1, most + 1):
        _, _, v = np.linalg.svd(np.hstack([space[:-1, :order], space[1:, :order]]), full_matrices=True)
        v = v.T
        found = np.linalg.eigvals(-np.linalg.lstsq(v[order:, order:].T, v[:order, order:].T, rcond=None)[0].T)
        found = found[(found.imag >= 0) & (np.abs(found) < GROWTH) & (np.abs(found) > 1e-3)]
        found = np.where(np.abs(found.imag) < 1e-12, found.real, found)
        yield found[np.argsort(-np.abs(found))]


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


def _in_parts(y, basis, factors):
    N, k = y.shape
    columns, owner = columns_of(factors, N)
    design = np.hstack([columns, basis])
    weights, *_ = np.linalg.lstsq(design, y, rcond=1e-13)
    left = y - design @ weights
    parts = np.stack(
        [columns[:, owner == i] @ weights[: len(owner)][owner == i] for i in range(len(factors))] or [np.zeros((N, k))]
    )[: len(factors)]
    numbers = len(owner) * (k + 1) + basis.shape[1] * k
    return Modes(
        factors=factors,
        parts=parts,
        path=basis @ weights[len(owner) :],
        noise=np.std(left, axis=0),
        score=misfit(left, y) + PENALTY * np.log(N) * numbers,
    )


def misfit(left, y) -> float:
    """-2 log of the likelihood of what is left (N, k) of y, each column with a noise of its own."""
    N = len(y)
    floor = (EXACT * np.std(y, axis=0)) ** 2 + (1e-15 * np.abs(y).max(0)) ** 2 + np.finfo(float).tiny
    return float(N * np.sum(np.log(np.mean(left**2, axis=0) + floor)))


def polynomials(y) -> float:
    """The information criterion of the polynomial that explains y (N, k) best, as `Modes.score` counts."""
    N, k = y.shape
    base, _ = np.linalg.qr(np.linspace(-1, 1, N)[:, None] ** np.arange(DEGREE + 1))
    return min(
        misfit(y - base[:, :n] @ (base[:, :n].T @ y), y) + PENALTY * np.log(N) * n * k for n in range(3, DEGREE + 2)
    )


def shape_of(y, found: Modes, i: int):
    """(k,) complex weights of the i-th mode in each column: y = … + Re(weight · factor^k), largest row 1."""
    columns, owner = columns_of(found.factors[[i]], len(y))
    weights, *_ = np.linalg.lstsq(columns, found.parts[i], rcond=1e-13)
    return weights[0] - 1j * weights[1] if len(owner) == 2 else weights[0].astype(complex)
