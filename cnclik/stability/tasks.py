"""Tasks of a stack at rest: the gains that each tolerates, its share of the motion that it asks for, and its effect.

With J# = Jᵀ (J Jᵀ + D)⁻¹ the rates of the loop, the eigenvalues of J#KJ, are those of the product of two symmetric
matrices, one with its spectrum in [0, 1]. They are real and between 0 and the largest gain, even if tasks conflict. So
the limits of a loop with one task hold for each task at any posture; at one posture, with the other gains unchanged,
the limit may be higher.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from cnclik.integrate.drive import Drive
from cnclik.law.inverse import Levels
from cnclik.record import AnyArray, Float, record
from cnclik.stability.driven import SLACK, increments, least_limits, radius
from cnclik.stability.drives import each_drive
from cnclik.stability.gain import Gain, gain_of
from cnclik.stability.linear import first_above
from cnclik.stability.loop import Rates, steps_of
from cnclik.stability.settings import MOST_Z

REACH = 1e4  # z up to which is looked
MOST_STEPS = 5000  # of errors that are followed
REACHED = 1e-9  # share of an error in a direction, below which no joint makes one there
LOST = 0.1  # share of what a task gets in its best direction, below which another is lost to it
NOTHING = 1e-9  # share of a direction that a task does not get even alone: no joint moves it there
CONFLICT = 0.9  # of what a task would get alone: with less in some direction it is in conflict


@record
class TaskAdvice:
    """Gains that one task of a stack tolerates, and how much of its motion it gets.

    Attributes:
      alpha: [1/s], its largest gain. z: alpha·Ts.
      largest_stable_alpha: at this posture, with the other gains unchanged, but those that are `unstable` lowered to
        the recommended ones. Of a task whose gain is 0: one gain for all its coordinates.
      fastest_monotone_alpha, recommended_alpha: the largest without overshoot, and without overshoot with one more
        sample of dead time, for any posture and any motion of the other tasks, if none of them is above it.
        For a task whose gain is 0, which asks for no motion and holds the others back, 0 is recommended.
      got: number of its coordinates that it gets, in sum. alone: the same without other tasks.
      least: share that it gets in its worst direction. least_alone: the same without other tasks. direction: (m,) the
        direction.
      yields_to: the task that takes most of this direction, or "", also where no joint moves the task along it.
      now, recommended: `Gain` of the task with the others at rest, in directions that are not lost; None where
        unstable, even if only with one joint's drive for all, the other gains as for `largest_stable_alpha`, or where
        its gain is 0.
    """

    alpha: float
    z: float
    largest_stable_alpha: float
    fastest_monotone_alpha: float
    recommended_alpha: float
    got: float
    alone: float
    least: float
    least_alone: float
    direction: np.ndarray
    yields_to: str
    now: Gain | None
    recommended: Gain | None


@record
class Leak:
    """A leak from a level to an earlier one: `share` of what `source` asks for moves `into` [units over units]."""

    source: str
    into: str
    share: float


@record
class StackAdvice:
    """Gains and margins of a stack of tasks at rest.

    Attributes:
      tasks: {name: `TaskAdvice`}.
      unstable: names of the tasks whose gains make the loop unstable, () where it is stable. With these gains lowered
        to the recommended ones it is stable, without any of them it is not; where nothing is known of the drives, on
        those that are assumed.
      least_room: name of the task whose gain is nearest to its limit, or farthest beyond it.
      growth: factor by which an error may grow before it decays, in the norm of weights and levels; 1: it does not
        grow. error_growth: the same for errors in [m, rad]. Without drives; inf where the loop is unstable.
      leaks: for each pair of levels the largest `Leak`.
    """

    tasks: dict
    unstable: tuple
    least_room: str
    growth: float
    error_growth: float
    leaks: tuple


class Shares(NamedTuple):
    """A loop at rest whose rates are known, and what its rows get of what they ask for."""

    loop: Any  # `LoopAtRest`
    Ts: float
    rates: Rates
    root: Float[AnyArray, " m"]  # λ of each row; 1 without damping
    weights: Float[AnyArray, " m"]
    shares: Float[AnyArray, "m m"]  # `got` of all rows

    def got(self, some):
        """J J# of some rows without the others, in the norm of weights and levels, in which it is symmetric."""
        rows = self.rates.rows[some] / self.root[some][:, None]
        if self.rates.damping is None:
            return rows @ np.linalg.pinv(rows)
        gram = rows @ rows.T
        return np.linalg.solve(gram + np.eye(len(gram)), gram)

    def taken(self, scale):
        """What a step takes (k, m) with the gains times a scale."""
        return self.rates.taken(scale, self.Ts, self.loop.method)

    def steps(self, taken):
        return steps_of(taken, self.loop.method, self.loop.stage)

    def radius(self, scale, drive):
        """Spectral radius (k,) with the gains times a scale (k, m), through a drive."""
        return radius(self.rates.driven(self.taken(scale), self.loop.method, self.loop.stage, drive), drive, self.Ts)

    def lowered(self, gains, but="") -> np.ndarray:
        """Scales (m,) that give some tasks gains {name: z}, and leave those of all others and of one as they are."""
        scale = np.ones(len(self.root))
        for name in gains.keys() - {but}:
            scale[self.loop.law.task.of(name)] = gains[name] / self.z(name)
        return scale

    def z(self, name) -> float:
        """alpha·Ts of a task, of its largest gain."""
        return float(np.max(self.rates.alpha[self.loop.law.task.of(name)])) * self.Ts

    def with_gain(self, at):
        """With z = 1 for rows whose gain is 0."""
        alpha = np.array(self.rates.alpha)
        alpha[at] = 1 / self.Ts
        return self._replace(rates=self.rates._replace(alpha=alpha))

    def fastest(self, scale):
        """Sensitivities (m,) of the largest rate to the gains, d ln(rate)/d ln(gain): the squares of its vector."""
        root = np.sqrt(np.abs(self.taken(scale)))
        return np.linalg.eigh(root[:, None] * self.shares * root)[1][:, -1] ** 2

    def own(self, at, scale):
        """Modes (r, p) of one task, the others at rest, in its directions that are not lost."""
        root = np.sqrt(self.taken(scale)[at])
        rates = np.linalg.eigvalsh(root[:, None] * self.shares[at, at] * root)
        return self.steps(rates[rates > LOST * rates.max(initial=0.0)])

    def growth(self) -> tuple:
        """Largest norms of what becomes of the errors of joints that are elsewhere: in the norm of weights and levels,
        and of the errors as they are. Of one gain for all the first is 1, else at most (κ + 1)/(2 √κ), κ the largest
        gain over the smallest (Kantorovich), while no step takes more than all of an error."""
        shares, taken = self.shares, self.taken(1.0)
        root = np.sqrt(np.maximum(taken, 1e-12 * taken.max()))
        rates, vectors = np.linalg.eigh(root[:, None] * shares * root)
        factors = _powers(self.steps(rates))
        got, those = np.linalg.eigh(shares)
        found = []
        for back in (np.ones(len(root)), self.root / self.weights):
            reached = np.linalg.qr(back[:, None] * those[:, got > REACHED])[0]
            left, right = back[:, None] * vectors / root[:, None], (vectors.T * (root / back)) @ reached
            found.append(max(1.0, *(float(np.linalg.norm((left * f) @ right, 2)) for f in factors)))
        return tuple(found)


def _powers(steps):
    """What modes (r, p) leave of an error 1 after some of many steps (k, r)."""
    slowest = -np.log(np.abs(1.0 + steps.sum(-1)).max())
    last = int(np.clip(5.0 / max(slowest, 1e-9), 50, MOST_STEPS))
    some = np.unique(np.r_[1:11, np.geomspace(1, last, 30).astype(int)])
    if steps.shape[1] == 1:
        return (1.0 + steps.T) ** some[:, None]
    past, found = [np.ones(len(steps))] * steps.shape[1], []
    for _ in range(last):
        past = [past[0] + sum(d * e for d, e in zip(steps.T, past, strict=True)), *past[:-1]]
        found.append(past[0])
    return np.array(found)[some - 1]


def bounded_rates(law) -> bool:
    """Whether it is a stack of tasks whose rates are between 0 and the largest gain: not by the transpose."""
    return bool(law.task.tasks) and law.null_velocity is None


def at_any_posture(loop, Ts: float, share: float | None = None) -> tuple:
    """z without overshoot, and recommended, of a loop of one rate between 0 and alpha, through the loop's drive.

    Args: share: what of an error a step may remove at most where a gain is recommended, or None.
    """
    limits = least_limits(loop.method, loop.stage, Ts, loop.drive)
    recommended = min(MOST_Z, limits.recommended)
    if share is not None:

        def removed(z):
            return np.abs(increments(loop.method, loop.stage, z).sum(-1))

        recommended = min(recommended, first_above(removed, share, MOST_Z, 128))
    return limits.monotone, recommended


def shares_of(loop, Ts: float) -> Shares:
    """Of a loop at rest of `bounded_rates`."""
    root = np.ones(loop.law.task.m) if loop.rates.damping is None else loop.rates.damping
    here = Shares(loop, Ts, loop.rates, root, np.asarray(loop.law.task.weight_of_each, float), root)
    return here._replace(shares=here.got(slice(None)))


def stack_advice(loop, safe: Drive, limits: tuple, Ts: float) -> StackAdvice:
    """Gains and margins of the tasks of a loop at rest.

    Args:
      loop: `LoopAtRest`, of `bounded_rates`. safe: the drive for which a gain is recommended: the loop's own, if known.
      limits: z without overshoot, and recommended, see `at_any_posture`.
    """
    law, here = loop.law, shares_of(loop, Ts)
    gains = _to_lower(here, safe, limits[1])
    tasks = {name: _task(here, name, at, safe, limits, gains) for name, at in law.task.each}
    room = {
        name: (name not in gains, one.now.gain_margin if one.now else one.largest_stable_alpha / one.alpha, -one.alpha)
        for name, one in tasks.items()
        if one.alpha
    }
    stable = not gains and bool(here.radius(np.ones((1, 1)), Drive())[0] <= 1 + SLACK)
    growth, error_growth = here.growth() if stable else (np.inf, np.inf)
    return StackAdvice(
        tasks=tasks,
        unstable=tuple(name for name in tasks if name in gains),
        least_room=min(room, key=lambda name: room[name]),
        growth=growth,
        error_growth=error_growth,
        leaks=tuple(_leaks(here, law)),
    )


def stable_shares(loops, Ts: float) -> np.ndarray:
    """Largest shares (m,) of gains that are stable at some postures: one share of the tasks that `StackAdvice.unstable`
    names at any of them, 1 of the others, and 1 of all where it names none.

    Args: loops: `LoopAtRest` at each posture, of `bounded_rates`.
    """
    each, shares = [shares_of(loop, Ts) for loop in loops], np.ones(loops[0].law.task.m)
    gains = [_to_lower(here, here.loop.drive, at_any_posture(here.loop, Ts)[1]) for here in each]
    lowered = [loops[0].law.task.of(name) for name in {name for found in gains for name in found}]

    def scale(share):
        changed = np.ones((len(share), len(shares)))
        for at in lowered:
            changed[:, at] = share[:, None]
        return changed

    if not lowered:
        return shares
    limits = [
        first_above(lambda s, here=here: here.radius(scale(s), here.loop.drive), 1 + SLACK, 1.0, here.loop.points)
        for here in each
    ]
    return scale(np.array([min(1.0, *limits)]))[0]


def half_shares(loop, Ts: float) -> np.ndarray:
    """Shares (m,) of gains: down to half of what is stable at any posture, of tasks that are above it, 1 of the others.

    Args: loop: `LoopAtRest`, of `bounded_rates`.
    """
    here, shares = shares_of(loop, Ts), np.ones(loop.law.task.m)
    half = 0.5 * least_limits(loop.method, loop.stage, Ts, loop.drive).stable
    for name, at in loop.law.task.each:
        if (z := here.z(name)) > half:  # which may be infinite
            shares[at] = half / z
    return shares


def _to_lower(here, drive, recommended) -> dict:
    """{name: its recommended z} of the tasks whose gains make a loop unstable, see `StackAdvice`.

    If no gain is above the limit of a loop with one task, the stack is stable. Of the tasks above it the first is the
    one on whose gain the largest rate depends most; then the same with this gain lowered, until the loop is stable.
    """

    def stable(gains):
        return bool(here.radius(here.lowered(gains)[None], drive)[0] <= 1 + SLACK)

    found: dict = {}
    if stable(found):
        return found
    loop, task = here.loop, here.loop.law.task
    limit = least_limits(loop.method, loop.stage, here.Ts, drive).stable
    left = [name for name, _ in task.each if here.z(name) > limit]
    while left and not stable(found):
        depends = here.fastest(here.lowered(found))
        left.remove(name := max(left, key=lambda name: depends[task.of(name)].sum()))
        found[name] = recommended
    for name in tuple(found):
        if stable(without := {other: z for other, z in found.items() if other != name}):
            found = without
    return found


def _task(here, name, at, safe, limits, gains) -> TaskAdvice:
    Ts, loop = here.Ts, here.loop
    alpha, others = here.z(name) / here.Ts, here.lowered(gains, but=name)
    unit = here if alpha else here.with_gain(at)

    def scale(z):
        changed = np.tile(others, (len(z), 1))
        changed[:, at] = (z / unit.z(name))[:, None]
        return changed

    def largest(drive):
        points = loop._replace(drive=drive).points
        return first_above(lambda z: unit.radius(scale(z), drive), 1 + SLACK, REACH, points)

    def does(z):
        steps = here.own(at, scale(np.array([z]))[0]) if z else ()
        stable = len(steps) and all(np.all(radius(steps, one, Ts) <= 1 + SLACK) for one in each_drive(safe))
        return gain_of(steps, safe, Ts, z, borne) if stable else None

    most = largest(loop.drive)
    borne = most if safe is loop.drive else largest(safe)
    share, alone = here.shares[at, at], here.got(at)
    least, vectors = np.linalg.eigh(share)
    worst = vectors[:, 0]
    direction = here.rates.turned[at, at] @ worst * here.root[at] / here.weights[at]
    monotone, recommended = limits if alpha else (limits[0], 0.0)
    return TaskAdvice(
        alpha=alpha,
        z=alpha * Ts,
        largest_stable_alpha=most / Ts,
        fastest_monotone_alpha=monotone / Ts,
        recommended_alpha=recommended / Ts,
        got=float(np.trace(share)),
        alone=float(np.trace(alone)),
        least=float(max(least[0], 0.0)),
        least_alone=float(worst @ alone @ worst),
        direction=direction / np.linalg.norm(direction),
        yields_to=_taker(here, name, worst, least[0], alone),
        now=does(alpha * Ts) if alpha * Ts < borne else None,
        recommended=does(recommended) if recommended < borne else None,
    )


def _taker(here, name, worst, got, alone) -> str:
    """The task without which one would get most of a direction more; "" where none takes much."""
    by_itself = worst @ alone @ worst
    if by_itself < NOTHING or got > CONFLICT * by_itself:
        return ""
    task, more = here.loop.law.task, {}
    for other in (one for one, _ in task.each if one != name):
        left = np.concatenate([np.arange(task.m)[at] for one, at in task.each if one != other])
        own = np.isin(left, np.arange(task.m)[task.of(name)])
        more[other] = worst @ here.got(left)[np.ix_(own, own)] @ worst
    return max(more, key=lambda other: more[other])


def _leaks(here, law):
    """Of each two levels what the later one lets through to the earlier, at most."""
    if not isinstance(law.inverse, Levels):
        return
    level, names, rates = np.array(law.inverse.level), law.task.names, here.rates
    through = rates.turned @ rates.rows @ rates.columns @ rates.turned.T * here.weights / here.weights[:, None]
    for first in range(level.max()):
        for later in range(first + 1, level.max() + 1):
            into, source = np.flatnonzero(level == first), np.flatnonzero(level == later)
            part = np.abs(through[np.ix_(into, source)])
            i, j = np.unravel_index(np.argmax(part), part.shape)
            yield Leak(source=names[source[j]], into=names[into[i]], share=float(part[i, j]))
