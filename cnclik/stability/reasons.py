"""Reasons: why a run did not do better, in words, from its case."""

import numpy as np

from cnclik.integrate.status import Status
from cnclik.quantities import plainly
from cnclik.reaching.result import ReachStatus
from cnclik.robot.posture import beyond_arm
from cnclik.stability.spectrum import drift_of_numbers, leaky
from cnclik.stability.stacked import out_of_reach

REVERSING = 0.15  # a loop shakes if a larger share of its joint speed reverses in the next step
GRADIENT = 0.02  # ‖Jᵀe‖/(‖J‖‖e‖) below which no joint motion reduces the error
LONGEST = 1e4  # longest time constant that is worth waiting for [steps]
SLOWEST = 1e6  # steps in which an error falls e-fold, at most
INSIDE = 1e-6  # [rad, m] excess over a limit that is rounding
LEAK = 0.3  # share of what the gain asks for that the null-space velocity's pull must be
PULLED = "the null-space velocity pulls at the task, as I − J# J of this inverse is no projector"


def at_limits(case) -> str:
    """A clause on the joint limits and walls that stop the arm; empty where there are none."""
    if not (keeps_positions(case.law) and case.seen.often(Status.AT_LIMIT)):
        return ""
    names = _joints(case, case.seen.at_position)
    at = [f"{', '.join(names)} {'is' if len(names) == 1 else 'are'} at a limit"] * bool(names)
    return ", ".join(at + case.walls)


def too_slow(case) -> str:
    """Which joints move at their velocity limits, in words; empty where the law keeps none, or the joints keep them."""
    if not case.held_back or not case.seen.at_velocity.any():
        return ""
    names = _joints(case, case.seen.at_velocity)
    return f"{', '.join(names)} {'moves at its velocity limit' if len(names) == 1 else 'move at their velocity limits'}"


def _joints(case, there) -> list:
    return [name for name, is_there in zip(case.law.chain.joint_names, there, strict=True) if is_there]


def open_ended(case) -> str:
    """A clause on why no run length decides; empty where the loop's time constants give one."""
    if case.held_back:
        where = " next to a singularity" * case.crawls
        return f"limits hold the joints back{where}, and how long that lasts is not known"
    if case.fold > LONGEST and case.seen.often(Status.NEAR_SINGULAR):
        return "next to a singularity a direction of the task hardly moves, and how long it takes is not known"
    if slow(case):
        takes = f"{plainly(float(f'{case.fold:.2g}'))} steps ({float(f'{case.fold * case.loop[0]:.2g}'):g} s)"
        return f"what is left of it takes {takes} to fall by a factor of e, and where that ends is not known"
    pulled, away = leaky(case.law), case.law.null_velocity is not None and case.null_radius >= 1 - 1 / SLOWEST
    if (pulled and case.law.limits is not None) or (away and (pulled or (case.stirred and not case.seen.shrinks))):
        return "the null-space velocity still moves the arm, and how long it does is not known"
    return ""


def slow(case) -> bool:
    """Whether the remaining error decays too slowly to wait for."""
    return case.fold * case.advance > LONGEST and case.radius <= 1


def keeps_positions(law) -> bool:
    """Whether the law's limits are those of joint values, too."""
    return law.limits is not None and law.limits.positions


def outside(case) -> str:
    """A clause on the joint farthest beyond its limits; empty where there is none."""
    law, beyond = case.law, case.seen.outside
    if keeps_positions(law):  # a joint that began outside returns
        began = np.maximum(case.q0 - np.array(law.chain.upper), np.array(law.chain.lower) - case.q0)
        beyond = np.where(beyond > began + INSIDE, beyond, 0.0)
    most = int(np.argmax(beyond))
    if beyond[most] <= INSIDE:
        return ""
    unit = law.chain.units[most]
    others = [law.chain.joint_names[i] for i in np.argsort(-beyond) if i != most and beyond[i] > INSIDE]
    are = "is beyond its own" if len(others) == 1 else "are beyond theirs"
    more = f", and {', '.join(others)} {are}" if others else ""
    past = ": its drive takes it past what the law keeps" if keeps_positions(law) else ""
    return f"joint {law.chain.joint_names[most]} is up to {beyond[most]:.3g} {unit} beyond its limit{more}{past}"


def whirls(case) -> bool:
    """Whether a joint is beyond its limits by a whole turn."""
    return bool(np.any((case.seen.outside > 2 * np.pi) & (np.array(case.law.chain.units) == "rad")))


def hopeless(case) -> bool:
    """Whether no joint motion reduces the error in this posture."""
    size, push = np.linalg.norm(case.e), np.linalg.norm(case.rows.T @ case.e)
    return size > case.seen.floor and push < GRADIENT * np.linalg.norm(case.rows, 2) * size


def beyond(case) -> float:
    """Distance of the target beyond the stretched arm [m]; negative within it, or where it is unknown."""
    if case.target is None:
        return -np.inf
    axes = (0, 1, 2) if len(case.target) == 3 else case.law.task.linear
    away = float(beyond_arm(case.law.chain, np.asarray(case.target), axes))
    return away if abs(away) > case.seen.floor else 0.0


def too_many(case) -> bool:
    """Whether the task has more coordinates than the joints can control."""
    m, n = case.rows.shape
    return m > n and hopeless(case)


def unreachable(case) -> str:
    """A clause on why the target is out of reach; empty where it is reachable or unknown."""
    if not case.law.task.of_one_tip:
        return out_of_reach(case)
    away, (m, n) = beyond(case), case.rows.shape
    if too_many(case):
        return f"the task asks for {m} coordinates of an arm with {n} joints"
    made, task = case.reached, case.law.task
    known = made is not None and made.status in (ReachStatus.OUT_OF_REACH, ReachStatus.AT_LIMIT)
    if away <= 0 and not known:
        return ""
    said = [f"the target is {away:.3g} m beyond the stretched arm"] * (away > 0)
    if known:
        best = [f"{made.position_error:.3g} m"] * bool(task.lengths)
        best += [f"{made.orientation_error:.3g} rad"] * bool(task.angles)
        kept = " within the joint limits" if made.status == ReachStatus.AT_LIMIT else ""
        said.append(f"the tip can get no nearer than {' and '.join(best)}{kept}")
    return "; ".join(said)


def leaks(case) -> bool:
    """Whether the null-space velocity causes the remaining error."""
    if not leaky(case.law):
        return False
    pull = case.rows @ _drift(case.law, case.end)
    asked = np.asarray(case.law.alpha, float)
    asked = asked @ case.e if asked.ndim == 2 else asked * case.e
    return bool(np.linalg.norm(pull) > LEAK * np.linalg.norm(asked) > 0)


def null_excess(case) -> float:
    """Joint velocity of the null-space term alone over its limit, at the start or the end of the run."""
    if case.law.null_velocity is None:
        return 0.0
    limit = np.maximum(np.array(case.law.chain.velocity_limit, float), 1e-12)
    return float(max(np.max(np.abs(_drift(case.law, at)) / limit) for at in (case.start, case.end)))


def _drift(law, at):
    """How the law's null-space velocity moves the arm of a loop at rest (n,)."""
    return np.asarray(drift_of_numbers(law, at.held, at.q))
