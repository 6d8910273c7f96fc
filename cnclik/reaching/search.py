"""Searching for many targets at once, where `native` does not: tries from ever new seeds, until all have arrived.

The first tries start from the nearest seeds, and end early: near the tolerance (in float32 where that is quicker), then
a step or two in float64, where every answer is checked. The targets that are left get several seeds each at once, more
steps, and a careful iteration in float64. What still has not arrived goes downhill from the best places found: to the
nearest pose.
"""

from typing import NamedTuple

import numpy as np

from cnclik.engine.plan import in_scalars
from cnclik.reaching import programs
from cnclik.reaching.seeds import SETS, STRETCHES, compared, nearest, seeds, spans, starts, turned

PLAIN, STEPS = 5, 9  # tries without taking back steps, and their steps
WIDE, COPIES, CAREFUL = 384, 12, 24  # later: lanes of a try, seeds per target at once at most, steps
COARSE = 2e-5  # [m, rad]: float32 is good for no less
POLISH, SLOW = 2, 30  # steps in float64 to the tolerance: nearly always, and near singularities
DOWNHILL = 150  # and to the nearest pose
BLOCK, SMALLEST = 4096, 256  # targets that a core searches for at a time
TOGETHER = 4  # later tries of which the outcomes go into float64 together
PLACES = 4  # downhill from so many of the best places
AROUND = 0.5  # [rad, m] about `near` that later tries start in
NEARBY, SELDOM = 0.35, 4  # of the range of seeds, about a place found; one try in so many starts there
STUCK = 1e-5  # of `step.Search.steep`: a try whose error falls as slowly as that ends


class Setup(NamedTuple):
    """What all targets of a search share."""

    chain: object
    task: object  # without weights
    roots: np.ndarray | None  # of the weights by which the nearest pose is the nearest
    seeds: object
    compared: object
    periods: np.ndarray  # (n,) what each joint turns by to the same posture; 0 of those that have none
    ends: tuple  # of the range of the seeds, (n,) each
    tolerance: np.ndarray  # [m], [rad]
    tries: int  # seeds per target, at most
    budget: int  # looks per target, at most
    seed: int  # number of the first set of seeds


def setup_of(asked) -> Setup:
    """The setup of what is asked."""
    known = seeds(asked.chain)
    limits = asked.tolerance, int(asked.seeds), int(asked.budget), int(asked.seed)
    return Setup(
        asked.chain, *asked.unweighted(), known, compared(known, asked.task), asked.periods, spans(asked.chain), *limits
    )


class Targets(NamedTuple):
    """What is each target's own, or all targets'."""

    pose: np.ndarray  # (B, 12) position, rows of the rotation
    bounds: tuple  # lower, upper: (n,), or (B, n)
    near: np.ndarray | None  # (B, n)

    def part(self, ids):
        """Some of the targets."""
        bounds = tuple(b[ids] if b.ndim > 1 else b for b in self.bounds)
        return Targets(self.pose[ids], bounds, None if self.near is None else self.near[ids])


class Answers(NamedTuple):
    """What a search comes to, for each target; written to as it goes on."""

    q: np.ndarray  # (B, n), the best posture found
    squares: np.ndarray  # (B, 2) squared position and orientation error there
    cost: np.ndarray  # (B,) and their sum, weighted where the search goes downhill
    looks: np.ndarray  # (B,)
    steep: np.ndarray  # (B,) gradient there, see `step.Search`; NaN where it was not looked at
    found: np.ndarray  # (B,)
    places: np.ndarray  # (B, PLACES, n) the best places of tries that did not arrive
    costs: np.ndarray  # (B, PLACES) and what they cost

    @classmethod
    def empty(cls, B, n):
        """Nothing found yet."""
        one = np.zeros((B, n)), np.full((B, 2), np.inf), np.full(B, np.inf), np.zeros(B)
        one += np.full(B, np.nan), np.zeros(B, bool)
        return cls(*one, np.zeros((B, PLACES, n)), np.full((B, PLACES), np.inf))

    def part(self, ids):
        """A copy of the answers for some of the targets."""
        return Answers(*(v[ids] for v in self))

    def put(self, ids, some):
        """Write down the answers for some of the targets."""
        for all_of, part in zip(self, some, strict=True):
            all_of[ids] = part

    def as_asked(self):
        """What `Asked.reached` takes."""
        return self.q, self.squares, self.steep, self.looks, self.found


def first_tries(setup: Setup, targets: Targets) -> Answers:
    """The tries that nearly all targets need no more than."""
    made = Answers.empty(len(targets.pose), setup.chain.n)
    left, arrived = np.arange(len(targets.pose)), []
    for done in range(min(PLAIN, setup.tries)):
        left = _try(setup, targets, left, done, 1, made, arrived)
    _polish(setup, targets, arrived, made)
    return made


def later_tries(setup: Setup, targets: Targets, made: Answers, done=PLAIN) -> Answers:
    """For targets without an answer, after `done` tries: until there is one, or seeds or budget are used up."""
    left, arrived = np.flatnonzero(~made.found), []
    while done < setup.tries and (len(left) or arrived):
        if len(left):
            copies = min(max(WIDE // len(left), 1), COPIES, setup.tries - done)
            left = _try(setup, targets, left, done, copies, made, arrived)
            done += copies
        if not len(left) or done >= setup.tries or len(arrived) == TOGETHER:  # what float64 does not confirm goes on
            ids = _polish(setup, targets, arrived, made)
            left, arrived = np.union1d(left, ids[~made.found[ids]]), []
        left = left[made.looks[left] < setup.budget]
    return made


def downhill(setup: Setup, targets: Targets, made: Answers) -> Answers:
    """From the best places found to where the error, weighted, is stationary, for targets without an answer."""
    left = np.flatnonzero(~made.found)
    made.cost[left] = np.inf
    order = np.argsort(made.costs[left], axis=1)
    for k in range(PLACES):
        go = np.isfinite(made.costs[left, order[:, k]]) & ~made.found[left]
        _settle(setup, targets, left[go], made.places[left[go], order[go, k]], DOWNHILL, made, setup.roots)
    return made


def _try(setup, targets, left, done, copies, made, arrived):
    """One try for the targets `left`; those that did not arrive.

    What arrived is appended to `arrived`: of each target's copies the nearest to `near` last, else that of least cost.
    """
    if not len(left):
        return left
    ids = np.repeat(left, copies)
    mine = targets.part(ids)
    start = _starts(setup, mine, done, copies, made.places[ids])
    careful = done >= PLAIN
    q, cost, here, looks = _searched(setup, mine, start, CAREFUL if careful else STEPS, careful)
    made.looks[left] += looks.reshape(-1, copies).sum(axis=1)
    cost = np.where(np.isfinite(cost), cost, np.inf)
    best = np.arange(0, len(q), copies) + np.argmin(cost.reshape(-1, copies), axis=1)
    _keep(made, left, q[best], cost[best])
    value = cost if mine.near is None else np.max(np.abs(q - mine.near), axis=1)
    order = np.argsort(-value)
    order = order[here[order]]  # all: the one wanted most may be a minimum that float64 finds to be none
    arrived.append((ids[order], q[order]))
    return left[~here.reshape(-1, copies).any(axis=1)]


def _polish(setup, targets, arrived, made):
    """Steps in float64 from what arrived in float32; whose they are."""
    ids = np.concatenate([ids for ids, _ in arrived]) if arrived else np.zeros(0, int)
    if len(ids):
        q = np.concatenate([q for _, q in arrived])
        _settle(setup, targets, ids, q, POLISH, made)
        slow = ~made.found[ids]
        _settle(setup, targets, ids[slow], q[slow], SLOW, made)
    return ids


def from_starts(setup: Setup, targets: Targets, start) -> Answers:
    """One careful search from each of (B, n) postures within the bounds."""
    made = Answers.empty(*start.shape)
    q, _, here, looks = _searched(setup, targets, start, CAREFUL, careful=True)
    made.looks[:] = looks
    _polish(setup, targets, [(np.flatnonzero(here), q[here])], made)
    return made


def _starts(setup, mine, done, copies, places):
    """Postures (L·copies, n) to start from, within the bounds."""
    L, known = len(mine.pose) // copies, setup.seeds
    number = setup.seed + done + np.tile(np.arange(copies), L)
    if mine.near is not None and done < PLAIN:
        shake = (known.postures[number % len(known.postures)] - known.middle) / np.maximum(known.width, 1e-9)
        about = mine.near + AROUND * done / PLAIN * 2 * shake
        return np.clip(turned(about, mine.near, setup.periods, *mine.bounds), *mine.bounds)
    seed = drawn(setup, mine.pose, done, number, np.repeat(np.arange(L), copies))
    stretch = np.array(STRETCHES)[number % len(STRETCHES)] if done >= SETS else 1.0
    start = starts(seed, mine.near, setup.periods, setup.ends, *mine.bounds, stretch)
    if done >= SETS:  # some near the best places found
        place = places[np.arange(len(start)), _any(setup, number, np.repeat(np.arange(L), copies)) % PLACES]
        close = np.clip(place + NEARBY * (seed - known.middle), *mine.bounds)
        start = np.where((number % SELDOM == 0)[:, None], close, start)
    return start


def drawn(setup, pose, done, number, target):
    """Seeds (L, n) to start from: the nearest of a set while there are sets, then any, another for each try and target.

    Args:
      done: tries before. number: of each one's set (L,). target: the number of each one's target (L,).
    """
    if done >= SETS:
        return setup.seeds.postures[_any(setup, number, target)]
    picked = np.empty(len(number), np.intp)
    for k in np.unique(number):
        picked[number == k] = nearest(setup.compared, pose[number == k], k)
    return setup.seeds.postures[picked]


def _any(setup, number, target):
    return (number * 2654435761 + target * 40503) % len(setup.seeds.postures)


def _searched(setup, mine, start, steps, careful):
    """A search from each start: q, cost, whether it came close, looks. In float32 but where it is `careful`.

    Float32 does not get next to singularities: damping that its rounding needs makes steps there too short. Of the
    source as it is, which calls LAPACK, a look in float32 takes twice as long as in float64.
    """
    close = np.maximum(setup.tolerance, COARSE)
    kind, tolerance = (float, setup.tolerance) if careful or not in_scalars() else (np.float32, close)
    bounds, (tolerance, start, pose) = (
        tuple(v.astype(kind) for v in some) for some in (mine.bounds, (tolerance, start, mine.pose))
    )
    found = programs.search(setup.chain, setup.task, bounds, tolerance, start, pose, steps, careful)
    return found.q.astype(float), found.cost, found.within(close.astype(kind)), found.looks


def _keep(made, ids, q, cost):
    """Take places in where they are better than the worst of those kept."""
    worst = np.argmax(made.costs[ids], axis=1)
    better = cost < made.costs[ids, worst]  # False for NaN
    made.places[ids[better], worst[better]], made.costs[ids[better], worst[better]] = q[better], cost[better]


def _settle(setup, targets, ids, q, steps, made, roots=None):
    """Steps in float64; the outcome is the answer where it is better than what there was.

    Of several for one target the last one that arrived is.
    """
    if not len(ids):
        return
    mine = targets.part(ids)
    q = np.clip(q, *mine.bounds)
    at = programs.search(setup.chain, setup.task, mine.bounds, setup.tolerance, q, mine.pose, steps, True, roots)
    np.add.at(made.looks, ids, at.looks)
    here = at.within(setup.tolerance)
    better = np.flatnonzero(here | (at.cost < made.cost[ids]))
    better = better[np.argsort(here[better], kind="stable")]
    ids = ids[better]
    made.cost[ids] = at.cost[better]
    made.q[ids], made.squares[ids], made.steep[ids] = at.q[better], at.squares[better], at.steep[better]
    made.found[ids] = here[better]
