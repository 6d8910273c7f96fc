"""Blocks: products and decompositions of tall matrices, in pieces too small for BLAS to use threads.

OpenBLAS splits products of a matrix and a vector beyond some 9,000 numbers, and of two matrices beyond 262,144
multiplications, among threads. Decomposing a tall matrix takes one such product per column; on busy cores the threads
wait for each other longer than they compute.
"""

import numpy as np

NUMBERS = 8192  # numbers of a piece, at most
PRODUCTS = 200_000  # multiplications of two pieces, at most


def product(a, b):
    """a (n, k) @ b (k, m), halving the longest dimension recursively."""
    (n, k), m = a.shape, b.shape[1]
    if n * k * m <= (NUMBERS if 1 in (n, m) else PRODUCTS):
        return a @ b
    half = max(n, k, m) // 2
    if k == max(n, k, m):
        return product(a[:, :half], b[:half]) + product(a[:, half:], b[half:])
    if n >= m:
        return np.concatenate([product(a[:half], b), product(a[half:], b)])
    return np.concatenate([product(a, b[:, :half]), product(a, b[:, half:])], axis=1)


def within(still, a):
    """The projection of columns a (N, c) on the span of orthonormal columns (N, t)."""
    return product(still, product(still.T, a))


def orthogonal(a):
    """(Q, R) of a (N, n), N ≥ n: of its pieces, then of their stacked R (Demmel et al. 2012)."""
    (N, n), rows = a.shape, _rows(a)
    if rows >= N:
        return np.linalg.qr(a)
    q, r = np.linalg.qr(_pieces(a, rows))
    over, r = orthogonal(r.reshape(-1, n))
    return np.concatenate([product(*both) for both in zip(q, over.reshape(-1, n, n), strict=True)])[:N], r


def triangle(a):
    """(n, n) R of a (N, n), padded with zero rows if N < n."""
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
