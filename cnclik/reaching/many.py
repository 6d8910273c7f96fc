"""Many targets: natively, or in blocks on all cores, each searched for in rounds; paths; several answers for each."""

import functools

import jax
import numpy as np

from cnclik.hints import as_here
from cnclik.reaching import programs, search
from cnclik.reaching.asked import Asked
from cnclik.reaching.native import native_for
from cnclik.reaching.result import PER_TARGET, Reached, ReachStatus, fields
from cnclik.reaching.search import BLOCK, SMALLEST, Answers, Targets
from cnclik.reaching.seeds import starts, turned
from cnclik.reaching.single import along, each
from cnclik.record import kept, replace
from cnclik.threads import cores, side_by_side

POOL = 1 << 18  # targets whose leftovers are searched for together
EARLY = search.PLAIN + 4  # tries of all targets, before it is asked which are out of reach
MANY, ALONE = 2000, 2  # targets, and calls for one alone, beyond which C is worth its compiling
ONE_BY_ONE = 512  # targets, at most, that are sooner searched for one by one
ENDLESS = 1 << 40  # looks
TRIES_FAR = 16  # of the search for the nearest pose to a target that is farther off than the arm is long
DIFFERENT, DIFFERENT_REDUNDANT = 0.1, 0.5  # [rad, m] in some joint: another solution; of an arm with freedom left
DRAWN, MOST_DRAWN = 4, 64  # seeds of a round that looks for other solutions, of which each has twice as many
EDGE = 1e-3  # [rad, m] beyond a bound: there may be an answer at it
PATIENCE = 64  # seeds without another solution, and twice as many as there were before, after which there is none


def many(asked: Asked, pose, near, progress=None) -> Reached:
    """Answers for (B, 12) targets, near (B, n) or None."""
    B, n = len(pose), asked.chain.n
    if B > POOL:  # what a search remembers of each target is several times as large as the answer
        parts = []
        for i in range(0, B, POOL):
            told = progress and (lambda done, total, i=i: progress(i + done, B))
            parts.append(many(asked, pose[i : i + POOL], None if near is None else near[i : i + POOL], told))
        return replace(parts[0], **{name: np.concatenate([fields(p)[name] for p in parts]) for name in PER_TARGET})
    if native := native_for(asked, often(asked.chain, B)):
        return native.reached(pose, near, progress)
    if B <= ONE_BY_ONE:
        return each(asked, pose, near, progress)
    setup = search.setup_of(asked)
    made = Answers.empty(B, n)
    sure, why = np.zeros(B, bool), np.zeros(B, int)
    targets = Targets(pose, asked.bounds(near), near)
    far = asked.too_far(pose)
    known, downhill = asked.finite(pose, near), asked.downhill

    def first(ids):
        made.put(ids, search.first_tries(setup, targets.part(ids)))

    def later(ids, done=search.PLAIN, tries=setup.tries):
        mine = setup._replace(tries=tries, budget=ENDLESS if tries > setup.tries else setup.budget)
        made.put(ids, search.later_tries(mine, targets.part(ids), made.part(ids), done))

    def nearest(ids):
        made.put(ids, search.downhill(setup, targets.part(ids), made.part(ids)))

    def free(status, bounds, tries, ids):
        mine = setup._replace(tries=int(tries), budget=ENDLESS, roots=None)
        wider = targets.part(ids)._replace(bounds=bounds)
        there = search.later_tries(mine, wider, search.first_tries(mine, wider))
        close = asked.close(there.costs.min(axis=1, keepdims=True))
        there.put(close, search.downhill(mine, wider.part(close), there.part(close)))
        why[ids] = asked.meaning(status, there.found, there.squares)

    with jax.enable_x64(True), programs.engine():

        def on_all_cores(fn, which):
            """fn of blocks of those of some targets that have no answer yet."""
            ids = np.flatnonzero(which & known & ~made.found & (why == 0))
            size = max(min(BLOCK, -(-len(ids) // cores())), SMALLEST)
            parts = [ids[i : i + size] for i in range(0, len(ids), size)]
            with side_by_side(programs.workers()) as pool:
                for _ in pool.map(as_here(fn), parts):
                    if progress is not None:
                        progress(int(made.found.sum()), B)

        on_all_cores(first, ~far | downhill)
        on_all_cores(functools.partial(later, tries=min(EARLY, setup.tries)), ~far)
        on_all_cores(functools.partial(later, done=EARLY), ~far)
        sure = asked.sure(made.looks) & ~far
        if downhill:
            on_all_cores(functools.partial(later, tries=min(TRIES_FAR, setup.tries)), far)
            on_all_cores(nearest, ~made.found)
        for less, done, tries in asked.longer():
            longer = functools.partial(later, done=int(done), tries=int(tries))
            on_all_cores(longer, sure & asked.close(made.squares, less))
        for status, bounds, tries in asked.beyond():
            on_all_cores(functools.partial(free, status, bounds, tries), sure)
    if progress is not None:
        progress(B, B)
    return asked.reached(pose, near, *made.as_asked(), sure, why)


def path(asked: Asked, pose, progress=None) -> Reached:
    """Answers for the targets (B, 12) of a path, each from the answer before it."""
    if native := native_for(asked, often(asked.chain, len(pose))):
        return native.along(pose, progress)
    return along(asked, pose, progress)


def often(chain, targets) -> bool:
    """Whether a chain has been asked of, with so many targets more, so often that compiling C for it pays."""
    asked_of = kept(chain, "_asked_of", lambda chain: [0, 0])
    alone = targets == 1
    asked_of[0 if alone else 1] += targets
    return asked_of[0] > ALONE if alone else asked_of[1] > MANY


def several(asked: Asked, pose, near, solutions, progress=None) -> Reached:
    """Up to `solutions` different answers for each of (B, 12) targets: the nearest of those that many seeds lead to."""
    first = many(asked, pose, near, progress)
    setup, targets = search.setup_of(asked), Targets(pose, asked.bounds(near), near)
    size = max(16 * BLOCK // (MOST_DRAWN + solutions), 1)

    def block(start):
        mine = {name: v[start : start + size] for name, v in fields(first).items()}
        return _several(asked, setup, mine, targets.part(slice(start, start + size)), solutions)

    often(asked.chain, len(pose) * PATIENCE)
    alone = native_for(asked, True) is None
    with jax.enable_x64(True), programs.engine(), side_by_side(programs.workers() if alone else None) as pool:
        made = list(pool.map(as_here(block), range(0, len(pose), size)))
    whole = {name: np.concatenate([part[name] for part in made]) for name in PER_TARGET}
    return replace(first, **whole, solutions=solutions)


def _several(asked, setup, first, targets, solutions) -> dict:
    """The fields of the record for some targets, from those of their first answers.

    From ever more seeds, until there are as many different ones as asked for, or nothing new has come for long.
    """
    B = len(targets.pose)
    found = {name: np.repeat(v[:, None], solutions, axis=1) for name, v in first.items()}
    found["status"][:, 1:] = ReachStatus.NO_OTHER
    count, newest, done, size = first["status"] <= ReachStatus.ACCEPTED, np.zeros(B, int), 0, DRAWN
    left = np.flatnonzero(count) if solutions > 1 else np.zeros(0, int)
    count = count.astype(int)
    while len(left):
        drawn = _drawn(asked, setup, targets.part(left), range(done, done + size))
        both = {name: np.concatenate([found[name][left], v], axis=1) for name, v in drawn.items()}
        best, there = _nearest(asked, setup, both, targets.part(left).near, solutions)
        for name, v in best.items():
            found[name][left] = v
        done, size = done + size, min(2 * size, MOST_DRAWN)
        newest[left] = np.where(there > count[left], done, newest[left])
        count[left] = there
        left = left[(there < solutions) & (done < PATIENCE + 2 * newest[left])]
    other = found["status"] == ReachStatus.NO_OTHER
    for name in ("q", "position_error", "orientation_error", "distance"):
        found[name][other] = np.nan
    found["at_limit"][other] = False
    return found


def _drawn(asked, setup, targets, numbers) -> dict:
    """The fields (B, K, ...) of what seeds of some numbers lead to."""
    B, K = len(targets.pose), len(numbers)
    seeds = [search.drawn(setup, targets.pose, k, np.full(B, k + setup.seed), 0) for k in numbers]
    mine = targets.part(np.repeat(np.arange(B), K))
    start = np.stack(seeds, axis=1).reshape(B * K, -1)
    low, high = mine.bounds
    if alone := asked.chain.n <= asked.task.m:  # each by itself: no bound is in its way, and those beyond are left out
        mine = mine._replace(bounds=(np.full(asked.chain.n, -np.inf), np.full(asked.chain.n, np.inf)))
    start = starts(start, mine.near, setup.periods, setup.ends, *mine.bounds)
    made = _searched(asked, setup, mine, start, alone)
    if alone:
        made[0][:] = turned(made[0], 0.0 if mine.near is None else mine.near, setup.periods, low, high)
        beyond = np.max(np.maximum(low - made[0], made[0] - high), axis=1)
        made[-1][:] &= beyond <= 0
        if len(edge := np.flatnonzero((beyond > 0) & (beyond < EDGE))):  # by a rounding, perhaps
            some = mine._replace(bounds=(low, high)).part(edge)
            again = _searched(asked, setup, some, np.clip(made[0][edge], *some.bounds), False)
            for whole, part in zip(made, again, strict=True):
                whole[edge] = part
    made = asked.reached(mine.pose, mine.near, *made, *np.zeros((2, B * K), int))
    return {name: v.reshape(B, K, *v.shape[1:]) for name, v in fields(made).items()}


def _searched(asked, setup, targets, start, free):
    """One search from each posture: what `Asked.reached` takes."""
    if native := native_for(asked, True):
        return native.from_starts(targets.pose, targets.near, start, free)
    return search.from_starts(setup, targets, start).as_asked()


def _nearest(asked, setup, of: dict, near, most):
    """The nearest `most` of different answers among (B, K), and how many there are."""
    around = setup.seeds.middle if near is None else near[:, None]
    usable = of["status"] <= ReachStatus.ACCEPTED
    away = np.max(np.abs(of["q"] - around), axis=2, where=usable[..., None], initial=0.0)
    order = np.argsort(np.where(usable, away, np.inf), axis=1, kind="stable")

    def in_order(v, order):
        return np.take_along_axis(v, order.reshape(*order.shape, *(1,) * (v.ndim - 2)), axis=1)

    taken = _different(asked, in_order(of["q"], order), in_order(usable, order))
    order = in_order(order, np.argsort(~taken, axis=1, kind="stable")[:, :most])
    there = np.minimum(taken.sum(axis=1), most)
    best = {name: in_order(v, order) for name, v in of.items()}
    best["status"] = np.where(np.arange(most) < there[:, None], best["status"], int(ReachStatus.NO_OTHER))
    return best, there


def _different(asked, q, usable):
    """Which of (B, K) answers, in order, differ from all that were taken before them."""
    turns = np.array(asked.chain.periodic)
    least = DIFFERENT if asked.chain.n <= asked.task.m else DIFFERENT_REDUNDANT
    taken = np.zeros(usable.shape, bool)
    for k in range(q.shape[1]):
        gap = np.abs(q[:, k : k + 1] - q[:, :k])
        gap = np.where(turns, np.abs(gap - 2 * np.pi * np.round(gap / (2 * np.pi))), gap)
        same = (np.max(gap, axis=2, initial=0.0) < least) & taken[:, :k]
        taken[:, k] = usable[:, k] & ~same.any(axis=1)
    return taken
