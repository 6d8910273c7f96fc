"""Calm: whether a motion that has decayed is at rest up to noise, or moves on as its own last row determines."""

import itertools

import numpy as np

from cnclik.diagnosis.excited import main_parts
from cnclik.diagnosis.judge import ABOVE_NOISE, HARDLY, LEAST, spans
from cnclik.diagnosis.modes import find_modes

DEGREE = 3  # of the polynomial of a row that predicts the next
STEPPED = 0.3  # share of values that repeat the last one, above which a column moves in the steps of its resolution
FIRST, LARGER = 12, 8.0  # numbers that a recording begins with; the factor above which it has grown since
PREDICTED = 0.3  # share of what a linear rule leaves, above which a polynomial predicts it: noise is not predicted


def is_calm(y, longest) -> bool:
    """Whether the second half of y (N, k), with columns of range 1, neither oscillates nor is predicted row by row.

    A bounded loop that is not stable moves without a period, like noise: but each row of it makes the next.
    """
    late = y[len(y) // 2 :]
    moves = (np.ptp(late, axis=0) > HARDLY) & (np.mean(np.diff(late, axis=0) == 0, axis=0) < STEPPED)
    if len(late) < LEAST or not moves.any():
        return True
    late = late[:, moves]
    found = find_modes(late, longest)
    turn = np.abs(np.angle(found.factors))
    swings = (turn * longest >= 2 * np.pi) & (np.abs(np.log(np.abs(found.factors))) < turn)
    if np.any(spans(found.parts[swings]) > np.maximum(HARDLY, ABOVE_NOISE * found.noise)):
        return False
    left = late - found.path - found.parts[~swings].sum(0)
    return not _is_predicted(left[:, np.ptp(left, axis=0) > HARDLY])


def is_as_large(y) -> bool:
    """Whether y (N, k) bends as much at first as in its second half: noise does, a loop that grows does not."""
    bends = np.diff(y, 2, axis=0) ** 2
    return bool(np.mean(bends[: -(-FIRST // y.shape[1])]) > np.mean(bends[len(bends) // 2 :]) / LARGER**2)


def _is_predicted(y) -> bool:
    """Whether a polynomial of a row of y (N, k) predicts more of the next row than a linear rule does."""
    if y.shape[1] == 0:
        return False
    y = main_parts(y)
    linear, whole = (_left(y, degree) for degree in (1, DEGREE))
    return bool(np.any(whole < (1 - PREDICTED) * linear))


def _left(y, degree):
    """(k,) variance of the rows that a polynomial of the rows before leaves, without bias."""
    powers = (c for d in range(degree + 1) for c in itertools.combinations_with_replacement(range(y.shape[1]), d))
    rules = np.stack([np.prod(y[:-1, list(c)], axis=1) for c in powers], 1)
    left = y[1:] - rules @ np.linalg.lstsq(rules, y[1:], rcond=None)[0]
    free = len(rules) - rules.shape[1]
    return np.sum(left**2, axis=0) / free if free > len(rules) / 3 else np.full(y.shape[1], np.inf)
