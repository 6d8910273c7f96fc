"""Recommendations: what gain is safe at a sampling time, what sampling time at a gain, and how far off the edge is."""

from typing import NamedTuple

import numpy as np

from cnclik import errors
from cnclik.integrate.method import DEFAULT, Method
from cnclik.integrate.solve import evaluations_per_step
from cnclik.integrate.stage import picard
from cnclik.precision import in_float64
from cnclik.record import in_words, record
from cnclik.robot.kinematics import as_joint_values
from cnclik.stability.linear import EPS, checked, delay_limit, first_above, least_on
from cnclik.stability.spectrum import (
    Spectrum,
    at_rest,
    largest_rate,
    null_radius,
    spectrum_of,
    step_map,
    step_maps,
    task_radius,
)

_SLACK = 2**22 * EPS  # a radius above 1 by more than this is unstable: rounding of eigenvalues that are 1 is not
REACH = 1e4  # z up to which is looked
POINTS = 256  # values of z that are looked at together: each is a whole loop's step differentiated


@record
class Recommendation:
    """Safe values of one quantity, alpha or Ts, the other one given.

    Attributes:
      name: "alpha" or "Ts".
      largest: the largest stable value, of the law's alpha's shape; inf where every one is stable.
      fastest: the value with the smallest spectral radius; inf where larger is faster without end.
      z_largest, z_fastest: alpha·Ts there (largest |eigenvalue| of a gain matrix).
      radius: spectral radius at `fastest`: the factor by which a step then multiplies the error.
      limit: what gives way first beyond `largest`, in words.
      direction: (m,) the task direction in which it does.
      evaluations: evaluations of f that a step costs.
    """

    name: str
    largest: object
    fastest: object
    z_largest: float
    z_fastest: float
    radius: float
    limit: str
    direction: np.ndarray
    evaluations: int

    def __str__(self):
        return (
            f"{self.name}: stable to {in_words(self.largest)} (z = {self.z_largest:.4g}), fastest at "
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
      limit: what gives way first, in words.
    """

    z: float
    z_largest: float
    margin: float
    radius: float
    limit: str


@record
class Advice:
    """What stability says of a loop at rest, all of it.

    Attributes:
      gains: `Recommendation` of alpha at this Ts.
      times: `Recommendation` of Ts at this alpha.
      margin: `Margin` of the loop as it is.
      spectrum: `Spectrum` of the loop as it is.
    """

    gains: Recommendation
    times: Recommendation
    margin: Margin
    spectrum: Spectrum


class _Loop(NamedTuple):
    """A loop at rest, checked, with the number behind its gain."""

    law: object
    held: object
    q: object
    method: Method
    stage: object
    rate: float


def _loop(law, reference, q, method, stage) -> _Loop:
    method, stage = checked(method, stage)
    held = at_rest(law, reference, q)
    return _Loop(law, held, as_joint_values(law.chain, q), method, stage, largest_rate(law.alpha))


@in_float64
def recommend(law, reference, q, *, Ts=None, method=DEFAULT, stage=picard(5), reach=REACH) -> Recommendation:
    """Which gain is safe at this sampling time; or, with Ts None, which sampling time at the law's gain. In float64.

    The spectral radius of the whole loop at rest (task directions, and null-space directions where a null-space
    velocity moves them) is followed from small gains up to the first one above 1. It is a statement about small
    errors; `certified_radius` and the measured maps say how far it carries.

    Args:
      law: its alpha, of any shape, is what is scaled.
      reference: the held reference, or None: where q is.
      q: (n,) joint values at rest [rad, m], see `settle`.
      Ts: sampling time [s], or None.
      method, stage: as for `solve`.
      reach: z up to which is looked.
    """
    return _recommend(_loop(law, reference, q, method, stage), Ts, reach)


@in_float64
def margin(law, reference, q, *, Ts, method=DEFAULT, stage=picard(5), reach=REACH) -> Margin:
    """The gain margin of a loop at rest: by which factor alpha may grow before it is unstable. In float64.

    Args: as for `recommend`.
    """
    return _margin(_loop(law, reference, q, method, stage), Ts, reach)[1]


@in_float64
def advise(law, reference, q, *, Ts, method=DEFAULT, stage=picard(5), reach=REACH) -> Advice:
    """Safe gains at this Ts, safe Ts at this gain, the margin and the eigenvalues of a loop at rest. In float64.

    Args: as for `recommend`.
    """
    loop = _loop(law, reference, q, method, stage)
    gains, room, now = _margin(loop, Ts, reach)
    return Advice(gains=gains, times=_recommend(loop, None, reach), margin=room, spectrum=now)


def _margin(loop, Ts, reach):
    """`Recommendation` of alpha, `Margin` and `Spectrum`."""
    z = loop.rate * float(errors.number("Ts", Ts, positive=True))
    gains = _recommend(loop, Ts, reach)
    now = spectrum_of(*step_map(loop.law, loop.held, loop.q, Ts, loop.method, loop.stage))
    known = dict(z=z, z_largest=gains.z_largest, margin=gains.z_largest / z, radius=now.radius, limit=gains.limit)
    return gains, Margin(**known), now


def _recommend(loop, Ts, reach) -> Recommendation:
    law, rate, reach = loop.law, loop.rate, float(errors.number("reach", reach, positive=True))
    if Ts is not None:
        errors.number("Ts", Ts, positive=True)

    def value(z):
        if Ts is None:
            return z / rate
        alpha = np.asarray(law.alpha)
        return np.multiply(alpha, z / (rate * Ts), where=alpha != 0, out=np.zeros(alpha.shape))  # 0·∞ stays 0

    def maps(z):
        z = np.asarray(z, float)
        scale, times = (np.ones_like(z), z / rate) if Ts is None else (z / (rate * Ts), np.full_like(z, Ts))
        return step_maps(law, loop.held, loop.q, scale, times, loop.method, loop.stage)

    def worst(z):
        moved, rows = maps(z)
        return np.maximum(task_radius(moved, rows), null_radius(moved, rows))

    z_largest = first_above(worst, 1 + _SLACK, reach, POINTS)
    z_fastest, least = least_on(lambda z: task_radius(*maps(z)), min(z_largest, reach), POINTS)
    if z_fastest >= reach:
        z_fastest = np.inf
    bounded = np.isfinite(z_largest)
    moved, rows = maps(np.array([z_largest * (1 + 1e-6) if bounded else 1.0]))  # unbounded: only for the direction
    beyond = spectrum_of(moved[0], rows)
    return Recommendation(
        name="Ts" if Ts is None else "alpha",
        largest=value(z_largest),
        fastest=value(z_fastest),
        z_largest=z_largest,
        z_fastest=z_fastest,
        radius=least,
        limit=_what_limits(loop, beyond) if bounded else f"no limit from stability: {_how(loop)} {_why(loop.method)}",
        direction=beyond.direction,
        evaluations=int(evaluations_per_step(loop.method, loop.stage, law.chain.n)),
    )


LATE = 2  # samples, from which on exponential steps have a limit


def _why(method) -> str:
    if not method.exponential:
        return "solves the stiff part"
    late = f"an error {LATE} samples late brings one back, z < {delay_limit(LATE, method):.3g}"
    return f"takes back a share of an error, never more than all of it ({late})"


def _how(loop):
    return str(loop.method) + (f" with {loop.stage}" if loop.method.implicit else "")


def _what_limits(loop, beyond) -> str:
    """The first thing to give way just beyond the largest stable value, in words."""
    if beyond.null_radius > max(beyond.radius, 1.0):
        return "limited by the null-space velocity"
    worst = beyond.task[0]
    if abs(worst.imag) > 1e-6:
        change = f"the error turns by {abs(np.degrees(np.angle(worst))):.3g}° per step and grows"
    else:
        change = "the error changes sign every step and grows" if worst.real < 0 else "the error grows"
    parts = zip(loop.law.task.names, beyond.direction, strict=True)
    along = ", ".join(f"{axis} {x:+.2f}" for axis, x in parts if abs(x) > 0.005)
    return f"limited by {_how(loop)}: beyond, {change}, along {along}"
