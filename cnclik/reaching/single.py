"""The search for one target as a pure function: what a single call runs, and what jit, vmap and grad go through.

A handful of seeds step side by side, carefully, until one arrives; then others. Where none does, the same is tried
without limits, to tell what is out of reach from what only the limits forbid.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.hints import as_here, quick_jit
from cnclik.law import dense
from cnclik.law.inverse import tiny_shift
from cnclik.reaching.asked import TOUCHING
from cnclik.reaching.programs import filled
from cnclik.reaching.result import Reached, ReachStatus, as_rows, fields, from_rows, width
from cnclik.reaching.seeds import SETS, SIZE, STRETCHES, compared, nearest_each, seeds, spans, starts, turned
from cnclik.reaching.step import begin, in_parts, iterate, look
from cnclik.record import cast, kept, placed, replace
from cnclik.robot.model import frames, jacobian_rows, modelled
from cnclik.robot.posture import evenly, start_posture
from cnclik.threads import side_by_side

TOGETHER = 8  # seeds side by side
STEPS = 40  # of a round, at most
BLOCK = 32  # targets that one call answers, one after the other
DOWNHILL, CLOSE = 3, 0.02  # rounds from the best place found, and from so far about it, of the way to other seeds
ROUNDS_FAR = 3  # where the target is farther off than the arm is long
FAR = np.asarray(1e3)  # [rad, m] of no jump
AROUND = 0.3  # of the range of seeds, about `near`


def each(asked, pose, near, progress=None):
    """Answers for some targets (B, 12), one by one: in blocks, on all cores."""
    rows = np.empty((len(pose), width(asked.chain.n)))

    def block(k):
        count = len(pose[k : k + BLOCK])
        own = None if near is None else filled(near[k : k + BLOCK], BLOCK)
        rows[k : k + count] = _block(*shared, filled(pose[k : k + BLOCK], BLOCK), own, np.int32(count))[:count]
        return count

    with jax.enable_x64(True):
        shared = _shared(asked)
        if len(pose) == 1:
            rows[0] = _program(*shared, pose[0], None if near is None else near[0])
            return from_rows(asked.chain, asked.task, rows)
        with side_by_side(1) as pool:  # LAPACK, see `cnclik.hints.shares_threads`
            done = 0
            for count in pool.map(as_here(block), range(0, len(pose), BLOCK)):
                done += count
                if progress is not None:
                    progress(done, len(pose))
    return from_rows(asked.chain, asked.task, rows)


def along(asked, pose, progress=None):
    """Answers for the targets of a path, each from the answer before it; where there was none, from the last one."""
    rows, at = np.empty((len(pose), width(asked.chain.n))), start_posture(asked.chain, asked.task)
    with jax.enable_x64(True):
        shared = _shared(asked)
        for k in range(0, len(pose), BLOCK):
            count = len(pose[k : k + BLOCK])
            at, made = _path(*shared, filled(pose[k : k + BLOCK], BLOCK), at, np.int32(count), np.bool_(k == 0))
            rows[k : k + count] = made[:count]
            if progress is not None:
                progress(k + count, len(pose))
    return from_rows(asked.chain, asked.task, rows)


def _shared(asked):
    """What is asked, seeds, and what they are to the task, on JAX's device; kept for the next call."""
    task, name = asked.task, f"_seeds_of_{asked.task.position}_{bool(asked.task.orientation)}"
    return placed(asked), *kept(
        asked.chain, name, lambda chain: jax.device_put((seeds(chain).postures, compared(seeds(chain), task)))
    )


def traced(asked, pose, near):
    """Answers for (B, 12) targets as part of another program."""
    if all(map(errors.concrete, jax.tree.leaves(asked.chain))):
        postures, to = seeds(asked.chain).postures, compared(seeds(asked.chain), asked.task)
    else:  # where their tips are depends on what is traced
        low, high = spans(asked.chain)
        postures, to = low + (high - low) * evenly(SETS * SIZE, asked.chain.n), None

    def one(pose, near):
        return _answer(asked, pose, near, postures, to, derivative=True)

    made = jax.vmap(one, (0, None if near is None else 0))(pose, near)
    return Reached(**made, chain=asked.chain, task=asked.task)


def _answer(asked, pose, near, postures, to, derivative=False):
    """Fields of the record of one target (12,)."""
    dtype = pose.dtype
    held = lax.stop_gradient((asked.chain, pose, near))
    tolerance = jnp.maximum(jnp.asarray(asked.tolerance, dtype), 64 * float(jnp.finfo(dtype).eps))
    asked = replace(asked, tolerance=tolerance)
    made, bounds, sure = _search(replace(asked, chain=held[0]), *held[1:], jnp.asarray(postures, dtype), to)
    q = made.q
    if derivative:
        held = (q <= bounds[0] + TOUCHING) | (q >= bounds[1] - TOUCHING)
        q = refined(asked.chain, asked.task, pose, q, held, made.found)
    found = asked.reached(pose, near, q, made.squares, made.steep, made.looks, made.found, sure, made.why, xp=jnp)
    return fields(found)


def _row(of):
    """One target's fields as one vector: a program with one result is sooner called than one with seven."""
    return as_rows({name: jnp.asarray(v, of["q"].dtype) for name, v in of.items()}, jnp)


def _target(asked, postures, to, pose, near):
    return _row(_answer(asked, pose, near, postures, to))


def _targets(asked, postures, to, poses, near, count):
    """What `_target` gives for the first `count` of some targets (K, 12)."""

    def one(i, rows):
        return rows.at[i].set(_target(asked, postures, to, poses[i], None if near is None else near[i]))

    return lax.fori_loop(0, count, one, jnp.zeros((len(poses), width(asked.chain.n)), poses.dtype))


def _waypoints(asked, postures, to, poses, at, count, begins):
    """The last answer, and what `_target` gives for the first `count` of some waypoints (K, 12), from `at` on.

    Args:
      begins: whether they begin the path: what is nearest to the first waypoint is not held to `jump`.
    """

    def one(i, carry):
        at, rows = carry
        mine = asked
        if asked.jump is not None:
            mine = replace(asked, jump=jnp.where(begins & (i == 0), FAR, asked.jump))
        row = _answer(mine, poses[i], at, postures, to)
        at = jnp.where(row["status"] <= int(ReachStatus.ACCEPTED), row["q"], at)
        return at, rows.at[i].set(_row(row))

    return lax.fori_loop(0, count, one, (at, jnp.zeros((len(poses), width(len(at))), at.dtype)))


_program, _block, _path = map(quick_jit, (_target, _targets, _waypoints))


def _search(asked, pose, near, postures, to):
    """The outcome, the bounds that it kept, and whether what was tried is enough to say that there is no answer."""
    dtype = pose.dtype
    bounds = tuple(jnp.asarray(b, dtype) for b in asked.bounds(near, jnp))
    ends, far = spans(asked.chain), asked.too_far(pose, jnp)
    beyond = [(status, own, jnp.where(far, 0, _rounds(tries))) for status, own, tries in asked.beyond()]
    if near is not None:
        middle = np.mean(ends, axis=0)  # known while tracing
        first = near + AROUND * (postures[:TOGETHER] - middle).at[0].set(0.0)
        first = turned(first, near, asked.periods, *bounds, jnp)
    elif to is None:
        first = postures[:TOGETHER]
    else:
        first = postures[nearest_each(to, pose, TOGETHER, asked.seed)]
    task, roots = asked.unweighted(jnp)
    roots = None if roots is None else roots.astype(dtype)
    own = _rounds(asked.seeds)
    longer = [(less, _rounds(before) - own, _rounds(tries) - own) for less, before, tries in asked.longer()]
    most = jnp.where(far, ROUNDS_FAR, own), longer, asked.budget, asked.seed

    def placed(seed, low, high, r):
        stretch = np.resize(STRETCHES, TOGETHER)
        return starts(seed, near, asked.periods, ends, low, high, jnp.where(r * TOGETHER >= SETS, stretch, 1.0), jnp)

    def hard(squares, tried, less):
        return asked.close(squares, less) & asked.sure(tried) & ~far

    meaning = functools.partial(asked.meaning, xp=jnp)
    given = asked.tolerance, postures, placed, first, most, hard, roots
    made = outcome(asked.chain, task, pose, bounds, beyond, meaning, *given)
    return made, bounds, asked.sure(made.tried)


def _rounds(tries):
    return -(-tries // TOGETHER)


class Outcome(NamedTuple):
    """What the search for one target came to."""

    q: object  # (n,) the answer, or the nearest posture found
    squares: object  # (2,) squared errors there
    steep: object  # gradient there, see `step.Search`
    looks: object
    tried: object  # looks of the rounds of seeds
    found: object  # within the bounds
    why: object  # what the searches of `Asked.beyond` say, see `Asked.meaning`


def outcome(
    chain, task, target, bounds, beyond, meaning, tolerance, postures, placed, first, most, hard, roots
) -> Outcome:
    """Search for a target (12,).

    Args:
      bounds: lower and upper (n,) to keep. beyond: (status, bounds, rounds) of the searches that tell why there is no
        answer. meaning: `Asked.meaning`.
      postures: (K, n) to start later rounds from, by placed(postures, low, high, round). first: (TOGETHER, n).
      roots: of the weights by which the nearest pose is the nearest, or None.
      most: rounds of seeds; (what is missed by less, others before, others in all), which follow where
        hard(squared errors, looks, less) is true; looks; number of the first seeds.
    """
    dtype = target.dtype
    chain, parts = cast(modelled(chain), dtype), in_parts(target)
    rounds, longer, budget, seed = most
    bottom = rounds + DOWNHILL
    last = bottom + (longer[-1][-1] if longer else 0)
    phases = [(0, bounds, last, last)]  # status, bounds, and where they begin and end
    for status, own, count in beyond:
        phases.append((int(status), own, phases[-1][-1], phases[-1][-1] + count))

    def phase(r, values):
        """The value of the bounds that are searched in round r."""
        found = values[0]
        for value, (*_, begins, _) in zip(values[1:], phases[1:], strict=True):
            found = jnp.where(r >= begins, value, found)
        return found

    def begins(r):
        """Whether a search of `beyond` begins with round r."""
        return functools.reduce(jnp.logical_or, [r == at for *_, at, _ in phases[1:]], r < 0)

    def again(carry):
        r, kept, _, why = carry
        wide = r >= last
        down = (r >= rounds) & (r < bottom)
        low, high = (phase(r, [jnp.asarray(own[side], dtype) for _, own, _, _ in phases]) for side in (0, 1))
        number = (r * 37 + seed * 41) * TOGETHER % (len(postures) - TOGETHER)
        others = lax.dynamic_slice_in_dim(postures, number, TOGETHER)
        begin_at = jnp.where((r == 0) | begins(r), first, placed(others, low, high, r))
        begin_at = jnp.where(down, kept[0] + CLOSE * (begin_at - kept[0]).at[0].set(0.0), begin_at)
        begin_at = jnp.clip(begin_at, low, high)
        own = None if roots is None else jnp.where(down, roots, 1.0)
        at = _together(chain, task, begin_at, parts, low, high, tolerance, own)
        q = at.best
        k = jnp.argmin(jnp.where(at.arrived, -1.0, jnp.where(jnp.isfinite(at.cost), at.cost, jnp.inf)))
        new = q[k], at.squares[k], at.cost[k], at.steep[k]
        better = ~wide & ((r < bottom) & (new[2] < kept[2]) | at.arrived[k] | (r == rounds))
        looks = kept[4] + jnp.sum(at.looks)
        tried = jnp.where(r < rounds, looks, kept[5])
        kept = (*(jnp.where(better, a, b) for a, b in zip(new, kept[:4], strict=True)), looks, tried)
        spent = (r < rounds) & (looks >= budget)
        said = meaning(phase(r, [jnp.int32(status) for status, *_ in phases]), at.arrived[k], at.squares[k])
        why = jnp.where(wide & (at.arrived[k] | (why == 0)), said, why)
        easy = r < 0
        for less, before, _ in longer:
            easy |= (r == bottom + before - 1) & ~hard(kept[1], kept[-1], less)
        return jnp.where(spent, rounds, jnp.where(easy, last, r + 1)), kept, at.arrived[k] & ~wide, why

    far, none = jnp.full((), jnp.inf, dtype), jnp.zeros((), dtype)
    start = jnp.clip(first[0], *bounds), jnp.full(2, jnp.inf, dtype), far, far, none, none

    def goes_on(carry):
        r, _, found, why = carry
        unsure = (why == int(ReachStatus.OUT_OF_BUDGET)) & ~begins(r)  # another try may find the answer
        return ~found & ((why == 0) | unsure) & (r < phases[-1][-1])

    ended = lax.while_loop(goes_on, again, (jnp.zeros_like(rounds), start, jnp.zeros((), bool), jnp.int32(0)))
    _, (q, squares, _, steep, looks, tried), found, why = ended
    return Outcome(q, squares, steep, looks, tried, found, why)


def _together(chain, task, starts, target, low, high, tolerance, roots):
    """Steps of some seeds side by side, until one has arrived."""

    def once(carry):
        i, at = carry
        step = jax.vmap(lambda at: iterate(chain, task, at, target, (low, high), tolerance, jnp.ones((), bool), roots))
        return i + 1, step(at)

    def goes_on(carry):
        i, at = carry
        return (i < STEPS) & ~jnp.any(at.arrived)

    start = jnp.zeros((), jnp.int32), jax.vmap(lambda q: begin(q, q[0] * 0.0))(starts)
    return lax.while_loop(goes_on, once, start)[1]


def refined(chain, task, target, q, held, found):
    """q with the derivative that the implicit function theorem gives it: dq = J# de of the joints that are free.

    The value stays. Of what the target and the chain's geometry do to the error, J# of the joints that no limit holds
    makes joint motion: the least, where the arm is redundant. Where there is no answer the derivative is 0.
    """
    q, held = lax.stop_gradient((q, held))
    chain = cast(modelled(chain), q.dtype)
    held_chain, held_target = lax.stop_gradient((chain, target))
    e, _ = look(chain, task, q, in_parts(target))
    if 0 < len(task.angular) < 3:  # what is left of the turn about other axes turns these with it
        rows = -jax.jacfwd(lambda v: look(held_chain, task, v, in_parts(held_target))[0])(q)
    else:
        rows = jacobian_rows(held_chain, frames(held_chain, q), task.linear, task.angular)
    rows = jnp.where(held, 0.0, rows)
    step = dense.cholesky_solve(dense.cholesky(dense.shifted(rows @ rows.T, tiny_shift(rows))), e) @ rows
    return q + jnp.where(found, step - lax.stop_gradient(step), 0.0)
