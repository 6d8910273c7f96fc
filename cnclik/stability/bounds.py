"""Limits and walls as loops of their own: an approach at rate · (distance to it) has a gain and a dead time, too."""

from __future__ import annotations

from typing import Any

import numpy as np

from cnclik.law.walls import bends, names_of, rate_of, wall_distance
from cnclik.quantities import in_samples
from cnclik.record import record
from cnclik.stability.driven import least_limits
from cnclik.stability.loop import parts_of_numbers


@record
class LimitAdvice:
    """How fast joints may approach their limits, and tips a wall: ḣ ≥ −rate·h is explicit Euler on ė = −rate·e.

    Attributes:
      rate: of the law's limits and walls, the largest [1/s]. z: rate·Ts.
      largest_stable_rate: with a larger one a joint at its limit swings ever more, as far as the task lets it.
      fastest_rate: the largest with which no joint passes its limit.
      recommended_rate: the same with one more sample of dead time.
      words: what the rate of the law does.
    """

    rate: float
    z: float
    largest_stable_rate: float
    fastest_rate: float
    recommended_rate: float
    words: str


@record
class WallAdvice:
    """A wall at the posture where a loop rests.

    Attributes:
      distance: distance to it [`unit`]; where it is negative, the robot comes back at the wall's rate.
      rate: [1/s]. z: rate·Ts.
      passed: how far a step may pass the wall because a velocity is constant over Ts [`unit`], with the tips at the
        given speed in the worst direction of the task; see `wall_margin`. NaN where the task has no position.
      unit: m or rad.
    """

    distance: float
    rate: float
    z: float
    passed: float
    unit: str


def wall_advice(loop, Ts: float, speed: float) -> dict[str, WallAdvice]:
    """The `WallAdvice` of each wall of a loop at rest, by name. Args: speed: of the tips [m/s]."""
    law, q = loop.law, loop.q
    walls = getattr(law.limits, "walls", None)
    if not walls:
        return {}
    away, bent, found = wall_distance(law, q), np.asarray(bends(walls, law.chain, q)), {}
    weights = 1.0 if law.task.weights is None else np.asarray(law.task.weights, float)
    moved = speed * (np.asarray(parts_of_numbers(law, loop.held, q)[1]) * weights)[:, law.task.lengths]
    for i, (name, wall) in enumerate(zip(names_of(walls), walls, strict=True)):
        rate, curved = float(rate_of(wall, law.limits.rate)), moved.T @ bent[i] @ moved
        most = max(0.0, -float(np.linalg.eigvalsh(curved + curved.T)[0]) / 2) if curved.size else np.nan
        said = dict(distance=float(away[i]), rate=rate, z=rate * Ts, passed=most * Ts / (2 * rate))
        found[name] = WallAdvice(**said, unit=wall.task.units[0])
    return found


def _held(names):
    """(what some walls are, and joint limits, None among the names; that they keep; that they do not), in words."""
    walls = [name for name in names if name is not None]
    if not walls:
        return "joint limits", "joints stay within them", "joints pass them"
    what = ["joint limits"] * (None in names) + [f"wall {walls[0]}" if len(walls) == 1 else f"{len(walls)} walls"]
    if len(names) == 1:
        return what[0], "the robot stays on its side", "the robot passes it"
    return " and ".join(what), "the robot stays within them", "the robot passes them"


def limit_advice(law, drive, Ts: float) -> LimitAdvice | None:
    """The `LimitAdvice` of a law with limits or walls; None without. Args: drive: see `Drive`."""
    of_all: Any = getattr(law.limits, "rate", None)
    walls = getattr(law.limits, "walls", None) or ()
    named = zip(names_of(walls), walls, strict=True)
    rates: list = [(float(rate_of(one, of_all)), name) for name, one in named]
    if of_all is not None and np.isfinite([law.chain.lower, law.chain.upper]).any():
        rates.append((float(of_all), None))
    if not rates:
        return None
    rate = max(one for one, _ in rates)
    what, keeps, passes = _held([name for one, name in rates if one == rate])
    most = least_limits("EE", None, Ts, drive)
    stable, fastest, recommended = (z / Ts for z in (most.stable, most.monotone, most.recommended))
    late = drive.lumped.delay
    through = f" with {in_samples(late, Ts)} of dead time" if late else ""
    kinds = (
        (rate > stable, f"UNSTABLE{through}: what is held there swings; rates up to {stable:.3g} 1/s are stable"),
        (rate > fastest * (1 + 1e-9), f"{passes}{through}, but not at rates up to {fastest:.3g} 1/s"),
        (rate > recommended * (1 + 1e-9), f"{keeps}, but not with one more sample of dead time"),
        (True, f"{keeps}, even with one more sample of dead time"),
    )
    words = next(said for holds, said in kinds if holds)
    if rate > recommended:
        words += f"; recommended: {recommended:.3g} 1/s"
    return LimitAdvice(
        rate=rate,
        z=rate * Ts,
        largest_stable_rate=stable,
        fastest_rate=fastest,
        recommended_rate=recommended,
        words=f"{what}, rate = {rate:g} 1/s (z = {np.round(rate * Ts, 6):g}): {words}",
    )
