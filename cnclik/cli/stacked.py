"""Stacks in `cnclik stability`: the posture and targets at which one rests, and its runs with other gains."""

import dataclasses
import math

import numpy as np

from cnclik import errors
from cnclik.law.reference import of_each
from cnclik.problem.reference import reference_from
from cnclik.reaching.aims import aims, of_tips
from cnclik.record import replace
from cnclik.stability.spectrum import held_at

PUSH = 0.05  # [rad, m] by which all joints are displaced at the start of a run


def at_targets(found, targets):
    """The problem with new targets for its first tips, in order; the other tips keep theirs."""
    law = found.law
    tips = aims(of_tips(law.task))
    if len(targets) > len(tips):
        must = f"be given at most once for each tip ({', '.join(aim.label for aim in tips)})"
        raise errors.fail("target", must, f"is given {len(targets)} times")
    given = iter(targets)

    def other(one, parts):
        target = next(given, None) if hasattr(parts.parts[0], "axes") else None
        return one if target is None else reference_from("hold", law.chain, parts, found.q0, target=target)

    told = {aim.path[0]: {"target": None} for aim in tips[: len(targets)]}
    tables = {name: table | told.get(name, {}) for name, table in found.tables.items()}
    return dataclasses.replace(found, reference=of_each(other, found.reference, law.task), tables=tables)


def runs_of_stack(found, rest, said) -> list:
    """[(name, run, spectral radius)] with recommended gains, and with the tightest task's gain beyond its limit.

    All joints begin a little away from the posture at which the loop rests.
    """
    from cnclik.show.viewer.look import look, loop_of

    law, stack = found.law, said.stack
    push = PUSH * (-1.0) ** np.arange(law.chain.n)
    q0 = np.clip(rest + push, np.array(law.chain.lower), np.array(law.chain.upper))
    settled = max(one.now.settling_time if one.now else math.inf for one in stack.tasks.values() if one.alpha)
    N = min(max(math.ceil(2 * settled / found.Ts), 40), 400) if math.isfinite(settled) else 400
    made = dataclasses.replace(found, reference=held_at(law, np.asarray(rest)), q0=q0, N=N)
    tight, runs = stack.tasks[stack.least_room], []
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
        runs.append((name, seen.run, seen.radius))
    return runs
