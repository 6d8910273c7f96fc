"""Diagnose: whether a log shows a loop that swings or grows, why, and the gain that stops it."""

from __future__ import annotations

import numpy as np

from cnclik import errors
from cnclik.diagnosis import loop
from cnclik.diagnosis.recording import columns, sampling_time, unwrapped
from cnclik.integrate.drive import Drive, drive_in_words
from cnclik.quantities import in_samples
from cnclik.record import ArrayLike, Float, record, replace
from cnclik.stability.gain import gains

CALM, UNDECIDED = "calm", "undecided"
EVIDENCE, KNOWN, LASTS = 45.0, 20.0, 90.0  # decrease of the criterion, at least; with alpha; of what does not decay
SURELY = 0.9  # share of the probability that loops which swing must have
SURE, UNKNOWN = 0.98, 0.8  # confidence where alpha is known; where it is not, or a path may look alike
OVERSHOOTS = 0.17  # of an error, at least, where the gain is not known
TOO_LARGE = 0.55  # ratio of the recommended gain to a known one, above which that is not why a loop swings
SWEEP, SWEPT = 1.13, 6.0  # ratio of two speeds of an oscillation of one size beyond which no loop makes it; periods
SIZES = (0.85, 1.7)  # ratio of the sizes in the two halves of its energy of what neither decays nor grows
TURNED, HALF = 27.0, 170.0  # [degrees]: by less no error passes its target by 0.2 %; by more a wrong sign looks alike
SAME = (0.75, 1.3)  # ratio of a spiral's gain to a known one; of a growth's, the least
STEADY, RESTLESS, HELD = 0.1, 0.35, 2.0  # unrest of what lasts, of noise (0.52 by Rayleigh); change in all periods
PERIODS = 3.0  # of one: in fewer a path, or a limit of acceleration, looks alike
WIDE = 6.25  # ratio of the shares of the gain that likely drives tolerate: then the slower overshoot 10 %
CLIPPED, SCALED = 3.0, 1.5  # ratio of a known gain to those that make the oscillation, of these to it, at most
SETTLED, PASSED = 0.03, 0.05  # shares of a motion that are left in the end, and beyond its end, where nothing is wrong
ALIKE, ABOVE = 0.1, 1.25  # relative difference of the periods of one mode; factor up to which a task's gain may stay
UNFINISHED = "It may be the start of an oscillation, or a path: push the loop at rest, and record until it rests again."
WRONG_SIGN = "It grows × {:.6g} per sample: the sign of error, Jacobian or command is wrong"
WRONG_SIGN += ", or one of their frames is turned by 150 to 180°. No gain helps."
DECAYS = "It decays without overshoot by this log: no smaller gain is needed."
PASSES = "It comes to rest, but a column passes its end by {:.2g} %: a smaller gain may be needed."
OPEN = "It oscillates, but the drives that may be behind it tolerate gains too different: record a step (--step)."
SMALL = "alpha is too small to make it oscillate like this: counts of an encoder, noise or a path may."
PATH = "A path of this period looks alike: record with the target at rest."
CIRCLES = "Its columns swing one after the other: look whether error and Jacobian are in the same frame."
UNLESS = "Where position commands start at the measured joints a smaller gain may not help: start each at the last one."


@record
class Diagnosis:
    """Answer of `diagnose`: what a log shows. A field that is unknown is None.

    Attributes:
      kind: "ringing", "sustained oscillation", "growing oscillation", "growth without oscillation", "spiral", "calm" or
        "undecided". cause: "dead time", "drive" (dead time with a lag or a servo), "wrong sign" or "turned frames".
      Ts: sampling time of log and loop [s]. period: of the oscillation [samples]. growth: factor per sample.
      drive: a likely `Drive`. interval: ends of its dead time [samples], where that alone explains the log.
      recommended_alpha: gain that stops it [1/s]; the Jacobian, the error and the drives may
        scale a gain, so factor is what the present one is to be multiplied by.
      angle: of frames that are turned against each other [degrees]: turn the error by −angle, about the note's axis.
      confidence: that cause and gain are right, 0 to 1; without alpha at most 0.8.
      fitted: (N, k) path and oscillation, NaN without one and in rows that were not read. note: further remarks.
    """

    kind: str
    Ts: float
    cause: str | None = None
    period: float | None = None
    growth: float | None = None
    drive: Drive | None = None
    interval: tuple[float, float] | None = None
    recommended_alpha: float | None = None
    factor: float | None = None
    angle: float | None = None
    confidence: float | None = None
    fitted: Float[np.ndarray, "N k"]
    note: str = ""

    def __str__(self):
        words = self.kind
        if self.drive is not None:
            words += f": period {in_samples(self.period, self.Ts)}, amplitude × {self.growth:.4g} per sample"
            words += f", as with {drive_in_words(self.drive, self.Ts)}"
            words += f". Use an alpha of {self.recommended_alpha:.4g} 1/s, {self.factor:.3g} times the present gain"
        return f"{words}. {self.note}".strip()


def diagnose(signal: Float[ArrayLike, "N ..."], Ts: float, *, alpha: float | None = None) -> Diagnosis:
    """Diagnose a log: whether its loop swings or grows, why, and the gain that stops it.

    The log has a row for each sample of the loop. It may start at rest, have an offset, drift, follow a slow path and
    be noisy. Several columns, such as several joints, belong to one loop.

    Args:
      signal: (N,) or (N, k): joint values, errors, or commanded steps. Two, three or six columns may be coordinates.
      Ts: sampling time [s]. alpha: gain of the loop [1/s], if known.
    Raises: ArgumentError for fewer than 16 rows, or values that are not finite, or beyond 1e30.
    """
    Ts = sampling_time(None, Ts)
    alpha = None if alpha is None else float(errors.number("alpha", alpha, positive=True))
    raw = columns("signal", signal, "diagnose")
    y = np.where(np.abs(raw).max(0) < 1.0001 * np.pi, unwrapped(raw)[0], raw)
    y_ = (y - y[0]) / (np.abs(y - y[0]).max() or 1.0)
    scaled = loop.prepared(y_)
    read = loop.read(scaled) if scaled.shape[1] else None
    fields = _seen(scaled, read, y_, Ts, alpha)
    fitted = np.full(y.shape, np.nan)
    if read is not None and "period" in fields:
        rows = y[read.first : read.last]
        basis = np.column_stack([loop.path_basis(len(rows), read.period), loop.wave(len(rows), read.mode)])
        fitted[read.first : read.last] = rows - loop.free(basis, rows)
        fitted += raw - y
    return Diagnosis(Ts=Ts, fitted=fitted, **fields)


def _seen(scaled, read, y, Ts, alpha) -> dict:
    """Fields of a `Diagnosis`. scaled: columns as `prepared` gives them; y: all columns, in one unit."""
    if not scaled.shape[1]:
        return {"kind": CALM, "note": "No column moves by more than some steps of its resolution."}
    sure = UNKNOWN if alpha is None else SURE
    tail, x = max(len(scaled) // 5, 8), loop.main_parts(scaled)[:, 0]
    x = x - np.median(x[-tail:])
    drift = np.polyfit(np.arange(tail), x[-tail:], 1)[0] * (np.arange(-len(x), 0) + (tail + 1) / 2)
    push = int(np.argmax(np.abs(x)))
    x, still = (part[push:] / (x[push] or 1.0) for part in (x, x - drift))  # either may hide that it passes its end
    soon = 4 * np.argmax(x < 0.5) < len(x)  # else it has not come to rest
    settled = soon and len(x) > tail and np.std(x[-tail:]) < SETTLED and min(*x, *still) > -PASSED
    away = y - np.median(y[-tail:], axis=0)  # of each column: one axis may grow alone
    settled = settled and np.std(away[-tail:], axis=0).max() < SETTLED * np.ptp(y, axis=0).max()
    circle = read is not None and loop.on_a_circle(y[read.first : read.last], read.mode)
    looked = scaled.shape == y.shape and (not settled or (circle and alpha is not None))
    turn, z, steady = (loop.turned(y, alpha and alpha * Ts, circle) if looked else None) or (np.zeros(3), 0, 0)
    main = int(np.argmax(np.abs(turn)))
    angle = float(np.copysign(np.linalg.norm(turn), turn[main]))
    along = abs(turn[main]) > 0.99 * abs(angle)
    if TURNED < abs(angle) < HALF:
        if steady if alpha is None else not SAME[0] < z / (alpha * Ts) < SAME[1]:
            return {"kind": UNDECIDED, "note": UNFINISHED}  # as on a circular path
        axis = "xyz"[main] if along else np.round(turn / angle, 2)
        note = f"Error and Jacobian are in frames turned by {abs(angle):.3g}° against each other about {axis}: no gain "
        note += f"helps. Turn the error by {-angle:.3g}° before J#, or express both in one frame."
        return dict(kind="spiral", cause="turned frames", angle=angle, confidence=sure, note=note)
    if circle:
        return _at_rest(away, tail) if settled else {"kind": UNDECIDED, "note": CIRCLES}
    if rate := loop.growth(scaled, SAME[0] * (alpha or 0.0) * Ts):
        note = WRONG_SIGN.format(rate)
        return dict(kind="growth without oscillation", cause="wrong sign", growth=rate, confidence=sure, note=note)
    sways = read is not None and read.evidence > KNOWN and np.isfinite(read.period) and read.swings > SURELY
    if sways and not (settled and alpha is None) and (fields := _swing(scaled, read, Ts, alpha)):
        return fields
    return _at_rest(away, tail) if settled else {"kind": UNDECIDED, "note": UNFINISHED}


def _at_rest(away, tail) -> dict:
    """Return fields of a `Diagnosis` of columns that come to rest at 0, each of which may pass its end alone."""
    first = np.argmax(np.abs(away), axis=0)
    away = away * np.sign(away[first, range(len(first))])
    past = [-min(column[k:]) for column, k in zip(away.T, first, strict=True)] - 4 * np.std(away[-tail:], axis=0)
    share = np.max(past / np.maximum(away.max(0), 0.2 * away.max()))  # of a column that hardly moves it is no sign
    return {"kind": CALM, "note": PASSES.format(100 * share) if share > OVERSHOOTS else DECAYS}


def _swing(scaled, read, Ts, alpha) -> dict | None:
    """Fields of a `Diagnosis` of a mode that swings; None where it may be something else."""
    rows = scaled[read.first : read.last]
    mode, turns = read.mode, len(rows) / read.period
    faster, larger, unrest = loop.swept(loop.main_parts(rows), read.period)
    alike = SIZES[0] < larger < SIZES[1]
    if unrest < STEADY and turns > PERIODS and alike:  # beside overtones a mode seems to decay
        mode = 1j * mode.imag
    change = mode.real * read.period
    held = bool(abs(change) * turns < np.log(HELD))
    excited = bool(not held and change < 0 and larger > SIZES[0])
    spread = (unrest > RESTLESS) * np.sqrt(max(-8 * read.mode.real, 0.0) / len(rows)) / read.mode.imag
    if turns > SWEPT and change < np.log(1.5) and alike and abs(np.log(faster)) > max(np.log(SWEEP), 2 * spread):
        return {"kind": UNDECIDED, "note": UNFINISHED}
    drive, ends, present, least, most, wide = loop.drives_of(read, mode, Ts, alpha, clipped=change > 0 or held)
    best = gains(Ts=Ts, drive=drive, method="EE").recommended
    if alpha is not None and least > SCALED * alpha:
        return {"kind": UNDECIDED if change > 0 else CALM, "note": SMALL}
    if alpha is not None and best > TOO_LARGE * alpha and not excited:
        return {"kind": CALM, "note": f"It swings a little at most: by this log up to {best:.4g} 1/s it would not."}
    if wide > WIDE if alpha is None else alpha > CLIPPED * most:
        return {"kind": UNDECIDED, "note": OPEN}
    lasts = excited or held
    needed = KNOWN if alpha is not None else LASTS if lasts else EVIDENCE
    overshoot = np.exp(0.5 * read.mode.real * read.period)
    if turns < (PERIODS if lasts else 1.5) or read.evidence < needed or (alpha is None and overshoot < OVERSHOOTS):
        return None
    notes = ["Noise excites it again and again."] * excited + [PATH] * held
    if read.dead is None:
        likely = " and ".join(drive_in_words(end, Ts) for end in ends)
        notes.append(f"Likely are drives between {likely}; a recorded step narrows them (--step).")
    return dict(
        kind="sustained oscillation" if held else "growing oscillation" if change > 0 else "ringing",
        cause="drive" if read.dead is None else "dead time",
        period=read.period,
        growth=float(np.exp(mode.real)),
        interval=read.dead,
        drive=drive,
        recommended_alpha=best,
        factor=best / (alpha or present),
        confidence=UNKNOWN if held or turns < PERIODS or alpha is None else SURE,
        note=" ".join([*notes, UNLESS]),
    )


@record
class StackDiagnosis:
    """Answer of `diagnose_tasks`: what the logs of several tasks show.

    Attributes:
      tasks: {name: `Diagnosis`}. change: tasks whose gain is to be changed.
      recommended_alpha: the largest gain for any task [1/s], or None.
    """

    tasks: dict
    change: tuple
    recommended_alpha: float | None

    def __str__(self):
        lines = [f"{name}: {found}" for name, found in self.tasks.items()]
        if self.recommended_alpha is not None:
            said = f"No task may have an alpha above {self.recommended_alpha:.4g} 1/s"
            lines.append(f"{said}{': ' * bool(self.change)}{', '.join(self.change)}.")
        return "\n".join(lines)


def diagnose_tasks(signals, Ts: float, *, alpha=None) -> StackDiagnosis:
    """Diagnose a stack: which gains make it swing, and the largest gain that any task may have.

    All tasks have the same drives, and no rate of their loop is larger than the largest gain (docs/theory.md): the gain
    that one task tolerates is a limit of all, whatever their units, weights and levels.

    Args:
      signals: {task: (N, k)} its errors. Ts: as for `diagnose`. alpha: {task: gain [1/s]} of those that are known.
    Raises: as `diagnose`, and for an alpha of a task that is not recorded.
    """
    if not errors.kind("signals", signals, dict):
        raise errors.fail("signals", "hold a task", "is empty")
    alpha = errors.kind("alpha", alpha or {}, dict)
    known = {errors.one_of("alpha", n, signals): errors.number("alpha", a, positive=True) for n, a in alpha.items()}
    largest = float(max(known.values())) if len(known) == len(signals) else None  # no mode is faster
    tasks: dict = {}
    for name, signal in signals.items():
        with errors.called("", name):
            tasks[name] = diagnose(signal, Ts, alpha=largest)
        if largest is not None and tasks[name].factor is not None:  # of its own gain
            tasks[name] = replace(tasks[name], factor=float(tasks[name].recommended_alpha / known[name]))
    swing = [found for found in tasks.values() if found.drive is not None]
    if not swing:
        return StackDiagnosis(tasks=tasks, change=(), recommended_alpha=None)
    lead = max(swing, key=lambda found: (found.confidence, found.growth**found.period))
    best = lead.recommended_alpha
    change = [name for name, gain in known.items() if gain > ABOVE * best]
    along = {name for name, found in tasks.items() if found.period and abs(found.period / lead.period - 1) < ALIKE}
    return StackDiagnosis(tasks=tasks, change=(*change, *sorted(along - known.keys())), recommended_alpha=best)
