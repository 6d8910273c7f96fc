"""The strategy of a search: its constants, and the phases for a target without an answer.

A try begins at a seed, or about `near`, and ends where it arrives, gets stuck or has had its steps. The first tries
start from the nearest seeds and end early; later ones step carefully. Where no try arrives, the search goes downhill
from the best places found, to the nearest pose, tries on where that is close, and then without `jump` and limits, to
tell why there is no answer. `search` and c/search.c make the tries, of one phase at a time.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from cnclik.reaching.result import ReachStatus
from cnclik.record import AnyArray, Bool, Float, Int, Number

PLAIN, STEPS = 5, 9  # tries that accept every step, and their largest number of steps
CAREFUL, SLOW = 24, 30  # steps of later ones, and how many more those get that are close
COARSE = 2e-5  # [m, rad] of the target: close
STUCK = 1e-5  # of `step.Search.steep`: a try whose error falls as slowly as that ends
PLACES = 4  # number of best postures kept from tries that did not arrive
AROUND = 0.5  # of the range of seeds, about `near`: where the last plain tries start; the first starts there
SELDOM = 4  # one try in so many starts about a place found, as far from it as a seed is from the middle of the seeds
# More postures lead to answers beyond the limits than to one at them: beyond the sets one try in so many is free of all
# bounds, and begins again within them from where it arrives. One in twice as many is not made for it.
OUTER = 4
DOWNHILL = 150  # steps from a place to the nearest pose
FIRST = 16  # tries of all targets, also of those farther off than the arm is long; nearly all need no more
ENDLESS = (1 << 30) - 1  # looks
FAR = np.asarray(1e3)  # [rad, m] of no jump
FREE = 128  # tries of the search without limits
SURE = 256  # tries, at least, before it is said that there is no answer
CLOSE, LONGER = (0.3, 2e-2), (4, 16)  # [rad, units]: a target missed by less gets so many times the seeds
NUMBERS = "PLAIN", "STEPS", "CAREFUL", "SLOW", "COARSE", "STUCK", "PLACES", "AROUND", "SELDOM", "OUTER"


class Phase(NamedTuple):
    """Some tries of a search, and the targets that they are for."""

    low: Float[AnyArray, " n"]  # bounds of the joints
    high: Float[AnyArray, " n"]
    jump: Float[AnyArray, " n"]  # and how far from `near`; infinite, where no jump is asked for
    roots: Float[AnyArray, " m"]  # of the task's weights
    done: Number  # tries before
    tries: Number  # in all
    budget: Number  # looks
    downhill: Number  # how many steps downhill from each of the best places, or 0: tries from seeds
    status: Number  # what an answer means, of a search beyond `jump` or the limits; else 0
    less: Number  # for targets missed by less
    far: np.bool | Bool[AnyArray, ""]  # also for those farther off than the arm is long
    sure: np.bool | Bool[AnyArray, ""]  # for those alone of which is known that no more tries were asked for


IN_C = Phase._fields[:8]  # what the search itself needs


def phases(asked, xp=np) -> list:
    """The phases of a search, in order."""
    n, m, downhill = asked.chain.n, asked.task.m, asked.downhill
    endless, ones, (lower, upper) = np.full(n, np.inf), np.ones(m), asked.limited()
    roots = ones if asked.task.weights is None else xp.sqrt(xp.asarray(asked.task.weights, float))
    jump = xp.broadcast_to(xp.asarray(np.inf if asked.jump is None else asked.jump, float), n)
    first, no = xp.minimum(FIRST, asked.seeds), np.bool_(False)
    own = Phase(lower, upper, jump, ones, 0, first, asked.budget, 0, 0, np.inf, np.bool_(downhill), no)
    made = [own, own._replace(done=FIRST, tries=asked.seeds, far=no)]
    if downhill:
        made.append(own._replace(roots=roots, tries=PLACES, downhill=DOWNHILL, far=~no))
    if not asked.explain:
        return made
    more = own._replace(budget=ENDLESS, far=no, sure=~no)
    for less, before, times in zip(CLOSE, (1, *LONGER), LONGER, strict=False):
        made.append(more._replace(done=before * asked.seeds, tries=times * asked.seeds, less=less))
    wide = []
    if asked.jump is not None:
        wide.append(more._replace(tries=LONGER[0] * asked.seeds, status=int(ReachStatus.JUMP)))
        wide.append(wide[0]._replace(done=wide[0].tries, tries=LONGER[1] * asked.seeds, less=CLOSE[1]))
    if (np.isfinite(lower) | np.isfinite(upper)).any():
        free = more._replace(low=-endless, high=endless, tries=FREE, status=int(ReachStatus.AT_LIMIT))
        wide.append(free)
    for phase in wide:
        phase = phase._replace(jump=endless)
        made += [phase, phase._replace(done=0, tries=PLACES, downhill=DOWNHILL, less=CLOSE[0])]
    return made


def alone(phase: Phase, wide=False) -> Phase:
    """A phase for single tries. Args: wide: whether to ignore all bounds."""
    everywhere = np.full(len(phase.low), np.inf)
    return phase._replace(low=-everywhere, high=everywhere, jump=everywhere) if wide else phase


def narrowed(low, high, jump, near, xp=np):
    """The bounds of a target's joints (n,); outside the limits, those nearest to `near`."""
    if near is None:
        return low, high
    about = xp.where(xp.isinf(jump), 0.0, near)
    return xp.minimum(xp.maximum(low, about - jump), high), xp.maximum(xp.minimum(high, about + jump), low)


class SoFar(NamedTuple):
    """The state of targets (...,) between phases."""

    made: Any  # `search.Found` within the bounds
    beyond: Any  # and of the last search beyond them
    sure: Bool[AnyArray, " *B"]  # whether the tries suffice to conclude that there is no answer
    why: Int[AnyArray, " *B"]  # the result of `Asked.meaning`


def wanted(phase, so_far: SoFar, known, far, xp=np):
    """Which of the finite targets (...,) need a phase."""
    beyond = phase.status > 0
    missed = xp.where(beyond, so_far.beyond.costs.min(axis=-1), so_far.made.squares.sum(axis=-1))
    near = xp.isinf(phase.less) | (missed < phase.less**2)
    open_ = known & (so_far.made.found == 0) & (so_far.why == 0)
    return open_ & near & (phase.far | ~far) & (so_far.sure | ~phase.sure)
