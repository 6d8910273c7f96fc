"""Verdict: what a run of a loop did, in one sentence with its numbers and the remedy.

`judged` states what the run did, and what might mend it. Where that is more than "settled", the loop is run on and run
again, see `trial`: a verdict that later steps contradict is not given, and a remedy that does not help is not named.
"""

from __future__ import annotations

import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive, check_drive
from cnclik.integrate.method import DEFAULT, MethodLike
from cnclik.integrate.stage import Stage, picard
from cnclik.integrate.trajectory import Trajectory, check_run, one_lane
from cnclik.law.law import Law, check_loop
from cnclik.law.reference import Reference
from cnclik.precision import in_float64, of_numbers
from cnclik.record import ArrayLike, Number, record, replace
from cnclik.robot.posture import unmoved
from cnclik.stability import reasons, remedies
from cnclik.stability.case import case_of
from cnclik.stability.judged import Behaviour, Judged, judged, restless
from cnclik.stability.linear import checked
from cnclik.stability.loop import UNSTABLE, resting
from cnclik.stability.observed import FALLEN
from cnclik.stability.replay import check_made
from cnclik.stability.stacked import largest_in_words
from cnclik.stability.trial import Trials, only_longer, whole_trial

_UNSTABLE_KINDS = (Behaviour.SHAKING, Behaviour.DIVERGING)  # too fast because of that
# Of a longer run, what contradicts:
CALM = 0.02  # share of the joint speed that is reversed, below which a loop does not shake
LESS = 0.3  # ratio of errors below which it does not diverge
SLOWLY = 0.9  # ratio of errors beyond which one that falls at each step is not seen to converge
SAME = 0.75, 1.9  # ratios between which an error stays
STRAYS = 4.0  # ratio of errors beyond which a loop follows its path no more
_STAY = (Behaviour.STALLED, Behaviour.AT_LIMIT)
_FOLLOW = (Behaviour.SETTLED, Behaviour.LAGGING)
# What a robot does as well, within its limits.
_FINE = Behaviour.SETTLED, Behaviour.LAGGING, Behaviour.PARTLY, Behaviour.CONVERGING
TOO_FAST = 2.0  # ratio of a joint's velocity and its limit from which on a robot does something else than the run


@record
class Verdict:
    """What a run did, and what to do about it.

    Attributes:
      kind: a `Behaviour`.
      sentence: what it did, with the numbers, and the remedy.
      remedies: `Remedy` records, each an alternative; none where there is nothing to mend.
      radius: largest |eigenvalue| of one step over the task's directions, at rest where the run ended (diverged:
        began); as for `advise`, a joint at its limit is free there, unless `weighted_least_norm` keeps it.
      null_radius: the same over the null space of J; near 1 where nothing acts there.
      error: largest ‖e‖ in the last quarter [m, rad].
    """

    kind: Behaviour
    sentence: str
    remedies: tuple
    radius: float
    null_radius: float
    error: float

    def __str__(self):
        return self.sentence

    @property
    def remedy(self) -> str:
        """The remedies in words; empty where there are none."""
        return _in_words(self.remedies)


@of_numbers
def verdict(
    law: Law,
    reference: Reference,
    run: Trajectory,
    *,
    Ts: Number,
    method: MethodLike = DEFAULT,
    stage: Stage = picard(5),
    drive: Drive = Drive(),
    noise: ArrayLike | None = None,
) -> Verdict:
    """What a run did, why, and what to do about it. In float64.

    If something is wrong with the run, the loop goes on to 4096 steps or the next power of two, and a verdict that
    these steps contradict is not given. Each remedy is tried in a run: one that does not help is not named.

    Args:
      law, reference, Ts, method, stage, drive: what was run, see `solve`.
      run: its `Trajectory`, one lane.
      noise: standard deviation of its measured error, a number or (m,).
    Raises: ArgumentError for a run of several lanes or of no step, or one whose record, or whose first steps made
      again, show that it is of another loop: another Ts, a drive or noise that is not given.
    """
    dtype = np.asarray(errors.kind("run", run, Trajectory).e).dtype
    check_loop(law, reference)
    method, stage = checked(method, stage)
    one_lane(run)
    check_run(run, law)
    if len(run.residual) == 0:
        raise errors.fail("run", "have at least one step", "has none")
    step = float(run.t[-1] - run.t[0]) / len(run.residual)
    if not np.isclose(errors.number("Ts", Ts, positive=True), step, rtol=1e-2):
        raise errors.fail("Ts", f"be the run's, {step:.6g} s", f"is {float(Ts):g}")
    loop = law, reference, run, float(Ts), method, stage, check_drive(Drive() if drive is None else drive, law.chain)
    if noise is None:
        check_made(*loop)
    return _verdict(*loop, dtype=dtype, noise=noise)


@in_float64
def _verdict(law, reference, run, Ts, method, stage, drive, dtype, **more):
    case = case_of(law, reference, run, dtype, Ts, method, stage, drive, **more)
    trials = Trials(case)
    case, (kind, what, found, slowly) = _decided(case, trials)
    beyond, left = [], reasons.outside(case)
    if case.seen.over_velocity and kind not in _UNSTABLE_KINDS:
        beyond, found = [case.seen.over_velocity], (*remedies.slower_joints(case), *found)
    if left and (kind not in _UNSTABLE_KINDS or case.pace is not None):
        beyond, found = [*beyond, left], (*found, *remedies.inside(case))
    found, left_out, unknown = _tried(case, trials, tuple({one.words: one for one in found}.values()))
    if kind == Behaviour.CONVERGING and unknown:  # it shrinks, and may not arrive
        kind, slowly = Behaviour.UNDECIDED, False
    what = f"slowly; {what}" if slowly else what
    if kind in _FINE and (left or (beyond and case.seen.excess >= TOO_FAST)):
        kind, what = Behaviour.BEYOND_LIMITS, f"{'; '.join(beyond)}. The loop is {kind}: {what}"
    else:
        what = "; ".join([what, *beyond])
    still = unmoved(law.chain, law.task)
    fixed = f"; no joint motion has a part along {' or '.join(still)}, in any posture" * bool(still)
    what, words = f"{what}{fixed}{left_out}", _in_words(found)
    return Verdict(
        kind=kind,
        sentence=f"{kind}: {what}." + (f" {words[0].upper()}{words[1:]}." if words else ""),
        remedies=found,
        radius=case.radius,
        null_radius=case.null_radius,
        error=np.inf if case.seen.bad is not None else case.seen.largest,
    )


def _decided(case, trials):
    """(the case, the `Judged` of it): joints that the path turns, with any gain, do not shake."""
    made = _confirmed(case, trials)
    if made.kind == Behaviour.SHAKING and trials.turned_by_path(case, made.remedies):
        case = replace(case, seen=case.seen._replace(reversing=0.0))
        made = _confirmed(case, trials)
    return case, made


def _confirmed(case, trials) -> Judged:
    """What is judged of a run where the loop, run on, does as it states; else that the run is too short to tell."""
    made = judged(case)
    kind, what, found, slowly = made
    N, plain = whole_trial(case.steps), case.seen.bad is not None or case.seen.still  # nothing later changes that
    open_ = (*_UNSTABLE_KINDS, *_STAY, Behaviour.CONVERGING, *(_FOLLOW if case.around else ()))
    if plain or kind not in open_ or case.steps >= N:
        return made
    later, on = _longer(case, trials, N), f"run on, for {N} steps in all,"
    contradicted = _contradicted(kind, case, later)
    if case.pace is not None and kind == Behaviour.DIVERGING:
        then = judged(later)
        if then.kind == Behaviour.SHAKING:
            return then._replace(what=f"{on} {then.what}")
        contradicted = then.kind != kind
    if not contradicted:
        stays = kind == Behaviour.CONVERGING and later.seen.largest > FALLEN * case.seen.largest
        return made._replace(slowly=slowly or stays)
    if later.seen.bad is not None:
        then = f"is not finite from step {later.seen.bad} on"
    elif kind in _FOLLOW:
        then = f"gets as large as {largest_in_words(case.law.task.units, later.errors[case.steps :])}"
    else:
        then = f"is at most {later.size} at the end"
    return Judged(*restless(case, f"{what}, but {on} the error {then}", found))


def _longer(case, trials, N):
    return case_of(case.law, case.reference, trials.longer(N), case.seen.dtype, *case.loop, **case.more)


def _contradicted(kind, case, later) -> bool:
    """Whether a longer run of the loop does not do what is said of a shorter one."""
    seen, before = later.seen, case.seen.largest
    if kind in _FOLLOW:  # an arm may wander as it goes round, and come next to a singularity
        return seen.bad is not None or seen.size[case.steps :].max() > max(STRAYS * before, later.behind)
    if case.moving and kind not in _UNSTABLE_KINDS:  # the path that is to come is another
        return False
    if seen.bad is not None:
        return kind not in _UNSTABLE_KINDS
    if kind in _UNSTABLE_KINDS:
        calm = not seen.visible or seen.reversing < CALM
        rests = calm if kind == Behaviour.SHAKING else not seen.visible or seen.arrived or seen.largest < LESS * before
        return later.radius <= UNSTABLE and rests
    if kind in _STAY:
        return not SAME[0] * before <= seen.largest <= SAME[1] * before
    falls = seen.shrinks or bool(np.all(np.diff(seen.late) < 0) and seen.largest < SLOWLY * before)
    return seen.largest > FALLEN * before and not (falls or seen.arrived)


def _tried(case, trials, found):
    """(remedies with which the loop does better, as runs with them show, what is to be said of the others, whether runs
    were tried and none was long enough)."""
    kept, vain, N = [], [], 0
    for one in found:
        if only_longer(one.change, case.period):
            made, N = _long_enough(case, trials, one)
            kept += made
        elif not trials.possible(one):
            kept.append(_untried(one))
        elif any(one.mends == other.mends and set(one.change) == set(other.change) for other in kept):
            continue  # another value of an option of which one helps
        elif why := trials.vain(one):
            vain.append((why, one))
        else:
            kept.append(one)
    said = f"; runs of up to N = {N} steps were tried, and which one is long enough is not known" if N else ""
    mended = {one.mends for one in kept}
    left = {}
    for why, one in vain:
        if one.mends not in mended:
            left.setdefault(why, []).append(one.words)
    return tuple(kept), said + "".join(f"; tried, {why}: {', '.join(words)}" for why, words in left.items()), bool(N)


def _long_enough(case, trials, one):
    """A longer run that is long enough, as a tuple; where none of those tried is, an empty one, and their largest N."""
    tried, longer = 0, remedies.longer if one.mends == "verdict" else remedies.to_the_end
    for times in (1, 2, 4):
        (one,) = longer(case, times)
        if not trials.possible(one):
            break
        N = one.change["N"]
        if one.mends == "error":
            enough = not trials.vain(one) and trials.repeats(N)
        else:
            later, made = _decided(_longer(case, trials, N), trials)
            open_ = made.kind == Behaviour.UNDECIDED or made.slowly
            enough = made.kind in _UNSTABLE_KINDS or (not open_ and trials.repeats(N))
            if enough and made.kind == Behaviour.CONVERGING:  # as for a run of its own
                enough = not _tried(later, Trials(later), made.remedies)[-1]
        if enough:
            return (one,), 0
        tried = N
    return ((), tried) if tried else ((_untried(one),), 0)


def _untried(one):
    return replace(one, words=f"{one.words} (not tried)")


def _in_words(found) -> str:
    """Alternatives with "or"; what mends something else is a sentence of its own. A change is named once."""
    groups = {}
    for k, one in enumerate(found):
        if all(one.change != before.change for before in found[:k]):
            groups.setdefault(one.mends, []).append(one.words)
    first, *more = [", or ".join(words) for words in groups.values()] or [""]
    return ". ".join([first, *(words[0].upper() + words[1:] for words in more)])


@in_float64
def prepare(law, reference, q, *, Ts, method=DEFAULT, stage=picard(5), drive=Drive()) -> None:
    """Compile what `verdict` will ask of such a run: beside other work, for who is going to ask."""
    method, stage = checked(method, stage)
    resting(law, np.asarray(q, float), method, stage, drive).maps(np.ones(1), np.full(1, Ts, float))
