"""Observed: a run in numbers: its late errors, their growth, the motion of its joints."""

from typing import NamedTuple

import numpy as np

from cnclik.integrate.status import Status
from cnclik.measure.outcome import STALL_RATIO
from cnclik.quantities import plainly
from cnclik.robot.chart import apart
from cnclik.robot.posture import arm_length

ARRIVED = 1e-3  # of the initial error: below, throughout the last quarter, a loop has settled
GROWN = 1.2  # ratio of the middle errors of two quarters from which on an error grows
LOST = 4.0  # and of those of the last quarter and of all before
VISIBLE = 1e-4  # RMS joint step, in rad or m, below which nobody sees it
FALLEN = 0.5  # ratio of the largest, and of the middle, errors of two quarters below which one that swings shrinks
FADING = 0.3  # ratio of the joint speeds of two quarters below which motion fades
OFTEN = 0.5  # share of the last quarter's steps with a status bit that counts

ROUNDED = 1e-6  # share of a velocity limit that is a rounding


class Observed(NamedTuple):
    size: np.ndarray  # ‖e‖ at every instant
    late: np.ndarray  # ‖e‖ over the last quarter
    before: np.ndarray  # ‖e‖ over the quarter before
    floor: float  # smaller errors are rounding
    reversing: float  # share of the late joint speed that alternates, see `back_and_forth`
    joint_speed: float  # largest late joint speed
    visible: bool  # whether the late joint steps are large enough to see
    fades: bool  # whether they are much smaller than those of the quarter before
    swings: int  # sign changes of the error before it was small
    swing: float  # median number of steps between sign changes
    status: np.ndarray  # of the late steps
    too_fast: int  # steps, of the whole run, in which a joint is faster than its limit
    excess: float  # largest joint velocity over its limit
    fastest: str  # the joint that has it
    at_velocity: np.ndarray  # (n,) whether a joint moves at its velocity limit in most of the late steps
    at_position: np.ndarray  # (n,) and whether it is at a position limit, or beyond
    by_error: bool  # whether the error caused the largest velocity, rather than the path's speed
    fast_singular: bool  # whether a joint is faster than that next to a singularity
    share: float  # share of the target's motion that the tip followed, over the last two quarters
    dtype: np.dtype  # dtype of the run
    still: bool  # whether late joint values are all the same, and short of the target
    drift: float  # net joint motion over the last quarter
    way: float  # length of the target's path [m; rad for a task without position]
    outside: np.ndarray  # (n,) largest excess of each joint over its position limits [rad, m]
    bad: int | None  # first instant that is not finite

    @property
    def largest(self):
        return float(self.late.max())

    @property
    def arrived(self):
        first = self.size[0] if self.size[0] > self.floor else self.size.max()  # the error may begin at 0
        return self.largest <= max(ARRIVED * first, self.floor)

    @property
    def grows(self):
        higher = np.median(self.late) > GROWN * np.median(self.before)
        return bool(higher and self.largest > max(self.before.max(), self.floor))

    @property
    def lost(self):
        """Whether the error has grown by more than it varies along a path."""
        return bool(np.median(self.late) > LOST * np.median(self.size[: len(self.size) - len(self.late)]))

    @property
    def shrinks(self):
        least = min(self.before.min(), self.size.max())
        return bool(self.largest < STALL_RATIO * self.before.max() and self.largest <= least)

    @property
    def swings_less(self):
        """Whether the error decreases although it oscillates through zero."""
        fallen = np.median(self.late) < FALLEN * np.median(self.before)
        return bool(fallen and self.largest < FALLEN * self.before.max())

    @property
    def over_velocity(self):
        """A clause on joints above their velocity limits; empty where there are none."""
        if not self.too_fast:
            return ""
        steps = f"{self.too_fast} of {len(self.size) - 1} steps exceed a joint's velocity limit"
        return f"{steps}, {self.fastest} with up to {plainly(self.excess)} times it" if self.excess > 1 else steps

    def often(self, bit):
        return bool(len(self.status) and np.mean((self.status & bit) != 0) >= OFTEN)


@np.errstate(over="ignore", invalid="ignore")  # a diverging loop overflows
def observe(law, run, Ts, dtype, mean=0) -> Observed:
    """What one lane's trajectory shows, up to its first instant that is not finite.

    Args: mean: steps for `back_and_forth`.
    """
    e, q, qdot = (np.asarray(v, float) for v in (run.e, run.q, run.qdot))
    finite = np.isfinite(e).all(1) & np.isfinite(q).all(1)
    bad = None if finite.all() else int(np.argmin(finite))
    e, qdot = e[:bad], qdot[:bad]
    if bad is not None and bad <= 1:
        e, qdot = np.concatenate([e, e, np.zeros((2, e.shape[1]))])[:2], np.zeros((1, q.shape[1]))
    size, N = np.linalg.norm(e, axis=1), len(qdot)
    quarter, status = max(N // 4, min(N, 2)), np.asarray(run.status)[:bad]
    late, before = size[-quarter:], size[:-quarter][-quarter:]
    eps = np.finfo(dtype).eps
    back, speed = back_and_forth(qdot[-2 * quarter :], mean)
    steps = np.linalg.norm(qdot, axis=1) * Ts
    fades = rms(steps[-quarter:]) < FADING * rms(steps[:-quarter][-quarter:]) if quarter < N else False
    turned = max((_turns(one, max(ARRIVED, eps) * size.max()) for one in e.T), key=len)
    least = 8 * eps * (1 + arm_length(law.chain))  # error caused by the rounding of q
    lower, upper = np.array(law.chain.lower), np.array(law.chain.upper)
    gain = np.abs(np.asarray(law.alpha, float)).max()
    ratio = np.abs(qdot) / np.maximum(np.array(law.chain.velocity_limit, float), 1e-12)
    k, moved = int(np.argmax(ratio.max(1))), np.diff(np.asarray(run.x, float)[: len(e)] + e, axis=0)
    return Observed(
        size=size,
        late=late,
        before=before if len(before) else size[:1],
        floor=64 * eps * (1 + arm_length(law.chain)),
        reversing=back / speed if speed > 0 else 0.0,
        joint_speed=float(np.abs(qdot[-quarter:]).max()),
        visible=rms(steps[-quarter:]) > VISIBLE,
        fades=bool(fades),
        swings=len(turned),
        swing=float(np.median(np.diff(turned))) if len(turned) > 1 else 0.0,
        status=status[-quarter:],
        too_fast=int(np.sum(status & Status.OVER_VELOCITY != 0)),
        excess=float(ratio.max(initial=0.0)),
        fastest=law.chain.joint_names[int(np.argmax(ratio.max(0)))],
        at_velocity=np.mean(ratio[-quarter:] > 1 - ROUNDED, axis=0) >= OFTEN,
        at_position=_at_position(law.chain, q[:bad][-quarter:]),
        by_error=bool(gain * Ts * size[k] > np.linalg.norm(moved[min(k, len(moved) - 1)])),
        fast_singular=bool(np.any((status & Status.OVER_VELOCITY != 0) & (status & Status.NEAR_SINGULAR != 0))),
        share=_share(*(np.asarray(v, float)[:bad][-2 * quarter :] for v in (run.x, run.e))),
        dtype=np.dtype(dtype),
        still=bool(quarter > 1 and (q[:bad][-quarter:] == q[:bad][-1]).all() and late.min() > least),
        drift=_drift(law.chain, q[:bad][-quarter:]) if quarter > 1 else 0.0,
        outside=np.maximum(q[:bad] - upper, lower - q[:bad]).max(0, initial=0.0),
        way=float(np.sum(np.linalg.norm(moved[:, law.task.lengths or slice(None)], axis=1))),
        bad=bad,
    )


def _at_position(chain, q):
    """(n,) whether joints are at a limit in most of the instants q (N, n); one whose limits are equal never is."""
    lower, upper = np.array(chain.lower), np.array(chain.upper)
    near = 1e-3 * (1 + np.abs(q))
    at = ((q <= lower + near) | (q >= upper - near)) & (lower < upper)
    return at.sum(axis=0) >= OFTEN * max(len(q), 1)


def _drift(chain, q):
    """Net motion of the joints (N, n), from the means of both halves."""
    halves = [np.mean(v, axis=0) for v in np.array_split(np.asarray(apart(chain, q[0], q)), 2)]
    return 2 * float(np.linalg.norm(halves[1] - halves[0]))


def _share(x, e):
    """Path length of the tip over that of its target, between 0.01 and 1."""
    made, asked = (np.sum(np.linalg.norm(np.diff(v, axis=0), axis=1)) for v in (x, x + e))
    return float(np.clip(made / asked, 0.01, 1.0)) if np.isfinite(made) and asked > 0 else 1.0


def rms(values):
    return float(np.sqrt(np.mean(np.square(values)))) if np.size(values) else 0.0


def back_and_forth(qdot, mean=0):
    """(RMS speed that goes back and forth, RMS speed) of joint velocities (N, n).

    That is what the next step reverses; or, at a pace, within which none may, what is off the mean over `mean` steps
    about it.
    """
    flips = qdot[1:] * qdot[:-1] < 0
    back = np.where(flips, np.minimum(np.abs(qdot[1:]), np.abs(qdot[:-1])), 0.0)
    if 0 < mean < len(qdot):
        total = np.cumsum(np.concatenate([0 * qdot[:1], qdot]), axis=0)
        means = (total[mean:] - total[:-mean]) / mean
        back = qdot[mean // 2 :][: len(means)] - means
    return rms(np.linalg.norm(back, axis=1)), rms(np.linalg.norm(qdot, axis=1))


def _turns(values, least):
    """Indices of sign changes among the values larger than `least`."""
    large = np.flatnonzero(np.abs(values) > least)
    return large[1:][values[large[1:]] * values[large[:-1]] < 0]
