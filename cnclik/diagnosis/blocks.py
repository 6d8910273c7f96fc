"""Blocks: tall matrices in pieces so small that no BLAS parts them among threads.

OpenBLAS parts every product of a matrix and a vector beyond some 9,000 numbers, and of two matrices beyond 262,144
multiplications. A decomposition of a tall matrix makes one for each column: on cores that are taken its threads wait
for each other longer than they compute.
"""

import numpy as np

NUMBERS = 8192  # of a piece
PRODUCTS = 200_000  # multiplications of two pieces


def product(a, b):
    """a (n, k) @ b (k, m), of halves of halves of what is longest."""
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
    """The part of columns a (N, c) in the span of orthonormal columns (N, t)."""
    return product(still, product(still.T, a))


def orthogonal(a):
    """(Q, R) of a (N, n), N at least n: of pieces, and then of what these leave (Demmel et al. 2012)."""
    (N, n), rows = a.shape, _rows(a)
    if rows >= N:
        return np.linalg.qr(a)
    q, r = np.linalg.qr(_pieces(a, rows))
    over, r = orthogonal(r.reshape(-1, n))
    return np.concatenate([product(*both) for both in zip(q, over.reshape(-1, n, n), strict=True)])[:N], r


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
