"""solve with a pace: the loop in time, whose steps are scaled to limits, and whose path waits."""

import jax.numpy as jnp

from cnclik.engine.tracing import checkpointed
from cnclik.integrate.advance import advance
from cnclik.integrate.history import blank
from cnclik.integrate.pace import check_pace, pace_at_rest, share
from cnclik.integrate.solve import check_arguments, check_time, early_steps, evaluations_of
from cnclik.integrate.status import Status, growing, too_fast
from cnclik.integrate.trajectory import Trajectory, assemble, instants
from cnclik.law.corners import Corners, corners
from cnclik.law.reference import check
from cnclik.record import cast, replace
from cnclik.robot.model import modelled, one_off


def solve_paced(law, reference, q0, Ts, N: int, method, stage, *, t0=0.0, pace) -> Trajectory:
    """`solve` with limits of velocity, acceleration and jerk, from rest at q0.

    Where the path waits, a step of the method is made over the time that the last one took of it, share·Ts: methods
    keep their order, and multistep methods a memory of even steps. Where it does not, steps are made over Ts and then
    scaled, and a scaled step is the first of a new memory.

    Args: as for `solve`; pace: `Pace`.
    """
    q0, method = check_arguments(law, reference, q0, Ts, method, stage)
    check(reference, law.task)
    check_time("t0", t0, Ts, q0.dtype, N)
    pace = check_pace(pace, law.chain.n, law.chain)
    return _compiled(law, reference, q0, Ts, t0, stage, pace, N=N, method=method)


def _loop(law, reference, q0, Ts, t0, stage, pace, *, N, method):
    dtype = q0.dtype
    waits = reference.known if pace.wait is None else pace.wait
    law, reference, pace, Ts, t0 = cast((modelled(law), reference, pace, Ts, t0), dtype)
    k = jnp.arange(N + 1).astype(dtype)
    t = t0 + k * Ts
    looks = waits and reference.known and N > 1 and not (pace.acceleration is None and pace.jerk is None)
    ahead: Corners | None = corners(reference, law.task, t) if looks else None
    least = float(jnp.finfo(dtype).eps) ** (1 / 3)  # of Ts, for a step that is told from rounding

    def one(starting, carry, k):
        q, here, pacing, history = carry
        here = here if waits else t0 + k * Ts
        part = jnp.clip(pacing.share, least, 1.0) if waits else 1.0
        length = jnp.where(k < N, part * Ts, 0.0)  # see `instants`
        made = advance(law, reference, q, here, length, method, stage, history, starting=starting)
        stop, sharpness = (None, 1.0) if ahead is None else ahead.after(here)
        s, pacing = share(pace, pacing, made.qdot, Ts, stop, sharpness)
        qdot = pacing.velocity
        moved = q + Ts * qdot
        status = made.status & ~int(Status.OVER_VELOCITY)
        status |= jnp.where(too_fast(law.chain, qdot), int(Status.OVER_VELOCITY), 0)
        status |= jnp.where(pacing.over, int(Status.OVER_ACCELERATION), 0)
        history = made.history
        if history is not None:  # the past says nothing of what is beyond a corner
            new = s < 1 if not waits else ahead is not None and stop <= s * Ts
            count = history.count if new is False else jnp.where(new, 0, history.count)
            history = replace(history, count=count, Ts=s * Ts if waits else history.Ts)
        # The field of a step that has no use in a run says when the target was where it was.
        step = replace(made, q=q, qdot=qdot, status=status, history=here)
        return (moved, here + s * Ts, pacing, history), step

    one = checkpointed(one)
    state = q0, t0, pace_at_rest(q0), blank(law, q0, method)
    found = instants(one, state, k, q0, law.task.m, early=early_steps(method, N))
    run = assemble(t, found, evaluations_of(method, stage, law.chain.n, N))
    if waits:
        run = replace(run, path_time=found[0].history)
    return replace(run, status=run.status | growing(law.task, reference, run.target_time, run.e))


_compiled = one_off(_loop, static_argnames=("N", "method"))
