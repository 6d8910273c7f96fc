"""Diagnose: whether a log shows a loop that swings or grows, why, and the gain that stops it."""

from __future__ import annotations

import enum

import numpy as np

from cnclik import errors
from cnclik.diagnosis import cause, loop
from cnclik.diagnosis.loop import EVIDENCE, SURELY
from cnclik.diagnosis.recording import LEAST, columns
from cnclik.integrate.drive import Drive, drive_in_words
from cnclik.quantities import in_samples
from cnclik.record import ArrayLike, Float, record, replace
from cnclik.stability.gain import gains


class Kind(enum.StrEnum):
    """Kinds of motion in a log."""

    RINGING = "ringing"
    SUSTAINED = "sustained oscillation"
    GROWING = "growing oscillation"
    DIVERGING = "growth without oscillation"
    SPIRAL = "spiral"
    CALM = "calm"
    QUIET = "quiet"
    UNDECIDED = "undecided"


EVIDENCE_KNOWN, NEAR = 20.0, 1.3  # as EVIDENCE, of a loop whose gain is known, and the mode's by less than this factor,
EVIDENCE_EXCITED, MANY = 90.0, 10.0  # or it does not decay as its mode does: then over so many periods
LASTS = 0.85  # ratio of its sizes in the two halves of its energy, above which it does not decay
SURE, UNKNOWN, UNSURE = 0.95, 0.8, 0.7  # confidence: of a free oscillation; without alpha or as of a path; of a stretch
OVERSHOOTS = 0.17  # of an error, at least, where the gain is not known
TOO_LARGE = 0.55  # ratio of the recommended gain to a known one, above which that is not why a loop swings
SWEEP, SWEPT = 1.13, 6.0  # ratio of two speeds of an oscillation of one size beyond which no loop makes it; periods
SIZES = (0.8, 1.7)  # ratio of two sizes that are one
SAME = (0.75, 1.3)  # ratio of a spiral's gain to a known one
STEADY = 0.1  # unrest of a sustained oscillation, at most; noise gives 0.5
UNREST, DOUBLE = 0.2, 2.0  # of an oscillation that grows as a mode does: its unrest beyond that, its size below it
FASTEST = np.log(1e3)  # growth in a period; with more it is a polynomial
HELD = 1.15  # change in a period, at most, of a sustained oscillation
PERIODS = 3.0  # of one: in fewer a path, or a limit of acceleration, looks alike
LONG = 30  # samples of dead time, beyond which a sample more or less counts little
UNFINISHED = "It may be the start of an oscillation, or a path: push the loop at rest, and record until it rests again."
CIRCLE = "It goes round as on a circular path, or as with frames that are turned by some 90°: hold the target still."
CHANGES = "The period changes, as of a sweep or another path, not of a loop."
STILL = "No column moves by more than some steps of its resolution."
WRONG_SIGN = "Each step adds to the error: the sign of error, Jacobian or command is wrong. No gain helps."
DECAYS = "It decays without overshoot by this log: no smaller gain is needed."
CLIPPED = "A linear loop of this alpha would grow: a limit of velocity or torque clips it."
PATH = "A path of this period looks alike: record with the target at rest."
UNLESS = "Where position commands start at the measured joints a smaller gain may not help: start each at the last one."


@record
class Diagnosis:
    """Answer of `diagnose`: what a log shows. A field that is unknown is None.

    Attributes:
      kind: a `Kind`. cause: "dead time", "drive" (dead time with a lag or a servo), "wrong sign" or "turned frames".
      Ts: sampling time of log and loop [s]. period: of the oscillation [samples]. growth: factor per sample.
      delay: dead time [samples], and interval: its ends, where dead time alone explains the log.
      drive: a likely `Drive`. z: gain per sample of the likely loops.
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
    y = columns("signal", signal, "diagnose")
    if len(y) < LEAST or y.shape[1] == 0:
        raise errors.fail("signal", f"have at least {LEAST} rows", f"has {len(y) if y.shape[1] else 0}")
    y_ = (y - y[0]) / (np.abs(y - y[0]).max() or 1.0)
    scaled = loop.prepared(y_)
    found = loop.read(scaled) if scaled.shape[1] else None
    fields = _seen(scaled, found, y_, Ts, alpha)
    if alpha is None and "confidence" in fields:
        fields["confidence"] = min(fields["confidence"], UNKNOWN)
    return Diagnosis(Ts=Ts, alpha=alpha, **fields, **_parts(y, found, "period" in fields))


def _seen(scaled, found, y, Ts, alpha) -> dict:
    """Fields of a `Diagnosis`. scaled: columns as `prepared` gives them; y: all columns, in one unit."""
    if not scaled.shape[1]:
        return {"kind": Kind.QUIET, "note": STILL}
    if scaled.shape == y.shape and (spin := cause.turned(y, alpha and alpha * Ts)) and 15 < abs(spin.degrees) < 173:
        if spin.steady if alpha is None else not SAME[0] < spin.z / (alpha * Ts) < SAME[1]:
            return {"kind": Kind.UNDECIDED, "note": CIRCLE}
        main = int(np.argmax(np.abs(spin.axis)))
        axis = "xyz"[main] if abs(spin.axis[main]) > 0.99 else np.round(spin.axis, 2)
        note = (
            f"The frames of error and Jacobian are turned by {abs(spin.degrees):.3g}° against each other about {axis}"
        )
        note += f": no gain helps. Turn the error by {-spin.degrees:.3g}° before J#, or express both in one frame."
        sure = UNSURE if spin.steady or spin.open > 10 else SURE
        fields = {"kind": Kind.SPIRAL, "cause": "turned frames", "confidence": sure, "note": note}
        return fields | {"angle": spin.degrees, "axis": spin.axis, "z": spin.z}
    rate, sure = cause.growth(scaled)
    if rate:
        return {"kind": Kind.DIVERGING, "cause": "wrong sign", "growth": rate, "confidence": sure, "note": WRONG_SIGN}
    if found is None or found.evidence < EVIDENCE_KNOWN:
        return {"kind": Kind.UNDECIDED, "note": UNFINISHED}
    if np.isfinite(found.period) and found.swings > SURELY:
        return _swing(scaled[found.first : found.last], found, Ts, alpha)
    calm = found.swings < 1 - SURELY and found.rests
    return {"kind": Kind.CALM, "note": DECAYS} if calm else {"kind": Kind.UNDECIDED, "note": UNFINISHED}


def _swing(rows, found, Ts, alpha) -> dict:
    """Fields of a `Diagnosis` of a mode that swings."""
    mode, turns = found.mode, len(rows) / found.period
    faster, larger, unrest = cause.swept(loop.main_parts(rows), found.period)
    alike = SIZES[0] < larger < SIZES[1]
    if unrest < STEADY and turns > PERIODS and alike:  # beside overtones a mode seems to decay
        mode = 1j * mode.imag
    change = mode.real * found.period
    held = abs(change) < np.log(HELD)
    excited = change < -np.log(HELD) and larger > LASTS
    if change > 0 or held:  # what grows, or does not, must do so as its mode does
        wave = np.exp(mode * np.arange(len(rows)) - max(mode.real, 0.0) * len(rows)).real[:, None]
        _, grows, rises = cause.swept(wave, found.period)
        excited = unrest > rises + UNREST or larger < grows / DOUBLE
    if turns > SWEPT and change < np.log(1.5) and alike and not 1 / SWEEP < faster < SWEEP:
        return {"kind": Kind.UNDECIDED, "note": CHANGES}
    drives = loop.drives_of(mode, Ts, alpha, clipped=change > 0 or held, alone=found.alone)
    best, off = _recommended(drives.drive, Ts), drives.off > NEAR
    if alpha is not None and best > TOO_LARGE * alpha and not excited:
        note = f"alpha is not too large: up to {best:.4g} 1/s nothing overshoots by this log."
        return {"kind": Kind.CALM, "note": note}
    needed = EVIDENCE if alpha is None or off else EVIDENCE_KNOWN
    if alpha is None and (excited or held):
        needed = EVIDENCE_EXCITED
    many = MANY if excited and alpha is None else PERIODS if excited or held else 2.0 if change > -np.log(2) else 1.2
    hidden = found.evidence < needed or (alpha is None and found.overshoot < OVERSHOOTS)
    if turns < many or hidden or change > FASTEST:
        return {"kind": Kind.UNDECIDED, "note": UNFINISHED}
    notes = []
    if held and alpha is not None and alpha > 1.2 * drives.most:
        notes.append(CLIPPED)
    if excited:
        notes.append("Noise excites it again and again.")
    if held:
        notes.append(PATH)
    if off:
        notes.append(f"No drive with this mode has this alpha: the gain differs by a factor of {drives.off:.2g}.")
    if not found.alone:
        ends = " and ".join(drive_in_words(end, Ts) for end in drives.ends)
        notes.append(f"Likely are drives between {ends}; a recorded step narrows them (--step).")
    stretched = off or (turns < PERIODS and abs(change) < np.log(1.5))
    return {
        "kind": Kind.SUSTAINED if abs(change) * turns < np.log(2) else Kind.GROWING if change > 0 else Kind.RINGING,
        "cause": "dead time" if found.alone else "drive",
        "period": found.period,
        "growth": float(np.exp(mode.real)),
        "delay": found.dead[0] if found.alone else None,
        "interval": found.dead[1:] if found.alone else None,
        "drive": drives.drive,
        "z": drives.alpha * Ts,
        "recommended_alpha": best,
        "factor": best / (alpha or drives.alpha),
        "confidence": UNSURE if stretched else UNKNOWN if excited or held else SURE,
        "note": " ".join([*notes, UNLESS]),
    }


def _recommended(drive, Ts) -> float:
    """The gain of `gains` [1/s]. Long dead times are computed at a larger Ts, which takes less time."""
    n = max(1, int(drive.delay // LONG))
    return gains(Ts=n * Ts, drive=replace(drive, delay=(drive.delay + 0.5) / n - 0.5), method="EE").recommended


def _parts(y, found, rings) -> dict:
    """The path and the oscillation in the rows that were read, and what is left."""
    first, last = (0, len(y)) if found is None else (found.first, found.last)
    rows, t = y[first:last], np.arange(last - first)
    basis = path = loop.path_basis(len(rows), found.period if rings else np.inf)
    if rings:
        wave = np.exp(found.mode * (t - t[-1] * (found.mode.real > 0)))
        basis = np.column_stack([path, wave.real, wave.imag])
    square, n = loop.product(basis.T, basis), path.shape[1]
    weights = np.linalg.solve(square + 1e-12 * np.trace(square) * np.eye(len(square)), loop.product(basis.T, rows))
    slow, modes = (loop.combined(basis[:, part], weights[part]) for part in (slice(n), slice(n, None)))
    left = np.std(rows - slow - modes, axis=0)
    return {"first": first, "path": slow, "modes": modes, "amplitude": np.ptp(modes, axis=0) / 2, "noise": left}
