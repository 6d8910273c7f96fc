"""Advice: the rates of a law, each beside the gains that its loop tolerates. No posture is asked."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive, check_drive
from cnclik.integrate.method import DEFAULT, MethodLike
from cnclik.integrate.stage import Stage, picard
from cnclik.law.law import Law
from cnclik.precision import of_numbers
from cnclik.record import Number, record
from cnclik.stability.gain import Gains, Response, gains, in_words
from cnclik.stability.linear import passes_of, removed

ROUNDING = 1e-9  # relative excess of a gain that is none


class Rate(NamedTuple):
    """A rate of the loop [1/s]: of a task, of the posture term, of joint limits or of a wall.

    `limits` are its `Gains`: those of the loop's method; of joint limits and walls, which act on velocities, of
    explicit Euler.
    """

    name: str
    kind: str
    rate: float
    limits: Gains

    @property
    def stable(self) -> bool:
        """Whether it is below the largest stable one, with which a loop swings for ever."""
        return not self.rate or self.rate < self.limits.largest_stable

    @property
    def within(self) -> bool:
        """Whether it is at most the recommended one."""
        return self.rate <= self.limits.recommended * (1 + ROUNDING)

    @property
    def response(self) -> Response | None:
        """What a loop does with it; None where it is 0 or unstable."""
        return self.limits.at(self.rate) if self.rate else None

    def __str__(self):
        most = self.limits
        if not self.rate:
            return f"{self.name}: 0 asks for no motion"
        if not self.stable:
            up_to = f"stable up to {in_words(most.largest_stable)} 1/s" if most.largest_stable else "no gain is stable"
            what = f"UNSTABLE where J# gives all that it asks for: {up_to}"
        elif self.rate > most.without_overshoot * (1 + ROUNDING):
            what = f"overshoots: without overshoot up to {in_words(most.without_overshoot)} 1/s"
        elif not self.within:
            late = 0 < most.shares[2] < float(removed(most.method, self.rate * most.Ts, most.M))
            up_to = f"recommended up to {in_words(most.recommended)} 1/s" if most.recommended else most.reason
            what = f"{'overshoots with one more sample of dead time: ' * late}{up_to}"
        else:
            what = "within what is recommended"
        return f"{self.name}: {self.rate:.4g} 1/s (z = {self.rate * most.Ts:.4g}), {what}"


@record
class Advice:
    """Answer of `advise`: what a law's gains do on its drives, at any posture.

    Attributes:
      gains: `Gains` of the loop's method: what every gain of a task and the rate of a posture may be.
      rates: `Rate` of each task, posture term, joint limit and wall.
    """

    gains: Gains
    rates: tuple[Rate, ...]

    @property
    def unstable(self) -> tuple[str, ...]:
        """Names of the rates above the largest stable one."""
        return tuple(one.name for one in self.rates if not one.stable)

    @property
    def above(self) -> tuple[str, ...]:
        """Names of the rates above the recommended one."""
        return tuple(one.name for one in self.rates if not one.within)

    def __str__(self):
        return "\n".join([str(self.gains), *(f"  {one}" for one in self.rates)])


@of_numbers
def advise(
    law: Law,
    *,
    Ts: Number,
    method: MethodLike = DEFAULT,
    stage: Stage = picard(5),
    drive: Drive | None = None,
) -> Advice:
    """Return what each gain of a law does on its drives, and what it may be, at any posture.

    All rates of the loop are weighted means of the gains of its tasks, its posture term, its active joint limits and
    walls, so each of them has the limits of `gains`. A gain above its limit is named.

    Args:
      law: with any stack, inverse, weights, limits and posture term. Ts: sampling time [s].
      method, stage: as for `solve`. drive: as for `gains`.
    Raises: ArgumentError where joints differ in their drives and tasks in their gains: then no limit holds at every
      posture.
    """
    errors.kind("law", law, Law)
    rates = rates_of(law)
    if drive is not None and mixed(law, drive):
        must = (
            "be the same for all joints where gains differ: no limit holds at every posture. Use one gain for all "
            "tasks, posture and limits, or give the fast joints the slow joints' lag"
        )
        raise errors.fail("drive", must, "differs from joint to joint")
    loop = gains(Ts=Ts, drive=drive, method=method, M=passes_of(stage))
    limits = dict.fromkeys(("task", "posture"), loop) | dict.fromkeys(("joint limits", "wall"), loop.by("EE"))
    return Advice(gains=loop, rates=tuple(Rate(name, kind, rate, limits[kind]) for name, kind, rate in rates))


def mixed(law, drive: Drive) -> bool:
    """Return whether joints differ in their drives, and rates differ, too: then no limit holds at every posture."""
    several = {rate for *_, rate in rates_of(law)} | set(np.ravel(np.asarray(law.alpha, float)).tolist())
    return len(check_drive(drive, law.chain).joints) > 1 and len(several - {0.0}) > 1


def rates_of(law) -> list[tuple[str, str, float]]:
    """Return (name, kind, rate [1/s]) of each task, posture term, joint limit and wall of a law."""
    alpha = np.broadcast_to(np.asarray(law.alpha, float), (law.task.m,))
    each = law.task.each or [("alpha", slice(None))]
    rates: list = [(name, "task", float(alpha[at].max())) for name, at in each]
    if law.null_velocity is not None:
        rates.append(("posture", "posture", float(law.null_velocity.rate)))
    of_limits: Any = getattr(law.limits, "rate", None)
    if of_limits is not None and np.isfinite([law.chain.lower, law.chain.upper]).any():
        rates.append(("joint limits", "joint limits", float(of_limits)))
    walls = getattr(law.limits, "walls", ())
    return rates + [(f"wall {wall.name}", "wall", float(wall.rate)) for wall in walls]
