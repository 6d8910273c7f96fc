"""Advice: what lies behind an oscillation or a growth, and the gain, the sign or the frame that would end it."""

import numpy as np

from cnclik.diagnosis.judge import Kind
from cnclik.diagnosis.late import Loop, gain_of, loops_of, phase_delay
from cnclik.diagnosis.modes import trend
from cnclik.diagnosis.turned import APART, together, turned_of
from cnclik.quantities import in_samples
from cnclik.stability.driven import DrivenLimits, driven_limits
from cnclik.stability.linear import late_monotone, late_stable

LATEST = 500  # samples of dead time: what is later is no robot
SLOW = 60  # samples of a period from which on a path may have it
NEAR = 1.25  # factor between alpha·Ts and z that is worth no word
SURE = 0.1  # confidence in the dead time below which no gain is named
APART_Z = 3.0  # factor between alpha·Ts and z from which on what swings is not that loop
BELOW = 0.97  # share of the limit below which a loop can't keep an oscillation by itself
LIKELY = 0.02  # share of the likeliest loop's probability from which on another one has a say in the gain
CAREFUL = 0.25  # share of the probability of loops for which a gain may be too much
CLOSE = 0.15  # share of the whole lateness by which dead times are the same
OTHER = 0.6  # confidence in a loop behind what keeps its size: a path may do the same
HALF_TURN = 3.5  # radians of an oscillation that must be seen, to be none of a path
FOLDS = 3.0  # by e, over which what grows or shrinks is seen
WHOLE = 0.95  # confidence in what needs no fit: a sign, a frame
UNLESS = (
    "Where position commands begin at the measured joints a smaller gain may not help: begin each at the last command."
)
BOTH = "--alpha or a recorded step (--step) decides"


def advice(kind, factor, shape, y, noise, alpha, Ts) -> dict:
    """Fields of a `Diagnosis` about the loop that a factor belongs to.

    Args:
      kind: what its oscillation does. shape: (k,) complex, of the columns. y: (N, k) the recording without its path.
    Returns: beside the fields, "whole": whether the loop explains the recording.
    """
    turned = turned_of(shape, factor) if len(shape) > 1 else None
    if turned is not None:
        return _said_turned(kind, factor, turned, together(shape), alpha, Ts)
    gain = None if alpha is None or kind is Kind.SUSTAINED else alpha * Ts
    loops, whole = loops_of(factor, y, trend(len(y)), noise, Ts, gain)
    best = loops[0]
    if whole and kind is not Kind.SUSTAINED:
        own = best.slowest(Ts)
        if np.angle(own):  # else a loop so calm doesn't swing, and the recording does
            factor, kind = own, Kind.GROWING if np.abs(own) > 1 else Kind.RINGING
    made = _about(kind, factor, phase_delay(factor)) | {
        "delay": best.delay,
        "whole": whole,
        "pure": whole and not best.lag,
    }
    made |= {"confidence": _confidence(loops, whole)}
    if best.delay > LATEST:
        return made | {"z": gain_of(factor, best.delay), "note": "So late is no robot: this may be a path."}
    made |= {"cause": "lag" if best.lag else "dead time"} | ({"lag": best.lag} if best.lag else {})
    limits, notes, z = limits_of(best, Ts), [], best.z
    likely = [one for one in loops if one.share > LIKELY * best.share or not whole]
    share = _careful(likely, Ts) if gain is None or not whole else limits.recommended / z
    if kind is Kind.SUSTAINED and whole and z < BELOW * limits.stable:
        made["kind"] = Kind.RINGING
        notes.append("It is excited again and again.")
    elif kind is Kind.SUSTAINED:
        share, z = share * z / limits.stable, limits.stable
        made["confidence"] = min(made["confidence"], OTHER)
        notes.append("What keeps its size is clipped, by a limit of speed or by friction: z may be larger.")
    if made["period"] > SLOW and (gain is None or not 1 / NEAR < gain / z < NEAR):
        made["confidence"] = min(made["confidence"], OTHER)
        notes.append("A path may have this period, too (--longest-period).")
    if np.abs(np.angle(factor)) * FOLDS < HALF_TURN * np.abs(np.log(np.abs(factor))):  # bends of a path do as much
        made["confidence"] = min(made["confidence"], OTHER)
    if made["period"] < 2.01:
        notes.append("Values return every second sample: z is above 1.")
    notes += _alike(likely, best, whole, gain, Ts)
    if len(shape) > 1 and together(shape) < APART:
        made["confidence"] *= together(shape)
        notes.append(
            "The columns do not swing together: frames of error and Jacobian that are turned against each other do "
            "this, too. Move the target along one axis at a small gain: if another axis moves first, they are."
        )
    if gain is not None and not 1 / NEAR < gain / z < NEAR:
        notes.append(f"alpha·Ts is {gain:.4g}: what is measured or driven changes the gain by {z / gain:.3g}.")
    doubtful = made["confidence"] < SURE and not (whole or len(likely) > 1)
    apart = alpha is not None and not 1 / APART_Z < z / (alpha * Ts) < APART_Z
    if doubtful or apart:
        why = f"alpha·Ts is {alpha * Ts:.4g}, far from this z, so " if apart else ""
        note = (
            f"No gain is named: {why}this may be the motion of a path, or of another loop. Record the loop at rest, "
            "pushed."
        )
        return made | {"z": z, "note": note}
    made |= {"z": z, "stable": limits.stable, "monotone": limits.monotone, "recommended": share * z, "factor": share}
    made |= {"note": " ".join([*notes, UNLESS])}
    return made | ({} if alpha is None else {"recommended_alpha": alpha * share})


def advice_excited(loops, alpha, Ts) -> dict:
    """Fields of a `Diagnosis` of a loop that noise keeps swinging."""
    best, factor = loops[0], loops[0].slowest(Ts)
    made = _about(Kind.RINGING, factor, phase_delay(factor))
    limits, share = limits_of(best, Ts), _careful(loops, Ts)
    notes = ["Noise excites it again and again.", *_alike(loops, best, False, None, Ts)]
    if alpha is not None and not 1 / NEAR < alpha * Ts / best.z < NEAR:
        notes.append(f"alpha·Ts is {alpha * Ts:.4g}: what is measured or driven changes the gain by "
                     f"{best.z / (alpha * Ts):.3g}.")  # fmt: skip
    made |= {"delay": best.delay, "z": best.z, "pure": not best.lag, "cause": "lag" if best.lag else "dead time"}
    made |= {"lag": best.lag or None}
    made |= {"stable": limits.stable, "monotone": limits.monotone, "recommended": share * best.z, "factor": share}
    sure = min(_confidence(loops, True), WHOLE)
    if made["period"] > SLOW:
        sure = min(sure, OTHER)
        notes.append("A path may have this period, too (--longest-period).")
    made |= {"confidence": sure, "note": " ".join([*notes, UNLESS])}
    return made | ({} if alpha is None else {"recommended_alpha": alpha * share})


def _about(kind, factor, phase) -> dict:
    turn = 2 * np.pi / np.abs(np.angle(factor))
    return {"kind": kind, "period": float(turn), "growth": float(np.abs(factor)), "phase_delay": phase}


def _careful(likely, Ts) -> float:
    """The factor of the gain that is not too much for most of the likely loops."""
    factors = np.array([one.calm(Ts) / one.z for one in likely])
    shares = np.array([one.share for one in likely])
    order = np.argsort(factors)
    return float(factors[order][np.argmax(np.cumsum(shares[order]) >= CAREFUL * shares.sum())])


def _confidence(loops, whole) -> float:
    """How likely the dead time of the first is, among all loops that were tried."""
    best = loops[0]
    if not whole:
        return best.share
    near = max(0.5, CLOSE * max(one.delay for one in loops))
    return float(sum(one.share for one in loops if abs(one.delay - best.delay) <= near))


def _alike(likely, best, whole, gain, Ts) -> list:
    """What else the recording may be of, and what decides."""
    if gain is not None and whole:
        if best.lag:
            return ["Dead time and lag are those that alpha and the oscillation say; a recorded step tells more "
                    "(--step)."]  # fmt: skip
        return []
    late, slow = max(likely, key=lambda one: one.delay), min(likely, key=lambda one: one.delay)
    if late.delay - slow.delay <= max(0.5, CLOSE * late.delay):
        return []
    return [
        f"Dead time of {_words(late)} and of {_words(slow)} are both possible, and what lies between: the gain suits "
        f"most, {BOTH}."
    ]


def _words(loop) -> str:
    """A loop's dead time and lag."""
    return f"{loop.delay:.3g} samples" + (f" with a lag of {1e3 * loop.lag:.3g} ms" if loop.lag else " alone")


def _said_turned(kind, factor, turned, round_, alpha, Ts) -> dict:
    axis = (
        "xyz"[int(np.argmax(np.abs(turned.axis)))] if np.max(np.abs(turned.axis)) > 0.99 else np.round(turned.axis, 2)
    )
    note = (
        f"Error and Jacobian are in frames that are turned by {abs(turned.degrees):.3g}° against each other, about "
        f"{axis}: no gain mends that. Turn the error by {-turned.degrees:.3g}° before J#, or give both in one frame."
    )
    if alpha is not None and not 1 / NEAR < alpha * Ts / turned.z < NEAR:
        note += f" alpha·Ts is {alpha * Ts:.4g}, and z here {turned.z:.4g}."
    made = _about(kind, factor, None) | {"cause": "turned frames", "z": turned.z, "delay": 0}
    sure = WHOLE * (1 - round_ / 4)
    if np.abs(np.angle(factor)) * FOLDS < 0.5 * np.pi * np.abs(
        np.log(np.abs(factor))
    ):  # less than a quarter turn is seen
        sure = min(sure, OTHER)
    known = alpha is not None and 1 / NEAR < alpha * Ts / turned.z < NEAR
    if kind is Kind.SUSTAINED and not known:
        sure, note = min(sure, OTHER), note + " A path that is a circle looks alike: record the loop at rest, pushed."
    return made | {"angle": turned.degrees, "axis": turned.axis, "confidence": sure, "note": note}


def growth_without_end(factor, shape, clear, alpha, Ts) -> dict:
    """Fields of a `Diagnosis` of what grows by a factor a sample and never returns; clear: as no path does."""
    turned = turned_of(shape, factor) if len(shape) > 1 else None
    if turned is not None:
        return _said_turned(Kind.DIVERGING, factor, turned, together(shape), alpha, Ts)
    factor = float(np.abs(factor))
    note = (
        "Each step adds to the error: the sign of the error, of the Jacobian or of the command is wrong. No gain ends "
        "that."
    )
    more = factor - 1
    share = np.nan if alpha is None else alpha * Ts / more  # factor ** d of a loop with d samples of dead time
    made = {"growth": factor, "z": -alpha * Ts if share >= 1 / NEAR else -more, "cause": "wrong sign"}
    if share < 1 / NEAR:
        note += f" It grows by {more:.3g} a sample and alpha·Ts is {alpha * Ts:.3g}: something else pushes as well."
    elif share > NEAR and (delay := float(np.log(share) / np.log(factor))) <= LATEST:
        note += f" At alpha·Ts = {alpha * Ts:.3g} such a loop has {in_samples(delay, Ts)} of dead time."
        made |= {"delay": delay}
    clear = clear or 1 / NEAR <= share <= NEAR  # it grows as fast as alpha itself makes it
    if not clear:
        note += " A path that starts slowly may look alike: record the loop at rest, pushed."
    return made | {"confidence": WHOLE if clear else OTHER, "note": note}


def limits_of(loop: Loop, Ts) -> DrivenLimits:
    """`driven_limits` of explicit Euler; with a whole number of samples of dead time alone in closed form.

    Where that is monotone no longer a double factor is d/(d + 1).
    """
    if loop.lag or loop.delay != round(loop.delay):
        return driven_limits("EE", Ts=Ts, drive=loop.drive)
    d = round(loop.delay)
    most = late_monotone(d)
    return DrivenLimits(
        stable=late_stable(d), monotone=most, recommended=late_monotone(d + 1), fastest=most, rate=d / (d + 1)
    )
