"""Poses as users give them: read and checked in one place for every door."""

import numpy as np


def quaternion(rotation) -> np.ndarray:
    """Unit quaternion (w, x, y, z), the first that is not 0 positive, of a rotation (3, 3) that is known."""
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(rotation, float)
    four = np.array([
        [1 + a + e + i, h - f, c - g, d - b],
        [h - f, 1 + a - e - i, b + d, c + g],
        [c - g, b + d, 1 - a + e - i, f + h],
        [d - b, c + g, f + h, 1 - a - e + i],
    ])  # fmt: skip
    row = four[np.argmax(np.diagonal(four))]
    return row / np.linalg.norm(row) * (-1.0 if row[0] < 0 else 1.0)
