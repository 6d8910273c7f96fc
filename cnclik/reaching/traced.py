"""The search within a program of the user's own: the same stages and groups of tries as a pure function."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.engine.native import native
from cnclik.law import dense
from cnclik.law.inverse import tiny_shift
from cnclik.reaching.asked import SURE, Asked
from cnclik.reaching.descent import attempt, look, starts_of
from cnclik.reaching.result import ReachStatus, row_of
from cnclik.reaching.search import ANEW, ROUND, Found, Stage, advanced, begins_anew, nothing, stages, wanted
from cnclik.reaching.starts import Starts, empty, turned
from cnclik.reaching.units import per_unit
from cnclik.record import replace
from cnclik.task.task import aims

LEAST = 64  # smallest tolerance, in roundings
_attempt = native(attempt)


def traced(asked: Asked, pose, near):
    """Return the rows of targets (B, t), near (B, n) or None."""
    known = all(map(errors.concrete, jax.tree.leaves(asked.chain)))
    starts = starts_of(asked.chain, asked.task) if known else empty(asked.chain, asked.task)
    return jax.vmap(lambda pose, near: _answer(asked, starts, pose, near), (0, None if near is None else 0))(pose, near)


def _answer(asked, starts, pose, near):
    dtype = pose.dtype
    chain, pose_, near_ = lax.stop_gradient((asked.chain, pose, near))
    least = LEAST * float(jnp.finfo(dtype).eps)
    of = replace(asked, chain=chain, tolerance=np.maximum(asked.tolerance, least * asked.scale))
    made, sure, why, far = _searched(of, starts, pose_, near_)
    row = row_of(made.rows, asked.chain.n)
    low, high = of.terms(xp=jnp).box(0.0 if near is None else near_)
    touching = row.at_limit.astype(bool) | (row.q <= low) | (row.q >= high)
    q = refined(asked.chain, asked.task, pose, row.q, touching, row.status == ReachStatus.SOLVED)
    rows = jnp.concatenate([q, made.rows[asked.chain.n :]])
    return of.concluded(rows, of.finite(pose_, near_, jnp), sure, why, far, xp=jnp)


def _searched(asked, starts, pose, near):
    """Return what was found, whether enough was tried, what that means, and whether the target is too far."""
    chain, task, n, dtype = asked.chain, asked.task, asked.chain.n, pose.dtype
    every = stages(asked, jnp)
    table = jax.tree.map(lambda *v: jnp.stack([jnp.asarray(x) for x in v]), *every)
    table = jax.tree.map(lambda v: v.astype({"f": dtype, "i": np.int32, "b": bool}[v.dtype.kind]), table)
    finite, far = asked.finite(pose, near, jnp), asked.too_far(pose, jnp)
    inside = None if near is None else turned(near, near, np.array(chain.periodic), *asked.limited(), jnp)
    nowhere, starts, seed = jnp.full(n, jnp.nan, dtype), Starts(*map(jnp.asarray, starts)), jnp.int32(asked.seed)

    def tried(terms, given, away, k, most):
        def one(given, away, k, most):
            there = nowhere if near is None else near
            return _attempt(chain, task, starts, terms, pose, there, given, away, k, most, seed)

        given = jnp.broadcast_to(given, (len(k), n)).astype(dtype)
        return jax.vmap(one)(given, away.astype(dtype), k, jnp.broadcast_to(most, k.shape).astype(jnp.int32))

    def once(carry):
        (p, k), found, beyond, sure, why = carry
        stage = Stage(*jax.tree.map(lambda v: v[p], table))
        aside = stage.status > 0
        beyond = _choose(aside & ~stage.downhill & (k == 0), nothing((), n, jnp, dtype), beyond)
        made = _choose(aside, beyond, found)
        anew = ~stage.downhill & begins_anew(k) & (k % ANEW < ROUND)
        made = made._replace(costs=jnp.where(anew, jnp.inf, made.costs))
        want = wanted(asked, stage, found, beyond, far, sure, why, jnp)
        stage = stage._replace(last=jnp.where(want, stage.last, 0))  # nothing is tried then
        order = k + jnp.arange(ROUND, dtype=jnp.int32)
        made = _choose(want, advanced(stage, made, order, inside, tried, xp=jnp), made)
        found, beyond = _choose(aside, found, made), _choose(aside, made, beyond)
        row = row_of(made.rows, n)
        over = (row.status == ReachStatus.SOLVED) | (k + ROUND >= stage.last)
        sure = jnp.where((p == 1) & over, (asked.seeds >= SURE) & ~far, sure)
        why = jnp.where(aside & over & want, asked.meaning(stage.status, row, jnp), why).astype(np.int32)
        following = table.first[jnp.minimum(p + 1, len(every) - 1)]
        return (p + over, jnp.where(over, following, k + ROUND)), found, beyond, sure, why

    def goes_on(carry):
        (p, _), found, _, _, why = carry
        return (p < len(every)) & (row_of(found.rows, n).status != ReachStatus.SOLVED) & finite & (why == 0)

    none = nothing((), n, jnp, dtype)
    first = (jnp.int32(0), jnp.int32(0)), none, none, jnp.zeros((), bool), jnp.int32(0)
    _, found, _, sure, why = lax.while_loop(goes_on, once, first)
    return found, sure, why, far


def _choose(which, one: Found, other: Found) -> Found:
    return jax.tree.map(lambda one, other: jnp.where(which, one, other), one, other)


def refined(chain, task, target, q, held, found):
    """Return q with the derivative that the implicit function theorem gives it: dq = J# de of the joints that are free.

    The value stays. Of what the target and the chain's geometry do to the error, J# of the joints that no limit holds
    makes joint motion: the least, where the arm is redundant. Where there is no answer the derivative is 0.
    """
    q, held = lax.stop_gradient((q, held))
    held_chain, held_target = lax.stop_gradient((chain, target))
    e, _, _ = look(chain, task, q, target)
    if any(len(aim.angular) in (1, 2) for aim in aims(task)):  # what is left about other axes turns these with it
        j = -jax.jacfwd(lambda v: look(held_chain, task, v, held_target)[0])(q)
    else:
        j = look(held_chain, task, q, held_target)[1]
    j = jnp.where(held, 0.0, j)
    step = dense.cholesky_solve(dense.cholesky(dense.shifted(j @ j.T, tiny_shift(j))), e) @ j
    step = per_unit(chain) * step
    return q + jnp.where(found, step - lax.stop_gradient(step), 0.0)
