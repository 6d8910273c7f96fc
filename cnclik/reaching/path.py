"""Paths: answers for targets one after the other, each from the one before it."""

import numpy as np

from cnclik.reaching.descent import CLOSE
from cnclik.reaching.result import ReachStatus, row_of, width
from cnclik.reaching.search import Search
from cnclik.record import memoized, replace
from cnclik.robot.posture import start_posture

AHEAD = 64  # targets that one call goes along


def path(search: Search, pose) -> np.ndarray:
    """Return rows (B, width) of targets (B, t); the first one is free to jump.

    One program goes along the targets, until there is none CLOSE to the answer before it; that one is searched for.
    """
    asked, n, B = search.asked, search.n, len(pose)
    free = search if asked.jump is None else memoized(asked, "_free", lambda asked: Search(replace(asked, jump=None)))
    rows, at, k = (
        np.empty((B, width(n))),
        memoized(asked, "_start", lambda _: start_posture(asked.chain, asked.task)),
        0,
    )
    along = search.attempts.along(search.stages[0].terms, AHEAD)
    while k < B:
        rows[k] = (free if k == 0 else search).rows(pose[k : k + 1], at[None])[0]
        row = row_of(rows[k], n)
        at, k = row.q if row.status <= ReachStatus.ACCEPTED else at, k + 1
        while k < B:
            some = pose[k : k + AHEAD]
            ahead = np.concatenate([some, np.repeat(some[-1:], AHEAD - len(some), axis=0)])
            made = along((ahead, at), 1)[0, : len(some)]
            row = row_of(made, n)
            fine = (row.status == ReachStatus.SOLVED) & (row.distance <= CLOSE)
            count = len(some) if fine.all() else int(np.argmin(fine))
            rows[k : k + count] = made[:count]
            at, k = made[count - 1, :n] if count else at, k + count
            if count < AHEAD:
                break
    return rows
