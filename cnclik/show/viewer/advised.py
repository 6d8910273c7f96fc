"""Advised: runs of a loop with the gains that the advice of `cnclik stability` recommends, and with one too large."""

import dataclasses
import math

import numpy as np

from cnclik.record import replace
from cnclik.show.viewer.look import look, loop_of
from cnclik.stability.spectrum import held_at

PUSH = 0.05  # [rad, m] by which all joints of a stack are displaced at the start of a run


def advised_runs(found, rest, said):
    """Yield (name, run, spectral radius) with recommended gains, and with one beyond its limit, or as they are.

    A task alone makes a step to its target. In a stack the one beyond is the tightest task's, and all joints begin a
    little away from the posture at which the loop rests.

    Args: found: the `Problem`. rest: the posture. said: the advice.
    """
    return _of_task(found, said) if said.stack is None else _of_stack(found, rest, said)


def _of_task(found, said):
    now, most = loop_of(found), said.largest_stable_alpha
    other = (now.alpha, "now") if math.isinf(most) else (1.1 * most, "a tenth beyond the largest stable")
    made = dataclasses.replace(found, N=_steps(said.recommended.settling_time, found.Ts))
    for alpha, name in ((said.recommended_alpha, "recommended"), other):
        seen = look(made, now._replace(alpha=min(alpha, 1e3 * now.alpha)))
        yield f"alpha = {alpha:.3g} 1/s ({name})", seen.run, seen.radius


def _of_stack(found, rest, said):
    law, stack = found.law, said.stack
    push = PUSH * (-1.0) ** np.arange(law.chain.n)
    q0 = np.clip(rest + push, np.array(law.chain.lower), np.array(law.chain.upper))
    settled = max(one.now.settling_time if one.now else math.inf for one in stack.tasks.values() if one.alpha)
    made = dataclasses.replace(found, reference=held_at(law, np.asarray(rest)), q0=q0, N=_steps(settled, found.Ts))
    tight = stack.tasks[stack.least_room]
    wanted = {name: min(one.alpha, one.recommended_alpha) for name, one in stack.tasks.items()}
    beyond: tuple = ({}, "as they are")
    if math.isfinite(most := tight.largest_stable_alpha):
        lowered = {name: wanted[name] for name in stack.unstable}
        beyond = lowered | {stack.least_room: 1.1 * most}, f"{stack.least_room} a tenth beyond its largest stable gain"
    for gains, name in ((wanted, "none above what is recommended"), beyond):
        alpha = np.broadcast_to(np.asarray(law.alpha, float), (law.task.m,) * max(np.ndim(law.alpha), 1)).copy()
        for task, value in gains.items():
            at = (law.task.of(task),) * alpha.ndim
            alpha[at] *= value / max(stack.tasks[task].alpha, 1e-300)
        seen = look(one := dataclasses.replace(made, law=replace(law, alpha=alpha)), loop_of(one))
        yield name, seen.run, seen.radius


def _steps(settled, Ts) -> int:
    return min(max(math.ceil(2 * settled / Ts), 40), 400) if math.isfinite(settled) else 400
