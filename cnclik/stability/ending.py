"""Ending: how a run ended, in a sentence, from its own steps and the scalar loop.

Nothing is run again. A cause is named only where the run shows it. A remedy follows from a formula, or there is none.
"""

from __future__ import annotations

import enum
import functools
import math

import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive, check_drive
from cnclik.integrate.method import DEFAULT, MethodLike
from cnclik.integrate.stage import Stage, picard
from cnclik.integrate.status import Status, rounding_of
from cnclik.integrate.trajectory import Trajectory, check_run
from cnclik.law.law import Law, check_loop, metric
from cnclik.law.paths import Reference
from cnclik.measure.outcome import STALL_RATIO
from cnclik.precision import in_float64_if_known, of_numbers
from cnclik.quantities import aloud
from cnclik.record import ArrayLike, record, replace
from cnclik.robot.posture import arm_length
from cnclik.stability.advice import ROUNDING, advise
from cnclik.task.parts import Joints

ARRIVED = 1e-3  # of the first error: a loop whose error stays below has settled, as in `outcome`
GROWN = 1.2  # ratio of two quarters' errors or swings from which on they grow; at its inverse a swing comes to rest
LARGE = 4.0  # errors of a path, or by noise, differ by less from quarter to quarter
TURNS = 4  # reversals of a motion in a quarter of the run from which on it swings: two whole periods
MOVES = 0.1  # of the error: one that swings by more, or is elsewhere than in the quarter before, does not stay
BESIDE = 0.25  # of the way of a target: with an unstable gain an error that is larger is not called following
VISIBLE = 1e-5  # of 1 + the arm's length [m, rad]: a smaller swing of the error is not seen
REVERSING = 0.15  # share of the joint speed that the next step reverses, from which on a loop shakes
NOISE = 4.0  # an error below so many standard deviations is noise
RARE, OFTEN = 0.01, 0.5  # shares of steps: a limit that acts more rarely is not named; a cause of rest acts that often
FAR = 0.1  # of the arm's length: a path's error from which on it is asked whether the target can be reached
EXPLAINED = 0.9  # share of an error's square that a lag must explain
AT_LIMIT = 1e-3  # of 1 + a joint value, or of a velocity limit: as near a joint is at its limit
NO_REMEDY: tuple[dict, str] = {}, ""


class Behaviour(enum.StrEnum):
    """Ways in which a run ends."""

    SETTLED = "settled"
    FOLLOWING = "following"
    HELD_BACK = "held back"
    SWINGING = "swinging"
    GROWING = "growing"
    TOO_SHORT = "too short to tell"


@record
class Verdict:
    """How a run ended, and what to change."""

    kind: Behaviour  # in a word
    sentence: str  # it in words, with its numbers, and the remedy
    remedy: str  # what to change, in words; "" where no formula says it
    change: dict  # {argument: value} of the remedy
    error: float  # largest ‖e‖ in the last quarter [m, rad]; inf where the run is not finite
    tasks: dict  # {name: what this task of a stack did, in words}

    def __str__(self):
        return self.sentence


@of_numbers
def verdict(
    law: Law,
    reference: Reference,
    run: Trajectory,
    *,
    method: MethodLike = DEFAULT,
    stage: Stage = picard(5),
    drive: Drive | None = None,
    noise: ArrayLike | None = None,
) -> Verdict:
    """Return how a run ended: settled, following, held back, swinging or growing; or that it is too short to tell.

    It reads the run's last quarter, its statuses and the gains of its drives, and asks `reach` at most once.

    Args:
      law, reference, run, method, stage, drive: what was run, see `solve`, and its `Trajectory` of one lane.
      noise: standard deviation of its measured error, a number or (m,).
    Raises: ArgumentError for a run of several lanes or of no step, or one of another law.
    """
    dtype = errors.kind("run", run, Trajectory).e.dtype
    return _verdict(law, reference, run, dtype, method, stage, drive, noise)


@in_float64_if_known
def _verdict(law, reference, run, dtype, method, stage, drive, noise) -> Verdict:
    check_loop(law, reference)
    check_run(run, law, lanes=False)
    if len(run.residual) == 0:
        raise errors.fail("run", "have at least one step", "has none")
    Ts = float(run.t[-1] - run.t[0]) / len(run.residual)
    drive = check_drive(Drive() if drive is None else drive, law.chain)
    noise = errors.array("noise", 0.0 if noise is None else noise, (), (law.task.m,), at_least=0)
    sigma = float(np.linalg.norm(np.broadcast_to(noise, (law.task.m,))))
    try:
        advice = advise(law, Ts=Ts, method=method, stage=stage, drive=drive)
    except errors.ArgumentError:  # joints with different drives and tasks with different gains: no gain is safe
        advice = None
    return _Case(law, reference, run, Ts, advice, sigma, dtype).verdict()


class _Case:
    def __init__(self, law, reference, run, Ts, advice, sigma, dtype):
        self.law, self.reference, self.Ts, self.advice, self.sigma = law, reference, Ts, advice, sigma
        self.e, self.q, self.x, self.qdot = (np.asarray(v, float) for v in (run.e, run.q, run.x, run.qdot))
        self.t, self.status, self.walls = np.asarray(run.t, float), np.asarray(run.status), run.walls
        self.finite = np.isfinite(self.e).all(1) & np.isfinite(self.q).all(1)
        self.N, self.length, self.still = len(self.qdot), arm_length(law.chain), bool(reference.still)
        quarter = max(self.N // 4, 1)
        self.last, self.before = slice(-quarter, None), slice(-2 * quarter, -quarter)  # quarters of the run
        self.earlier = slice(-3 * quarter, -2 * quarter)
        self.floor = 64 * np.finfo(dtype).eps * (1 + self.length)  # what rounding of q makes of an error
        task = law.task  # of which a posture that yields is no error
        tips = [at for name, at in task.each if not all(isinstance(part, Joints) for part in task.alone(name).parts)]
        self.counted = np.arange(task.m)[np.r_[tuple(tips)] if tips else slice(None)]
        self.lengths = [i for i in task.lengths if i in self.counted]
        self.alpha = np.broadcast_to(np.asarray(law.alpha, float), (task.m,))
        self.most = np.array(law.chain.velocity_limit, float)
        self.size = np.linalg.norm(self.e[:, self.counted], axis=1)
        self.least, self.apart = max(self.floor, NOISE * sigma), LARGE if sigma else GROWN  # of errors that count
        self.above = advice is not None and bool(advice.unstable)  # a gain is above the largest stable one
        self.error = self.peak(self.last) if self.finite.all() else np.inf

    def verdict(self) -> Verdict:
        kind, words, (change, remedy) = self.judged()
        tasks = {name: self.of_task(at, kind) for name, at in self.law.task.each} if self.finite.all() else {}
        words = "; ".join([words, *(f"{name} {what}" for name, what in tasks.items())])
        said = f"{kind}: {words}." + (f" {remedy[0].upper()}{remedy[1:]}." if remedy else "")
        return Verdict(kind=kind, sentence=said, remedy=remedy, change=change, error=float(self.error), tasks=tasks)

    def judged(self) -> tuple[Behaviour, str, tuple[dict, str]]:
        """The ending, what is said of it, and its remedy."""
        if not self.finite.all():
            k = int(np.argmin(self.finite))
            return Behaviour.GROWING, f"not finite from t = {self.t[k]:.4g} s on (step {k})", self.lower_gain()
        said = f"over the last quarter of the run the error is at most {self.largest()}"
        if self.N < 2 * TURNS:
            return Behaviour.TOO_SHORT, f"{said} after {self.N} steps", NO_REMEDY
        swing, before, turns = self.swing()
        seen = swing > max(VISIBLE * (1 + self.length), NOISE * self.sigma) and not self.arrived()
        swings = seen and (self.shakes() or (turns >= TURNS and swing >= before / GROWN))
        drift = np.linalg.norm((self.e[self.last].mean(0) - self.e[self.before].mean(0))[self.counted])
        changes = max(swing * seen, drift) > MOVES * self.error
        moves = self.still and changes and not swings
        held, grows = self.held(), self.grows()
        too_large = self.above and (swings or grows)  # a gain, whatever else acts
        if held and not too_large:
            if moves:
                return Behaviour.TOO_SHORT, f"{held}; {said}, and still changes", self.unstable()
            also = "; it swings" * bool(swings)
            return Behaviour.HELD_BACK, f"{held}; {said}{also}", self.more_damping() if swings else NO_REMEDY
        if grows or (swings and swing > self.apart * before and before > self.floor):
            return Behaviour.GROWING, said, self.lower_gain()
        if swings:
            cause = self.cause() if self.still and not too_large else ""
            return Behaviour.SWINGING, "; ".join(filter(None, [cause, said])), self.lower_gain()
        if not self.still:
            if self.above and self.beside() > BESIDE:
                return Behaviour.TOO_SHORT, said, self.unstable()
            return Behaviour.FOLLOWING, said + (self.lag() if self.error > self.floor else ""), self.unstable()
        if self.arrived():
            return Behaviour.SETTLED, said, self.unstable()
        if self.shrinks():
            left = self.error / self.peak(self.before)
            return Behaviour.TOO_SHORT, f"{said}, {100 * left:.2g} % of that in the quarter before", NO_REMEDY
        if moves:
            return Behaviour.TOO_SHORT, f"{said}, and still changes", self.unstable()
        if self.N * self.Ts < self.takes():
            words = f"{said}; a loop of this gain and drive settles later than these {self.N * self.Ts:.3g} s"
            return Behaviour.TOO_SHORT, words, self.unstable()
        why = "its tasks contradict each other there" if self.law.task.tasks else "the run does not show by what"
        return Behaviour.HELD_BACK, f"{why}; {said} and stays", self.unstable()

    def peak(self, instants, some=None):
        """The largest ‖e‖ at some instants, of some coordinates; by default of all that count."""
        return np.linalg.norm(self.e[instants][:, self.counted if some is None else some], axis=1).max()

    def arrived(self, some=None) -> bool:
        """Whether the last quarter's errors are a small part of the first one, rounding or noise."""
        small = ARRIVED * self.still * self.peak([0], some)
        return self.peak(self.last, some) <= max(small, self.least)

    def shrinks(self, some=None) -> bool:
        """Whether the errors still become smaller."""
        return self.peak(self.last, some) < STALL_RATIO * self.peak(self.before, some)

    def grows(self) -> bool:
        """Whether errors grow from quarter to quarter, or have become larger than the first one, or than their path."""
        last, before, earlier = (np.median(self.size[part]) for part in (self.last, self.before, self.earlier))
        whole = np.linalg.norm(metric(self.law) * self.e, axis=1)
        falls = whole[self.last].max() < GROWN * min(whole[0], whole[self.before].max())
        if self.law.task.tasks and falls and not self.above:  # a task may give way to others
            return False
        grown = last > self.apart * before and self.error > max(self.peak(self.before), self.least)
        if self.still:  # one that passes its target has a small quarter before its largest swing
            more = last > GROWN * max(self.size[0], self.least) and (self.above or not self.shrinks())
            return more or (grown and before > earlier)
        farther = self.error > max(self.size[0], self.least) and self.beside() > 1
        return farther or (grown and last > LARGE * max(np.median(self.size[: self.last.start]), self.least))

    def beside(self) -> float:
        """The largest error of lengths over the way of their target; 0 without lengths."""
        way = np.linalg.norm(np.ptp((self.x + self.e)[:, self.lengths], axis=0))
        return self.peak(self.last, self.lengths) / max(way, self.floor) if self.lengths else 0.0

    def swing(self):
        """(largest swing in the last quarter, that in the quarter before, reversals beside those of the path)."""
        each = [_deviation(self.e[part][:, self.counted]) for part in (self.last, self.before)]
        path = 0 if self.still else _turns(_deviation((self.x + self.e)[self.last]))
        return *(np.abs(beside).max(initial=0.0) for beside in each), _turns(each[0]) - 2 * path

    def shakes(self) -> bool:
        """Whether joints reverse from one step to the next in the last quarter."""
        qdot = self.qdot[self.last]
        back = np.where(qdot[1:] * qdot[:-1] < 0, np.minimum(np.abs(qdot[1:]), np.abs(qdot[:-1])), 0.0)
        return bool(np.linalg.norm(back) > REVERSING * np.linalg.norm(qdot))

    def lag(self) -> str:
        """The lag behind the path, where one explains the errors of lengths."""
        wanted = np.gradient(self.x[:, self.lengths] + self.e[:, self.lengths], self.Ts, axis=0)[self.last]
        e, speed = self.e[self.last][:, self.lengths], np.sum(wanted**2)
        lag = np.sum(wanted * e) / speed if speed else np.nan
        explains = speed > 0 and np.sum((e - lag * wanted) ** 2) <= (1 - EXPLAINED) * np.sum(e**2)
        return f", as a lag of {1e3 * lag:.3g} ms explains" if explains else ""

    def largest(self, instants=None, some=None) -> str:
        """The largest errors with their units, such as "1.2 mm and 0.3 rad"; by default of the last quarter."""
        axes = self.counted if some is None else np.arange(self.law.task.m)[some]
        units = np.array([u if u in ("m", "rad") else "" for u in np.array(self.law.task.units)[axes]])
        e = self.e[self.last if instants is None else instants][:, axes]
        each = {u: np.linalg.norm(e[:, units == u], axis=1).max() for u in ("m", "rad", "") if u in units}
        if max(each.values()) <= self.floor:
            return "rounding"
        return " and ".join(aloud(float(size), unit) for unit, size in each.items())

    def of_task(self, at, kind) -> str:
        """What a task of a stack did, in words; its error alone where the run shakes or is too short to tell."""
        rests = "still falls" if self.shrinks(at) else "stays"
        state = "settled" if self.arrived(at) else rests if self.still else "following"
        says = state == "settled" or kind in ("settled", "following", "held back")
        return f"{self.largest(some=at)}{f' ({state})' * says}"

    def held(self) -> str:
        """What acts against the motion while the error is large, in words; "" where nothing does."""
        if self.still:
            return "" if self.shrinks() or self.arrived() else self.cause()
        (acted, words), lag = self.acted(), self.lag()
        far = self.unreachable if self.error > FAR * self.length and not lag else ""
        if not words or (acted.all() and lag):
            return far
        when, usual = np.flatnonzero(acted) + 1, 0.0 if acted.all() else np.median(self.size[1:][~acted])
        there = np.argmax(np.diff(self.size) >= 0)  # until then it only came nearer to its path
        when = when[(when > there) | (there > self.N + self.last.start)]
        if not when.size or self.peak(when) <= max(2 * usual, 10 * self.floor):
            return far
        words += f"; while they acted the error was up to {self.largest(when)}"
        return "; ".join(filter(None, [far, words]))

    def cause(self) -> str:
        """What holds the robot where it rests away from its target, in words; "" where the run does not show it."""
        if not self.alpha[self.counted][np.argmax(np.abs(self.e[-1, self.counted]))]:
            return "the gain is 0"
        acted, held = self.acted()
        held = held if acted[self.last].mean() >= OFTEN else ""
        if causes := "; ".join(filter(None, [self.unreachable, held])):
            return causes
        if np.mean((self.status[self.last] & Status.NEAR_SINGULAR) != 0) >= OFTEN:
            return "next to a singularity"
        return ""

    def acted(self) -> tuple[np.ndarray, str]:
        """(steps in which a limit or wall acted (N,), what acted, in words)."""
        chain, limits = self.law.chain, self.law.limits
        if limits is None:
            return np.zeros(self.N, bool), ""
        q, lower, upper = self.q[1:], np.array(chain.lower, float), np.array(chain.upper, float)
        near = AT_LIMIT * (1 + np.abs(q))
        stopped = ((q <= lower + near) | (q >= upper - near)) & (lower < upper)
        fast = np.abs(self.qdot) >= (1 - AT_LIMIT) * self.most
        acts = {}
        if self.walls is not None:
            held = np.asarray(self.walls, float) <= rounding_of(self.qdot)
            acts |= {f"wall {wall.name} held": steps for wall, steps in zip(limits.walls, held.T, strict=True)}
        for steps, where in ((stopped, "at a limit"), (fast, "at its velocity limit")):
            acts |= {f"joint {name} was {where}": own for name, own in zip(chain.joint_names, steps.T, strict=True)}
        words = [f"{what} in {steps.sum()} of {self.N} steps" for what, steps in acts.items() if steps.mean() >= RARE]
        return np.any(list(acts.values()), axis=0), "; ".join(words)

    @functools.cached_property
    def unreachable(self) -> str:
        """How far the nearest posture is from the targets at the largest error of the last quarter, in words; "" where
        that is 0 or unknown."""
        from cnclik.reaching.public import reach  # most runs do not need it
        from cnclik.reaching.result import ReachStatus
        from cnclik.reaching.targets import wanted_at

        try:
            worst = self.t[self.last][np.argmax(self.size[self.last])]
            task, targets = wanted_at(self.reference, self.law.task, worst)
            task, limited = replace(task, weights=None), self.law.limits is not None
            nearest = reach(self.law.chain, targets, task=task, tolerance=(1e-4, 1e-4), limits=limited)
        except errors.ArgumentError:  # of a free base, of joint values and functions of one's own alone
            return ""
        if nearest.status not in (ReachStatus.OUT_OF_REACH, ReachStatus.AT_LIMIT):
            return ""
        sizes = ((task.lengths, nearest.position_error, "m"), (task.angles, nearest.orientation_error, "rad"))
        far = " and ".join(aloud(float(size), unit) for axes, size, unit in sizes if axes)
        kept = " within the joint limits" * bool(nearest.status == ReachStatus.AT_LIMIT)
        when = "" if self.still else f" at t = {worst:.4g} s"
        return f"out of reach{when}: the nearest posture found{kept} is {far} away"

    def takes(self) -> float:
        """The time in which a linear loop with the least gain that counts settles [s]; 0 where that is not known."""
        rates = self.alpha[self.counted]
        if self.advice is None or not rates.any():
            return 0.0
        response = self.advice.gains.at(rates[rates > 0].min())
        return 0.0 if response is None else response.settling_time

    def lower_gain(self) -> tuple[dict, str]:
        """The recommended gain, where one is above that without overshoot; else damping, next to a singularity."""
        if self.advice is not None and (gains := self.advice.gains).recommended:
            tasks = [rate for rate in self.advice.rates if rate.kind == "task"]
            high = [rate.name for rate in tasks if rate.rate > gains.without_overshoot * (1 + ROUNDING)]
            several, words = bool(self.law.task.tasks), f"use an alpha of at most {gains.recommended:.4g} 1/s"
            if high:
                alpha = dict.fromkeys(high, gains.recommended) if several else gains.recommended
                return {"alpha": alpha}, words + f" for {' and '.join(high)}" * several
        near = np.flatnonzero(self.finite[:-1] & (self.status & Status.NEAR_SINGULAR != 0))
        slowest = self.most.min(initial=np.inf)
        if not near.size or not np.isfinite(slowest):
            return NO_REMEDY
        damping = float(f"{np.linalg.norm((self.alpha * self.e)[near[0], self.counted]) / (2 * slowest):.1g}")
        if damping >= self.length:  # not steadied by that, but stopped
            return NO_REMEDY
        words = f"near the singularity use a damping of {damping:g}, which keeps joint velocities below |v|/(2 λ)"
        return {"damping": damping}, words

    def more_damping(self) -> tuple[dict, str]:
        """The damping with which a step towards a target out of reach contracts: λ² > alpha Ts ‖e‖ c/2, c the arm's
        curvature, at most its length."""
        damping = getattr(self.law.inverse, "damping", None)
        if damping is None or np.ndim(damping):
            return NO_REMEDY
        needed = math.ceil(100 * math.sqrt(self.alpha.max() * self.Ts * self.error * self.length / 2)) / 100
        if needed <= float(damping):
            return self.lower_gain()
        return {"damping": needed}, f"a damping of {needed:g} keeps it calm in front of the target"

    def unstable(self) -> tuple[dict, str]:
        """The recommended gain, of a run that is calm with a gain above the largest stable one."""
        if not self.above:
            return NO_REMEDY
        change, words = self.lower_gain()
        high = f"with {', '.join(self.advice.unstable)} above the largest stable gain a disturbance may grow"
        return change, words and f"{words}; {high}"


def _deviation(part):
    """Return the largest component of values (k, m) beside the straight line between their ends."""
    if len(part) < 4:
        return np.zeros(len(part))
    beside = part - np.linspace(part[:3].mean(0), part[-3:].mean(0), len(part))
    return beside @ np.linalg.svd(beside, full_matrices=False)[2][0]


def _turns(values) -> int:
    """Return the number of sign changes among values that are not small."""
    large = values[np.abs(values) > 0.3 * np.abs(values).max(initial=0.0)]
    return int(np.sum(large[1:] * large[:-1] < 0))
