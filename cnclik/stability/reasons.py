"""Reasons: why a loop's run did not do better, and what does, in the words of its verdict.

Each takes the verdict's case: the run, the loop behind it, and what its step does where the run ended.
"""

import jax
import numpy as np

from cnclik import errors
from cnclik.integrate.stage import Picard
from cnclik.integrate.status import Status
from cnclik.law.inverse import Transpose
from cnclik.law.limits import Saturated
from cnclik.record import replace
from cnclik.robot.kinematics import as_joint_values
from cnclik.robot.posture import arm_length
from cnclik.stability.local import fastest_share, maps, resting, stable_share
from cnclik.stability.spectrum import drift_of_numbers, held_at, leaky, null_radius

UNSTABLE = 1.01  # spectral radius beyond which a loop that seems to rest doesn't: smaller excess is the error's own
WILD = 1e3  # joint values, in rad or m, of a run that has left its senses: it is judged where it began
GRADIENT = 0.02  # ‖Jᵀe‖/(‖J‖‖e‖) below which no joint motion reduces the error
SLOWER = "follow a slower path, use limits velocity_scaling(), or, near a singularity, damped(...)"
GENTLER = "use limits velocity_scaling(), or an error_clamp, or reduce alpha"
LESS_NULL = "reduce the gain of the null-space velocity"
PULLED = "the null-space velocity pulls at the task, as I − J# J of this inverse is no projector"
LESS_PULL = "use pseudoinverse(), less damping, or a slower null-space velocity"
LEAK = 0.3  # share of what the gain asks for that such a pull must be


def held_by(case, moving):
    """Which limit holds the arm, and the remedy."""
    remedy = "choose another start, posture or path"
    if not isinstance(case.law.limits, Saturated):
        remedy += ", or limits saturation(), which lets other joints take over"
    chain, q = case.law.chain, case.end.q
    near = 1e-3 * (1 + np.abs(q))
    stopped = (q <= np.array(chain.lower) + near) | (q >= np.array(chain.upper) - near)
    names = [name for name, is_there in zip(chain.joint_names, stopped, strict=True) if is_there]
    if not names:
        return "joints are held at their velocity limits", "follow a slower path" if moving else remedy
    return f"{', '.join(names)} {'is' if len(names) == 1 else 'are'} at a limit", remedy


def hopeless(case):
    """Whether no joint motion reduces the error."""
    size, push = np.linalg.norm(case.e), np.linalg.norm(case.rows.T @ case.e)
    return size > case.seen.floor and push < GRADIENT * np.linalg.norm(case.rows, 2) * size


def beyond(case):
    """By how much the target lies beyond the stretched arm [m]; negative where it doesn't, or that isn't known."""
    if case.target is None:
        return -np.inf
    base = np.array([float(v) for v in case.law.chain.joints[0].origin.position])
    base = base if len(case.target) == 3 else base[list(case.law.task.linear)]
    return float(np.linalg.norm(case.target - base) - arm_length(case.law.chain))


def gap(case):
    """How far from the target the tip stays at best, in words; empty where it can get there, or that isn't known."""
    from cnclik.reaching.reach import reach  # here: most runs end where nothing is asked of it
    from cnclik.reaching.result import ReachStatus

    chain, task = case.law.chain, replace(case.law.task, weights=None)
    if task.m > chain.n or not all(map(errors.concrete, jax.tree.leaves(chain))):
        return ""
    position, rotation = np.zeros(3), np.eye(3) if case.turn is None else case.turn
    if case.target is not None:
        position[list(task.linear) if len(case.target) < 3 else slice(None)] = case.target
    made = reach(chain, (position, rotation), task=task, tolerance=(1e-4, 1e-4), limits=case.law.limits is not None)
    if made.solved or made.status not in (ReachStatus.OUT_OF_REACH, ReachStatus.AT_LIMIT):
        return ""
    best = [f"{made.position_error:.3g} m"] * bool(task.position)
    best += [f"{made.orientation_error:.3g} rad"] * bool(task.orientation)
    held = " within the joint limits" if made.status == ReachStatus.AT_LIMIT else ""
    return f"the tip can get no nearer than {' and '.join(best)}{held}"


def why_not(case):
    away, (m, n) = beyond(case), case.rows.shape
    if away > 0:
        return f"the target is {away:.3g} m beyond the stretched arm"
    if np.linalg.matrix_rank(case.rows) < m and m > n:
        return f"the task asks for {m} coordinates of an arm with {n} joints"
    return "no joint motion makes it smaller"


def reach_remedy(case):
    m, n = case.rows.shape
    if m > n:
        return "ask for fewer coordinates"
    if not np.any(getattr(case.law.inverse, "damping", 0.0)):
        return "bring the target nearer, or use damped(...) and error_clamp to stop quietly before it"
    return "bring the target nearer, or start from another posture"


def leaks(case) -> bool:
    """Whether what is left of an error is what the null-space velocity puts there."""
    law, q = case.law, as_joint_values(case.law.chain, case.end.q)
    if not leaky(law):
        return False
    pull = case.rows @ np.asarray(drift_of_numbers(law, held_at(law, q), q))
    asked = np.asarray(law.alpha, float)
    asked = asked @ case.e if asked.ndim == 2 else asked * case.e
    return bool(np.linalg.norm(pull) > LEAK * np.linalg.norm(asked) > 0)


def faster_than_its_joints(case) -> str:
    """What to do about a loop that asks for more than its joints can."""
    if case.behind > case.seen.floor:
        return SLOWER
    if case.law.null_velocity is None:
        return GENTLER
    return f"use limits velocity_scaling(), or {LESS_NULL}, or alpha"


def lower(case):
    """What stops a loop that shakes or diverges: less gain, by what is stable at rest at both ends of the run, of which
    the last may be where it has gone astray."""
    law, (Ts, method, stage, drive) = case.law, case.loop
    ends = [resting(law, at) for at in (case.end, case.start) if np.abs(at.q).max() <= WILD]
    across = [null_radius(*maps(*at, np.ones(1), Ts, method, stage))[0] for at in ends if callable(law.null_velocity)]
    if across and min(across) > UNSTABLE:
        return LESS_NULL
    share = min((stable_share(*at, *case.loop) for at in ends), default=1.0)
    if 0 < share < 1:
        solved = method.implicit and isinstance(stage, Picard)
        other = ", or solve the stage with chord(2)" if solved else ""
        if not (method.exponential or solved or not drive.prompt or isinstance(law.inverse, Transpose)):
            other = ", or use method EXP-MIDPOINT, which has no such limit"
        return f"reduce {_gain(law, share, 'below')}{other}"
    if max(across, default=0.0) > UNSTABLE:
        return LESS_NULL
    if share == 0:
        more = "raise the damping" if np.any(getattr(law.inverse, "damping", 0.0)) else "use damped(...)"
        return f"no gain is stable in this posture: {more}"
    if beyond(case) > 0:
        return f"{why_not(case)}: bring it nearer, or use damped(...) and error_clamp"
    if case.seen.often(Status.NEAR_SINGULAR):
        return "it is next to a singularity: use damped(...), and error_clamp if the target is far"
    return "what is asked is too far off, or out of reach: use damped(...) and error_clamp, or reduce alpha"


def faster(case):
    share = fastest_share(*resting(case.law, case.end), *case.loop)
    return f"reduce {_gain(case.law, share, 'to about')}, which settles soonest" if share < 1 else "reduce alpha"


def _gain(law, share, word):
    alpha = np.asarray(law.alpha, float)
    amount = f"{share * alpha:.3g} 1/s" if alpha.ndim == 0 else f"{share:.2g} of what it is"
    return f"alpha {word} {amount} at this Ts"
