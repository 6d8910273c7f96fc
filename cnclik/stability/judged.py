"""Judged: what a run did, from the evidence of its case: a kind, the numbers in words, and remedies to be tried.

Two things are asked. What did the run do: did its error shrink, stay, grow; did its joints go back and forth? And
why: what are the eigenvalues of the loop's own step (law, inverse, damping, limits, gain, method and stage as they are)
at rest where the run ended? What the run is too short to tell is not told: the answer is the run that decides it. The
thresholds are constants here, in `reasons`, `remedies` and `observed`; quarters are the run's, as for `outcome`.
"""

import enum
from typing import NamedTuple

import numpy as np

from cnclik.integrate.status import Status
from cnclik.law.inverse import Levels
from cnclik.quantities import plainly
from cnclik.stability import reasons, remedies
from cnclik.stability.case import LEAST, NEARLY, PLENTY
from cnclik.stability.loop import UNSTABLE
from cnclik.stability.observed import VISIBLE, rms
from cnclik.stability.reasons import REVERSING
from cnclik.stability.remedies import ENOUGH, Remedy
from cnclik.stability.stacked import ALL_REACHABLE, COMPROMISE, SHARED, UNKNOWN, each_task

TIMES_AROUND = 3  # times around a path that tell, however slow a direction of the loop is
# Share of the joint speed off its mean, from which on what is unstable at rest shakes at a pace. A sine has
# 1 − sin(π/16)/(π/16) = 0.006 of itself off its mean, its second harmonic 0.026. Measured on circles of 2 to 6 s
# (Panda, UR5; EE, AB2; 3 rad/s², 60 rad/s³): 0.007 to 0.025 in calm loops, 0.04 to 0.75 in those that shake. A path
# that turns faster has more by itself, whatever the gain: lissajous figures at the same limits 0.04 to 0.3.
RESTLESS = 0.045
NOISE = 4.0  # an error below so many standard deviations is noise
OVERSHOOT = 0.4  # of an error by which a loop lands beyond the target, from which on it rings


class Behaviour(enum.StrEnum):
    """What a run did."""

    SETTLED = "settled"
    LAGGING = "settled with lag"
    PARTLY = "settled in part"  # of a stack: some of its tasks
    CONVERGING = "converging"
    UNDECIDED = "too short to tell"
    RINGING = "ringing"
    SHAKING = "shaking"
    DIVERGING = "diverging"
    AT_LIMIT = "held back by a limit"
    OUT_OF_REACH = "out of reach"
    STALLED = "no progress"
    BEYOND_LIMITS = "beyond the robot's limits"


class Judged(NamedTuple):
    """What a run did, and what might mend it."""

    kind: Behaviour
    what: str  # in words
    remedies: tuple
    slowly: bool = False  # of an error that shrinks: more slowly than the loop's time constants say


def judged(case) -> Judged:
    return Judged(*_judged(case))


def _judged(case):
    law, seen, error = case.law, case.seen, f"over the last quarter of the run the error is at most {case.size}"
    if seen.bad is not None:
        since = case.t[0] + seen.bad * case.loop[0]  # the time of a path that waits is not finite either
        what = f"not finite from t = {since:.4g} s on (step {seen.bad})"
        return Behaviour.DIVERGING, what, remedies.lower(case)
    if not np.any(np.asarray(law.alpha)):
        Ts, drive = case.loop[0], case.loop[-1]
        gain = 0.2 / (Ts + float(np.max(drive.late_by(Ts))))
        raised = Remedy(change={"alpha": gain}, words=f"raise alpha, to {gain:.3g} 1/s for example")
        return Behaviour.STALLED, f"the gain is 0, so errors stay; {error}", (raised,)
    if case.steps - 1 <= case.dead and case.dead:
        what = f"the run is over before its dead time of {case.dead} steps is; {error}"
        return Behaviour.UNDECIDED, what, remedies.longer(case)
    if not law.task.of_one_tip:
        return _stack(case, error)
    return (_moving if case.moving else _held)(case, error)


def _radius(case):
    digits = 3 if abs(case.radius - 1) > 0.005 else 6  # 1.0003 is not 1
    slow = ""
    if case.radius > UNSTABLE and case.moving and _slow_enough(case):
        part = case.advance
        slow = f", and {case.radius_at(case.end, part):.3g} at the {part:.2g} of a step that the pace makes"
    return f"the loop's spectral radius at rest is {case.radius:.{digits}g}{slow}"


def _slow_enough(case):
    """Whether a loop that is unstable at rest is stable at its pace: it takes a share of each step."""
    return case.advance < 1 and not _shakes(case) and case.radius_at(case.end, case.advance) <= UNSTABLE


def _pulled(case, error):
    if case.steps < PLENTY * case.null_fold:
        return undecided(case, error)
    return Behaviour.STALLED, f"{error} and stays: {reasons.PULLED}", remedies.less_pull(case)


def _held(case, error):
    seen = case.seen
    # A loop that carries what it rounds away would have moved by now.
    if seen.still and 4 * case.rounding / len(seen.late) < seen.largest <= 2 * case.rounding:
        return _rounded(case, error)
    if seen.arrived or seen.largest <= NOISE * case.noise:
        return _arrived(case, error)
    if case.radius > UNSTABLE or case.null_unstable:
        return _unstable(case, error)
    if reasons.beyond(case) > 0 or reasons.too_many(case):
        return _out_of_reach(case, error)
    if _rings(case):
        restless = _shakes(case) and case.radius_at(case.start) > UNSTABLE
        return (_shaking if restless else _ringing)(case, error)
    if seen.shrinks or seen.swings_less:
        return _shrinking(case, error)
    if case.spans >= ENOUGH and (at := reasons.at_limits(case)):
        found = remedies.elsewhere(case) or remedies.nearer(case)
        return Behaviour.AT_LIMIT, f"{at}, and {error}", found
    slowly = not (case.stays or reasons.open_ended(case) or reasons.leaks(case))
    if slowly and _fallen(case) and np.all(np.diff(seen.late) < 0):
        found = (*remedies.raised(case), *remedies.to_the_end(case))
        return Behaviour.CONVERGING, f"{error}; {_radius(case)}", found, True
    if not case.stays:
        return undecided(case, error)
    if reasons.leaks(case):
        return _pulled(case, error)
    if reasons.unreachable(case):
        return _out_of_reach(case, error)
    if _shakes(case):
        return _shaking(case, error)
    if seen.often(Status.NEAR_SINGULAR) or reasons.hopeless(case):
        return Behaviour.STALLED, f"{error} and stays, next to a singularity", remedies.elsewhere(case)
    return Behaviour.STALLED, f"{error} and stays; {_radius(case)}", remedies.elsewhere(case)


def _arrived(case, error):
    seen = case.seen
    unstable = max(case.radius, case.null_radius * case.null_unstable)
    moves = seen.visible or (case.pace is not None and unstable > UNSTABLE)  # within a pace it grows no further
    if moves and not seen.fades and seen.reversing > REVERSING:
        return _shaking(case, error)
    if unstable > UNSTABLE:
        what = f"at rest, but any disturbance grows: the loop's spectral radius is {unstable:.3g}"
        return Behaviour.DIVERGING, what, remedies.lower(case)
    if _rings(case):
        return _ringing(case, error)
    return Behaviour.SETTLED, f"{error}; {_radius(case)}", ()


def _moving(case, error):
    seen = case.seen
    lag, follows = rms(seen.late), case.follows
    if case.radius > UNSTABLE and not (follows and (case.radius_at(case.start) <= UNSTABLE or _slow_enough(case))):
        return _unstable(case, error)
    if seen.often(Status.AT_LIMIT) and case.law.limits is not None and not follows and not seen.shrinks:
        what = f"{_held_by(case) or 'limits hold the joints back'}, and {error}"
        slower = remedies.slower_path(case, 0.8 * seen.share)
        if case.covered >= 1:
            return Behaviour.AT_LIMIT, what, slower
        kind, what, found = undecided(case, what)
        return kind, what, found if case.crawls else (*slower, *found)
    if _rings(case):
        return _ringing(case, error)
    if not follows and (reasons.beyond(case) > 0 or reasons.too_many(case)):
        return _out_of_reach(case, error)
    if case.covered < 1 or (case.spans < ENOUGH and case.covered < TIMES_AROUND):
        return undecided(case, f"{'it follows so far; ' if follows else ''}{error}")
    if follows:
        return Behaviour.SETTLED, f"it follows; {error}; {_radius(case)}", ()
    if seen.shrinks:
        return _shrinking(case, error)
    if reasons.unreachable(case):
        return _out_of_reach(case, error)
    if _shakes(case):
        return _shaking(case, error)
    behind = "" if case.waits else f", a lag of {lag / case.behind * case.loop[0]:.3g} s"
    what = f"{error}{behind}; {_radius(case)}"
    limited = case.law.limits is not None and bool(np.any(seen.status & Status.AT_LIMIT))
    if limited:  # more velocity may be more than they let through
        return Behaviour.LAGGING, what, remedies.slower_path(case, 0.5)
    if float(case.law.feedforward) != 1.0:
        return Behaviour.LAGGING, what, (_fed_forward(),)
    held_back = case.pace is not None and (not case.waits or case.advance < NEARLY)
    slower = remedies.slower_path(case, 0.25 if held_back else 0.5)
    raised = remedies.raised(case)
    return Behaviour.LAGGING, what, (*raised, *(slower if held_back or not raised else ()))


def _stack(case, error):
    """A run of several tasks: each by its own error, and the loop by its step."""
    each, quarter = each_task(case), "over the last quarter of the run the errors are at most"
    said, left = f"{quarter}: {', '.join(one.words for one in each)}", [one for one in each if not one.settled]
    if case.radius > UNSTABLE and (left or not case.moving) and not _slow_enough(case):
        return _unstable(case, error)
    if _shakes(case) and not (case.seen.arrived and case.seen.fades):
        return _shaking(case, said)
    if _rings(case):
        return _ringing(case, said)
    if not left:
        return Behaviour.SETTLED, f"{said}; {_radius(case)}", ()
    if case.covered < 1 or case.steps < LEAST + case.dead:
        return undecided(case, said)
    if any(one.shrinks for one in left):
        return Behaviour.CONVERGING, f"{said}; {_radius(case)}", remedies.to_the_end(case)
    of_tips = any(one.of_tips for one in left)
    if of_tips and reasons.unreachable(case):
        return _out_of_reach(case, said)
    at = _held_by(case) if case.moving else reasons.at_limits(case)
    if at and (of_tips or len(left) == len(each)):
        return Behaviour.AT_LIMIT, f"{at}, and {said}", remedies.freer(case)
    if case.moving and float(case.law.feedforward) != 1.0:
        return Behaviour.LAGGING, said, (_fed_forward(),)
    all_left = Behaviour.LAGGING if case.moving else Behaviour.STALLED
    kind = all_left if len(left) == len(each) else Behaviour.PARTLY
    known = of_tips and case.reached is not None and case.reached.solved
    held = f"; {at}" if at else ""
    why = "" if not of_tips else f"; {ALL_REACHABLE if known else UNKNOWN}"
    found = (*remedies.less_damping(case), *(() if case.moving else remedies.elsewhere(case))) if known else ()
    shared = SHARED if isinstance(case.law.inverse, Levels) else COMPROMISE
    return kind, f"{said}{held}; {shared}{why}; {_radius(case)}", found


def _held_by(case):
    """What the limits of the law do to the joints, in words."""
    return ", ".join(filter(None, (reasons.at_limits(case), reasons.too_slow(case))))


def _fed_forward():
    return Remedy(change={"feedforward": 1.0}, words="feed the velocity forward (feedforward=1)")


def _rounded(case, error):
    lost = f"it stops short there: below {case.rounding:.2g}, a step is lost in the rounding of q in {case.seen.dtype}"
    kind = Behaviour.SETTLED if case.seen.arrived else Behaviour.STALLED
    wide = Remedy(change={"dtype": "float64"}, words="work in float64 (JAX_ENABLE_X64=1)")
    return kind, f"{error}; {lost}", (wide,) if case.seen.dtype == np.float32 else remedies.raised(case)


# --- one kind each ------------------------------------------------------------------------------------


def _rings(case):
    seen = case.seen
    swing = seen.swing * case.loop[0] * case.advance  # of the path's time
    by_path = case.moving and case.path and 4 * swing >= case.path  # as slowly as its path turns
    return case.overshoot > OVERSHOOT and seen.swings >= 2 and case.radius <= UNSTABLE and not by_path


def _ringing(case, error):
    size = f"{case.overshoot:.{2 if case.overshoot < 0.95 else 3}g} times"  # 0.998 is not 1
    swing = size if case.overshoot < 0.9995 else "nearly as large as"
    swings = f"the error oscillates about the target, each swing {swing} the one before"
    return Behaviour.RINGING, f"{swings}; {error}", remedies.faster(case)


def _shakes(case):
    smooth = case.pace is not None and case.pace.smooth
    least = RESTLESS if smooth and case.radius > UNSTABLE else REVERSING
    return case.seen.visible and case.seen.reversing > least


def _shaking(case, error):
    seen, unit = case.seen, " or ".join(sorted(set(case.law.chain.units), reverse=True))
    fast = f"joint velocities up to {plainly(seen.joint_speed)} {unit}/s go back and forth"
    fast += " within the limits of the pace" if case.pace is not None else ""
    fast += f", with the path at {case.advance:.2g} of its speed" if case.waits and case.advance < NEARLY else ""
    if case.null_unstable and seen.arrived:
        inside = f"in the null space of the task, where the spectral radius is {case.null_radius:.3g}"
        return Behaviour.SHAKING, f"{fast} {inside}", remedies.less_null(case.null_radius)
    if not seen.arrived and case.radius <= UNSTABLE and reasons.unreachable(case):
        return _out_of_reach(case, f"{error}, and {fast}")
    if case.crawls and case.radius <= UNSTABLE:
        kind, what, found = undecided(case, f"{fast}; {error}")
        return kind, what, found if hasattr(case.law.inverse, "damping") else (*found, *remedies.gentle(case, "motion"))
    found = remedies.lower(case)
    if case.pace is not None and _near_singular(case):
        fast, found = f"{fast}, next to a singularity", (*found, *remedies.gentle(case, "motion"))
    return Behaviour.SHAKING, f"{fast}; {error}; {_radius(case)}", found


def _near_singular(case):
    return bool(np.any(case.seen.status & Status.NEAR_SINGULAR))


def _unstable(case, error):
    """What is unstable at rest where it ended, and did not arrive."""
    seen = case.seen
    if seen.shrinks and not _shakes(case):
        return undecided(case, error)
    if seen.grows and (case.pace is None or (seen.lost and not _shakes(case))):
        return Behaviour.DIVERGING, f"the error has grown to {case.size}; {_radius(case)}", remedies.lower(case)
    follows = case.pace is not None and (case.waits or case.follows)  # it moves with its path
    moves = seen.visible or (case.pace is not None and seen.largest > VISIBLE)  # it may rest between whiles
    if _shakes(case) or (moves and case.spans > PLENTY and not follows):
        return _shaking(case, error)
    if case.pace is None and reasons.whirls(case) and case.radius_at(case.start) > UNSTABLE:
        what = "; ".join(filter(None, (reasons.outside(case), error, _radius(case))))
        return Behaviour.DIVERGING, what, remedies.lower(case)
    falls = np.median(seen.late) < np.median(seen.before) or seen.often(Status.AT_LIMIT)
    if not falls and case.radius_at(case.start) > UNSTABLE:
        return Behaviour.DIVERGING, f"{error} so far, but any disturbance grows: {_radius(case)}", remedies.lower(case)
    return restless(case, error, remedies.lower(case))


def _shrinking(case, error):
    if case.crawls or reasons.slow(case) or (case.spans < ENOUGH and not _fallen(case)):
        return undecided(case, error)
    if _shakes(case) and case.seen.largest > 0.8 * case.seen.before.max():
        return _shaking(case, error)
    if reasons.leaks(case):  # down to where gain and pull are even, wherever that is
        return undecided(case, error)
    if case.seen.largest > 0.1 * case.seen.size[0] and reasons.unreachable(case):
        return _out_of_reach(case, error)
    return Behaviour.CONVERGING, f"{error} and shrinking; {_radius(case)}", remedies.to_the_end(case)


def _fallen(case):
    """Whether the error is as small as it is after enough time constants."""
    return case.seen.size[0] > np.exp(ENOUGH) * case.seen.largest


def _out_of_reach(case, error):
    found = remedies.nearer(case) if case.law.task.of_one_tip else ()
    return Behaviour.OUT_OF_REACH, f"{error}; {reasons.unreachable(case)}", found


def restless(case, what, found):
    """Undecided, but of a loop that was unstable where it began: what mends that is tried all the same."""
    kind, what, more = undecided(case, what)
    return kind, what, (*(found if case.radius_at(case.start) > UNSTABLE else ()), *more)


def undecided(case, error):
    if why := reasons.open_ended(case):
        return Behaviour.UNDECIDED, f"{error}; {why}", remedies.quicker(case)
    holds = f"the run holds {plainly(float(f'{case.spans:.2g}'))} of the loop's own time constants"
    share = f"{100 * case.covered:.2g}" if case.covered < 0.1 else int(100 * case.covered)
    path = f" and {share} % of the path" if case.covered < 1 else ""
    return Behaviour.UNDECIDED, f"{error}; {holds}{path}", remedies.longer(case)
