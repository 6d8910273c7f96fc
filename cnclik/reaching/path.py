"""Paths: answers for targets one after the other, each from the one before it."""

import numpy as np

from cnclik.reaching.descent import CLOSE
from cnclik.reaching.result import ReachStatus, row_of, width
from cnclik.reaching.search import Search
from cnclik.record import replace
from cnclik.robot.posture import start_posture

AHEAD = 64  # targets that one call goes along


def path(search: Search, pose, progress=None) -> np.ndarray:
    """Return rows (B, width) of targets (B, t); the first one is free to jump.

    One program goes along the targets, until there is none CLOSE to the answer before it; that one is searched for.
    """
    asked, n, B = search.asked, search.n, len(pose)
    free = search if asked.jump is None else Search(replace(asked, jump=None))
    along = search.attempts.along(search.stages[0].terms, AHEAD)
    rows, q, k = np.empty((B, width(n))), start_posture(asked.chain, asked.task), 0
    while k < B:
        rows[k] = (search if k else free).rows(pose[k : k + 1], q[None])[0]
        row, k = row_of(rows[k], n), k + 1
        q, count = row.q if row.status <= ReachStatus.ACCEPTED else q, AHEAD
        while k < B and count == AHEAD:
            some = pose[k : k + AHEAD]
            ahead = np.concatenate([some, np.repeat(some[-1:], AHEAD - len(some), axis=0)])
            made = along((ahead, q), 1)[0, : len(some)]
            row = row_of(made, n)
            close = (row.status == ReachStatus.SOLVED) & (row.distance <= CLOSE)
            count = len(some) if close.all() else int(np.argmin(close))
            rows[k : k + count] = made[:count]
            q, k = made[count - 1, :n] if count else q, k + count
        if progress is not None:
            progress(k, B)
    return rows
