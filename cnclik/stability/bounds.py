"""Limits as loops of their own: a joint that nears a limit at rate · (limit − q) has a gain too, and a dead time."""

from __future__ import annotations

import numpy as np

from cnclik.quantities import in_samples
from cnclik.record import record
from cnclik.stability.driven import driven_limits, each_drive


@record
class LimitAdvice:
    """How fast joints may near their limits: q̇ ≤ rate · (limit − q) is explicit Euler on ė = −rate·e.

    Attributes:
      rate: of the law's limits [1/s]. z: rate·Ts.
      largest_stable_rate: beyond, a joint at a limit swings and grows, as far as what it is asked for lets it.
      fastest_rate: the largest with which no joint passes its limit; recommended_rate: were the dead time a sample
        longer.
      words: what the rate of the law does.
    """

    rate: float
    z: float
    largest_stable_rate: float
    fastest_rate: float
    recommended_rate: float
    words: str


def limit_advice(law, drive, Ts: float) -> LimitAdvice | None:
    """Of a law whose joints near their limits at a rate; None where there is none. Args: drive: see `Drive`."""
    rate = getattr(law.limits, "rate", None)
    if rate is None or not np.isfinite([law.chain.lower, law.chain.upper]).any():
        return None
    rate = float(rate)
    found = [driven_limits("EE", Ts=Ts, drive=one) for one in each_drive(drive)]
    stable, fastest, recommended = (
        min(getattr(one, name) for one in found) / Ts for name in ("stable", "monotone", "recommended")
    )
    late = drive.lumped.delay
    through = f" through these drives, {in_samples(late, Ts)} late" if late else ""
    kinds = (
        (rate > stable, f"is UNSTABLE{through}: a joint at a limit swings; at most {stable:.3g} 1/s is stable"),
        (rate > fastest * (1 + 1e-9), f"takes joints past their limits{through}; up to {fastest:.3g} 1/s does not"),
        (rate > recommended * (1 + 1e-9), "keeps joints within their limits, but not with a sample more of dead time"),
        (True, "keeps joints within their limits, even with a sample more of dead time"),
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
        words=f"limits with rate = {rate:g} 1/s (z = {np.round(rate * Ts, 6):g}) {words}",
    )
