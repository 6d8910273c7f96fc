"""Search: tries for the targets that are still open, in rounds, around one compiled program; several answers; paths.

The first sixteen tries begin at postures whose tips are near the target. The first that arrives is the answer; with
`near` it is the one nearest to that. Later rounds hold tries of three kinds, see `starts.origins`; the best of a round
go on carefully. So an answer is its target's own, whatever is asked beside it.
"""

import functools
from typing import Any, NamedTuple

import numpy as np

from cnclik.engine.plan import in_c
from cnclik.reaching.asked import Asked
from cnclik.reaching.descent import AHEAD, CAREFUL, CLOSE, DOWNHILL, PLAIN, programs
from cnclik.reaching.result import ReachStatus, blank, row_of, width
from cnclik.reaching.starts import BINNED, ISLANDS, beginnings, island_of, origins, spans, starts_of, turned
from cnclik.record import AnyArray, Float, memoized, replace
from cnclik.robot.posture import start_posture

ROUND, WIDEST = BINNED, 256  # tries of the first rounds, and of later ones at most
MANY = 512  # tries at once, at least, if there are as many
AT_ONCE = 1 << 15  # tries at once, at most
DIFFERENT, DIFFERENT_REDUNDANT = 0.1, 0.5  # [rad, m] answers differ by more in some joint; of a redundant arm
DRAWN, MOST_DRAWN = 4, 64  # tries in the first round; each round has twice as many
PATIENCE = 64  # the search ends after so many tries without a new answer, plus twice the tries before the last one
TRIES = 512  # for each target
CLOSER = 0.3, 2e-2  # [rad, units] a target missed by less gets 4 times as many, and 16 times
FREELY, NEAREST = 128, 64  # tries without limits, and descents to the nearest pose


class Stage(NamedTuple):
    """Some tries of a search, and the targets that they are for."""

    terms: Any  # of the descents: numbers, or a program that is bound to them
    first: int  # number of the first try
    last: int  # and one more than that of the last one
    less: float = np.inf  # for targets missed by less
    status: int = 0  # what an answer means, of a search beyond `jump` or the limits
    downhill: bool = False  # whether the tries go to the nearest pose, the first ones from the best postures so far


def stages(asked: Asked, xp=np) -> list:
    """Return the stages of a search, in order."""
    own, nearest = asked.terms(xp=xp), Stage(asked.terms(weights=True, xp=xp), 0, NEAREST, downhill=True)
    made = [Stage(own, 0, ROUND), Stage(own, ROUND, TRIES), nearest]
    made += [Stage(own, TRIES, 4 * TRIES, CLOSER[0]), Stage(own, 4 * TRIES, 16 * TRIES, CLOSER[1])]
    made.append(nearest._replace(last=ISLANDS, less=CLOSER[0]))
    if asked.jump is not None:
        made.append(Stage(asked.terms(jump=False, xp=xp), 0, TRIES, status=int(ReachStatus.JUMP)))
    if np.isfinite(asked.limited()).any():
        made.append(Stage(asked.terms(limits=False, xp=xp), 0, FREELY, status=int(ReachStatus.AT_LIMIT)))
    return made


class Found(NamedTuple):
    """What the tries for targets came to so far."""

    rows: Float[AnyArray, "*B width"]  # answers; of targets without one the nearest pose, once that was looked for
    places: Float[AnyArray, "*B ISLANDS n"]  # the best postures of tries that did not arrive
    costs: Float[AnyArray, "*B ISLANDS"]


def nothing(shape, n, xp=np, dtype=float) -> Found:
    """Return what no try came to, for targets of that shape."""
    rows = xp.tile(xp.asarray(blank(n), dtype), (*shape, 1))
    return Found(rows, xp.zeros((*shape, ISLANDS, n), dtype), xp.full((*shape, ISLANDS), np.inf, dtype))


def winners(block, n, near, first, xp=np) -> tuple:
    """Return the winning rows (..., width) of tries (..., W, width), and which of them are answers.

    The first answer wins; with `near` the nearest, but at once that of the search's first try, if `first`, where CLOSE.
    """
    row = row_of(block, n)
    solved = row.status == ReachStatus.SOLVED
    won = xp.argmax(solved, axis=-1)
    if near:
        at_once = first & solved[..., 0] & (row.distance[..., 0] <= CLOSE)
        won = xp.where(at_once, 0, xp.argmin(xp.where(solved, row.distance, np.inf), axis=-1))
    return _of_each(block, won, xp), solved.any(axis=-1)


def _of_each(rows, index, xp):
    return xp.take_along_axis(rows, index[..., None, None], -2)[..., 0, :]


def wanted(asked, stage: Stage, row, far, why, xp=np):
    """Return which targets (...,) need a stage: those too far off for the arm its first tries, and the nearest pose."""
    near = xp.isinf(stage.less) | (asked.squares(row, xp) < stage.less**2)
    return (row.status != ReachStatus.SOLVED) & (why == 0) & near & (~far | (stage.first + stage.status == 0))


def advanced(stage: Stage, found: Found, k, near, tried, block=None, xp=np) -> Found:
    """Return what was found, after tries k (W,) of a stage, and the careful ones that follow.

    Args: near: (..., n) within the limits, or None. tried: see `Search.tried`. block: the tries, if they are made.
    """
    n, island, uphill = found.places.shape[-1], island_of(k), xp.logical_not(stage.downhill)
    if block is None:
        number, given, away = origins(k, stage.downhill, near, found.places, found.costs, xp)
        block = tried(stage.terms, given, away, number, (k < stage.last) * xp.where(uphill, PLAIN, DOWNHILL))
    row = row_of(block, n)
    none = ~(row.status == ReachStatus.SOLVED).any(axis=-1, keepdims=True) & uphill
    better = xp.isfinite(row.cost) & ((k % 2 == 1) | (row.cost < found.costs[..., island]))
    again = tried(stage.terms, row.q, xp.zeros(k.shape), k, xp.where(none & better, CAREFUL, 0))
    both, island = xp.concatenate([block, again], axis=-2), xp.concatenate([island, island])
    rows, solved = winners(both, n, near is not None, (k[0] == 0) & uphill, xp)
    row = row_of(both, n)
    nearest = _of_each(both, xp.argmin(row.cost, axis=-1), xp)
    nearer = stage.downhill & (row_of(nearest, n).cost < row_of(found.rows, n).cost)
    rows = xp.where(solved[..., None], rows, xp.where(nearer[..., None], nearest, found.rows))
    mine = np.arange(ISLANDS)[:, None] == xp.concatenate([np.arange(ISLANDS), island])
    costs = xp.concatenate([found.costs, row.cost], axis=-1)
    best = xp.argmin(xp.where(mine, costs[..., None, :], np.inf), axis=-1)
    places = xp.take_along_axis(xp.concatenate([found.places, row.q], axis=-2), best[..., None], -2)
    return Found(rows, places, xp.take_along_axis(costs, best, -1))


class Targets(NamedTuple):
    """Targets of one search, in NumPy's float64."""

    pose: Float[np.ndarray, "B t"]
    near: Float[np.ndarray, "B n"] | None
    inside: Float[np.ndarray, "B n"] | None  # as `near`, by whole turns within the limits

    def some(self, ids):
        """Return some of them."""
        return Targets(*[v if v is None else v[ids] for v in self])


class Search:
    """The search for a chain's targets, with all that they share; made once for an `Asked`."""

    def __init__(self, asked: Asked):
        chain, task = asked.chain, asked.task
        bound, starts = programs(chain, task).bound, starts_of(chain, task)
        self.asked, self.n, self.nowhere = asked, chain.n, np.full(chain.n, np.nan)
        self.stages = [stage._replace(terms=bound(*starts, *stage.terms)) for stage in stages(asked)]
        self.wide = bound(*starts, *asked.terms(limits=False))

    def rows(self, of: Targets) -> np.ndarray:
        """Return the rows (B, width) of targets. Of many ones the first tries are made one after the other."""
        n, near, finite = self.n, of.near is not None, self.asked.finite(of.pose, of.near)
        if not finite.all():
            rows = self.asked.concluded(np.tile(blank(n), (len(finite), 1)), False, 0, False)
            rows[finite] = self.rows(of.some(finite))
            return rows
        rows, ids, block, k = np.empty((len(finite), width(n))), np.arange(len(finite)), None, 0
        while len(ids) and k < ROUND:
            one, part = len(ids) * (ROUND - k) > MANY and (k == 0 or not near), of.some(ids) if k else of
            order = np.arange(k, k + 1 if one else ROUND)
            given, away = beginnings(order, part.inside)
            tries = self.tried(part, self.stages[0].terms, given, away, order, PLAIN)
            block = np.concatenate([block, tries], axis=1) if k else tries
            made, solved = winners(block if near else tries, n, near, first=True)
            if near and one:
                solved &= row_of(made, n).distance <= CLOSE
            rows[ids[solved]] = made[solved]
            ids, block, k = ids[~solved], block[~solved], k + len(order)
        if len(ids):
            rows[ids] = self.rest(of.some(ids), block)
        return rows

    def rest(self, of: Targets, block) -> np.ndarray:
        """Return the rows of targets whose first tries (K, W, width) have not arrived."""
        asked, n, K, tried = self.asked, self.n, len(of.pose), functools.partial(self.tried, of)
        found = advanced(self.stages[0], nothing((K,), n), np.arange(ROUND), of.inside, tried, block)
        far, why = asked.too_far(of.pose), np.zeros(K, int)
        for stage in self.stages[1:]:
            ids = left = np.flatnonzero(wanted(asked, stage, row_of(found.rows, n), far, why))
            into, k = nothing((K,), n) if stage.status else found, stage.first
            while len(left) and k < stage.last:
                count = stage.last if stage.downhill else min(max(k - ROUND, ROUND), WIDEST)
                for some in np.array_split(left, -(-len(left) * count // AT_ONCE)):
                    part, before = of.some(some), Found(*(v[some] for v in into))
                    tried = functools.partial(self.tried, part)
                    made = advanced(stage, before, k + np.arange(count), part.inside, tried)
                    for whole, new in zip(into, made, strict=True):
                        whole[some] = new
                left, k = left[row_of(into.rows[left], n).status != ReachStatus.SOLVED], k + count
            if stage.status:
                why[ids] = asked.meaning(stage.status, into.rows[ids], into.costs[ids].min(axis=1))
        return asked.concluded(found.rows, True, why, far)

    def tried(self, of: Targets, call, given, away, k, most) -> np.ndarray:
        """Return the rows (B, W, width) of tries k (W,), see `descent.attempt`; blank ones where `most` is 0."""
        shape, near = (len(of.pose), len(k)), self.nowhere if of.near is None else of.near
        given = self.nowhere if np.ndim(given) == 0 else given
        if shape[0] == 1 and np.ndim(most) == 0:  # as a control loop asks for one target: quicker
            near, given = near.reshape(self.n), given[0] if given.ndim > 2 else given
            return call((of.pose[0], near, given, away, k, most), len(k))[None]
        most = np.broadcast_to(most, shape)
        ids, which = np.nonzero(most)
        given = np.broadcast_to(given, (*shape, self.n))[ids, which] if given.ndim > 1 else given
        lanes = of.pose[ids], near[ids] if near.ndim > 1 else near, given, away[which], k[which], most[ids, which]
        made: Any = call(lanes, len(ids)) if len(ids) else 0.0
        if 0 < len(ids) == most.size:
            return made.reshape(*shape, -1)
        rows = np.tile(blank(self.n), (*shape, 1))
        rows[ids, which] = made
        return rows


def path(search: Search, pose) -> np.ndarray:
    """Return rows (B, width) of targets (B, t), each from the answer before it; the first one is free to jump.

    One program goes along the targets, until there is none CLOSE to the answer before it; that one is searched for.
    """
    asked, n, B = search.asked, search.n, len(pose)
    free = search if asked.jump is None else Search(replace(asked, jump=None))
    along = programs(asked.chain, asked.task, path=True).bound(*asked.terms())
    rows, k = np.empty((B, width(n))), 0
    q: Any = np.asarray(start_posture(asked.chain, asked.task))
    while k < B:
        rows[k] = (search if k else free).rows(Targets(pose[k : k + 1], q[None], q[None]))[0]
        row, k = row_of(rows[k], n), k + 1
        q, count = row.q if row.status == ReachStatus.SOLVED else q, AHEAD
        while k < B and count == AHEAD:
            made = along((pose[np.minimum(np.arange(k, k + AHEAD), B - 1)], q), 1)[0, : B - k]
            row = row_of(made, n)
            close = (row.status == ReachStatus.SOLVED) & (row.distance <= CLOSE)
            count = len(made) if close.all() else int(np.argmin(close))
            rows[k : k + count] = made[:count]
            q, k = made[count - 1, :n] if count else q, k + count
    return rows


def search_of(asked: Asked) -> Search:
    """Return the search, made once for what is asked and for the engine that is chosen."""
    return memoized(asked, f"_search_{in_c()}", Search)


# --- several different answers for each target: the nearest ones that many tries find -----------------------


def several(search: Search, of: Targets, solutions) -> np.ndarray:
    """Return rows (B, solutions, width) of targets: the nearest ones first; NO_OTHER where there are fewer.

    Tries go on until each target has as many answers as are wanted, or none has been new for long.
    """
    first = search.rows(of)
    n, B = search.n, len(first)
    no_other = np.full(width(n), np.nan)
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
    return search.tried(of, search.stages[0].terms, q, none, k, (row.status == ReachStatus.SOLVED) * CAREFUL)


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
