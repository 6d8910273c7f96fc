"""Advice: the loop behind an oscillation, its limits, and the gain that would end it."""

import numpy as np

from cnclik.diagnosis.judge import Kind
from cnclik.diagnosis.late import gain_of, lag_of, loop_of, slowest_of
from cnclik.diagnosis.modes import trend
from cnclik.stability.driven import DrivenLimits, driven_limits
from cnclik.stability.linear import late_monotone, late_stable

LATEST = 500  # samples of dead time: what is later is no robot
SLOW = 60  # samples of a period from which on a path may have it
NEAR = 1.25  # factor between alpha·Ts and z that is worth no word
SURE = 0.1  # confidence in the dead time below which no gain is named
APART = 3.0  # factor between alpha·Ts and z from which on what swings is not that loop
BELOW = 0.97  # share of the limit below which a loop can't keep an oscillation by itself


def advice(kind, factor, y, noise, alpha, Ts) -> dict:
    """Fields of a `Diagnosis` about the loop that a factor belongs to.

    Args:
      kind: what its oscillation does. y: (N, k) the recording without what of it is path.
    """
    late = loop_of(factor, y, trend(len(y)), noise)
    if late.whole and kind is not Kind.SUSTAINED:
        own = slowest_of(late.z, late.delay)
        factor = own if np.angle(own) else factor  # a loop so calm doesn't swing, and the recording does
    made = {"kind": kind, "period": float(2 * np.pi / np.abs(np.angle(factor))), "growth": float(np.abs(factor))}
    made |= {"delay": late.delay, "phase_delay": late.phase, "confidence": late.confidence, "pure": late.whole}
    if late.delay > LATEST:
        return made | {"z": gain_of(factor, late.delay), "note": "So late is no robot: this may be a path."}
    notes, z, limits = [], late.z, pure_limits(late.delay)
    if kind is Kind.SUSTAINED and late.whole and z < BELOW * limits.stable:
        made["kind"] = Kind.RINGING
        notes.append("It is excited again and again.")
    elif kind is Kind.SUSTAINED:
        z = limits.stable
        notes.append("What keeps its size is clipped, by a limit of speed or by friction: z may be larger.")
        if made["period"] > SLOW and not late.whole:
            notes.append("A path may have this period, too (--longest-period).")
    if made["period"] < 2.01:
        notes.append("Values return every second sample: z is above 1.")
    if alpha is not None and made["kind"] is not Kind.SUSTAINED and not 1 / NEAR < alpha * Ts / z < NEAR:
        drive = None if late.whole else lag_of(factor, alpha * Ts, Ts)
        if drive is not None:
            z, limits = alpha * Ts, driven_limits("EE", Ts=Ts, drive=drive)
            made |= {"delay": drive.delay, "lag": float(drive.lag)}
            notes.append(
                "Dead time and lag are those that alpha and the oscillation say; a recorded step tells more (--step)."
            )
        else:
            notes.append(
                f"alpha·Ts is {alpha * Ts:.4g}: what is measured or driven changes the gain by {z / (alpha * Ts):.3g}."
            )
    elif not late.whole and kind is not Kind.SUSTAINED:
        notes.append(
            "A drive lags: without its gain (--alpha) or a recorded step (--step) twice too much may be advised."
        )
    doubtful = made.get("confidence", 1.0) < SURE or (
        alpha is not None and not 1 / APART < z / (alpha * Ts) < APART and not made.get("lag")
    )
    if doubtful:  # a path looks like a slow loop with much dead time
        note = (
            "No gain is named: this may be the motion of a path, or of another loop. Record the loop at rest, pushed."
        )
        return made | {"z": z, "note": note}
    made |= {"z": z, "stable": limits.stable, "monotone": limits.monotone, "recommended": limits.recommended}
    made |= {"factor": limits.recommended / z, "note": " ".join(notes)}
    if alpha is not None:
        made |= {"recommended_alpha": alpha * made["factor"]}
    return made


def pure_limits(delay: int) -> DrivenLimits:
    """`driven_limits` of explicit Euler with d samples of dead time alone, in closed form.

    Where it is monotone no longer a double factor is d/(d + 1).
    """
    most = late_monotone(delay)
    return DrivenLimits(
        stable=late_stable(delay),
        monotone=most,
        recommended=late_monotone(delay + 1),
        fastest=most,
        rate=delay / (delay + 1),
    )
