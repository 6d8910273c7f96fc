"""Several different answers for each target: the nearest ones that many tries find."""

import numpy as np

from cnclik.reaching.descent import CAREFUL
from cnclik.reaching.result import ReachStatus, blank, row_of
from cnclik.reaching.search import Search, Targets
from cnclik.reaching.starts import beginnings, spans, turned

DIFFERENT, DIFFERENT_REDUNDANT = 0.1, 0.5  # [rad, m] answers differ by more in some joint; of a redundant arm
DRAWN, MOST_DRAWN = 4, 64  # tries in the first round; each round has twice as many
PATIENCE = 64  # the search ends after so many tries without a new answer, plus twice the tries before the last one
AT_ONCE = 1 << 16  # answers compared at once


def several(search: Search, of: Targets, solutions) -> np.ndarray:
    """Return rows (B, solutions, width) of targets: the nearest ones first; NO_OTHER where there are fewer.

    Tries go on until each target has as many answers as are wanted, or none has been new for long.
    """
    first = search.rows(of)
    n, B = search.n, len(first)
    no_other = blank(n) + np.where(np.arange(len(blank(n))) < n + 3, np.nan, 0.0)
    no_other[n] = int(ReachStatus.NO_OTHER)
    found = np.concatenate([first[:, None], np.tile(no_other, (B, solutions - 1, 1))], axis=1)
    count = (row_of(first, n).status == ReachStatus.SOLVED).astype(int)
    newest, done, size, left = np.zeros(B, int), 0, DRAWN, np.flatnonzero(count)
    while len(left):
        own = of.some(left)
        every = np.concatenate([found[left], _drawn(search, own, done, size)], axis=1)
        best, there = _nearest(search.asked, every, own.near)
        found[left] = np.where((np.arange(solutions) < there[:, None])[..., None], best[:, :solutions], no_other)
        there = np.minimum(there, solutions)
        done, size = done + size, min(2 * size, MOST_DRAWN)
        newest[left] = np.where(there > count[left], done, newest[left])
        count[left] = there
        left = left[(there < solutions) & (done < PATIENCE + 2 * newest[left])]
    return found


def _drawn(search, of: Targets, k, size):
    """Return the rows (B, size, width) of tries from number k on: free of all bounds, then from there within them."""
    asked, k, none = search.asked, np.arange(k, k + size), np.zeros(size)
    row = row_of(search.tried(of, search.wide, *beginnings(k, of.near), k, CAREFUL), search.n)
    about = 0.0 if of.near is None else of.near[:, None]
    q = turned(row.q, about, np.array(asked.chain.periodic), *asked.limited())
    return search.tried(of, search.stages[0].terms, q, none, 0 * k - 1, (row.status == ReachStatus.SOLVED) * CAREFUL)


def _nearest(asked, rows, near):
    """Return rows (B, K, width) with those of different answers first, the nearest first, and how many these are."""
    row = row_of(rows, asked.chain.n)
    around = sum(spans(asked.chain)) / 2 if near is None else near[:, None]
    usable = row.status == ReachStatus.SOLVED
    away = np.max(np.abs(row.q - around), axis=2, where=usable[..., None], initial=0.0)
    order = np.argsort(np.where(usable, away, np.inf), axis=1, kind="stable")
    q, taken = np.take_along_axis(row.q, order[..., None], axis=1), np.take_along_axis(usable, order, axis=1)
    turns = 2 * np.pi * np.array(asked.chain.periodic)
    least = DIFFERENT if asked.chain.n <= asked.task.m else DIFFERENT_REDUNDANT
    for k in range(1, q.shape[1]):
        gap = np.abs(q[:, k : k + 1] - q[:, :k])
        gap = np.abs(gap - turns * np.round(gap / (2 * np.pi)))
        taken[:, k] &= ~((np.max(gap, axis=2) < least) & taken[:, :k]).any(axis=1)
    first = np.take_along_axis(order, np.argsort(~taken, axis=1, kind="stable"), axis=1)
    return np.take_along_axis(rows, first[..., None], axis=1), taken.sum(axis=1)
