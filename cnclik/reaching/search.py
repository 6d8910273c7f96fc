"""The search for one target as a pure function, for jit, vmap and grad, and for systems without a compiler.

A try is a state, `Try`, and a step, `advance`. Several tries step side by side. The result is the same as one after the
other: the answer is the first try, in their order, that arrives. c/search.c is the same search, with the
same numbers, one try after the other in each lane of a vector.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.reaching import strategy
from cnclik.reaching.asked import Asked
from cnclik.reaching.seeds import SETS, STRETCHES, nearest, periods, spans, starts, turned
from cnclik.reaching.step import Search, begin, iterate
from cnclik.reaching.strategy import Phase, SoFar, narrowed, phases, wanted
from cnclik.reaching.targets import aims, owners
from cnclik.record import AnyArray, Array, Bool, Float, Int, replace

SIDE_BY_SIDE = 8  # tries side by side
SCATTER = np.uint32(0x7F4A7C15)  # by which a try's number becomes that of any seed; its upper bits are even (Knuth)


class Found(NamedTuple):
    """The result of a search for one target; several targets add an axis."""

    q: Float[AnyArray, "*B n"]  # the best posture found
    squares: Float[AnyArray, "*B 2"]  # squared position and orientation error there
    cost: Float[AnyArray, " *B"]  # and their sum, weighted where the search goes downhill
    steep: Float[AnyArray, " *B"]  # gradient there, see `step.Search`; NaN where it was not looked at
    looks: Float[AnyArray, " *B"]
    found: Float[AnyArray, " *B"]  # 1 where it is an answer
    places: Float[AnyArray, "*B PLACES n"]  # the best places of tries that did not arrive
    costs: Float[AnyArray, "*B PLACES"]  # and what they cost


def nothing(shape, n, dtype=float, xp=np):
    """`Found`: nothing yet, for targets of that shape."""

    def full(value, *own):
        return xp.full((*shape, *own), value, dtype)

    one = full(0.0, n), full(np.inf, 2), full(np.inf), full(np.nan), full(0.0), full(0.0)
    return Found(*one, full(0.0, strategy.PLACES, n), full(np.inf, strategy.PLACES))


def choose(which, one, other):
    return jax.tree.map(lambda one, other: jnp.where(which, one, other), one, other)


class Given(NamedTuple):
    """Data shared by all targets."""

    asked: Asked  # its tolerance in the targets' dtype
    advance: Callable  # `advance` of its chain and task
    postures: Float[Array, "K n"]  # to start from
    nearest: Callable  # of a target and the number of a try: indices of the posture that is nearest by each aim


def given(asked, postures, to, dtype, by=None) -> Given:
    """What is asked, for targets in a dtype.

    Args: to: what the postures are to the task; None where that is unknown. by: what runs steps, `native` or `scalars`
      of the engine; None: the source as it is.
    """
    tolerance = jnp.maximum(jnp.asarray(asked.tolerance, dtype), 64 * float(jnp.finfo(dtype).eps))
    made = functools.partial(advance, asked.chain, asked.task)
    if by is not None and all(map(errors.concrete, jax.tree.leaves((asked.chain, asked.task)))):
        made = by(made)

    def nearest_to(pose, number):
        if to is None:
            return jnp.full(len(aims(asked.task)), number % len(postures))
        return nearest(to, pose, number % SETS)

    return Given(replace(asked, tolerance=tolerance), made, jnp.asarray(postures, dtype), nearest_to)


class Try(NamedTuple):
    at: Search
    step: Int[Array, ""]
    most: Int[Array, ""]  # steps
    careful: Bool[Array, ""]
    free: Bool[Array, ""]  # of all bounds: where it arrives, it begins again within them
    over: Bool[Array, ""]
    found: Bool[Array, ""]


def advance(chain, task, pose, near, bounds, tolerance, roots, own: Try) -> Try:
    """One iteration, and whether the try has ended; a try that has ended does not change."""
    low, high = bounds
    within_bounds = jnp.where(own.free, -np.inf, low), jnp.where(own.free, np.inf, high)
    at = iterate(chain, task, own.at, pose, within_bounds, tolerance, own.careful, roots)
    step, short = own.step + 1, own.most <= strategy.CAREFUL
    within, close = ((at.squares <= most**2).all() for most in (tolerance, strategy.COARSE))
    ends = at.arrived | (short & (at.steep <= strategy.STUCK)) | (step >= own.most)
    on = ends & ~within & ~at.arrived & short & close  # some more steps
    most = jnp.where(on, own.most + strategy.SLOW, own.most)
    inward = ends & within & own.free
    q = jnp.clip(turned(at.best, 0.0 if near is None else near, periods(chain), low, high, jnp), low, high)
    again = begin(q.astype(at.q.dtype), 0.0 * at.trust)._replace(looks=at.looks)
    new = Try(at, step, most, own.careful | on, own.free, ends & ~on, ends & within)
    new = choose(inward, Try(again, 0 * step, 0 * step + strategy.CAREFUL, own.careful, ~inward, ~inward, ~inward), new)
    return choose(own.over, own, new)


def start(of: Given, phase: Phase, made: Found, pose, near, bounds, k):
    """The posture that try k begins at, whether it is free of all bounds, and whether there is such a try."""
    asked, postures = of.asked, of.postures
    ends, number, (low, high) = spans(asked.chain), asked.seed + k, bounds
    middle, width = (ends[0] + ends[1]) / 2, np.maximum(ends[1] - ends[0], 1e-9)
    scattered = number.astype(np.uint32) * SCATTER
    own, count = owners(asked.task, asked.chain), len(aims(asked.task))
    which = jnp.where(k < SETS, of.nearest(pose, number), (scattered >> 20) % len(postures))
    seed = postures[which[own], np.arange(len(own))]
    stretch = jnp.where(k < SETS, 1.0, jnp.asarray(STRETCHES)[number % len(STRETCHES)]).astype(pose.dtype)
    q = starts(seed, near, asked.periods, ends, low, high, stretch)
    some = (scattered >> 16) % strategy.PLACES
    by = (k >= SETS) & (number % strategy.SELDOM <= (count > 1)) & jnp.isfinite(made.costs[some])
    if count > 1:  # of several tips one begins elsewhere
        q = jnp.where(by & (own != number // strategy.SELDOM % count), made.places[some], q)
    else:
        q = jnp.where(by, made.places[some] + seed - middle, q)
    if near is not None:
        away = postures[number % len(postures)] - middle
        shift = strategy.AROUND * k.astype(pose.dtype) / strategy.PLAIN * 2 * away / width
        q = jnp.where(k < strategy.PLAIN, turned(near + shift, near, asked.periods, low, high, jnp), q)
    place = jnp.minimum(k, strategy.PLACES - 1)
    q = jnp.where(phase.downhill > 0, made.places[place], q)
    there = (phase.downhill == 0) | jnp.isfinite(made.costs[place])
    outer = (phase.downhill == 0) & (k >= SETS) & (jnp.isfinite(low) | jnp.isfinite(high)).any()
    there = there & ~(outer & (number % (2 * strategy.OUTER) == 2 * strategy.OUTER - 1)) & (k < phase.tries)
    return jnp.clip(q, low, high).astype(pose.dtype), outer & (number % strategy.OUTER == 2), there


def tries(of: Given, phase: Phase, made: Found, pose, near, k, together) -> Found:
    """What so many tries come to, from number k on.

    Args: pose: the target. near: (n,) or None.
    """
    bounds = narrowed(phase.low, phase.high, phase.jump, near, jnp)
    number, downhill = k + jnp.arange(together, dtype=jnp.int32), phase.downhill > 0
    q, free, there = jax.vmap(lambda k: start(of, phase, made, pose, near, bounds, k))(number)
    plain = (number < strategy.PLAIN) & jnp.logical_not(downhill)
    most = jnp.where(downhill, phase.downhill, jnp.where(plain, strategy.STEPS, strategy.CAREFUL))
    at = jax.vmap(lambda q: begin(q, q[0] * 0.0))(q)
    own = Try(at, jnp.zeros_like(number), most, ~plain, free, ~there, jnp.zeros_like(there))
    roots, order = None if of.asked.task.weights is None else phase.roots, jnp.arange(together)

    alike = pose, near, bounds, of.asked.tolerance, roots
    shared = jax.tree.map(lambda v: jnp.broadcast_to(v, (together, *jnp.shape(v))), alike)

    def first(own):
        return jnp.min(jnp.where(own.found, order, together))

    def once(own):
        return jax.vmap(of.advance)(*shared, own)

    own = lax.while_loop(lambda own: (~own.over & (order < first(own))).any(), once, own)
    at, won, counted = own.at, first(own), order <= first(own)
    cost = jnp.where(there & counted & ~own.free & jnp.isfinite(at.cost), at.cost, jnp.inf)
    best = jnp.where(won < together, won, jnp.argmin(cost))
    taken = (won < together) | downhill & (cost[best] < made.cost)
    newest = (jnp.where(taken, v[best], old) for v, old in zip((at.best, *at[2:5]), made[:4], strict=True))
    posture, squares, least, steep = newest
    looks = made.looks + jnp.sum(jnp.where(counted & there, at.looks, 0.0))
    costs = jnp.concatenate([made.costs, jnp.where(own.found | downhill, jnp.inf, cost)])
    kept = jnp.argsort(costs)[: strategy.PLACES]
    places = jnp.concatenate([made.places, at.best])[kept]
    return Found(posture, squares, least, steep, looks, (won < together) * 1.0, places, costs[kept])


def search(of: Given, phase: Phase, made: Found, pose, near, wanted) -> Found:
    """The tries of a phase, until one arrives or seeds or budget are used up; none where it is not `wanted`."""
    fresh = wanted & (phase.done == 0)
    made = made._replace(cost=jnp.where(fresh, jnp.inf, made.cost))
    made = choose(fresh & (phase.downhill == 0), nothing((), len(made.q), pose.dtype, jnp), made)

    def goes_on(carry):
        k, made = carry
        return wanted & (made.found == 0) & (k < phase.tries) & ((k < strategy.PLAIN) | (made.looks < phase.budget))

    def once(carry):
        k, made = carry
        return k + SIDE_BY_SIDE, tries(of, phase, made, pose, near, k, SIDE_BY_SIDE)

    return lax.while_loop(goes_on, once, (phase.done, made))[1]


def concluded(of: Given, pose, near, made: Found, done) -> SoFar:
    """The result of all phases for a target, after its first tries."""
    asked, dtype = of.asked, pose.dtype
    table = phases(asked, jnp)
    table[0] = table[0]._replace(done=done)
    table = jax.tree.map(lambda *rows: jnp.stack(jnp.broadcast_arrays(*map(jnp.asarray, rows))), *table)
    table = jax.tree.map(lambda v: v.astype({"f": dtype, "i": np.int32, "b": bool}[v.dtype.kind]), table)
    known, far = asked.finite(pose, near, jnp), asked.too_far(pose, jnp)
    count = len(table.done)

    def once(carry):
        p, so_far = carry
        phase = jax.tree.map(lambda v: v[p], table)
        beyond = phase.status > 0
        which = wanted(phase, so_far, known, far, jnp)
        found = search(of, phase, choose(beyond, so_far.beyond, so_far.made), pose, near, which)
        made, there = choose(beyond, so_far.made, found), choose(beyond, found, so_far.beyond)
        sure = jnp.where(p == 1, asked.sure(made.looks) & ~far, so_far.sure)
        said = asked.meaning(phase.status, there.found != 0, there.squares, jnp)
        return p + 1, SoFar(made, there, sure, jnp.where(beyond & which, said, so_far.why).astype(np.int32))

    def goes_on(carry):
        p, so_far = carry
        return (p < count) & (so_far.made.found == 0) & (so_far.why == 0) & known

    start = SoFar(made, made, jnp.zeros((), bool), jnp.int32(0))
    return lax.while_loop(goes_on, once, (jnp.int32(0), start))[1]
