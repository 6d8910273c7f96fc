"""Many targets, paths, and several answers per target: in C where there is a compiler, else in JAX."""

import numpy as np

from cnclik.reaching.asked import Asked
from cnclik.reaching.native import native_for
from cnclik.reaching.result import PER_TARGET, Reached, ReachStatus, fields
from cnclik.reaching.seeds import seeds, turned
from cnclik.reaching.single import Programs
from cnclik.reaching.strategy import PLAIN, narrowed
from cnclik.record import memoized, replace

POOL = 1 << 18  # largest number of targets in one search
MANY, ALONE = 2000, 2  # after so many targets, or calls for one target, compiling C pays
DIFFERENT, DIFFERENT_REDUNDANT = 0.1, 0.5  # [rad, m] solutions differ by more in some joint; for a redundant arm
DRAWN, MOST_DRAWN = 4, 64  # tries in the first round for other solutions; each round has twice as many
EDGE = 1e-3  # [rad, m] a solution beyond a bound by less may be one at it
PATIENCE = 64  # the search ends after so many tries without a new solution, plus twice the tries before the last one
TARGETS = 1 << 16  # number of answers compared at a time


def many(asked: Asked, pose, near, progress=None) -> Reached:
    """Answers for (B, t) targets, near (B, n) or None."""
    B = len(pose)
    if B > POOL:  # a search needs several times the memory of its answers
        parts = []
        for i in range(0, B, POOL):
            report = progress and (lambda done, total, i=i: progress(i + done, B))
            parts.append(many(asked, pose[i : i + POOL], None if near is None else near[i : i + POOL], report))
        return replace(parts[0], **{name: np.concatenate([fields(p)[name] for p in parts]) for name in PER_TARGET})
    return _engine(asked, often(asked.chain, B)).reached(pose, near, progress)


def path(asked: Asked, pose, progress=None) -> Reached:
    """Answers for the targets (B, t) of a path, each from the answer before it."""
    return _engine(asked, often(asked.chain, len(pose))).along(pose, progress)


def _engine(asked, soon):
    """The engine for the search: C where it is available, else JAX."""
    return native_for(asked, soon) or memoized(asked, f"_programs_{soon}", lambda asked: Programs(asked, soon))


def often(chain, targets) -> bool:
    """Whether compiling C for a chain pays, after so many more `targets`. It counts them."""
    asked_of = memoized(chain, "_asked_of", lambda chain: [0, 0])
    alone = targets == 1
    asked_of[0 if alone else 1] += targets
    return asked_of[0] > ALONE if alone else asked_of[1] > MANY


def several(asked: Asked, pose, near, solutions, progress=None) -> Reached:
    """Up to `solutions` different answers for each of (B, t) targets: the nearest ones that many tries find."""
    first = many(asked, pose, near, progress)
    engine = native_for(asked, True) or _engine(asked, often(asked.chain, len(pose)))
    size, made = max(TARGETS // (MOST_DRAWN + solutions), 1), []
    for k in range(0, len(pose), size):
        mine = {name: v[k : k + size] for name, v in fields(first).items()}
        own = pose[k : k + size], None if near is None else near[k : k + size]
        made.append(_several(asked, engine, mine, *own, solutions))
    whole = {name: np.concatenate([part[name] for part in made]) for name in PER_TARGET}
    return replace(first, **whole, solutions=solutions)


def _several(asked, engine, first, pose, near, solutions) -> dict:
    """The fields of the record for some targets, given those of their first answers.

    Tries until there are as many different answers as requested, or none has been new for long.
    """
    B = len(pose)
    found = {name: np.repeat(v[:, None], solutions, axis=1) for name, v in first.items()}
    found["status"][:, 1:] = ReachStatus.NO_OTHER
    count, newest, done, size = first["status"] <= ReachStatus.ACCEPTED, np.zeros(B, int), 0, DRAWN
    left = np.flatnonzero(count) if solutions > 1 else np.zeros(0, int)
    count = count.astype(int)
    while len(left):
        own = pose[left], None if near is None else near[left]
        drawn = _drawn(asked, engine, *own, range(done, done + size))
        both = {name: np.concatenate([found[name][left], v], axis=1) for name, v in drawn.items()}
        best, there = _nearest(asked, both, own[1], solutions)
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


def _drawn(asked, engine, pose, near, numbers) -> dict:
    """The fields (B, K, ...) of the results of tries with given numbers."""
    wide = asked.chain.n <= asked.task.m  # search without bounds, and discard solutions beyond them
    B, K = len(pose), len(numbers)
    pose, near = np.repeat(pose, K, axis=0), None if near is None else np.repeat(near, K, axis=0)
    made = engine.tried(pose, near, np.tile(PLAIN + np.array(numbers), B), wide)
    if wide:
        lower, upper = asked.limited()
        low, high = narrowed(lower, upper, np.inf if asked.jump is None else asked.jump, near)
        made.q[:] = turned(made.q, 0.0 if near is None else near, asked.periods, low, high)
        beyond = np.max(np.maximum(low - made.q, made.q - high), axis=1)
        if len(edge := np.flatnonzero((made.found != 0) & (beyond > 0) & (beyond < EDGE))):  # perhaps only by rounding
            own = pose[edge], None if near is None else near[edge]
            again = engine.descended(*own, np.clip(made.q, low, high)[edge])
            beyond[edge] = 0
            for whole, part in zip(made, again, strict=True):
                whole[edge] = part
        made.found[beyond > 0] = 0
    q, squares, _, steep, looks, found, *_ = made
    answer = asked.reached(pose, near, q, squares, steep, looks, found != 0, np.False_, 0)
    return {name: v.reshape(B, K, *v.shape[1:]) for name, v in fields(answer).items()}


def _nearest(asked, of: dict, near, most):
    """The nearest `most` different answers among (B, K), and their number."""
    around = seeds(asked.chain).middle if near is None else near[:, None]
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
    """Which of (B, K) ordered answers differ from all answers chosen before them."""
    turns = np.array(asked.chain.periodic)
    least = DIFFERENT if asked.chain.n <= asked.task.m else DIFFERENT_REDUNDANT
    taken = np.zeros(usable.shape, bool)
    for k in range(q.shape[1]):
        gap = np.abs(q[:, k : k + 1] - q[:, :k])
        gap = np.where(turns, np.abs(gap - 2 * np.pi * np.round(gap / (2 * np.pi))), gap)
        same = (np.max(gap, axis=2, initial=0.0) < least) & taken[:, :k]
        taken[:, k] = usable[:, k] & ~same.any(axis=1)
    return taken
