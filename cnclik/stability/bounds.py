"""Limits and walls as loops of their own: what nears one at rate · (distance to it) has a gain too, and a dead time."""

from __future__ import annotations

from typing import Any

import numpy as np

from cnclik.law.walls import rate_of
from cnclik.quantities import in_samples
from cnclik.record import record
from cnclik.stability.driven import least_limits


@record
class LimitAdvice:
    """How fast joints may near their limits, and what walls keep back: ḣ ≥ −rate·h is explicit Euler on ė = −rate·e.

    Attributes:
      rate: of the law's limits and walls, the largest [1/s]. z: rate·Ts.
      largest_stable_rate: beyond, a joint at a limit swings and grows, as far as what it is asked for lets it.
      fastest_rate: the largest with which none passes its limit; recommended_rate: were the dead time a sample
        longer.
      words: what the rate of the law does.
    """

    rate: float
    z: float
    largest_stable_rate: float
    fastest_rate: float
    recommended_rate: float
    words: str


_LIMITS = "limits", "keeps joints within their limits", "takes joints past their limits"
_WALLS = "a wall", "keeps the robot on its side", "lets the robot pass"


def limit_advice(law, drive, Ts: float) -> LimitAdvice | None:
    """Of a law whose joints near limits or walls at a rate; None where there is none. Args: drive: see `Drive`."""
    of_all: Any = getattr(law.limits, "rate", None)
    walls = getattr(law.limits, "walls", None) or ()
    rates = [(float(rate_of(one, of_all)), _WALLS) for one in walls]
    if of_all is not None and np.isfinite([law.chain.lower, law.chain.upper]).any():
        rates.append((float(of_all), _LIMITS))
    if not rates:
        return None
    rate, (what, keeps, passes) = max(rates)
    stable, fastest, recommended = (z / Ts for z in least_limits("EE", None, Ts, drive).values())
    late = drive.lumped.delay
    through = f" through these drives, {in_samples(late, Ts)} late" if late else ""
    kinds = (
        (rate > stable, f"is UNSTABLE{through}: what is held there swings; at most {stable:.3g} 1/s is stable"),
        (rate > fastest * (1 + 1e-9), f"{passes}{through}; up to {fastest:.3g} 1/s does not"),
        (rate > recommended * (1 + 1e-9), f"{keeps}, but not with a sample more of dead time"),
        (True, f"{keeps}, even with a sample more of dead time"),
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
        words=f"{what} with rate = {rate:g} 1/s (z = {np.round(rate * Ts, 6):g}) {words}",
    )
