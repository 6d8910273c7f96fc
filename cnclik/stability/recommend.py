"""Recommendations: the safe gain at a sampling time, the safe sampling time at a gain, and the margin of a loop."""

from __future__ import annotations

import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive
from cnclik.integrate.method import DEFAULT, MethodLike, evaluations_per_step
from cnclik.integrate.stage import Stage, picard
from cnclik.law.law import Law
from cnclik.law.reference import Reference
from cnclik.precision import in_float64
from cnclik.quantities import in_samples
from cnclik.record import ArrayLike, Float, Number, in_words, record
from cnclik.stability import rebased
from cnclik.stability.driven import SLACK, looked_at, monotone_limit, radius
from cnclik.stability.drives import longer, side_by_side
from cnclik.stability.linear import delay_limit, first_above, least_on
from cnclik.stability.loop import UNSTABLE, LoopAtRest, loop_at_rest
from cnclik.stability.spectrum import MEETING, Spectrum, spectrum_of

REACH = 1e4  # largest z that is considered
_MEASURED = "For a robot give `drive`, as `ck.fit_drive` finds it: real drives need a smaller gain."


@record
class Recommendation:
    """Safe values of one quantity, alpha or Ts, the other one given.

    Attributes:
      name: "alpha" or "Ts".
      assumed: a sentence about the drives that are assumed; "" where a lag or a servo is given.
      largest: the largest stable value, of the law's alpha's shape; inf where every one is stable, 0 where none is,
        as with a null-space velocity that is unstable by itself.
      fastest: the value with the smallest spectral radius; inf where larger is faster without end.
      monotone: of alpha, the largest value without overshoot; None of Ts.
      recommended: of alpha, the largest value that does not overshoot with one more sample of dead time; None of Ts. It
        and `monotone` are 0 where none is safe, as with some servos whose commands start at the measured joints.
      z_largest, z_fastest, z_monotone, z_recommended: alpha·Ts there (largest |eigenvalue| of a gain matrix).
      radius: spectral radius at `fastest`: the factor by which a step then multiplies the error.
      limit: what becomes unstable first beyond `largest`, in words.
      direction: (m,) the task direction in which it does.
      evaluations: evaluations of f that a step costs.
    """

    name: str
    assumed: str
    largest: float | np.ndarray
    fastest: float | np.ndarray
    monotone: float | np.ndarray | None
    recommended: float | np.ndarray | None
    z_largest: float
    z_fastest: float
    z_monotone: float | None
    z_recommended: float | None
    radius: float
    limit: str
    direction: np.ndarray
    evaluations: int

    def __str__(self):
        said = f"{self.assumed} {_MEASURED}\n{self.name}" if self.assumed else self.name
        first = ""
        if self.recommended is not None:
            first = f"recommended {in_words(self.recommended)} (z = {self.z_recommended:.4g}), "
        if self.z_recommended == 0:
            return f"{said}: none is recommended; {self.limit}"
        return (
            f"{said}: {first}stable to {in_words(self.largest)} (z = {self.z_largest:.4g}), fastest at "
            f"{in_words(self.fastest)} (z = {self.z_fastest:.4g}, error × {self.radius:.3g} per step); {self.limit}"
        )


@record
class Margin:
    """How far a loop is from instability.

    Attributes:
      z: alpha·Ts (largest |eigenvalue| of a gain matrix).
      z_largest: where it becomes unstable.
      margin: z_largest/z, the factor by which alpha may still grow; below 1 the loop is unstable.
      radius: spectral radius now.
      limit: what becomes unstable first, in words.
    """

    z: float
    z_largest: float
    margin: float
    radius: float
    limit: str


@record
class Analysis:
    """The whole stability analysis of a loop at rest.

    Attributes:
      gains: `Recommendation` of alpha at this Ts.
      times: `Recommendation` of Ts at this alpha; None where there is a drive, which has times of its own.
      margin: `Margin` of the loop as it is.
      spectrum: `Spectrum` of the loop as it is.
    """

    gains: Recommendation
    times: Recommendation | None
    margin: Margin
    spectrum: Spectrum


@in_float64
def recommend(
    law: Law,
    reference: Reference | None,
    q: Float[ArrayLike, " n"],
    *,
    Ts: Number | None = None,
    method: MethodLike = DEFAULT,
    stage: Stage = picard(5),
    drive: Drive = Drive(),
    reach: float = REACH,
) -> Recommendation:
    """The safe gain at a sampling time; with Ts None, the safe sampling time at the law's gain. In float64.

    The spectral radius of the whole loop at rest (task directions, and null-space directions where a null-space
    velocity moves them) is followed from small gains up to the first gain where it exceeds 1. The result holds for
    small errors; `certified_radius` and the measured maps show how large they may be.

    Args:
      law: its alpha, of any shape, is what is scaled.
      reference: the held reference, or None: where q is.
      q: (n,) joint values at rest [rad, m], see `settle`.
      Ts: sampling time [s], or None.
      method, stage: as for `solve`.
      drive: what lies between command and motion, see `Drive`; its limits and noise are ignored here.
      reach: largest z that is considered.
    """
    return recommendation_of(loop_at_rest(law, reference, q, method, stage, drive), Ts, reach)


@in_float64
def margin(
    law: Law,
    reference: Reference | None,
    q: Float[ArrayLike, " n"],
    *,
    Ts: Number,
    method: MethodLike = DEFAULT,
    stage: Stage = picard(5),
    drive: Drive = Drive(),
    reach: float = REACH,
) -> Margin:
    """The gain margin of a loop at rest: the factor by which alpha may grow until the loop is unstable. In float64.

    Args: as for `recommend`.
    """
    return _margin(loop_at_rest(law, reference, q, method, stage, drive), Ts, reach)[1]


@in_float64
def analyse(law, reference, q, *, Ts, method=DEFAULT, stage=picard(5), drive=Drive(), reach=REACH) -> Analysis:
    """Safe gains at this Ts, safe Ts at this gain, the margin and the eigenvalues of a loop at rest. In float64.

    Args: as for `recommend`.
    """
    return analysis_of(loop_at_rest(law, reference, q, method, stage, drive), Ts, reach)


def analysis_of(loop: LoopAtRest, Ts, reach=REACH) -> Analysis:
    gains, room, now = _margin(loop, Ts, reach)
    times = recommendation_of(loop, None, reach) if loop.drive.prompt else None
    return Analysis(gains=gains, times=times, margin=room, spectrum=now)


def _margin(loop, Ts, reach):
    """`Recommendation` of alpha, `Margin` and `Spectrum`."""
    z = loop.rate * float(errors.number("Ts", Ts, positive=True))
    gains = recommendation_of(loop, Ts, reach)
    now = loop.now(Ts)
    size = now.radius
    if not loop.drive.prompt:
        size = float(radius(loop.modes(np.array([z]), Ts)[0], loop.drive, Ts)[0])
    known = dict(z=z, z_largest=gains.z_largest, margin=gains.z_largest / z, radius=size, limit=gains.limit)
    return gains, Margin(**known), now


def recommendation_of(loop: LoopAtRest, Ts, reach=REACH) -> Recommendation:
    law, rate, drive = loop.law, loop.rate, loop.drive
    reach = float(errors.number("reach", reach, positive=True))
    if Ts is not None:
        errors.number("Ts", Ts, positive=True)
    elif not drive.prompt:
        raise errors.fail("Ts", "be given where there is a drive", "is None")

    def value(z):
        if Ts is None or z is None:
            return z if z is None else z / rate
        alpha = np.asarray(law.alpha)
        return np.multiply(alpha, z / (rate * Ts), where=alpha != 0, out=np.zeros(alpha.shape))  # 0·∞ remains 0

    def slowest(z):
        return loop.radii(z, Ts)[0]

    z_largest = largest_stable(loop, Ts, reach)
    z_fastest, least = least_on(slowest, min(z_largest, reach), loop.points) if z_largest else (0.0, 1.0)
    if z_fastest >= reach:
        z_fastest = np.inf
    z_monotone = z_recommended = None
    astray = "" if Ts is None else rebased.astray(drive, Ts)
    if Ts is not None:
        some = z_largest and not astray
        z_monotone, z_recommended = (
            without_overshoot(loop, one, Ts, z_largest, reach) if some else 0.0 for one in (drive, longer(drive))
        )
        z_recommended = min(z_recommended, z_monotone)
    bounded = np.isfinite(z_largest)
    edge = max(z_largest, 1e-9) * (1 + 1e-6) if bounded else 1.0  # without a limit, only for the direction
    moved, rows = loop.along(np.array([edge]), Ts)
    beyond = spectrum_of(moved[0], rows)
    return Recommendation(
        name="Ts" if Ts is None else "alpha",
        assumed=assumed_of(drive, Ts),
        largest=value(z_largest),
        fastest=value(z_fastest),
        monotone=value(z_monotone),
        recommended=value(z_recommended),
        z_largest=z_largest,
        z_fastest=z_fastest,
        z_monotone=z_monotone,
        z_recommended=z_recommended,
        radius=least,
        limit=_what_limits(loop, beyond, z_largest, astray, Ts),
        direction=beyond.direction,
        evaluations=int(evaluations_per_step(loop.method, loop.stage, law.chain.n)),
    )


def assumed_of(drive: Drive, Ts) -> str:
    """What is assumed of the drives where only their dead time is known; "" where more is known, or nothing matters."""
    late = drive.lumped.delay
    if drive.order or drive.feedback == "commanded":
        return ""
    if not late:
        return "Assumed: the drives follow at once, without dead time, lag or servo."
    return f"Assumed: after {in_samples(late, Ts)} of dead time the drives follow at once, without a lag."


def largest_stable(loop: LoopAtRest, Ts, reach=REACH) -> float:
    """Largest stable z, of gains at a sampling time, or, with Ts None, of sampling times; inf where every one is."""

    def worst(z):
        task, null = loop.radii(z, Ts)
        return np.maximum(task, null - MEETING)

    return first_above(worst, 1 + SLACK, reach, loop.points)


def without_overshoot(loop, drive, Ts, most, reach) -> float:
    """Largest z up to `most` without overshoot through a drive, see `DrivenLimits`; of several the slowest joint's."""
    modes, points = lambda z: loop.prompt.modes(z, Ts)[0], looked_at(drive, 3)
    return monotone_limit(modes, side_by_side(drive), Ts, most, reach, points)


LATE = 2  # samples, from which on exponential steps have a limit


def _why(loop) -> str:
    if not loop.drive.prompt:
        return "removes less of an error than the drive could make grow"
    method = loop.method
    if not method.exponential:
        return "solves the stiff part"
    late = f"an error delayed by {LATE} samples brings a limit back, z < {delay_limit(LATE, method):.3g}"
    return f"removes a share of an error, never more than all of it ({late})"


def _how(loop):
    return str(loop.method) + (f" with {loop.stage}" if loop.method.implicit else "")


def _what_limits(loop, beyond, z_largest, astray, Ts) -> str:
    """A clause on what becomes unstable first beyond the largest stable value."""
    if astray:
        return astray
    if not np.isfinite(z_largest):
        return f"no limit from stability: {_how(loop)} {_why(loop)}"
    if z_largest == 0 and loop.law.null_velocity is not None:
        through, radii = "", (beyond.radius, beyond.null_radius)
        if max(radii) <= UNSTABLE:
            through, radii = "through dead time and drive ", (v[0] for v in loop.radii(np.array([1e-9]), Ts))
        (factor, what) = max(zip(radii, ("an error, through this J#,", "a motion"), strict=True))
        return f"none is stable: {through}the null-space velocity multiplies {what} by {factor:.4g} each step"
    if loop.law.null_velocity is not None and beyond.null_radius > max(beyond.radius, 1.0):
        return "limited by the null-space velocity"
    if not loop.drive.prompt and loop.drive.feedback != "commanded":
        return "limited by dead time and drive: beyond this limit the error oscillates and grows"
    worst = beyond.task[0]
    if abs(worst.imag) > 1e-6:
        change = f"the error turns by {abs(np.degrees(np.angle(worst))):.3g}° per step and grows"
    else:
        change = "the error changes sign every step and grows" if worst.real < 0 else "the error grows"
    parts = zip(loop.law.task.names, beyond.direction, strict=True)
    along = ", ".join(f"{axis} {x:+.2f}" for axis, x in parts if abs(x) > 0.005)
    return f"limited by {_how(loop)}: beyond this limit {change}, along {along}"
