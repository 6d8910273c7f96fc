"""Rollout: the loop as a robot would run it, its error measured with noise, late, and on geometry the model lacks.

All three act through one number per step: the error that is fed back is the measured one, w[k] away from what the
model at q[k] would say. A step holds w[k], as a controller does that measures once per sample.
"""

import jax.numpy as jnp

from cnclik.integrate.history import blank
from cnclik.integrate.solve import advance, cast, early_steps, evaluations_of, solve
from cnclik.integrate.trajectory import Trajectory, assemble, instants
from cnclik.law.law import look
from cnclik.law.shifted import shifted
from cnclik.record import record, replace
from cnclik.robot import spatial as sp
from cnclik.robot.rolled import in_form
from cnclik.tuning.parameters import Adjustable, scheduled


@record
class Scenario:
    """One run that a tuning looks at.

    Attributes:
      reference, q0: as for `solve`.
      noise: (N, m) added to the measured error at each step [m, rad], or None.
      plant: the chain as it really is, the law's being a model of it; None: the same.
    """

    reference: object
    q0: object
    noise: object = None
    plant: object = None


def rollout(loop: Adjustable, scenario: Scenario, N: int, method, stage, *, delay: int = 0, horizon=None) -> Trajectory:
    """Run the loop for N steps; `e` is the true error, measured ones are only fed back. Pure, for jit, vmap and grad.

    Args:
      loop, scenario: what runs, and under which conditions.
      N, method, stage: as for `solve`.
      delay: samples by which the measured error is late; before the first one is there it is taken as e[0].
      horizon: [s] over which a gain schedule is spread, N·Ts by default.
    """
    differs = scenario.plant is not None
    if delay == 0 and loop.schedule is None and scenario.noise is None and not differs:
        return solve(loop.law, scenario.reference, scenario.q0, loop.Ts, N, method, stage)
    dtype = scenario.q0.dtype
    law, q0 = in_form(loop.law, scenario.q0)
    plant = in_form(scenario.plant, scenario.q0)[0] if differs else law.chain
    loop, plant, scenario = cast((replace(loop, law=law), plant, replace(scenario, plant=None)), dtype)
    law, reference, Ts = loop.law, scenario.reference, loop.Ts
    true_law = replace(law, chain=plant)
    horizon = N * Ts if horizon is None else horizon
    first = look(true_law, reference, jnp.zeros((), dtype), q0).e

    def one(starting, carry, k):
        q, past, history = carry
        t = k * Ts
        at = look(true_law, reference, t, q)
        late = (at.e, *past)
        measured = late[delay]
        if scenario.noise is not None:
            row = scenario.noise[k.astype(int)]
            measured = sp.vadd(measured, sp.like(measured, row))
        model = look(law, reference, t, q).e if differs else at.e
        told = shifted(reference, law.task, sp.vsub(measured, model))
        length = jnp.where(k < N, Ts, 0.0)  # see `instants`
        gained = scheduled(loop, t / horizon)
        made = advance(gained, told, q, t, length, method, stage, history, starting=starting)
        return (made.q, late[:delay], made.history), replace(made, q=q, x=at.x(), e=at.e, history=None)

    k = jnp.arange(N + 1).astype(dtype)
    state = q0, (first,) * delay, blank(law, q0, method)
    found = instants(one, state, k, q0, law.task.m, early=early_steps(method, N))
    return assemble(k * Ts, found, evaluations_of(method, stage, law.chain.n, N))
