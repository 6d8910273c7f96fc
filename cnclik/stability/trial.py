"""Trial: what a remedy changes is changed and the loop is run again, before the remedy is named."""

from __future__ import annotations

import functools
import typing
from collections.abc import Callable

import jax
import numpy as np

from cnclik.integrate import stage as stages
from cnclik.integrate.drive import Drive
from cnclik.integrate.method import Method, named
from cnclik.integrate.solve import solve
from cnclik.integrate.stage import Stage
from cnclik.integrate.trajectory import truncate
from cnclik.law import inverse, limits
from cnclik.law.law import Law
from cnclik.law.paths import hold
from cnclik.law.reference import Reference, References, of_each
from cnclik.record import AnyArray, ArrayLike, Float, record, replace
from cnclik.stability.case import brief
from cnclik.stability.loop import UNSTABLE
from cnclik.stability.observed import ARRIVED, VISIBLE, back_and_forth, observe, rms
from cnclik.stability.reasons import INSIDE
from cnclik.stability.remedies import Remedy
from cnclik.stability.stacked import kinds

LEAST_TRIED = 1 << 12  # steps that a trial takes, at least; another power of two where more are asked for
MOST_TRIED = 1 << 15  # and at most, or as many as the run that is judged has
SHORTEST = 16  # steps of a run whose own program is used again, piece by piece
BETTER = 0.9  # ratio of two errors below which a loop does better
GONE = 0.25  # and below which a longer run has shrunk it
UNCHANGED = 0.8  # ratio of two shares of joint speed that go back and forth, above which a loop is no calmer
CALMER = 0.4  # ratio of two errors, or of the joint velocities that reverse, below which a loop is calmer
SLOWER = 0.75  # ratio of two joint velocities below which a loop is slower
NUDGE = 1e-10  # [rad, m] of the start, and a share of gain and feed-forward, to see whether a loop amplifies them
FARTHER = 1.1  # ratio of how far two loops get along a path that waits, from which on one gets farther
AS_GOOD = 2.0  # and of their errors, up to which they are no worse in kind
LEAST_WAY = 1e-9  # [m, rad]
LEAST_TURNS = 1e-3 * VISIBLE  # joint step [rad, m] back and forth that is rounding
HUGE = 1e300  # stands for what is not finite
VAIN = "and no better"
PLACES = ("center", "start", "end")  # what a shift moves of a path


@record
class Run:
    """A loop as `solve` takes it, the rotation that is wanted at its end, and the noise of its measured error."""

    law: Law
    reference: Reference | References
    q0: np.ndarray
    N: int
    method: Method
    stage: Stage
    drive: Drive
    turn: Float[np.ndarray, "3 3"] | None = None
    noise: ArrayLike | None = None


@record
class _Altered:
    curve: Callable
    shift: Float[AnyArray, " 3"] | None
    speed: Float[AnyArray, ""]

    def __call__(self, t):
        position, rotation = self.curve(self.speed * t)
        moved = position is not None and self.shift is not None
        return (position + self.shift[: len(position)] if moved else position), rotation


def changed(run: Run, change: dict) -> Run:
    law, change = run.law, dict(change)
    made = {"N": change.pop("N", run.N), "q0": np.asarray(change.pop("q0", run.q0), float)}
    made["method"] = named(change.pop("method")) if "method" in change else run.method
    made["drive"] = replace(run.drive, feedback=change.pop("feedback", run.drive.feedback))
    made["stage"] = getattr(stages, change.pop("stage"))(change.pop("M")) if "stage" in change else run.stage
    made["reference"] = _path(run, change)
    if change.pop("inverse", None) == "pseudoinverse":
        law = replace(law, inverse=inverse.pseudoinverse())
        change.pop("damping")
    if "damping" in change:
        law = replace(law, inverse=inverse.damped(np.asarray(change.pop("damping"), float)))
    if "damping_share" in change:
        share, levels = change.pop("damping_share"), typing.cast(inverse.Levels, law.inverse)
        each = (replace(one, damping=share * np.asarray(one.damping, float)) for one in levels.damping)
        law = replace(law, inverse=replace(levels, damping=tuple(each)))
    if "limits" in change:
        law = replace(law, limits=getattr(limits, change.pop("limits").replace("-", "_"))())
    if "null_gain" in change:
        law = replace(law, null_velocity=_slower(law.null_velocity, change.pop("null_gain")))
    numbers = ("alpha", "error_clamp", "feedforward")
    law = replace(law, **{name: np.asarray(change.pop(name), float) for name in numbers if name in change})
    assert not change, change
    return replace(run, law=law, **made)


def _path(run, change):
    """The reference with what a remedy changes of it, which is taken out of the change."""
    if "target" in change:
        return hold(np.asarray(change.pop("target"), float), run.turn)
    names = {"shift", "speed", "period"} & set(change)
    of_path = {name: np.asarray(change.pop(name), float) for name in names}
    return (
        of_each(lambda one, _: _changed_path(one, **of_path), run.reference, run.law.task) if names else run.reference
    )


def _changed_path(reference, shift=None, speed=np.ones(()), period=None):
    curve, shifted = reference.curve, shift is not None and shift.any()
    if getattr(reference, "still", False) and not shifted:
        return reference
    fields = [name for name in PLACES if getattr(curve, name, None) is not None]
    if speed != 1 or (shifted and not fields):
        feedforward = reference.feedforward
        reference = replace(reference, feedforward=None if feedforward is None else feedforward * speed)
        curve = _Altered(curve=curve, shift=shift, speed=speed)
    elif shifted:
        moved = {name: np.asarray(getattr(curve, name), float) for name in fields}
        curve = replace(curve, **{name: at + shift[: len(at)] for name, at in moved.items()})
    if period is not None:
        field = "period" if hasattr(curve, "period") else "duration"
        curve = replace(curve, **{field: period})
    return replace(reference, curve=curve)


def _slower(null, share):
    if hasattr(null, "rate"):
        return replace(null, rate=null.rate * share)
    return functools.partial(_times, null, share) if callable(null) else np.asarray(null) * share


def _times(null, share, *q):
    return jax.tree.map(lambda v: share * v, null(*q))


class Trials:
    """Runs of a case's loop, with remedies and without."""

    def __init__(self, case):
        Ts, method, stage, drive = case.loop
        how = dict(N=case.steps, method=method, stage=stage, drive=drive, turn=case.turn, **case.more)
        self.case, self.Ts = case, Ts
        self.given = Run(law=case.law, reference=case.reference, q0=case.q0, **how)
        self.nudge = _nudge(case)
        self.unchanged = functools.cache(lambda steps, *by: self._run(_nudged(self.given, *by), steps))
        self.mended = functools.cache(
            lambda one, steps, *by: self._run(_nudged(changed(self.given, one.change), *by), steps)
        )

    def longer(self, N):
        """The loop as it is, for N steps."""
        return truncate(self.unchanged(whole_trial(N)), N)

    def _run(self, made, steps):
        """The run of so many steps: by the program that the given run used, where that is one of single steps."""
        how = made.law, made.reference, made.q0, self.Ts, steps, made.method, made.stage
        if not (made.drive.prompt and made.noise is None):
            draws = np.random.default_rng(0).standard_normal((steps, made.law.task.m))
            noise = None if made.noise is None else made.noise * draws
            whole = solve(*how, t0=self.case.t[0], drive=made.drive, noise=noise)
            return jax.tree.map(np.asarray, whole)
        return jax.tree.map(np.asarray, solve(*how, t0=self.case.t[0]))

    def repeats(self, N) -> bool:
        """Whether a run of N steps is the loop's own: that of a chaotic one depends on roundings."""
        law, steps = self.given.law, whole_trial(N)  # one at the start dies out where the loop follows
        more = {name: (1 + NUDGE) * np.asarray(getattr(law, name), float) for name in ("alpha", "feedforward")}
        beside = replace(self.given, q0=self.given.q0 + NUDGE, law=replace(law, **more))
        q, other = (truncate(run, N).q for run in (self.unchanged(steps), self._run(beside, steps)))
        return bool(np.allclose(q, other, rtol=1e-3, atol=1e-3, equal_nan=True))

    def possible(self, remedy) -> bool:
        """Whether a remedy can be tried: errors of other coordinates are other errors, and long runs take long."""
        N = self.case.steps
        return "task" not in remedy.change and remedy.change.get("N", N) <= max(MOST_TRIED, N)

    def vain(self, remedy) -> str:
        """Why a remedy is none, in words; empty where the run does better with it, and nothing else gets worse.

        Better is an error whose largest and whose RMS value are smaller once it has settled, in the run's own steps or
        where it is run on, or joints that go back and forth less; along a path neither may be larger in either.
        """
        change, N, given = remedy.change, self.case.steps, self.case.seen
        after = change.get("N", N)
        if "dtype" in change:  # trials are in float64
            return "" if self._seen(self.unchanged(whole_trial(N))).largest < given.largest else VAIN
        steps = whole_trial(max(N, after))
        was, now = self.unchanged(steps, *self.nudge), self.mended(remedy, steps, *self.nudge)
        seen = self._seen(truncate(now, after))
        if remedy.mends == "velocity":
            better = not seen.too_fast or max(seen.excess, 1.0) < SLOWER * max(given.excess, 1.0)
        elif remedy.mends == "limits":
            better = float(seen.outside.max()) <= INSIDE
        else:
            better = self._nearer(remedy, was, now, after, seen)
        if not better:
            return VAIN
        if remedy.mends in ("velocity", "limits"):
            return "but with a larger error" if self._farther_off(was, now, after) else ""
        strains = not only_longer(change, self.case.period) and _strains(given, seen)
        return "but with joints farther beyond their limits" if strains else ""

    def _nearer(self, remedy, was, now, after, seen) -> bool:
        """Whether the error, or how the joints move, gets better.

        Args: after: steps of the run with the remedy. seen: what it shows.
        """
        change, N, given, moving = remedy.change, self.case.steps, self.case.seen, self.case.moving
        longer = only_longer(change, self.case.period)
        if remedy.mends == "error" and not self.case.law.task.of_one_tip:
            least = self._ratios(was, now, after)[:, :2].min()
            return bool(least < (GONE if longer else BETTER)) and not self._farther_off(was, now, after)
        gone = max(ARRIVED * given.size[0], given.floor)
        end, new_end = self._seen(was), self._seen(now)
        # Along a path errors come and go: the last quarter may be that in which nothing happens.
        in_the_end = max(times(late(end, k), late(new_end, k), gone).max() for k in ((1, 2) if moving else (1,)))
        here = times(late(given), late(seen), gone).max()
        follows = max(gone, self.case.behind)  # what is less than a sample behind
        largest, middle = times(late(given), late(seen), follows)
        if self.case.waits and not longer:  # a loop that shakes crawls along its path, with a small error
            gained = seen.way / max(given.way, LEAST_WAY)
            if gained < 1 / FARTHER and not here < GONE:
                return False
            no_worse = max(largest, times(late(end), late(new_end), follows).max()) <= AS_GOOD
            if gained > FARTHER and after == N and middle <= 1 and no_worse:
                return True
        if remedy.mends == "motion":
            early, new_early = (late(self._seen(truncate(run, 5 * N))) for run in (was, now))
            turns = self._turns(remedy, truncate(was, N), truncate(now, after), LEAST_TURNS)
            calmer = min(turns, in_the_end, times(early, new_early, gone).max()) < CALMER
            as_near = in_the_end <= 1 and not (moving and max(largest, middle) > 1)
            return as_near and calmer and self._turns(remedy, was, now, VISIBLE) <= 1
        if late(seen)[0] <= gone:
            return True
        if longer:
            return here < GONE
        return here < BETTER and (in_the_end <= 1 or bool({"shift", "period", "speed"} & set(change)))  # another path

    def _ratios(self, was, now, after):
        """(late in the run's own steps, late in the end) of the errors with a remedy, over those without, of each task
        [m] or [rad]; along a path at any time, too."""
        case, N = self.case, self.case.steps
        least, found = max(ARRIVED * case.seen.size.max(), case.seen.floor, case.behind), []
        for some in kinds(case.law.task):
            was_all, all_ = (np.linalg.norm(np.asarray(run.e, float)[:, some], axis=1) for run in (was, now))
            own_was, own = was_all[: N + 1], all_[: after + 1]
            spans = [
                (one[3 * len(one) // 4 :], other[3 * len(other) // 4 :])
                for one, other in ((own_was, own), (was_all, all_))
            ]
            spans += [(own_was, own), (was_all[len(was_all) // 2 :], all_[len(all_) // 2 :])] if case.moving else []
            sizes = np.nan_to_num([[one.max(), other.max()] for one, other in spans], nan=HUGE, posinf=HUGE)
            found.append(np.divide(*np.maximum(sizes, least).T[::-1]))
        return np.array(found)

    def _farther_off(self, was, now, after) -> bool:
        """Whether a task's error gets worse in kind: in the end, or along a path at any time."""
        return bool(self._ratios(was, now, after)[:, not self.case.moving :].max() > AS_GOOD)

    def _seen(self, run):
        return observe(self.case.law, run, self.Ts, self.case.seen.dtype)

    @np.errstate(over="ignore", invalid="ignore")
    def turned_by_path(self, case, found) -> bool:
        """Whether joints go back and forth as much with another gain: the path turns them.

        The gain is that of a remedy, which is stable, or half of the loop's own.

        Args: case: of the loop's run, or of a longer one.
        """
        if case.pace is None or not (case.pace.smooth and case.moving):
            return False
        half = Remedy(change={"alpha": 0.5 * np.asarray(case.law.alpha)}, words="half the gain", mends="motion")
        calm = next((one for one in found if "alpha" in one.change), half)
        made, N = changed(self.given, calm.change), case.steps
        steps = whole_trial(N)
        runs = truncate(self.mended(calm, steps), N), truncate(self.unchanged(steps), N)
        (calmed, speed), (shaking, all_of_it) = (self._back_and_forth(made.reference, run) for run in runs)
        return bool(calmed * all_of_it > UNCHANGED * shaking * speed)

    @np.errstate(over="ignore", invalid="ignore")
    def _turns(self, remedy, was, now, least):
        """How many times as large the joint speed that goes back and forth in the second half gets.

        Args: least: joint step [rad, m] that counts.
        """
        runs = (self.given.reference, was), (changed(self.given, remedy.change).reference, now)
        before, after = (np.nan_to_num(self._back_and_forth(*run)[0], nan=HUGE, posinf=HUGE) for run in runs)
        return times(min(before, HUGE), min(after, HUGE), least / self.Ts)

    def _back_and_forth(self, reference, run):
        return back_and_forth(run.qdot[len(run.qdot) // 2 - 1 :], brief(reference, run, self.Ts, None))


def _nudge(case) -> tuple:
    """What excites an unstable loop with a task that never left its target, as its error may be exactly 0; () else."""
    rests = any(np.abs(case.errors[:, some]).max() <= case.seen.floor for some in kinds(case.law.task))
    return (NUDGE,) if rests and case.radius > UNSTABLE else ()


def _nudged(run, by=0.0) -> Run:
    return replace(run, q0=run.q0 + by)


def late(seen, quarters=1):
    """(largest, RMS) error of what a run settles to, its last quarter, or two; huge where one is not finite."""
    size = np.concatenate([seen.before, seen.late]) if quarters > 1 else seen.late
    return np.full(2, HUGE) if seen.bad is not None else np.minimum([size.max(), rms(size)], HUGE)


def times(before, after, least=0.0) -> np.ndarray:
    """How many times as large numbers get. Args: least: of them that counts."""
    return np.maximum(after, least) / np.maximum(before, least)


def _strains(given, seen) -> bool:
    """Whether joints go farther beyond their limits, of velocity or of position, than they did."""
    faster = bool(seen.too_fast) and seen.excess > FARTHER * max(given.excess, 1.0)
    return faster or bool(np.any(seen.outside > FARTHER * given.outside + INSIDE))


def only_longer(change, period):
    """Whether a change makes the run longer, its path as it is, and nothing else."""
    return set(change) <= {"N", "period"} and change.get("period", period) == period


def whole_trial(N):
    """Steps of a trial of N."""
    return max(LEAST_TRIED, 1 << (N - 1).bit_length()) if N <= MOST_TRIED else N
