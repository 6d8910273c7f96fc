"""Several different answers for each target: the nearest ones that many tries find."""

import numpy as np

from cnclik.reaching.descent import CAREFUL, FREE
from cnclik.reaching.result import ReachStatus, row_of
from cnclik.reaching.search import Search, Targets, blank
from cnclik.reaching.starts import spans, turned

DIFFERENT, DIFFERENT_REDUNDANT = 0.1, 0.5  # [rad, m] answers differ by more in some joint; of a redundant arm
DRAWN, MOST_DRAWN = 4, 64  # tries in the first round; each round has twice as many
EDGE = 1e-3  # [rad, m] an answer beyond a bound by less may be one at it
PATIENCE = 64  # the search ends after so many tries without a new answer, plus twice the tries before the last one
AT_ONCE = 1 << 16  # answers compared at once


def most_at_once(solutions) -> int:
    """Return the number of targets that may be asked at once."""
    return AT_ONCE // (MOST_DRAWN + solutions)


def several(search: Search, pose, near, solutions) -> np.ndarray:
    """Return rows (B, solutions, width) of targets (B, t): the nearest ones first; NO_OTHER where there are fewer.

    Tries go on until each target has as many answers as are wanted, or none has been new for long.
    """
    of, first = search.targets(pose, near), search.rows(pose, near)
    n, B = search.n, len(first)
    found = np.concatenate([first[:, None], np.tile(_no_other(n), (B, solutions - 1, 1))], axis=1)
    count = (row_of(first, n).status <= ReachStatus.ACCEPTED).astype(int)
    newest, done, size, left = np.zeros(B, int), 0, DRAWN, np.flatnonzero(count)
    while len(left):
        own = of.some(left)
        best, there = _nearest(
            search.asked, np.concatenate([found[left], _drawn(search, own, done, size)], 1), own.near
        )
        found[left] = np.where((np.arange(solutions) < there[:, None])[..., None], best[:, :solutions], _no_other(n))
        there = np.minimum(there, solutions)
        done, size = done + size, min(2 * size, MOST_DRAWN)
        newest[left] = np.where(there > count[left], done, newest[left])
        count[left] = there
        left = left[(there < solutions) & (done < PATIENCE + 2 * newest[left])]
    return found


def _no_other(n):
    row = blank(n)
    made = row_of(row, n)
    made.q[:] = made.position_error[...] = made.orientation_error[...] = np.nan
    made.status[...] = int(ReachStatus.NO_OTHER)
    return row


def _drawn(search, of: Targets, k, size):
    """Return the rows (B, size, width) of tries from number k on.

    Where there are no more joints than coordinates they are free of all bounds: those that arrive within them count.
    """
    asked, n, B = search.asked, search.n, len(of.pose)
    each, own = of.some(np.repeat(np.arange(B), size)), search.stages[0].terms
    wide, k, none = n <= asked.task.m, np.arange(k, k + size), np.zeros(size)
    rows = search.tried(of, search.wide if wide else own, None, none, k, CAREFUL).reshape(B * size, -1)
    row = row_of(rows, n)
    again = row.status == FREE
    if wide:
        around = 0.0 if each.near is None else np.where(np.isfinite(own.jump), each.near, 0.0)
        low, high = np.maximum(own.lower, around - own.jump), np.minimum(own.upper, around + own.jump)
        about = 0.0 if each.near is None else each.near
        row.q[:] = turned(row.q, about, np.array(asked.chain.periodic), low, high)
        beyond = np.max(np.maximum(low - row.q, row.q - high), axis=1)
        again = (row.status == ReachStatus.SOLVED) & (beyond < EDGE)
        row.status[:] = int(ReachStatus.OUT_OF_BUDGET)
    ids = np.flatnonzero(again)
    given = row.q[ids][:, None]
    rows[ids] = search.tried(each.some(ids), own, given, none[:1], np.array([-1]), CAREFUL)[:, 0]
    return rows.reshape(B, size, -1)


def _nearest(asked, rows, near):
    """Return rows (B, K, width) with those of different answers first, the nearest first, and how many these are."""
    row = row_of(rows, asked.chain.n)
    around = sum(spans(asked.chain)) / 2 if near is None else near[:, None]
    usable = row.status <= ReachStatus.ACCEPTED
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
