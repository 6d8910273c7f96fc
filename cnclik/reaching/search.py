"""Searching for many targets at once: tries from ever new seeds, in rounds after which those that arrived leave.

Short rounds with compaction cost what the mean target costs, and not the hardest. Float32 to near the tolerance, then
a step or two in float64, where every answer is checked. The first tries start from the nearest seeds; the targets that
are left get several seeds each at once, more steps, and a careful iteration. What still has not arrived goes downhill
in float64 from the best places found: to the nearest pose.
"""

from typing import NamedTuple

import numpy as np

from cnclik.reaching import programs
from cnclik.reaching.seeds import SETS, nearest

PLAIN, ROUNDS = 5, (6, 3)  # tries without taking back steps, and the steps of their rounds
WIDE, COPIES, CAREFUL = 384, 12, 24  # later: lanes of a try, seeds per target at once at most, steps
COARSE = 2e-5  # [m, rad]: float32 is good for no less
POLISH, SLOW, DOWNHILL = 4, 30, 150  # steps in float64: to the tolerance, near singularities, and to the nearest pose
PLACES = 4  # downhill from so many of the best places
AROUND = 0.5  # [rad, m] about `near` that later tries start in
NEARBY = 0.2  # of the range of seeds, about a place found


class Setup(NamedTuple):
    """What all targets of a search share."""

    chain: object
    task: object
    seeds: object
    compared: object
    tolerance: np.ndarray  # [m], [rad]
    tries: int  # seeds per target, at most
    budget: int  # looks per target, at most
    seed: int  # number of the first set of seeds


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
    """What a search comes to, for each target."""

    q: np.ndarray  # (B, n), the best posture found
    squares: np.ndarray  # (B, 2) squared position and orientation error there
    looks: np.ndarray  # (B,)
    steep: np.ndarray  # (B,) gradient there, see `step.Search`; NaN where it was not looked at
    found: np.ndarray  # (B,)

    @classmethod
    def empty(cls, B, n):
        """Nothing found yet."""
        return cls(np.zeros((B, n)), np.full((B, 2), np.inf), np.zeros(B), np.full(B, np.nan), np.zeros(B, bool))

    def put(self, ids, some):
        """Write down the answers for some of the targets."""
        for all_of, part in zip(self, some, strict=True):
            all_of[ids] = part

    def as_asked(self):
        """What `Asked.reached` takes."""
        return self.q, self.squares, self.steep, self.looks, self.found


def find(setup: Setup, targets: Targets, downhill=True) -> Answers:
    """A posture for every target, or, with `downhill`, one whose pose is as near as can be."""
    B, n = len(targets.pose), setup.chain.n
    made = Answers.empty(B, n)
    places = np.zeros((B, PLACES, n)), np.full((B, PLACES), np.inf)
    left, done = np.arange(B), 0
    while len(left) and done < setup.tries:
        wide = done >= PLAIN
        copies = min(max(WIDE // len(left), 1), COPIES, setup.tries - done) if wide else 1
        mine = targets.part(np.repeat(left, copies))
        start = _starts(setup, mine, done, copies, places[0][np.repeat(left, copies)])
        q, cost, arrived, looks = _careful(setup, mine, start) if wide else _rounds(setup, mine, start)
        made.looks[left] += looks.reshape(-1, copies).sum(axis=1)
        best = _preferred(q, cost, arrived, mine.near, copies)
        q, cost, arrived = q[best], cost[best], arrived[best]
        _keep(places, left, q, cost)
        if arrived.any():
            ids = left[arrived]
            _settle(setup, targets.part(ids), ids, q[arrived], POLISH, made)
            slow = ~made.found[ids]
            if slow.any():
                _settle(setup, targets.part(ids[slow]), ids[slow], q[arrived][slow], SLOW, made)
        left = left[~made.found[left] & (made.looks[left] < setup.budget)]
        done += copies
    left = np.flatnonzero(~made.found)
    if len(left) and downhill:
        _downhill(setup, targets, left, places, made)
    return made


def warm(setup: Setup, bounds, dtype) -> None:
    """Compile the program of a precision, where it is not yet."""
    n = setup.chain.n
    own = tuple((b[:1] if b.ndim > 1 else b).astype(dtype) for b in bounds)
    start, pose = np.zeros((1, n), dtype), np.eye(1, 12, dtype=dtype)
    programs.search(setup.chain, setup.task, own, setup.tolerance.astype(dtype), start, pose, 0, careful=False)


def from_starts(setup: Setup, targets: Targets, start) -> Answers:
    """One careful search from each of (B, n) postures."""
    made = Answers.empty(*start.shape)
    q, _, arrived, looks = _careful(setup, targets, np.clip(start, *targets.bounds))
    made.looks[:] = looks
    ids = np.flatnonzero(arrived)
    if len(ids):
        _settle(setup, targets.part(ids), ids, q[ids], POLISH, made)
    return made


def _starts(setup, mine, done, copies, places):
    """Postures (L·copies, n) to start from, within the bounds."""
    L = len(mine.pose) // copies
    number = setup.seed + done + np.tile(np.arange(copies), L)
    if mine.near is not None and done < PLAIN:
        shake = setup.seeds.postures[number % len(setup.seeds.postures)]
        middle, wide = np.mean(setup.seeds.postures, axis=0), np.ptp(setup.seeds.postures, axis=0)
        start = mine.near + AROUND * done / PLAIN * 2 * (shake - middle) / np.maximum(wide, 1e-9)
    elif done < SETS:
        picked = np.empty(len(number), np.intp)
        for k in np.unique(number):
            picked[number == k] = nearest(setup.compared, mine.pose[number == k], k)
        start = setup.seeds.postures[picked]
    else:  # any of them, another each time; and every other one near the best places found
        k = (number * 2654435761 + np.repeat(np.arange(L), copies) * 40503) % len(setup.seeds.postures)
        start = setup.seeds.postures[k]
        close = places[np.arange(len(k)), k % PLACES] + NEARBY * (start - np.mean(setup.seeds.postures, axis=0))
        start = np.where((number % 2 == 0)[:, None], close, start)
    return np.clip(start, *mine.bounds)


def _single(setup, mine, start, steps, careful):
    """A search in float32."""
    coarse = np.maximum(setup.tolerance, COARSE).astype(np.float32)
    bounds = tuple(b.astype(np.float32) for b in mine.bounds)
    pose = mine.pose.astype(np.float32)
    return programs.search(
        setup.chain, setup.task, bounds, coarse, start.astype(np.float32), pose, steps, careful
    ), coarse


def _rounds(setup, mine, start):
    """One try without taking back steps: rounds, after which those that arrived leave."""
    L = len(start)
    q, cost, looks, arrived = np.empty((L, setup.chain.n)), np.empty(L), np.zeros(L), np.zeros(L, bool)
    left, at = np.arange(L), start
    for steps in ROUNDS:
        found, coarse = _single(setup, mine.part(left), at, steps, careful=False)
        q[left], cost[left] = found.q, found.cost
        looks[left] += found.looks
        arrived[left] = here = (found.squares <= coarse**2).all(axis=1)
        left, at = left[~here], found.onward[~here]
        if not len(left):
            break
    return q, cost, arrived, looks


def _careful(setup, mine, start):
    found, coarse = _single(setup, mine, start, CAREFUL, careful=True)
    return found.q.astype(float), found.cost, (found.squares <= coarse**2).all(axis=1), found.looks


def _preferred(q, cost, arrived, near, copies):
    """Index (L,) of the copy of each target that is nearest to `near` of those that arrived, else of the least cost."""
    value = np.where(np.isfinite(cost), cost, np.finfo(np.float32).max)
    if near is not None:
        away = np.max(np.abs(q - near), axis=1)
        value = np.where(arrived, away - 1e6, value)
    else:
        value = np.where(arrived, value - 1e6, value)
    return np.arange(0, len(q), copies) + np.argmin(value.reshape(-1, copies), axis=1)


def _keep(places, ids, q, cost):
    """Take places in where they are better than the worst of those kept."""
    kept, costs = places
    worst = np.argmax(costs[ids], axis=1)
    better = cost < costs[ids, worst]  # False for NaN
    kept[ids[better], worst[better]], costs[ids[better], worst[better]] = q[better], cost[better]


def _settle(setup, mine, ids, q, steps, made):
    """Steps in float64; the outcome is the answer where it is better than what there was."""
    q = np.clip(np.asarray(q, float), *mine.bounds)
    at = programs.search(setup.chain, setup.task, mine.bounds, setup.tolerance, q, mine.pose, steps, careful=True)
    made.looks[ids] += at.looks
    here = (at.squares <= setup.tolerance**2).all(axis=1)
    better = here | (at.squares.sum(axis=1) < made.squares[ids].sum(axis=1))
    ids = ids[better]
    made.q[ids], made.squares[ids], made.steep[ids] = at.q[better], at.squares[better], at.steep[better]
    made.found[ids] = here[better]


def _downhill(setup, targets, left, places, made):
    """From the best places found to where the error is stationary."""
    order = np.argsort(places[1][left], axis=1)
    for k in range(PLACES):
        ids = left[np.isfinite(places[1][left, order[:, k]]) & ~made.found[left]]
        if len(ids):
            column = order[np.searchsorted(left, ids), k]
            _settle(setup, targets.part(ids), ids, places[0][ids, column], DOWNHILL, made)
