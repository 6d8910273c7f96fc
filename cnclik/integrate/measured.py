"""Measured: the loop as a robot runs it, its error measured with noise, late, and on geometry that the law lacks.

All three act through one number per step: the error that is fed back is the measured one, w[k] away from what the
law's own chain at q[k] would say. A step holds w[k], as a controller does that measures once per sample.
"""

import jax
import jax.numpy as jnp

from cnclik import errors
from cnclik.integrate.history import blank
from cnclik.integrate.solve import advance, cast, check_arguments, early_steps, evaluations_of
from cnclik.integrate.trajectory import Trajectory, assemble, instants
from cnclik.law.law import look
from cnclik.law.reference import check
from cnclik.law.shifted import shifted
from cnclik.record import replace
from cnclik.robot import spatial as sp
from cnclik.robot.rolled import in_form


def white_noise(sigma, N: int, m: int, seed=0):
    """(N, m) independent normal errors of a measurement, the same for the same seed.

    Args:
      sigma: standard deviation, a number or one per task coordinate (m,) [m, rad]; it may be traced, as may the seed.
    """
    sigma = errors.array("noise", sigma, (), (1,), (m,))
    if errors.concrete(sigma) and (sigma < 0).any():
        raise errors.fail("noise", "be at least 0", f"is {sigma.min():g}")
    errors.number("seed", seed, at_least=0)
    sigma = jnp.asarray(sigma)
    key = jax.random.key(jnp.asarray(seed).astype(jnp.uint32))
    return sigma * jax.random.normal(key, (N, m), sigma.dtype)


def _between(task, measured, model):
    """What a target is to be moved by so that its error is the measured one, and not the model's (m,)."""
    p = len(task.position)
    if len(task.orientation) < 3:
        return sp.vsub(measured, model)
    turn = sp.turn_from(sp.scale(-1.0, measured[p:]), sp.scale(-1.0, model[p:]))
    return sp.join(sp.vsub(measured[:p], model[:p]), turn)


def solve_measured(
    law, reference, q0, Ts, N: int, method, stage, *, delay: int = 0, noise=None, plant=None, gained=None
) -> Trajectory:
    """`solve` with a measured error: `e` is the true one, measured ones are only fed back. Pure.

    No step is marked GROWING: with noise an error grows and shrinks by chance.

    Args:
      law, reference, q0, Ts, N, method, stage: as for `solve`, and what it raises.
      delay: samples by which the measured error is late; before the first one is there it is taken as e[0].
      noise: (N, m) added to the measured error at each step [m, rad], or None.
      plant: the chain as it really is, the law's being a model of it; None: the same.
      gained: the law at time t, gained(law, t), where it changes; None: the same.
    """
    q0, method = check_arguments(law, reference, q0, Ts, method, stage)
    check(reference, law.task)
    if noise is not None:
        noise = errors.array("noise", noise, (N, law.task.m))
    delay, dtype, differs = errors.integer("delay", delay, at_least=0), q0.dtype, plant is not None
    law, q0 = in_form(law, q0)
    plant = in_form(plant, q0)[0] if differs else law.chain
    law, plant, reference, noise, Ts = cast((law, plant, reference, noise, Ts), dtype)
    true_law = replace(law, chain=plant)
    first = look(true_law, reference, jnp.zeros((), dtype), q0).e

    def one(starting, carry, k):
        q, past, history = carry
        t = k * Ts
        at = look(true_law, reference, t, q)
        late = (at.e, *past)
        measured = late[delay]
        if noise is not None:
            measured = sp.vadd(measured, sp.like(measured, noise[k.astype(int)]))
        model = look(law, reference, t, q).e if differs else at.e
        told = shifted(reference, law.task, _between(law.task, measured, model))
        length = jnp.where(k < N, Ts, 0.0)  # see `instants`
        now = law if gained is None else gained(law, t)
        made = advance(now, told, q, t, length, method, stage, history, starting=starting)
        return (made.q, late[:delay], made.history), replace(made, q=q, x=at.x(), e=at.e, history=None)

    k = jnp.arange(N + 1).astype(dtype)
    state = q0, (first,) * delay, blank(law, q0, method)
    found = instants(one, state, k, q0, law.task.m, early=early_steps(method, N))
    return assemble(k * Ts, found, evaluations_of(method, stage, law.chain.n, N))
