"""The search within a program of the user's own: the same stages and groups of tries as a pure function."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik import errors
from cnclik.engine.native import native
from cnclik.law import dense
from cnclik.law.inverse import tiny_shift
from cnclik.reaching.asked import Asked
from cnclik.reaching.descent import attempt, look
from cnclik.reaching.result import ReachStatus, row_of, touching
from cnclik.reaching.search import ROUND, Stage, advanced, nothing, stages, wanted
from cnclik.reaching.starts import Starts, empty, starts_of, turned
from cnclik.record import replace

LEAST = 64  # smallest tolerance, in roundings
_attempt = native(attempt)


def traced(asked: Asked, pose, near):
    """Return the row of a target (t,), near (n,) or None."""
    known = all(map(errors.concrete, jax.tree.leaves(asked.chain)))
    starts = starts_of(asked.chain, asked.task) if known else empty(asked.chain, asked.task)
    chain, pose_, near_ = lax.stop_gradient((asked.chain, pose, near))
    lower, upper = (tuple(np.array(limits, float).tolist()) for limits in (asked.chain.lower, asked.chain.upper))
    chain = replace(chain, lower=lower, upper=upper)  # arrays would be tracers
    least = LEAST * float(jnp.finfo(pose.dtype).eps)
    of = replace(asked, chain=chain, tolerance=np.maximum(asked.tolerance, least * asked.scale))
    finite, far = of.finite(pose_, near_, jnp), of.too_far(pose_, jnp)
    rows, why = _searched(of, starts, pose_, near_, finite, far)
    row = row_of(rows, asked.chain.n)
    low, high = of.terms(xp=jnp).box(0.0 if near is None else near_)
    held = touching(chain, row.q) & of.limits | (row.q <= low) | (row.q >= high)
    q = refined(asked.chain, asked.task, pose, row.q, held, row.status == ReachStatus.SOLVED)
    return of.concluded(jnp.concatenate([q, rows[asked.chain.n :]]), finite, why, far, xp=jnp)


def _searched(asked, starts, pose, near, finite, far):
    """Return the row of what was found, and what a search beyond limits or jump means."""
    chain, task, n, dtype = asked.chain, asked.task, asked.chain.n, pose.dtype
    every = stages(asked, jnp)
    table = jax.tree.map(lambda *v: jnp.stack([jnp.asarray(x) for x in v]), *every)
    table = jax.tree.map(lambda v: v.astype({"f": dtype, "i": np.int32, "b": bool}[v.dtype.kind]), table)
    there = jnp.full(n, jnp.nan, dtype) if near is None else near
    inside = near if near is None else turned(near, near, np.array(chain.periodic), *asked.limited(), jnp)
    starts, none = Starts(*map(jnp.asarray, starts)), nothing((), n, jnp, dtype)

    def tried(terms, given, away, k, most):
        one = functools.partial(_attempt, chain, task, starts, terms, pose, there)
        return jax.vmap(one)(given.astype(dtype), away.astype(dtype), k, most.astype(jnp.int32))

    def once(carry):
        (p, k), found, kept, why = carry
        stage = Stage(*jax.tree.map(lambda v: v[p], table))
        aside = stage.status > 0
        want = wanted(asked, stage, row_of(kept, n), far, why, jnp)
        stage = stage._replace(last=jnp.where(want, stage.last, 0))  # nothing is tried then
        found = advanced(stage, found, k + jnp.arange(ROUND, dtype=jnp.int32), inside, tried, xp=jnp)
        over = (row_of(found.rows, n).status == ReachStatus.SOLVED) | (k + ROUND >= stage.last)
        meaning = asked.meaning(stage.status, found.rows, found.costs.min(), jnp)
        why = jnp.where(aside & over & want, meaning, why).astype(np.int32)
        kept, following = jnp.where(aside, kept, found.rows), jnp.minimum(p + 1, len(every) - 1)
        afresh = over & (table.status[following] > 0)
        found = jax.tree.map(lambda new, old: jnp.where(afresh, new, old), none, found)
        return (p + over, jnp.where(over, table.first[following], k + ROUND)), found, kept, why

    def goes_on(carry):
        (p, _), _, kept, why = carry
        return (p < len(every)) & (row_of(kept, n).status != ReachStatus.SOLVED) & finite & (why == 0)

    _, _, kept, why = lax.while_loop(goes_on, once, ((jnp.int32(0), jnp.int32(0)), none, none.rows, jnp.int32(0)))
    return kept, why


def refined(chain, task, target, q, held, found):
    """Return q with the derivative that the implicit function theorem gives it: dq = J# de of the joints that are free.

    Where there is no answer the derivative is 0.
    """
    q, held, held_chain, held_target = lax.stop_gradient((q, held, chain, target))
    e, _, _ = look(chain, task, q, target)
    # not J: where a task leaves some axes of the turn free, what is left about these turns the others with it
    j = jnp.where(held, 0.0, -jax.jacfwd(lambda v: look(held_chain, task, v, held_target)[0])(q))
    step = dense.cholesky_solve(dense.cholesky(dense.shifted(j @ j.T, tiny_shift(j))), e) @ j
    return q + jnp.where(found, step - lax.stop_gradient(step), 0.0)
