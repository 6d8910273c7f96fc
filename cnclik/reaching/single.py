"""Answers in JAX: inside other programs, with derivatives, and as programs for systems without a compiler."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.cache import bounded_jit
from cnclik.engine.native import native
from cnclik.engine.plan import as_here, in_c
from cnclik.integrate.lanes import tiled
from cnclik.law import dense
from cnclik.law.inverse import tiny_shift
from cnclik.reaching.asked import TOUCHING
from cnclik.reaching.result import Reached, ReachStatus, as_rows, fields, from_rows, width
from cnclik.reaching.search import Found, concluded, given, nothing, tries
from cnclik.reaching.seeds import SETS, SIZE, compared, nearest, seeds, spans
from cnclik.reaching.step import in_parts, look
from cnclik.reaching.strategy import CAREFUL, FAR, PLAIN, alone, narrowed, phases
from cnclik.reaching.targets import aims, told_apart
from cnclik.record import cast, memoized, on_device, replace
from cnclik.robot.model import modelled
from cnclik.robot.posture import evenly, start_posture
from cnclik.task.parts import At
from cnclik.task.task import rows
from cnclik.threads import cores, side_by_side

PER_CALL = 32  # number of targets per call, one after the other
HARD = 200  # targets without an answer after sixteen tries, from which on further ones have a quick program, too
ONE_BY_ONE = 2000, 128  # targets, at most, that are sooner searched for so; and of a chain that is asked of often
CAPACITY, TILE = 1024, 64  # targets of a call that makes their first tries side by side


def traced(asked, pose, near):
    """Answers for (B, t) targets as part of another program."""
    if all(map(errors.concrete, jax.tree.leaves(asked.chain))):
        postures, to = seeds(asked.chain).postures, compared(asked.chain, asked.task)
    else:  # where their tips are depends on what is traced
        low, high = spans(asked.chain)
        postures, to = low + (high - low) * evenly(SETS * SIZE, asked.chain.n), None

    def one(pose, near):
        made = nothing((), asked.chain.n, pose.dtype, jnp)
        by = native if in_c() else None  # the iteration runs in C where there is a compiler
        return answer(asked, postures, to, pose, near, made, jnp.int32(0), by, derivative=True)

    made = jax.vmap(one, (0, None if near is None else 0))(pose, near)
    return Reached(**made, chain=asked.chain, task=asked.task)


def answer(asked, postures, to, pose, near, made, done, by=None, derivative=False) -> dict:
    """Fields of the record of one target, of which so many tries have been `made`; by: as `search.given` has it."""
    dtype = pose.dtype
    chain, held_pose, held_near = lax.stop_gradient((asked.chain, pose, near))
    of = given(replace(asked, chain=chain), postures, to, dtype, by)
    made, _, sure, why = concluded(of, held_pose, held_near, made, done)
    q, found = made.q, made.found != 0
    if derivative:
        low, high, jump = (jnp.asarray(v, dtype) for v in phases(asked, jnp)[0][:3])
        low, high = narrowed(low, high, jump, held_near, jnp)
        held = (q <= low + TOUCHING) | (q >= high - TOUCHING)
        q = refined(asked.chain, asked.task, pose, q, held, found)
    asked = replace(asked, tolerance=of.asked.tolerance)
    return fields(asked.reached(pose, near, q, made.squares, made.steep, made.looks, found, sure, why, xp=jnp))


def refined(chain, task, target, q, held, found):
    """q with the derivative that the implicit function theorem gives it: dq = J# de of the joints that are free.

    The value stays. Of what the target and the chain's geometry do to the error, J# of the joints that no limit holds
    makes joint motion: the least, where the arm is redundant. Where there is no answer the derivative is 0.
    """
    q, held = lax.stop_gradient((q, held))
    chain = cast(modelled(chain), q.dtype)
    held_chain, held_target = lax.stop_gradient((chain, target))
    e, _ = look(chain, task, q, in_parts(task, target))
    some = any(len(aim.angular) in (1, 2) for aim in aims(task))  # what is left about other axes turns these with it
    if some:
        j = -jax.jacfwd(lambda v: look(held_chain, task, v, in_parts(task, held_target))[0])(q)
    else:
        j = rows(task, At(held_chain, q))
    j = jnp.where(held, 0.0, j)
    step = dense.cholesky_solve(dense.cholesky(dense.shifted(j @ j.T, tiny_shift(j))), e) @ j
    return q + jnp.where(found, step - lax.stop_gradient(step), 0.0)


# --- without a compiler ----------------------------------------------------------------------------------


def _rows(asked, postures, to, pose, near, made, done, count, at=None, begins=False, by=None):
    """The rows of the record for the first `count` of some targets (K, t), and the last answer.

    Args:
      made: what so many tries came to for each (`done`).
      at: joint values to begin at, of a path: each target's answer is searched for from the one before it. begins:
        whether they begin the path: what is nearest to the first waypoint is not held to `jump`.
      by: as `search.given` has it. With `native` hard targets take a tenth of the time, and compiling twice.
    """

    def one(i, carry):
        at, rows = carry
        mine, about = asked, at if near is None else near[i]
        if at is not None and asked.jump is not None:
            mine = replace(asked, jump=jnp.where(begins & (i == 0), FAR, asked.jump))
        row = answer(mine, postures, to, pose[i], about, jax.tree.map(lambda v: v[i], made), done, by)
        if at is not None:
            at = jnp.where(row["status"] <= int(ReachStatus.ACCEPTED), row["q"], at)
        row = {name: jnp.asarray(v, pose.dtype) for name, v in row.items()}
        return at, rows.at[i].set(as_rows(row, jnp))

    return lax.fori_loop(0, count, one, (at, jnp.zeros((len(pose), width(asked.chain.n)), pose.dtype)))


def _one_try(asked, postures, phase, made, pose, near, number, seed, count, by=None):
    """What the try of its own number, from its own seed, comes to for each of the first `count` of many targets.

    Args: by: as `search.given` has it. With `native` it runs in a twentieth of the time, and compiles in three times.
    """
    of = given(asked, postures, None, pose.dtype, by)

    def one(phase, made, pose, number, seed, *near):
        return tries(of._replace(nearest=lambda *_: seed), phase, made, pose, *(near or (None,)), number, 1)

    phase = jax.tree.map(lambda v: jnp.broadcast_to(v, (len(pose), *jnp.shape(v))), phase)
    return tiled(one, TILE, phase, made, pose, number, seed, *(() if near is None else (near,)), count=count)


_some = bounded_jit(_rows, static_argnames="by")
batch = bounded_jit(_one_try, static_argnames="by")


class Programs:
    """The search by JAX's programs, on all cores."""

    def __init__(self, asked, soon):
        """Args: soon: whether the chain is used so often that the fastest program is worth compiling."""
        task, chain = asked.task, asked.chain
        name = f"_seeds_of_{told_apart(task)}"
        self.asked, self.soon, self.first, self.hard = asked, soon, phases(asked)[0], 0
        with jax.enable_x64(True):
            self.shared = (
                on_device(asked),
                *memoized(chain, name, lambda chain: jax.device_put((seeds(chain).postures, compared(chain, task)))),
            )

    def reached(self, pose, near, progress=None) -> Reached:
        """Answers for (B, t) targets, near (B, n) or None."""
        asked, B, n = self.asked, len(pose), self.asked.chain.n
        made, left, rows, done = nothing((B,), n), np.arange(B), np.empty((B, width(n))), 0

        def search(ids):
            own = None if near is None else filled(near[ids], PER_CALL)
            some = Found(*(filled(v[ids], PER_CALL) for v in made))
            given = filled(pose[ids], PER_CALL), own, some, np.int32(done), np.int32(len(ids))
            by = native if self.hard > HARD else None
            rows[ids] = np.asarray(_some(*self.shared, *given, by=by)[1])[: len(ids)]

        if ONE_BY_ONE[self.soon] < B:
            which, done = asked.finite(pose, near) & (asked.downhill | ~asked.too_far(pose)), int(self.first.tries)
            with jax.enable_x64(True), side_by_side(1) as beside:
                beside.submit(as_here(search), left[:0])  # compiled, until it is needed for those that are left
                for k in range(done):
                    goes_on = which & (made.found == 0) & ((k < PLAIN) | (made.looks < asked.budget))
                    self._try(made, pose, near, np.flatnonzero(goes_on), self.first, np.full(B, k))
                    if progress is not None:
                        progress(int(made.found.sum()), B)
            q, squares, _, steep, looks, found, *_ = made
            rows[:] = as_rows(fields(asked.reached(pose, near, q, squares, steep, looks, found != 0, np.False_, 0)))
            left = np.flatnonzero(found == 0)
            self.hard += len(left)
        _on_all_cores(search, left, PER_CALL, progress and (lambda count: progress(B - len(left) + count, B)))
        return from_rows(asked.chain, asked.task, rows)

    def along(self, pose, progress=None) -> Reached:
        """Answers for the targets of a path, each from the last answer before it."""
        chain, task = self.asked.chain, self.asked.task
        rows, at = np.empty((len(pose), width(chain.n))), start_posture(chain, task)
        made, done = nothing((PER_CALL,), chain.n), np.int32(0)
        with jax.enable_x64(True):
            for k in range(0, len(pose), PER_CALL):
                count = len(pose[k : k + PER_CALL])
                given = (
                    filled(pose[k : k + PER_CALL], PER_CALL),
                    None,
                    made,
                    done,
                    np.int32(count),
                    at,
                    np.bool_(k == 0),
                )
                at, found = _some(*self.shared, *given)
                rows[k : k + count] = found[:count]
                if progress is not None:
                    progress(k + count, len(pose))
        return from_rows(chain, task, rows)

    def tried(self, pose, near, number, wide=False) -> Found:
        """The result of one try, of number (B,), for each of (B, t) targets. `wide`: without bounds."""
        made = nothing((len(pose),), self.asked.chain.n)
        self._try(made, pose, near, np.arange(len(pose)), alone(self.first, wide), number)
        return made

    def descended(self, pose, near, start) -> Found:
        """The result of a careful search from one posture (B, n) for each of (B, t) targets."""
        made = nothing((len(pose),), self.asked.chain.n)
        made.places[:, 0], made.costs[:, 0] = start, 0.0
        self._try(made, pose, near, np.arange(len(pose)), self.first._replace(downhill=CAREFUL), np.zeros(len(pose)))
        return made

    def _try(self, made, pose, near, ids, phase, number):
        """One try, of its own number (B,), for some of the targets."""
        phase, number = phase._replace(tries=phase.budget), number.astype(np.int32)
        to = compared(self.asked.chain, self.asked.task)

        def one_try(some):
            own = None if near is None else filled(near[some])
            which = number[some] + int(self.asked.seed)
            seed = np.empty((len(some), len(to.factors)), np.int32)
            for k in np.unique(which % SETS):
                seed[which % SETS == k] = nearest(to, pose[some[which % SETS == k]], k, np)
            of = Found(*(filled(v[some]) for v in made)), filled(pose[some]), own, filled(number[some]), filled(seed)
            found = batch(*self.shared[:2], phase, *of, np.int32(len(some)), by=native if self.soon else None)
            for whole, part in zip(made, found, strict=True):
                whole[some] = np.asarray(part)[: len(some)]

        size = min(CAPACITY, max(-(-len(ids) // cores()), PER_CALL))
        _on_all_cores(one_try, ids, size)


def _on_all_cores(fn, ids, size, progress=None):
    """fn of so many of some targets at a time. Args: progress: told of how many it has been."""
    parts = [ids[i : i + size] for i in range(0, len(ids), size)]
    with jax.enable_x64(True), side_by_side() as pool:
        for k, _ in enumerate(pool.map(as_here(fn), parts), 1):
            if progress is not None:
                progress(min(k * size, len(ids)))


def filled(rows, size=CAPACITY):
    if len(rows) == size:
        return rows
    out = np.zeros((size, *rows.shape[1:]), rows.dtype)
    out[: len(rows)] = rows
    return out
