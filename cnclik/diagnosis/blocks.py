"""Blocks: tall matrices in pieces so small that no BLAS parts them among threads.

OpenBLAS parts every product of a matrix and a vector beyond some 9,000 numbers. A decomposition of a tall matrix makes
one for each column: on cores that are taken its threads wait for each other longer than they compute.
"""

import numpy as np

NUMBERS = 8192  # of a piece


def orthogonal(a):
    """(Q, R) of a (N, n), N at least n: of pieces, and then of what these leave (Demmel et al. 2012)."""
    (N, n), rows = a.shape, _rows(a)
    if rows >= N:
        return np.linalg.qr(a)
    q, r = np.linalg.qr(_pieces(a, rows))
    over, r = orthogonal(r.reshape(-1, n))
    return (q @ over.reshape(-1, n, n)).reshape(-1, n)[:N], r


def triangle(a):
    """(n, n) R alone of a (N, n), with rows of zeros where N is less."""
    n, rows = a.shape[1], _rows(a)
    while len(a) > rows:
        a = np.linalg.qr(_pieces(a, rows), mode="r").reshape(-1, n)
    r = np.linalg.qr(a, mode="r")
    return np.pad(r, ((0, n - len(r)), (0, 0)))


def _rows(a) -> int:
    n = max(a.shape[1], 1)
    return max(NUMBERS // n, 2 * n)


def _pieces(a, rows):
    return np.pad(a, ((0, -len(a) % rows), (0, 0))).reshape(-1, rows, a.shape[1])
