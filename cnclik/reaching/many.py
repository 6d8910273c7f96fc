"""Many targets: natively, or in blocks on all cores, each searched for in rounds; paths; several answers for each."""

import functools

import jax
import numpy as np

from cnclik.hints import as_here, form, use_form
from cnclik.reaching import programs, search
from cnclik.reaching.asked import Asked
from cnclik.reaching.native import native_for
from cnclik.reaching.result import PER_TARGET, Reached, ReachStatus, fields
from cnclik.reaching.search import BLOCK, SMALLEST, Answers, Targets
from cnclik.reaching.seeds import SETS, starts
from cnclik.reaching.single import along, each
from cnclik.record import kept, replace
from cnclik.threads import cores, side_by_side

POOL = 1 << 18  # targets whose leftovers are searched for together
EARLY, HARD = search.PLAIN + 4, 100  # so many targets without an answer after so many tries: it is worth it, too
MANY, ALONE = 2000, 2  # targets, and calls for one alone, beyond which the unrolled form is worth its compiling
# Targets, at most, that are sooner searched for one by one; rolled, also where none of them has an answer: more of
# these take longer than to compile what `HARD` asks for.
ONE_BY_ONE = {"unrolled": 128, "rolled": 512}
ENDLESS = 1 << 40  # looks
TRIES_FAR = 16  # of the search for the nearest pose to a target that is farther off than the arm is long
DIFFERENT, DIFFERENT_REDUNDANT = 0.1, 0.5  # [rad, m] in some joint: another solution; of an arm with freedom left
DRAWN = 12  # seeds for each solution asked for


def many(asked: Asked, pose, near, progress=None) -> Reached:
    """Answers for (B, 12) targets, near (B, n) or None."""
    B, n = len(pose), asked.chain.n
    if B > POOL:  # what a search remembers of each target is several times as large as the answer
        parts = []
        for i in range(0, B, POOL):
            told = progress and (lambda done, total, i=i: progress(i + done, B))
            parts.append(many(asked, pose[i : i + POOL], None if near is None else near[i : i + POOL], told))
        return replace(parts[0], **{name: np.concatenate([fields(p)[name] for p in parts]) for name in PER_TARGET})
    kind = form() or form_for(asked.chain, B)
    if native := native_for(asked, kind == "unrolled"):
        return native.reached(pose, near, progress)
    chosen, few = use_form(kind), ONE_BY_ONE[kind]
    if len(pose) <= few:
        with chosen:
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
        mine = setup._replace(tries=min(tries, setup.tries))
        made.put(ids, search.later_tries(mine, targets.part(ids), made.part(ids), done))

    def nearest(ids):
        made.put(ids, search.downhill(setup, targets.part(ids), made.part(ids)))

    def free(status, bounds, tries, ids):
        mine = setup._replace(tries=int(tries), budget=ENDLESS)
        wider = targets.part(ids)._replace(bounds=bounds)
        found = search.later_tries(mine, wider, search.first_tries(mine, wider)).found
        why[ids[found]] = status

    with jax.enable_x64(True):

        def on_all_cores(fn, which):
            """fn of blocks of those of some targets that have no answer yet."""
            ids = np.flatnonzero(which & known & ~made.found & (why == 0))
            size = max(min(BLOCK, -(-len(ids) // cores())), SMALLEST)
            parts = [ids[i : i + size] for i in range(0, len(ids), size)]
            with side_by_side(programs.workers(form())) as pool:
                for _ in pool.map(as_here(fn), parts):
                    if progress is not None:
                        progress(int(made.found.sum()), B)

        with chosen:
            if form() == "unrolled":  # both programs compile at once
                warm = as_here(lambda dtype: search.warm(setup, targets.bounds, dtype))
                with side_by_side() as pool:
                    list(pool.map(warm, ("float32", "float64")))
            on_all_cores(first, ~far | downhill)
            on_all_cores(functools.partial(later, tries=EARLY), ~far)
        # A target without an answer takes hundreds of times as long as one with: then the quicker form is the sooner.
        with use_form(form() or "unrolled") if np.sum(known & ~made.found) > HARD else chosen:
            on_all_cores(functools.partial(later, done=EARLY), ~far)
            sure = asked.sure(made.looks) & ~far
            if downhill:
                on_all_cores(functools.partial(later, tries=TRIES_FAR), far)
                on_all_cores(nearest, ~made.found)
            for status, bounds, tries in asked.beyond():
                on_all_cores(functools.partial(free, status, bounds, tries), sure)
    if progress is not None:
        progress(B, B)
    return asked.reached(pose, near, *made.as_asked(), sure, why)


def path(asked: Asked, pose, progress=None) -> Reached:
    """Answers for the targets (B, 12) of a path, each from the answer before it."""
    kind = form() or form_for(asked.chain, len(pose))
    if native := native_for(asked, kind == "unrolled"):
        return native.along(pose, progress)
    with use_form(kind):
        return along(asked, pose, progress)


def form_for(chain, targets) -> str:
    """The form of programs for so many targets: rolled until a chain has been asked of so often that compiling pays.

    Compiling takes seconds; then a target of the unrolled form is several times quicker one by one, and in batches ten.
    """
    asked_of = kept(chain, "_asked_of", lambda chain: [0, 0])
    alone = targets == 1
    asked_of[0 if alone else 1] += targets
    return "unrolled" if (asked_of[0] > ALONE if alone else asked_of[1] > MANY) else "rolled"


def several(asked: Asked, pose, near, solutions, progress=None) -> Reached:
    """Up to `solutions` different answers for each of (B, 12) targets: the nearest of those that many seeds lead to."""
    first = many(asked, pose, near, progress)
    copies = max(SETS, DRAWN * solutions)
    size = max(4 * BLOCK // copies, 1)

    def block(start):
        cut = slice(start, start + size)
        mine = {name: v[cut] for name, v in fields(first).items()}
        return _several(asked, mine, pose[cut], None if near is None else near[cut], solutions, copies)

    kind = form() or form_for(asked.chain, len(pose) * copies)
    with use_form(kind), jax.enable_x64(True), side_by_side(programs.workers(kind)) as pool:
        made = list(pool.map(as_here(block), range(0, len(pose), size)))
    return replace(first, **{name: np.concatenate([part[name] for part in made]) for name in PER_TARGET})


def _several(asked, first, pose, near, solutions, copies) -> dict:
    """The fields of the record for some targets, from those of their first answers."""
    B, n, setup = len(pose), asked.chain.n, search.setup_of(asked)
    each_of = np.arange(B)
    start = np.stack([search.drawn(setup, pose, k, np.full(B, k + setup.seed), each_of) for k in range(copies)], 1)
    mine = Targets(pose, asked.bounds(near), near).part(np.repeat(each_of, copies))
    start = starts(start.reshape(-1, n), mine.near, setup.periods, setup.ends, *mine.bounds)
    if native := native_for(asked, True):
        found = native.from_starts(mine.pose, mine.near, start)
    else:
        found = search.from_starts(setup, mine, start).as_asked()
    drawn = asked.reached(mine.pose, mine.near, *found, *np.zeros((2, B * copies), int))
    rows = {name: v.reshape(B, copies, *v.shape[1:]) for name, v in fields(drawn).items()}
    both = {name: np.concatenate([first[name][:, None], v], 1) for name, v in rows.items()}
    around = setup.seeds.middle if near is None else near[:, None]
    away = np.max(np.abs(both["q"] - around), axis=2)
    usable = both["status"] <= ReachStatus.ACCEPTED
    order = np.argsort(np.where(usable, away, np.inf), axis=1)
    taken = _different(asked, np.take_along_axis(both["q"], order[..., None], 1), np.take_along_axis(usable, order, 1))
    rank = np.argsort(~taken, axis=1, kind="stable")[:, :solutions]
    picked, there = np.take_along_axis(order, rank, 1), np.take_along_axis(taken, rank, 1)
    none = ~usable.any(axis=1)
    picked[none, 0], there[none, 0] = 0, True  # why there is none, and the nearest pose, as of one solution
    out = {n: np.take_along_axis(v, picked.reshape(B, -1, *(1,) * (v.ndim - 2)), 1) for n, v in both.items()}
    out["status"] = np.where(there, out["status"], int(ReachStatus.NO_OTHER))
    for name in ("q", "position_error", "orientation_error", "distance"):
        out[name][~there] = np.nan
    out["at_limit"][~there] = False
    return out


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
