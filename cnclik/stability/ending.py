"""Ending: how a run ended, in a sentence, from its own steps and the scalar loop.

Nothing is run again. A cause is named only where the run shows it: a wall or limit that acted, a singular value, a
target that `reach` does not reach. The remedy follows from a formula, or there is none.
"""

from __future__ import annotations

import enum
import math

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive, check_drive
from cnclik.integrate.method import DEFAULT, MethodLike
from cnclik.integrate.stage import Stage, picard
from cnclik.integrate.status import Status, rounding_of
from cnclik.integrate.trajectory import Trajectory, check_run, one_lane
from cnclik.law.law import Law, check_loop, evaluate
from cnclik.law.reference import Reference
from cnclik.law.walls import names_of
from cnclik.measure.outcome import STALL_RATIO
from cnclik.precision import in_float64
from cnclik.quantities import aloud, plainly
from cnclik.record import ArrayLike, Number, record, replace
from cnclik.robot.model import modelled
from cnclik.robot.posture import arm_length
from cnclik.stability.advice import advise

ARRIVED = 1e-3  # of the first error: a loop whose error stays below has settled
GROWN = 1.2  # ratio of the middle errors of two quarters from which on an error grows
LOST = 4.0  # and of those of the last quarter and of all before, along a path
TURNS = 4  # reversals of a motion in a quarter of the run from which on it swings
STEADY = 0.8  # ratio of two swings below which a motion comes to rest
VISIBLE = 1e-5  # of 1 + the arm's length [m, rad]: a smaller swing of the error is not seen
REVERSING = 0.15  # share of the joint speed that the next step reverses, from which on a loop shakes
NOISE = 4.0  # an error below so many standard deviations is noise
RARE = 0.01  # share of the run's steps below which a limit that acts is not named
OFTEN = 0.5  # share of the last quarter's steps that a cause of rest must be in
EXPLAINED = 0.9  # share of an error's square that a lag must explain
AT_VELOCITY = 1 - 1e-6  # share of a velocity limit
PULLED = 0.1  # joint speed over that which is left without the posture term, below which the term holds the arm


class Behaviour(enum.StrEnum):
    """How a run ended."""

    SETTLED = "settled"
    FOLLOWING = "following"
    HELD_BACK = "held back"
    SWINGING = "swinging"
    GROWING = "growing"
    TOO_SHORT = "too short to tell"


@record
class Verdict:
    """How a run ended, and what to change.

    Attributes:
      kind: a `Behaviour`.
      sentence: it in words, with its numbers, and the remedy.
      remedy: what to change, in words; "" where no formula says it. change: {argument: value} of it.
      error: largest ‖e‖ in the last quarter [m, rad]; inf where the run is not finite.
      tasks: {name: what this task of a stack did, in words}.
    """

    kind: Behaviour
    sentence: str
    remedy: str
    change: dict
    error: float
    tasks: dict

    def __str__(self):
        return self.sentence


@in_float64
def verdict(
    law: Law,
    reference: Reference,
    run: Trajectory,
    *,
    Ts: Number,
    method: MethodLike = DEFAULT,
    stage: Stage = picard(5),
    drive: Drive | None = None,
    noise: ArrayLike | None = None,
) -> Verdict:
    """Return how a run ended: settled, following, held back, swinging or growing; or that it is too short to tell.

    It reads the run's last quarter, its statuses and the gains of its drives, and asks `reach` at most once.

    Args:
      law, reference, Ts, method, stage, drive: what was run, see `solve`.
      run: its `Trajectory`, one lane.
      noise: standard deviation of its measured error, a number or (m,).
    Raises: ArgumentError for a run of several lanes or of no step, or one of another law or Ts.
    """
    dtype = np.asarray(errors.kind("run", run, Trajectory).e).dtype
    check_loop(law, reference)
    one_lane(run)
    check_run(run, law)
    if len(run.residual) == 0:
        raise errors.fail("run", "have at least one step", "has none")
    step = float(run.t[-1] - run.t[0]) / len(run.residual)
    if not np.isclose(errors.number("Ts", Ts, positive=True), step, rtol=1e-2):
        raise errors.fail("Ts", f"be the run's, {step:.6g} s", f"is {float(Ts):g}")
    drive = check_drive(Drive() if drive is None else drive, law.chain)
    sigma = 0.0 if noise is None else float(np.linalg.norm(np.broadcast_to(np.asarray(noise, float), (law.task.m,))))
    return _Case(law, reference, run, float(Ts), method, stage, drive, sigma, dtype).verdict()


class _Case:
    """A run with what is asked of it."""

    def __init__(self, law, reference, run, Ts, method, stage, drive, sigma, dtype):
        self.law, self.reference, self.Ts, self.drive, self.sigma = law, reference, Ts, drive, sigma
        self.e, self.q, self.x, self.qdot = (np.asarray(v, float) for v in (run.e, run.q, run.x, run.qdot))
        self.t, self.status = np.asarray(run.t, float), np.asarray(run.status)
        self.walls = None if run.walls is None else np.asarray(run.walls, float)
        finite = np.isfinite(self.e).all(1) & np.isfinite(self.q).all(1)
        self.lost = None if finite.all() else int(np.argmin(finite))
        self.length, self.N = arm_length(law.chain), len(self.qdot)
        self.quarter = max(self.N // 4, 1)
        self.floor = 64 * np.finfo(dtype).eps * (1 + self.length)  # what rounding of q makes of an error
        self.still = bool(reference.still)
        tips = [at for name, at in law.task.each if not _of_joints(law.task, at)]  # a posture that yields is no error
        self.counted = np.concatenate([np.r_[at] for at in tips]) if tips else slice(None)
        try:
            self.advice, self.mixed = advise(law, Ts=Ts, method=method, stage=stage, drive=drive), ""
        except errors.ArgumentError as error:  # joints with different drives and tasks with different gains
            self.advice, self.mixed = None, str(error)

    # --- what is seen -------------------------------------------------------------------------------------

    def size(self, some=None):
        return np.linalg.norm(self.e[:, self.counted if some is None else some], axis=1)

    def late(self, some=None):
        """The errors of the last quarter, and those of the quarter before."""
        size = self.size(some)
        before = size[: -self.quarter][-self.quarter :]
        return size[-self.quarter :], before if before.size else size[:1]

    def arrived(self, some=None):
        """Whether the last quarter's errors are a small part of the first one, rounding or noise."""
        late, first = self.late(some)[0].max(), self.size(some)[0]
        return late <= max(ARRIVED * first if self.still else 0.0, self.floor, NOISE * self.sigma)

    def swing(self):
        """(largest swings of the error in the last quarter, and in the one before, reversals in the last quarter)."""

        def deviation(part):
            off = part - np.linspace(part[:3].mean(0), part[-3:].mean(0), len(part))
            return off @ np.linalg.svd(off, full_matrices=False)[2][0] if len(off) > 3 else np.zeros(len(off))

        e = self.e[:, self.counted]
        parts = [e[-self.quarter :], e[: -self.quarter][-self.quarter :]]
        off, before = (deviation(part) for part in parts)
        path = deviation((self.x + self.e)[-self.quarter :])
        size = np.abs(off).max(initial=0.0)
        turns = _turns(off, 0.3 * size) - 2 * _turns(path, 0.3 * np.abs(path).max(initial=0.0)) * (not self.still)
        return size, np.abs(before).max(initial=0.0), turns

    def shakes(self) -> bool:
        """Whether joints reverse from one step to the next in the last quarter."""
        qdot = self.qdot[-self.quarter :]
        back = np.where(qdot[1:] * qdot[:-1] < 0, np.minimum(np.abs(qdot[1:]), np.abs(qdot[:-1])), 0.0)
        return bool(np.linalg.norm(back) > REVERSING * np.linalg.norm(qdot))

    # --- why ----------------------------------------------------------------------------------------------

    def acted(self) -> tuple[np.ndarray, list[str]]:
        """(steps in which a limit or wall acted (N,), what acted, in words)."""
        chain, acted, words = self.law.chain, np.zeros(self.N, bool), []
        if self.law.limits is None:
            return acted, words
        named = [*names_of(getattr(self.law.limits, "walls", ()))] if self.walls is not None else []
        for i, name in enumerate(named):
            at = self.walls[:, i] <= rounding_of(self.qdot)[:, 0]
            words += [f"wall {name} held in {at.sum()} of {self.N} steps"] * bool(at.mean() >= RARE)
            acted |= at
        near = 1e-3 * (1 + np.abs(self.q[1:]))
        lower, upper = np.array(chain.lower, float), np.array(chain.upper, float)
        most = np.array(chain.velocity_limit, float)
        at_limit = ((self.q[1:] <= lower + near) | (self.q[1:] >= upper - near)) & (lower < upper)
        fast = np.abs(self.qdot) >= AT_VELOCITY * most
        for at, what in ((at_limit, "at a limit"), (fast, "at its velocity limit")):
            for i in np.flatnonzero(at.mean(0) >= RARE):
                words.append(f"joint {chain.joint_names[i]} was {what} in {at[:, i].sum()} of {self.N} steps")
            acted |= at.any(1)
        return acted, words

    def often(self, bit) -> bool:
        return bool(np.mean((self.status[-self.quarter :] & int(bit)) != 0) >= OFTEN)

    def unreachable(self) -> str:
        """How far the nearest posture is from the last targets, in words; "" where that is 0 or unknown."""
        from cnclik.reaching.public import reach  # most runs do not need it
        from cnclik.reaching.result import ReachStatus
        from cnclik.reaching.targets import wanted_at

        if self.law.chain.balls:
            return ""
        try:
            task, targets = wanted_at(self.reference, self.law.task, self.t[-1])
            nearest = reach(
                self.law.chain, targets, task=replace(task, weights=None), tolerance=(1e-4, 1e-4),
                limits=self.law.limits is not None,
            )  # fmt: skip
        except errors.ArgumentError:  # of joint values and functions of one's own alone
            return ""
        if nearest.status not in (ReachStatus.OUT_OF_REACH, ReachStatus.AT_LIMIT):
            return ""
        far = [aloud(float(nearest.position_error), "m")] * bool(task.lengths)
        far += [aloud(float(nearest.orientation_error), "rad")] * bool(task.angles)
        kept = " within the joint limits" * bool(nearest.status == ReachStatus.AT_LIMIT)
        return f"out of reach: the nearest posture found{kept} is {' and '.join(far)} away"

    def pulled(self) -> bool:
        """Whether the posture term holds the arm: without it the joints would move."""
        if self.law.null_velocity is None:
            return False
        free = replace(self.law, null_velocity=None)
        qdot = evaluate(modelled(free), self.reference, jnp.asarray(self.t[-1]), jnp.asarray(self.q[-1])).qdot
        return bool(np.linalg.norm(self.qdot[-1]) < PULLED * np.linalg.norm(np.asarray(qdot)))

    def cause(self) -> str:
        """What holds the robot where it rests away from its target, in words; "" where the run does not show it."""
        acted, words = self.acted()
        if not np.any(np.asarray(self.law.alpha)):
            return "the gain is 0"
        held = "; ".join(words) if acted[-self.quarter :].mean() >= OFTEN else ""
        if far := self.unreachable():
            return "; ".join(filter(None, [far, held]))
        if held:
            return held
        if self.often(Status.NEAR_SINGULAR):
            return "next to a singularity"
        if self.pulled():
            return "the posture term pulls at the task, as I − J#J of a damped J# is no projector"
        return "its tasks share the joints and contradict each other there" if self.law.task.tasks else ""

    def lag(self) -> str:
        """The lag behind the path, where one explains the errors of lengths."""
        lengths = list(self.law.task.lengths)
        wanted = np.gradient(self.x[:, lengths] + self.e[:, lengths], self.Ts, axis=0)[-self.quarter :]
        e, speed = self.e[-self.quarter :, lengths], np.sum(wanted**2)
        if not speed:
            return ""
        late = np.sum(wanted * e) / speed
        left = np.sum((e - late * wanted) ** 2)
        return f", as a lag of {1e3 * late:.3g} ms explains" if left <= (1 - EXPLAINED) * np.sum(e**2) else ""

    # --- the answer ---------------------------------------------------------------------------------------

    def verdict(self) -> Verdict:
        kind, what, change, remedy = self._judged()
        over = self._over_velocity()
        tasks = {} if self.lost is not None else {name: self._task(at) for name, at in self.law.task.each}
        words = "; ".join(filter(None, [what, *(f"{k} {v}" for k, v in tasks.items()), over]))
        if over and not remedy:
            change, remedy = (
                {"limits": "velocity_scaling"},
                "limits of velocity_scaling or bounded keep joint velocities within those of the robot",
            )
        tail = f" {remedy[0].upper()}{remedy[1:]}." if remedy else ""
        return Verdict(
            kind=kind,
            sentence=f"{kind}: {words}.{tail}",
            remedy=remedy,
            change=change,
            error=np.inf if self.lost is not None else float(self.late()[0].max()),
            tasks=tasks,
        )

    def _judged(self):
        if self.lost is not None:
            what = f"not finite from t = {self.t[self.lost]:.4g} s on (step {self.lost})"
            return Behaviour.GROWING, what, *self._lower()
        late, before = self.late()
        said = f"over the last quarter of the run the error is at most {self._largest()}"
        if self.N < 8:
            return Behaviour.TOO_SHORT, f"{said} after {self.N} steps", {}, ""
        swing, swung, turns = self.swing()
        seen = swing > max(VISIBLE * (1 + self.length), NOISE * self.sigma) and not self.arrived()
        swings = seen and (self.shakes() or (turns >= TURNS and swing >= STEADY * swung))
        grown = np.median(late) > GROWN * np.median(before) and late.max() > max(before.max(), self.floor)
        if self.still:
            grown |= np.median(late) > GROWN * max(self.size()[0], self.floor)
        else:
            grown = np.median(late) > LOST * max(np.median(self.size()[: -self.quarter]), self.floor) and grown
        held = self._held()
        if held and (self.still or not grown):
            also = f"; it swings by {self._along(swing)}" * bool(swings)
            return Behaviour.HELD_BACK, f"{held}; {said}{also}", *(self._calmer(late.max()) if swings else ({}, ""))
        if grown or (swings and swing > GROWN * swung and swung > self.floor):
            return Behaviour.GROWING, said, *self._lower()
        if swings:
            period = f" with a period of about {2 * self.quarter * self.Ts / turns:.2g} s" * (turns >= TURNS)
            return Behaviour.SWINGING, f"{said}; it swings{period}", *self._lower()
        if self.still and self.arrived():
            return Behaviour.SETTLED, said, *self._unstable()
        if not self.still:
            return Behaviour.FOLLOWING, f"{said}{self.lag() if late.max() > self.floor else ''}", *self._unstable()
        if late.max() < STALL_RATIO * before.max():
            left = late.max() / before.max()
            goal = max(ARRIVED * self.size()[0], self.floor)
            steps = (
                self.N - self.quarter + self.quarter * math.log(goal / late.max()) / math.log(left) if left > 0 else 0
            )
            more = math.ceil(1.01 * steps / 0.75)  # the last quarter then begins there
            what = f"{said}, {100 * left:.2g} % of that in the quarter before"
            longer = ({"N": more}, f"run {more} steps") if self.N < more <= errors.MOST else ({}, "")
            return Behaviour.TOO_SHORT, what, *longer
        return Behaviour.HELD_BACK, f"{self.cause() or 'the run does not show by what'}; {said} and stays", {}, ""

    def _held(self) -> str:
        """What acts against the motion while the error is large, in words; "" where nothing does."""
        late = self.late()[0]
        acted, words = self.acted()
        if self.still:
            rests = late.max() >= STALL_RATIO * self.late()[1].max() and not self.arrived()
            return self.cause() if rests else ""
        size = self.size()[1:]
        if not words or (acted.all() and self.lag()):
            return ""
        free = np.median(size[~acted]) if not acted.all() else 0.0
        if size[acted].max() <= max(2 * free, 10 * self.floor):
            return ""
        return f"{'; '.join(words)}; while they acted the error was up to {self._largest(np.flatnonzero(acted) + 1)}"

    def _largest(self, instants=None, some=None) -> str:
        """The largest errors with their units, such as "1.2 mm and 0.3 rad"; by default of the last quarter."""
        own = np.arange(self.law.task.m)[self.counted if some is None else some]
        units = np.array([u if u in ("m", "rad") else "" for u in np.array(self.law.task.units)[own]])
        e = self.e[-self.quarter :] if instants is None else self.e[instants]
        if np.linalg.norm(e[:, own], axis=1).max() <= self.floor:
            return "rounding"
        each = ((own[units == u], u) for u in ("m", "rad", ""))
        return " and ".join(aloud(float(np.linalg.norm(e[:, at], axis=1).max()), u) for at, u in each if at.size)

    def _along(self, size) -> str:
        units = set(self.law.task.units)
        return aloud(float(size), units.pop()) if len(units) == 1 else f"{size:.3g} [m, rad]"

    def _task(self, at) -> str:
        late, before = self.late(at)
        alpha = np.broadcast_to(np.asarray(self.law.alpha, float), (self.law.task.m,))
        if not alpha[at].any():
            state = "no gain"
        elif self.arrived(at):
            state = "settled"
        elif not self.still:
            state = "following"
        else:
            state = "shrinking" if late.max() < STALL_RATIO * before.max() else "stays"
        return f"{self._largest(some=at)} ({state})"

    def _over_velocity(self) -> str:
        if self.law.limits is not None or not np.any(self.status & int(Status.OVER_VELOCITY)):
            return ""
        ratio = np.nan_to_num(np.abs(self.qdot) / np.maximum(np.array(self.law.chain.velocity_limit, float), 1e-12))
        steps = int(np.sum(self.status & int(Status.OVER_VELOCITY) != 0))
        return (
            f"{steps} of {self.N} steps exceed a joint's velocity limit, by up to {plainly(100 * (ratio.max() - 1))} %"
        )

    # --- remedies: one, from a formula ----------------------------------------------------------------------

    def _lower(self):
        """The recommended gain, where one is above that without overshoot; else damping, next to a singularity."""
        if self.advice is not None and self.advice.gains.recommended:
            tasks = [one for one in self.advice.rates if one.kind == "task"]
            most = self.advice.gains
            high = [one for one in tasks if one.rate > most.without_overshoot * (1 + 1e-9)]
            if high and self.law.task.tasks:
                words = f"give {' and '.join(one.name for one in high)} an alpha of at most {most.recommended:.4g} 1/s"
                return {"alpha": {one.name: most.recommended for one in high}}, words
            if high:
                return {"alpha": most.recommended}, f"use an alpha of at most {most.recommended:.4g} 1/s"
        if np.any(self.status & int(Status.NEAR_SINGULAR)) and np.isfinite(self.law.chain.velocity_limit).any():
            near = np.flatnonzero(self.status & int(Status.NEAR_SINGULAR))
            near = near[np.isfinite(self.e[near]).all(1)]
            if len(near):
                speed = float(np.max(np.asarray(self.law.alpha, float)) * self.size()[near[0]])
                damping = float(f"{speed / (2 * np.min(np.array(self.law.chain.velocity_limit, float))):.1g}")
                words = f"near the singularity use a damping of {damping:g}"
                return {"damping": damping}, f"{words}, which keeps joint velocities below |v|/(2 λ)"
        return {}, ""

    def _calmer(self, error):
        """The damping with which a step towards a target out of reach contracts: λ² > alpha Ts ‖e‖ c/2, c the arm's
        curvature, at most its length."""
        if not hasattr(self.law.inverse, "damping") or np.ndim(self.law.inverse.damping):
            return {}, ""
        z = float(np.max(np.asarray(self.law.alpha, float))) * self.Ts
        damping = math.sqrt(z * error * self.length / 2)
        damping = math.ceil(100 * damping) / 100
        if damping <= float(self.law.inverse.damping):
            return self._lower()
        return {"damping": damping}, f"a damping of {damping:g} lets it rest in front of the target"

    def _unstable(self):
        """The recommended gain, of a run that is calm with a gain above the largest stable one."""
        if self.advice is None or not self.advice.unstable:
            return {}, ""
        change, words = self._lower()
        return (
            change,
            f"{', '.join(self.advice.unstable)} above the largest stable gain, so a disturbance may grow: {words}"
            if words
            else "",
        )


def _of_joints(task, at) -> bool:
    """Whether the coordinates of a task are joint values."""
    return all(
        hasattr(p, "wanted") for p, own in zip(task.parts, task.slices, strict=True) if at.start <= own.start < at.stop
    )


def _turns(values, least) -> int:
    """Number of sign changes among the values larger than `least`."""
    large = values[np.abs(values) > max(least, 0.0)]
    return int(np.sum(large[1:] * large[:-1] < 0)) if len(large) > 1 else 0
