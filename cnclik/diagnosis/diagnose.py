"""Diagnose: whether a log shows a loop that swings or grows, why, and the gain that stops it."""

from __future__ import annotations

import enum

import numpy as np

from cnclik import errors
from cnclik.diagnosis import cause, loop
from cnclik.diagnosis.recording import LEAST, columns
from cnclik.integrate.drive import Drive
from cnclik.quantities import in_samples
from cnclik.record import ArrayLike, Float, record
from cnclik.stability.gain import drive_in_words, gains


class Kind(enum.StrEnum):
    """What a log shows."""

    RINGING = "ringing"
    SUSTAINED = "sustained oscillation"
    GROWING = "growing oscillation"
    DIVERGING = "growth without oscillation"
    CALM = "calm"
    QUIET = "quiet"
    UNDECIDED = "undecided"


EVIDENCE = 45.0  # decrease of the criterion from which on an oscillation is a loop's
EVIDENCE_KNOWN = 20.0  # the same where the gain of the loop is that of the mode
SURELY = 0.9  # share of the probability that loops which swing must have
TOO_LARGE = 0.55  # ratio of the recommended gain to a known one below which that is why a loop swings
OVERSHOOTS = 0.17  # of an error, at least, where the gain is not known
SWEEP = 1.15  # ratio of two speeds of an oscillation of one size beyond which no loop makes it
SIZES = (0.8, 1.45)  # ratio of two sizes that are one
HELD = 1.15  # change in a period, at most, of a sustained oscillation
PERIODS = 3.0  # of an oscillation that neither decays nor grows: in fewer a path, or a limit of acceleration, looks alike


@record
class Diagnosis:
    """What a log shows. A field that is unknown is None.

    Attributes:
      kind: a `Kind`. cause: "dead time", "drive" (dead time with a lag or a servo), "wrong sign" or "turned frames".
      Ts: sampling time of log and loop [s]. period: of the oscillation [samples]. growth: factor per sample.
      delay: dead time [samples], and interval: its ends, where dead time alone explains the log.
      drive: a likely `Drive`. z: gain per sample of the best loop.
      alpha: of the loop [1/s], if given. recommended_alpha: gain that stops it [1/s]; the Jacobian, the error and the
        drives may scale a gain, so factor is what the present one is to be multiplied by.
      angle, axis: of frames that are turned against each other [degrees], about an axis of the columns x, y, z: turn
        the error by −angle.
      confidence: that cause and gain are right, 0 to 1; without alpha at most 0.8.
      amplitude: (k,) half the range of the oscillation in each column [unit of the column]. noise: (k,) deviation of
        what is left. first: first row that was read. path, modes: (n, k) of the rows from there on.
      note: further remarks.
    """

    kind: Kind
    Ts: float
    cause: str | None = None
    period: float | None = None
    growth: float | None = None
    delay: float | None = None
    interval: tuple[float, float] | None = None
    drive: Drive | None = None
    z: float | None = None
    alpha: float | None = None
    recommended_alpha: float | None = None
    factor: float | None = None
    angle: float | None = None
    axis: Float[np.ndarray, " 3"] | None = None
    confidence: float | None = None
    amplitude: Float[np.ndarray, " k"]
    noise: Float[np.ndarray, " k"]
    first: int = 0
    path: Float[np.ndarray, "n k"]
    modes: Float[np.ndarray, "n k"]
    note: str = ""

    @property
    def rings(self) -> bool:
        """Whether it oscillates."""
        return self.kind in (Kind.RINGING, Kind.SUSTAINED, Kind.GROWING)

    def __str__(self):
        said = [str(self.kind)]
        if self.period is not None:
            said.append(f"period {in_samples(self.period, self.Ts)}, amplitude × {self.growth:.4g} per sample")
        elif self.growth is not None:
            said.append(f"the error grows × {self.growth:.6g} per sample")
        if self.drive is not None:
            late = self.drive if self.delay is None else Drive(delay=self.delay)
            said[-1] += f", as with {drive_in_words(late, self.Ts)}"
        words = ": ".join(said) + "."
        if self.recommended_alpha is not None:
            words += f" Use an alpha of {self.recommended_alpha:.4g} 1/s"
            words += f", {self.factor:.3g} times the present gain." if self.factor is not None else "."
        return f"{words} {self.note}".strip()


def diagnose(signal: Float[ArrayLike, "N ..."], Ts: float, *, alpha: float | None = None) -> Diagnosis:
    """Diagnose a log: whether its loop swings or grows, why, and the gain that stops it.

    The log may start at rest, have an offset, drift, follow a slow path and be noisy. Several columns, such as several
    joints, belong to one loop. The log needs a row for each sample of the loop.

    Args:
      signal: (N,) or (N, k): joint values, errors, or commanded steps. Two, three or six columns may be coordinates.
      Ts: sampling time [s]. alpha: gain of the loop [1/s], if known.
    Raises: ArgumentError for fewer than 16 rows, or values that are not finite, or beyond 1e30.
    """
    Ts = float(errors.number("Ts", Ts, positive=True))
    if alpha is not None:
        alpha = float(errors.number("alpha", alpha, positive=True))
    y = columns("signal", signal)
    if len(y) < LEAST or y.shape[1] == 0:
        raise errors.fail("signal", f"have at least {LEAST} rows", f"has {len(y) if y.shape[1] else 0}")
    size = np.abs(y - y[0]).max() or 1.0
    scaled, moving = loop.prepared((y - y[0]) / size)
    found = loop.read(scaled) if len(moving) else None
    made = _seen(scaled, found, len(moving) == y.shape[1], (y - y[0]) / size, Ts, alpha)
    return Diagnosis(Ts=Ts, alpha=alpha, **made, **_parts(y, found, made.get("period")))


def _seen(scaled, found, whole, y, Ts, alpha) -> dict:
    """Fields of a `Diagnosis` of columns as `prepared` gives them, and as they are, y, where none is left out."""
    if not scaled.shape[1]:
        return {"kind": Kind.QUIET, "note": "No column moves by more than a few steps of its resolution."}
    if whole and (spin := cause.turned(y)) and 15 < abs(spin.degrees) < 165:
        return _turned_frames(spin, found)
    rate, sure = cause.growth(scaled)
    if rate:
        return _wrong_sign(rate, sure, Ts, alpha)
    if found is None:
        return {"kind": Kind.UNDECIDED, "note": UNFINISHED}
    swings = found.swings > SURELY and np.isfinite(found.period)
    if not swings or found.evidence < EVIDENCE_KNOWN:
        return _no_swing(found)
    period, Ts_ = found.period, Ts
    held = abs(found.mode.real * period) < np.log(HELD)
    clipped = found.growth > 1 or held
    drives = loop.drives_of(found.mode, Ts_, alpha, clipped=clipped, alone=found.alone)
    faster, larger = cause.swept(loop.main_parts(scaled[found.first : found.last]), period)
    kind = Kind.SUSTAINED if held else Kind.GROWING if found.mode.real > 0 else Kind.RINGING
    made = {"kind": kind, "period": period, "growth": found.growth}
    if SIZES[0] < larger < SIZES[1] and not 1 / SWEEP < faster < SWEEP:
        return {"kind": Kind.UNDECIDED, "note": "The period changes, as of a sweep or another path, not of a loop."}
    turns = (found.last - found.first) / period
    if turns < (PERIODS if held else 2.0 if abs(found.mode.real * period) < np.log(2) else 1.2):
        return {"kind": Kind.UNDECIDED, "note": UNFINISHED}
    best = _recommended(drives.drive, Ts)
    present = drives.alpha if alpha is None else alpha
    if best / present > TOO_LARGE and alpha is not None:
        return {"kind": Kind.CALM, "note": f"alpha is not too large: up to {best:.4g} 1/s nothing overshoots by this log."}
    if found.evidence < EVIDENCE and (alpha is None or drives.off > 1.3):
        return {"kind": Kind.UNDECIDED, "note": UNFINISHED}
    if alpha is None and found.overshoot < OVERSHOOTS:
        return _no_swing(found)
    return made | _gain(found, drives, best, present, alpha, Ts)


def _recommended(drive, Ts) -> float:
    """The gain of `gains` [1/s]. More than 30 samples of dead time are as 30 longer ones, which take less time."""
    n = max(1, int(drive.delay // 30))
    from cnclik.record import replace

    late = replace(drive, delay=(drive.delay + 0.5) / n - 0.5)
    return gains(Ts=n * Ts, drive=late, method="EE").recommended


def _gain(found, drives, best, present, alpha, Ts) -> dict:
    made = {"drive": drives.drive, "recommended_alpha": best, "factor": best / present, "z": found.z}
    notes = []
    if found.alone:
        made |= {"cause": "dead time", "delay": found.dead[0], "interval": found.dead[1:]}
    else:
        made |= {"cause": "drive"}
    made["confidence"] = 0.8 if alpha is None else 0.95 if drives.off < 1.3 else 0.7
    return made | {"note": " ".join(notes)}


def _turned_frames(spin, found) -> dict:
    return {"kind": Kind.UNDECIDED, "cause": "turned frames", "angle": spin.degrees, "axis": spin.axis, "z": spin.z, "confidence": 0.95}


def _wrong_sign(rate, sure, Ts, alpha) -> dict:
    return {"kind": Kind.DIVERGING, "cause": "wrong sign", "growth": rate, "confidence": sure}


def _no_swing(found) -> dict:
    return {"kind": Kind.CALM if found.evidence > EVIDENCE_KNOWN else Kind.UNDECIDED}


def _parts(y, found, period) -> dict:
    k = y.shape[1]
    return {"amplitude": np.zeros(k), "noise": np.zeros(k), "path": y, "modes": 0 * y}


UNFINISHED = "It may be the start of an oscillation, or a path: push the loop at rest, and record until it rests again."
