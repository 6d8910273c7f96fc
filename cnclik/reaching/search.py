"""Search: tries for the targets that are still open, in rounds, around one compiled program.

Tries come in groups of eight. The first that arrives is the answer; with `near` it is the nearest of its group. If none
arrives, the best of the group goes on carefully. So an answer is its target's own, whatever is asked beside it.
"""

import copy
import functools
from typing import NamedTuple

import numpy as np

from cnclik.engine.plan import in_c
from cnclik.reaching.asked import SURE, Asked
from cnclik.reaching.descent import CAREFUL, CLOSE, DOWNHILL, FREE, PLAIN, Terms, attempts
from cnclik.reaching.result import ReachStatus, row_of, width
from cnclik.reaching.starts import BINNED, ISLANDS, about, about_places, downhill, island_of, turned
from cnclik.record import AnyArray, Float, memoized
from cnclik.threads import side_by_side

GROUP, WIDEST = 16, 16  # tries of a group, and groups of a round
ORDER = np.arange(GROUP)
FEW = 64  # targets, at most, of which the first group is tried at once
MANY = 512  # tries at once, at least, if there are as many
AT_ONCE = 1 << 15  # tries at once, at most
POOL = 1 << 18  # targets at once, at most
AHEAD = 64  # targets of a path that one call goes along
CLOSER, LONGER = (0.3, 2e-2), (4, 16)  # [rad, units] a target missed by less gets so many times the tries
ANEW = 512  # tries after which those begin elsewhere that began about places found
FREELY = 128  # tries without limits
NEAREST = 64  # descents to the nearest pose


class Stage(NamedTuple):
    """Some tries of a search, and the targets that they are for."""

    terms: Terms
    first: int  # number of the first try
    last: int  # and one more than that of the last one
    less: float = np.inf  # for targets missed by less
    status: int = 0  # what an answer means, of a search beyond `jump` or the limits
    sure: bool = True  # for those alone of which enough was tried
    far: bool = False  # also for those farther off than the arm is long
    downhill: bool = False  # whether the tries go to the nearest pose, the first ones from the best postures so far


def stages(asked: Asked, xp=np) -> list:
    """Return the stages of a search, in order."""
    seeds, own = asked.seeds, asked.terms(xp=xp)
    four, sixteen = (times * seeds for times in LONGER)
    made = [Stage(own, 0, min(GROUP, seeds), sure=False, far=asked.downhill), Stage(own, GROUP, seeds, sure=False)]
    if asked.downhill:
        made.append(Stage(asked.terms(weights=True, xp=xp), 0, NEAREST, sure=False, far=True, downhill=True))
    if not asked.explain:
        return made
    made += [Stage(own, seeds, four, CLOSER[0]), Stage(own, four, sixteen, CLOSER[1])]
    made.append(made[2]._replace(last=ISLANDS, less=CLOSER[0], sure=True, far=False))
    if asked.jump is not None:
        terms, status = asked.terms(jump=False, xp=xp), int(ReachStatus.JUMP)
        made += [Stage(terms, 0, four, status=status), Stage(terms, four, sixteen, CLOSER[1], status)]
        made += [Stage(terms, 0, ISLANDS, CLOSER[0], status, downhill=True)]
    if np.isfinite(asked.limited()).any():
        terms, status = asked.terms(limits=False, xp=xp), int(ReachStatus.AT_LIMIT)
        made += [Stage(terms, 0, FREELY, status=status)]
        made += [Stage(terms, 0, ISLANDS, CLOSER[0], status, downhill=True)]
    return made


class Found(NamedTuple):
    """What the tries for targets came to so far."""

    rows: Float[AnyArray, "*B width"]  # answers; of targets without one the nearest pose, once that was looked for
    places: Float[AnyArray, "*B ISLANDS n"]  # the best postures of tries that did not arrive
    costs: Float[AnyArray, "*B ISLANDS"]


def nothing(shape, n, xp=np, dtype=float) -> Found:
    """Return what no try came to, for targets of that shape."""
    return Found(
        xp.zeros((*shape, width(n)), dtype) + xp.asarray(blank(n), dtype),
        xp.zeros((*shape, ISLANDS, n), dtype),
        xp.full((*shape, ISLANDS), np.inf, dtype),
    )


def blank(n) -> np.ndarray:
    """Return the row of a try that was not made."""
    made = np.zeros(width(n))
    row = row_of(made, n)
    row.status[...], row.distance[...] = int(ReachStatus.OUT_OF_BUDGET), np.nan
    row.position_error[...] = row.cost[...] = row.steep[...] = np.inf
    return made


def winners(block, n, near, first, each=None, xp=np):
    """Return the winning rows (..., width) of tries (..., W, width), with the looks it took, and which are answers.

    Args:
      near: whether the nearest of the first group with any answer wins, and not the first one.
      first: whether the first of the tries is the search's first, which then wins at once where it is CLOSE.
      each: tries of a group; None: all.
    """
    row, order, count = row_of(block, n), np.arange(block.shape[-2]), block.shape[-2]
    score, group = 0.0 * row.status + order, order // (each or count)
    if near:
        score = xp.where((order == 0) & first & (row.distance <= CLOSE), -1.0, group * 1e9 + row.distance)
    score = xp.where(row.status == ReachStatus.SOLVED, score, np.inf)
    won = xp.argmin(score, axis=-1)[..., None]
    best = xp.take_along_axis(score, won, -1)
    last = xp.where(best < 0, 0, (won // (each or count) + 1) * (each or count) - 1) if near else won
    counted = (order <= last) | ~xp.isfinite(best)
    looks = xp.sum(xp.where(counted, row.evaluations, 0.0), axis=-1)
    rows = xp.take_along_axis(block, won[..., None], -2)[..., 0, :]
    return with_looks(rows, n, looks, xp), xp.isfinite(best[..., 0])


def with_looks(rows, n, looks, xp=np):
    """Return the rows with another number of evaluations."""
    return xp.concatenate([rows[..., : 2 * n + 3], looks[..., None], rows[..., 2 * n + 4 :]], -1)


def after(found: Found, block, n, near, first, downhill, island, each=None, xp=np) -> Found:
    """Return what was found, after some more tries (..., W, width), see `winners`.

    Args: downhill: whether the best of them, if none arrives, is the nearest pose.
    """
    rows, solved = winners(block, n, near, first, each, xp)
    row = row_of(block, n)
    nearest = xp.take_along_axis(block, xp.argmin(row.cost, axis=-1)[..., None, None], -2)[..., 0, :]
    nearer = downhill & (row_of(nearest, n).cost < row_of(found.rows, n).cost)
    others = xp.where(nearer[..., None], nearest, found.rows)
    looks = row_of(found.rows, n).evaluations + row_of(rows, n).evaluations
    rows = with_looks(xp.where(solved[..., None], rows, others), n, looks, xp)
    mine = np.arange(ISLANDS)[:, None] == xp.concatenate([np.arange(ISLANDS), island])
    every = xp.concatenate([found.costs, row.cost], axis=-1)[..., None, :]
    best = xp.argmin(xp.where(mine, every, np.inf), axis=-1)
    places = xp.take_along_axis(xp.concatenate([found.places, row.q], axis=-2), best[..., None], -2)
    return Found(rows, places, xp.take_along_axis(every[..., 0, :], best, -1))


def going_on(block, n, each, xp=np):
    """Return which tries (..., W) go on carefully: the best of each group before the first with an answer.

    And those that arrived where they were free of all bounds, which begin again within them.
    """
    row = row_of(block.reshape(*block.shape[:-2], -1, each, block.shape[-1]), n)
    none = xp.cumsum((row.status == ReachStatus.SOLVED).any(axis=-1), axis=-1) == 0
    order = np.arange(each)
    best = (order == xp.argmin(row.cost, axis=-1)[..., None]) | (order % 2 == 1)
    on = (best & xp.isfinite(row.cost)) | (row.status == FREE)
    return (on & none[..., None]).reshape(block.shape[:-1])


def joined(block, again, each, xp=np):
    """Return tries (..., W, width), each group followed by what became of it carefully."""
    groups = [v.reshape(*v.shape[:-2], -1, each, v.shape[-1]) for v in (block, again)]
    return xp.concatenate(groups, axis=-2).reshape(*block.shape[:-2], -1, block.shape[-1])


def wanted(asked, stage: Stage, found: Found, beyond: Found, finite, far, sure, why, xp=np):
    """Return which targets (...,) need a stage of a search."""
    row = row_of(found.rows, asked.chain.n)
    missed = xp.where(stage.status, xp.min(beyond.costs, axis=-1), asked.squares(row, xp))
    open_ = finite & (row.status != ReachStatus.SOLVED) & (why == 0) & (sure | xp.logical_not(stage.sure))
    return open_ & (xp.isinf(stage.less) | (missed < stage.less**2)) & (~far | stage.far)


def round_of(k, xp=np):
    """Return the number of tries of the round that begins with try k: one group, later as many as were made before.

    In a round all tries begin about the same places.
    """
    return GROUP * xp.where(k < 3 * GROUP, 1, xp.minimum(k // GROUP - 1, WIDEST))


def begins_anew(k):
    """Return whether all islands are left, and others looked for, before the round that begins with try k."""
    return (k >= ANEW) & (k % ANEW < GROUP * WIDEST)


class Targets(NamedTuple):
    """Targets of one search, in NumPy's float64."""

    pose: Float[np.ndarray, "B t"]
    near: Float[np.ndarray, "B n"] | None
    inside: Float[np.ndarray, "B n"] | None  # `near`, turned into the limits

    def some(self, ids):
        """Return some of them, or each several times."""
        return Targets(*(None if v is None else v[ids] for v in self))


def targets_of(asked, pose, near) -> Targets:
    """Return targets (B, t), near (B, n) or None, as searches take them."""
    inside = None if near is None else turned(near, near, np.array(asked.chain.periodic), *asked.limited())
    return Targets(pose, near, inside)


class Search:
    """The search for a chain's targets, with all that they share; made once for an `Asked`."""

    pool = None  # threads, of a copy that is searching

    def __init__(self, asked: Asked):
        self.asked, self.attempts = asked, attempts(asked.chain, asked.task)
        self.n, self.stages, self.wide = asked.chain.n, stages(asked), asked.terms(limits=False)

    def rows(self, pose, near, progress=None) -> np.ndarray:
        """Return the rows (B, width) of targets (B, t), near (B, n) or None."""
        B, made = len(pose), []
        if B <= FEW:
            return self.part(pose, near, progress)
        with side_by_side() as pool:
            own = copy.copy(self)
            own.pool = pool
            for i in range(0, B, POOL):
                report = progress and (lambda done, _, i=i: progress(i + done, B))
                made.append(own.part(pose[i : i + POOL], None if near is None else near[i : i + POOL], report))
        return made[0] if len(made) == 1 else np.concatenate(made)

    def part(self, pose, near, progress) -> np.ndarray:
        """Return the rows of some targets."""
        asked, B = self.asked, len(pose)
        of = targets_of(asked, pose, near)
        far = None if asked.downhill else asked.too_far(pose)
        if far is None or not far.any():
            rows, block, left = self.first(of)
        else:
            rows, which = np.tile(blank(self.n), (B, 1)), np.flatnonzero(~far)
            rows[which], block, left = self.first(of.some(which))
            left = which[left]
            rows[far] = asked.concluded(rows[far], asked.finite(pose[far], None), False, 0, True)
        if len(left):
            report = progress and (lambda done: progress(B - len(left) + done, B))
            rows[left] = self.rest(of.some(left), block, report)
        if asked.jump is not None and (gone := asked.away(row_of(rows, self.n))).any():
            rows[gone] = asked.concluded(rows[gone], True, False, 0, False)
        if progress is not None:
            progress(B, B)
        return rows

    @functools.cached_property
    def along(self):
        """`descent.along` for AHEAD targets."""
        program = memoized(self.attempts, "_along", lambda attempts: attempts.along(AHEAD))
        return program.bound(self.stages[0].terms)

    def first(self, of: Targets) -> tuple:
        """Make the first group's plain tries.

        Returns: rows (B, width); those tries (K, GROUP, width) of targets that have no answer; the indices of these.
        """
        n, B, near, count = self.n, len(of.pose), of.near is not None, min(GROUP, int(self.asked.seeds))
        if B == 1 and count == GROUP:
            return self.alone(of)
        if B <= FEW:
            block = self.group(self.stages[0], of, None, np.arange(count))
            rows, solved = winners(block, n, near, first=True)
            return rows, block[~solved], np.flatnonzero(~solved)
        rows = self.group(self.stages[0], of, None, np.arange(1))[:, 0]
        row = row_of(rows, n)
        open_ = row.status != ReachStatus.SOLVED
        ids = np.flatnonzero(open_ | ~(row.distance <= CLOSE) if near else open_)
        block = rows[ids][:, None]
        while not near and len(ids) * (count - block.shape[1]) > MANY:  # of those that are left, one after the other
            tries = self.group(self.stages[0], of.some(ids), None, np.arange(block.shape[1], block.shape[1] + 1))
            won = row_of(tries[:, 0], n).status == ReachStatus.SOLVED
            looks = row_of(block[won], n).evaluations.sum(1) + row_of(tries[won, 0], n).evaluations
            rows[ids[won]] = with_looks(tries[won, 0], n, looks)
            ids, block = ids[~won], np.concatenate([block[~won], tries[~won]], axis=1)
        if len(ids) and block.shape[1] < count:
            tries = self.group(self.stages[0], of.some(ids), None, np.arange(block.shape[1], count))
            block = np.concatenate([block, tries], axis=1)
            made, solved = winners(block, n, near, first=False)
            rows[ids[solved]] = made[solved]
            ids, block = ids[~solved], block[~solved]
        return rows, block, ids

    def alone(self, of: Targets) -> tuple:
        """Return `first` of a single target, as a control loop asks for: its sixteen tries side by side."""
        given, away = (None, 0.0) if of.near is None else about(ORDER, of.inside[0])
        near, status = None if of.near is None else of.near[0], 2 * self.n
        tries = self.attempts(self.stages[0].terms, of.pose[0], near, given, away, ORDER, PLAIN, self.asked.seed)
        solved = tries[:, status] == ReachStatus.SOLVED
        if not solved.any():
            return tries[:1], tries[None], np.zeros(1, int)
        if near is None:
            k = last = int(solved.argmax())
        else:
            distance = np.where(solved, row_of(tries, self.n).distance, np.inf)
            k, last = (0, 0) if distance[0] <= CLOSE else (int(distance.argmin()), GROUP)
        made = tries[k : k + 1]
        made[0, status + 3] = tries[: last + 1, status + 3].sum()
        return made, tries[:0, None], np.zeros(0, int)

    def rest(self, of: Targets, block, progress=None) -> np.ndarray:
        """Return the rows of targets whose first tries (K, GROUP, width) have not arrived."""
        asked, n, K = self.asked, self.n, len(of.pose)
        finite, far = asked.finite(of.pose, of.near), asked.too_far(of.pose)
        found = beyond = self.after(nothing((K,), n), block, of, self.stages[0], 0)
        sure, why = np.zeros(K, bool), np.zeros(K, int)
        for i, stage in enumerate(self.stages[1:]):
            if stage.status and not (stage.first or stage.downhill):
                beyond = nothing((K,), n)
            ids = np.flatnonzero(wanted(asked, stage, found, beyond, finite, far, sure, why))
            made = beyond if stage.status else found
            self.stage(made, ids, of, stage)
            if i == 0:
                sure = (asked.seeds >= SURE) & ~far
            if stage.status:
                why[ids] = asked.meaning(stage.status, row_of(beyond.rows[ids], n))
            elif progress is not None:
                progress(int(np.sum(row_of(found.rows, n).status == ReachStatus.SOLVED)))
        return asked.concluded(found.rows, finite, sure, why, far)

    def stage(self, found: Found, ids, of: Targets, stage: Stage) -> None:
        """Put what comes of a stage's tries into what was found, of some targets."""
        k = stage.first
        while len(ids) and k < stage.last:
            numbers = np.arange(k, stage.last if stage.downhill else k + round_of(k))
            if not stage.downhill and begins_anew(k):
                found.costs[ids] = np.inf
            for some in np.array_split(ids, -(-len(ids) * len(numbers) // AT_ONCE)):
                own, targets = Found(*(v[some] for v in found)), of.some(some)
                made = self.after(own, self.group(stage, targets, own, numbers), targets, stage, k)
                for whole, part in zip(found, made, strict=True):
                    whole[some] = part
            ids, k = ids[row_of(found.rows[ids], self.n).status != ReachStatus.SOLVED], k + len(numbers)

    def group(self, stage: Stage, of: Targets, found: Found, k) -> np.ndarray:
        """Return the rows (B, W, width) of tries k (W,) of each target."""
        B, W, given, away = len(of.pose), len(k), None, np.zeros(1)
        most = np.where(k < stage.last, DOWNHILL if stage.downhill else PLAIN, 0)
        if stage.downhill:
            k, given = downhill(k, found.places, found.costs)
        elif k[0] >= BINNED:
            given, away = about_places(k, found.places, found.costs)
        elif of.near is not None:
            given, away = about(k, of.inside)
        if W == 1:
            return self.tried(stage.terms, of, None if given is None else given[:, 0], away[0], k[0], most[0])[:, None]
        lanes, given = of.some(np.repeat(np.arange(B), W)), None if given is None else given.reshape(-1, self.n)
        rows = self.tried(stage.terms, lanes, given, np.resize(away, B * W), np.tile(k, B), np.tile(most, B))
        return rows.reshape(B, W, -1)

    def after(self, found: Found, block, of: Targets, stage: Stage, k) -> Found:
        """Return what was found, after tries (B, W, width) from number k on, and the careful ones that follow."""
        n, each, near = self.n, min(GROUP, block.shape[1]), of.near is not None
        island = island_of(k + np.arange(block.shape[1]))
        if stage.downhill:
            return after(found, block, n, near, False, True, island, each)
        again = np.tile(blank(n), (*block.shape[:2], 1))
        ids, which = np.nonzero(going_on(block, n, each))
        if len(ids):
            given = row_of(block, n).q[ids, which]
            again[ids, which] = self.tried(stage.terms, of.some(ids), given, 0.0, -1, CAREFUL)
        island = np.repeat(island.reshape(-1, 1, each), 2, axis=1).reshape(-1)
        return after(found, joined(block, again, each), n, near, k == 0, False, island, 2 * each)

    def tried(self, terms, of: Targets, given, away, k, most) -> np.ndarray:
        """Return the rows of tries, one for each target, within some terms, see `descent.attempt`."""
        return self.attempts(terms, of.pose, of.near, given, away, k, most, self.asked.seed, self.pool)


def search_of(asked: Asked) -> Search:
    """Return the search, made once for what is asked and for the engine that is chosen."""
    return memoized(asked, f"_search_{in_c()}", Search)
