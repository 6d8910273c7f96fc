"""Advice: the cause of an oscillation or a growth, and the gain, sign or frame that stops it.

If the frames of error and Jacobian are turned by θ about an axis, a step leaves e[k+1] = (1 − z e^{iθ}) e[k] across the
axis: a spiral, in which one coordinate follows another by a quarter turn. With dead time alone all coordinates
oscillate in phase.
"""

from typing import NamedTuple

import numpy as np

from cnclik.diagnosis.judge import Kind
from cnclik.diagnosis.late import LateLoop, gain_of, loops_of, phase_delay
from cnclik.diagnosis.modes import trend
from cnclik.quantities import in_samples
from cnclik.stability.driven import DrivenLimits, driven_limits
from cnclik.stability.linear import late_monotone, late_stable

LATEST = 500  # samples of dead time, at most, of a robot
SLOW = 60  # samples; a path may oscillate with a longer period
NEAR = 1.25  # factor between alpha·Ts and z that needs no note
SURE = 0.1  # confidence in the dead time below which no gain is recommended
APART_Z = 3.0  # factor between alpha·Ts and z beyond which another loop oscillates
BELOW = 0.97  # share of the limit below which a loop cannot sustain an oscillation
LIKELY = 0.02  # share of the likeliest loop's probability, at least, for another one to affect the gain
CAREFUL = 0.25  # share of the loops' probability for which a gain may be too large
TAIL = 0.1  # share of it, on either side, that does not count as to how far gains for these loops are apart
AGREED = 2.5  # and that factor, beyond which a gain that is safe for most may be far too low for the loop
CLOSE = 0.15  # share of the total delay within which dead times are about equal, and gains, too
ONE = 0.5  # [samples] within which they are one
OTHER = 0.6  # confidence, at most, in a sustained oscillation's loop: a path may oscillate, too
HALF_TURN = 3.5  # [rad] of an oscillation that must be visible to rule out a path
FOLDS = 3.0  # factors of e over which growth or decay is visible
ROUND = 0.2  # |vᵀv|/‖v‖² of a shape v, at most, to count as a circle: 0 for a circle, 1 in phase
APART = 0.95  # below this, columns are not in phase
WHOLE = 0.95  # confidence in causes found without a fit: a sign, a frame
PATH = "A path may also have this period (--longest-period)."
UNLESS = (
    "Where position commands start at the measured joints a smaller gain may not help: start each at the last command."
)


def advice(kind, factor, shape, y, noise, alpha, Ts) -> dict:
    """Fields of a `Diagnosis` about the loop that a factor belongs to.

    Args:
      kind: kind of its oscillation. shape: (k,) complex, of the columns. y: (N, k) the recording without its path.
    Returns: the fields, and "whole": whether the loop explains the recording.
    """
    if turned := turned_of(shape, factor):
        return _turned_frames(kind, factor, turned, shape, alpha, Ts)
    known = None if alpha is None or kind is Kind.SUSTAINED else alpha * Ts
    loops, whole = loops_of(factor, y, trend(len(y)), noise, Ts, known)
    best = loops[0]
    if whole and kind is not Kind.SUSTAINED:
        own = best.slowest(Ts)
        if np.angle(own):  # otherwise so calm a loop would not oscillate, but the recording does
            factor, kind = own, Kind.GROWING if np.abs(own) > 1 else Kind.RINGING
    made = _oscillation(kind, factor) | {"phase_delay": phase_delay(factor), "delay": best.delay}
    made |= {"whole": whole, "pure": whole and not best.lag, "confidence": _confidence(loops, whole)}
    if best.delay > LATEST:
        return made | {"z": gain_of(factor, best.delay), "note": "No robot has so much dead time: this may be a path."}
    made |= _cause(best)
    limits, notes, z = limits_of(best, Ts), [], best.z
    likely = [loop for loop in loops if loop.share > LIKELY * best.share or not whole]
    if known is None or not whole:
        alike = [loop.calm(Ts) / loop.z for loop in _about(likely)]  # all of these, as they cost a few per cent
        share = min(_careful(likely, Ts)[0], *alike)
    else:
        share = limits.recommended / z
    may_be_path = _turns_less(HALF_TURN, factor)  # a path may bend as much
    if kind is Kind.SUSTAINED and whole and z < BELOW * limits.stable:
        made["kind"] = Kind.RINGING
        notes.append("It is excited repeatedly.")
    elif kind is Kind.SUSTAINED:
        share, z, may_be_path = share * z / limits.stable, limits.stable, True
        notes.append(
            "An oscillation of constant amplitude is clipped, by a velocity limit or by friction: z may be larger."
        )
    if made["period"] > SLOW and (known is None or _apart(known, z)):
        may_be_path = True
        notes.append(PATH)
    if made["period"] < 2.01:
        notes.append("Values alternate every second sample: z is above 1.")
    unknown = alpha is None and kind is not Kind.SUSTAINED  # a clipped oscillation hides its z
    notes += _alike(likely, best, whole, known, "--alpha or " * unknown, Ts)
    made["confidence"] = min(made["confidence"], OTHER if may_be_path else 1.0)
    if len(shape) > 1 and together(shape) < APART:
        made["confidence"] *= together(shape)
        notes.append(
            "The columns do not oscillate in phase. The frames of error and Jacobian may be rotated against each "
            "other: move the target along one axis at a small gain and see whether another axis moves first."
        )
    notes += _changed(known, z)
    unsure = made["confidence"] < SURE and not (whole or len(likely) > 1)
    if note := _other(alpha, z, Ts, unsure):
        return made | {"z": z, "note": note}
    return made | _gains(z, limits, share, alpha) | {"note": " ".join([*notes, UNLESS])}


def advice_excited(loops, alpha, Ts) -> dict:
    """Fields of a `Diagnosis` of a loop that noise excites."""
    best, factor = loops[0], loops[0].slowest(Ts)
    made = _oscillation(Kind.RINGING, factor) | _cause(best)
    made |= {"phase_delay": phase_delay(factor), "delay": best.delay, "pure": not best.lag}
    notes = ["Noise excites it repeatedly."]
    notes += _changed(None if alpha is None else alpha * Ts, best.z)
    made["confidence"] = min(_confidence(loops, True), WHOLE)
    if made["period"] > SLOW:
        made["confidence"] = min(made["confidence"], OTHER)
        notes.append(PATH)
    if note := _other(alpha, best.z, Ts):
        return made | {"z": best.z, "note": note}
    share, apart = _careful(loops, Ts)
    if alpha is None and apart > AGREED:
        wide = f"No gain can be given: gains for the loops that explain it differ by a factor of {apart:.2g}."
        return made | {"z": best.z, "note": " ".join([wide, "--alpha or a recorded step (--step) decides.", *notes])}
    notes = [notes[0], *_alike(loops, best, False, None, "--alpha or " * (alpha is None), Ts), *notes[1:]]
    return made | _gains(best.z, limits_of(best, Ts), share, alpha) | {"note": " ".join([*notes, UNLESS])}


def _oscillation(kind, factor) -> dict:
    return {"kind": kind, "period": float(2 * np.pi / np.abs(np.angle(factor))), "growth": float(np.abs(factor))}


def _cause(loop) -> dict:
    return {"cause": "lag", "lag": loop.lag} if loop.lag else {"cause": "dead time", "lag": None}


def _gains(z, limits, share, alpha) -> dict:
    """Limits of z, and the gain that stops the oscillation: `share` times the present one."""
    made = {"z": z, "stable": limits.stable, "monotone": limits.monotone, "recommended": share * z, "factor": share}
    return made | {"recommended_alpha": None if alpha is None else alpha * share}


def _apart(known, z, by=NEAR) -> bool:
    """Whether a known gain and z differ by more than a factor."""
    return not 1 / by < z / known < by


def _other(alpha, z, Ts, unsure=False) -> str:
    """Why the recording may not be of the loop with this gain; "" if it may."""
    far = alpha is not None and _apart(alpha * Ts, z, APART_Z)
    why = f"alpha·Ts is {alpha * Ts:.4g}, far from this z, so " if far else ""
    note = f"No gain can be given: {why}this may be the motion of a path, or of another loop."
    return f"{note} Record the loop at rest: push it and wait until it rests again." if far or unsure else ""


def _changed(known, z) -> list:
    if known is None or not _apart(known, z):
        return []
    return [f"alpha·Ts is {known:.4g}: measurement or drive change the gain by a factor of {z / known:.3g}."]


def _turns_less(angle, factor) -> bool:
    """Whether a mode turns by less than an angle while it grows or shrinks by FOLDS."""
    return bool(np.abs(np.angle(factor)) * FOLDS < angle * np.abs(np.log(np.abs(factor))))


def _careful(likely, Ts) -> tuple[float, float]:
    """(the factor of the gain that is low enough for most of the likely loops, how far such factors are apart)."""
    factors = np.array([loop.calm(Ts) / loop.z for loop in likely])
    shares = np.array([loop.share for loop in likely])
    order = np.argsort(factors)
    total = np.cumsum(shares[order]) / shares.sum()
    low, careful, high = (float(factors[order][np.argmax(total >= part)]) for part in (TAIL, CAREFUL, 1 - TAIL))
    return careful, high / low


def _confidence(loops, whole) -> float:
    """The probability of the first loop's dead time among all loops that were tried."""
    return float(sum(loop.share for loop in _about(loops))) if whole else loops[0].share


def _about(loops) -> list:
    """The loops whose dead time is about that of the first."""
    near = max(ONE, CLOSE * max(loop.delay for loop in loops))
    return [loop for loop in loops if abs(loop.delay - loops[0].delay) <= near]


def _alike(likely, best, whole, known, decides, Ts) -> list:
    """Other loops that the recording may belong to, and what decides between them beside a recorded step."""
    if known is not None and whole:
        note = "Dead time and lag follow from alpha and the oscillation; a recorded step shows more (--step)."
        return [note] if best.lag else []
    late, slow = max(likely, key=lambda loop: loop.delay), min(likely, key=lambda loop: loop.delay)
    if late.delay - slow.delay <= ONE:
        return []
    suits = "is low enough for all" if late.delay - slow.delay <= CLOSE * late.delay else "suits most"
    ends = [
        f"{loop.delay:.3g} samples " + (f"with a lag of {1e3 * loop.lag:.3g} ms" if loop.lag else "alone")
        for loop in (late, slow)
    ]
    return [
        f"A dead time of {ends[0]}, one of {ends[1]} and anything in between are possible. The gain {suits} of "
        f"them; {decides}a recorded step (--step) decides."
    ]


class Turned(NamedTuple):
    degrees: float  # angle of the error's frame about the axis, relative to the Jacobian's
    axis: np.ndarray  # (3,) in the order of the coordinates; for two coordinates, the third axis
    z: float


def together(shape) -> float:
    """|vᵀv|/‖v‖² of a shape (k,): 1 if all columns are in phase or opposite, 0 for a circle."""
    return float(np.abs(np.sum(shape**2)) / np.sum(np.abs(shape) ** 2))


def turned_of(shape, factor):
    """`Turned` if a complex shape (k,) of two or three coordinates, or both halves of six, are circles; otherwise None.

    A mode turns in a plane by 1 − z e^{iθ}. λ is given as the factor above the real axis; the shape gives the
    direction.
    """
    blocks = {2: [shape], 3: [shape], 6: [shape[:3], shape[3:]]}.get(len(shape), [])
    power = [np.sum(np.abs(block) ** 2) for block in blocks]
    blocks = [block for block, p in zip(blocks, power, strict=True) if p > 1e-2 * max(power)]
    if not blocks or not factor.imag or max(map(together, blocks)) > ROUND:
        return None
    block = max(blocks, key=lambda block: np.sum(np.abs(block) ** 2))
    block = np.pad(block, (0, 3 - len(block)))
    axis = np.cross(block.real, -block.imag)  # y = Re(v λ^k) turns from Re v to −Im v
    axis = axis / np.linalg.norm(axis)
    degrees = np.degrees(np.angle(1 - factor))
    if axis[np.argmax(np.abs(axis))] < 0:
        axis, degrees = -axis, -degrees
    return Turned(float(degrees), axis, float(np.abs(1 - factor)))


def _turned_frames(kind, factor, turned, shape, alpha, Ts) -> dict:
    axis = np.round(turned.axis, 2)
    if np.max(np.abs(turned.axis)) > 0.99:
        axis = "xyz"[int(np.argmax(np.abs(turned.axis)))]
    note = (
        f"The frames of error and Jacobian are rotated by {abs(turned.degrees):.3g}° against each other about {axis}: "
        f"no gain helps. Rotate the error by {-turned.degrees:.3g}° before J#, or express both in one frame."
    )
    off = alpha is not None and _apart(alpha * Ts, turned.z)
    if off:
        note += f" alpha·Ts is {alpha * Ts:.4g}, and z here {turned.z:.4g}."
    sure = WHOLE * (1 - together(shape) / 4)
    if _turns_less(0.5 * np.pi, factor):  # less than a quarter turn is visible
        sure = min(sure, OTHER)
    if kind is Kind.SUSTAINED and (alpha is None or off):
        sure = min(sure, OTHER)
        note += " A circular path looks alike: record the loop at rest after a push."
    made = _oscillation(kind, factor) | {"cause": "turned frames", "z": turned.z, "delay": 0}
    return made | {"angle": turned.degrees, "axis": turned.axis, "confidence": sure, "note": note}


def growth_without_end(factor, shape, clear, alpha, Ts) -> dict:
    """Fields of a `Diagnosis` of growth by a factor per sample that never returns; clear: no path grows like this."""
    if turned := turned_of(shape, factor):
        return _turned_frames(Kind.DIVERGING, factor, turned, shape, alpha, Ts)
    factor = float(np.abs(factor))
    note = (
        "Each step adds to the error: the sign of the error, of the Jacobian or of the command is wrong. No gain helps."
    )
    more = factor - 1
    share = np.nan if alpha is None else alpha * Ts / more  # factor ** d, for d samples of dead time
    made = {"growth": factor, "z": -alpha * Ts if share >= 1 / NEAR else -more, "cause": "wrong sign"}
    if share < 1 / NEAR:
        note += f" It grows by {more:.3g} per sample and alpha·Ts is {alpha * Ts:.3g}: there is another cause as well."
    elif share > NEAR and (delay := float(np.log(share) / np.log(factor))) <= LATEST:
        note += f" At alpha·Ts = {alpha * Ts:.3g} such a loop has {in_samples(delay, Ts)} of dead time."
        made |= {"delay": delay}
    clear = clear or 1 / NEAR <= share <= NEAR  # alpha explains the growth
    if not clear:
        note += " A path that starts slowly may look alike: record the loop at rest after a push."
    return made | {"confidence": WHOLE if clear else OTHER, "note": note}


def limits_of(loop: LateLoop, Ts) -> DrivenLimits:
    """`driven_limits` of explicit Euler; in closed form for a whole number of samples of dead time alone.

    At the limit of monotone decay two factors meet at d/(d + 1).
    """
    if loop.lag or loop.delay != round(loop.delay):
        return driven_limits("EE", Ts=Ts, drive=loop.drive)
    d = round(loop.delay)
    most = late_monotone(d)
    calm = dict(monotone=most, recommended=late_monotone(d + 1))
    return DrivenLimits(stable=late_stable(d), **calm, fastest=most, rate=d / (d + 1))
