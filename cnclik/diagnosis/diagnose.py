"""Diagnose: whether a recording rings, how late the robot is by that, and which gain would end it."""

import enum
import functools

import numpy as np

from cnclik import errors
from cnclik.diagnosis.late import gain_of, loop_of
from cnclik.diagnosis.modes import Modes, find_modes, trend
from cnclik.integrate.drive import Drive
from cnclik.record import record
from cnclik.stability.driven import DrivenLimits, driven_limits

LEAST = 16  # rows
MOST = 2000  # rows that are looked at: those that move most
LONGEST = 250  # samples of a period: what is slower is taken for a path
TURNS = 3  # periods that must be there of what doesn't die out
STILL = 1e-12  # share of the largest value that is rounding
BEGUN = 0.05  # share of the range that something must move to have begun
BACK = 0.04  # share of the range by which a recording goes back and forth, from which on it rings
SEEN = 0.01  # share that is left after half a period, below which nobody would call it ringing
HELD = 1.5  # factor in size over all rows up to which an oscillation counts as sustained
LOST = 0.05  # share that is left at the end of what has died out
LATEST = 200  # samples of dead time of which limits are told


class Kind(enum.StrEnum):
    """What a recording shows."""

    RINGING = "ringing"
    SUSTAINED = "sustained oscillation"
    GROWING = "growing oscillation"
    MONOTONE = "monotone decay"
    QUIET = "quiet"
    NOISE = "noise"


OSCILLATING = (Kind.RINGING, Kind.SUSTAINED, Kind.GROWING)


@record
class Diagnosis:
    """What a recording shows, and the loop e[k+1] = e[k] − z e[k−d] behind it; None where it doesn't say.

    Attributes:
      kind: a `Kind`.
      Ts: sampling time of recording and loop [s].
      period: of the oscillation [samples]; growth: factor of its size per sample. Of a monotone decay growth alone.
      factors: (g,) complex, of all modes that were found, the dominant first; of each pair one.
      z, delay: gain per sample, z = alpha Ts, and dead time d [samples]. SUSTAINED: z is at least that.
      phase_delay: dead time that the dominant factor alone says, not a whole number.
      confidence: in d, 0 to 1. pure: whether gain and dead time explain all of the recording; else a drive lags as
        well, of which d is part.
      stable, monotone, recommended: limits of z at this dead time, see `DrivenLimits`.
      factor: by which the gain is to be multiplied. alpha, recommended_alpha: gain now, if given, and then [1/s].
      amplitude: (k,) largest part of the oscillation, or decay, in each column [unit of the column].
      noise: (k,) standard deviation of what is left in each column.
      first: row where what was looked at begins. path, modes: (n, k) what of it is path, and the rest but for noise.
      note: what else is to be said.
    """

    kind: Kind
    Ts: float
    period: float | None = None
    growth: float | None = None
    factors: object = ()
    z: float | None = None
    delay: int | None = None
    phase_delay: float | None = None
    confidence: float | None = None
    pure: bool | None = None
    stable: float | None = None
    monotone: float | None = None
    recommended: float | None = None
    factor: float | None = None
    alpha: float | None = None
    recommended_alpha: float | None = None
    amplitude: object = ()
    noise: object = ()
    first: int = 0
    path: object = ()
    modes: object = ()
    note: str = ""

    @property
    def rings(self) -> bool:
        """Whether it oscillates."""
        return self.kind in OSCILLATING

    @property
    def period_seconds(self):
        """Of the oscillation [s]."""
        return None if self.period is None else self.period * self.Ts

    @property
    def delay_seconds(self):
        """Dead time [s]."""
        return None if self.delay is None else self.delay * self.Ts

    def __str__(self):
        return f"{self.kind}: {_sentence(self)}." + (f" {self.note}" if self.note else "")


def diagnose(signal, Ts: float, *, alpha=None, longest=LONGEST) -> Diagnosis:
    """Whether a recording rings, how late the robot is by that, and which gain would end it.

    The recording may begin at rest, have an offset, drift, follow a slow path, and be noisy. Several columns, as of
    several joints, share one loop. It must be as fast as the loop: a row for each sample.

    Args:
      signal: (N,) or (N, k): joint values, errors, or steps commanded.
      Ts: sampling time [s]. alpha: gain of the loop [1/s], if known.
      longest: period [samples] from which on motion is taken for that of a path.
    Raises: ArgumentError for fewer than 16 rows, or values that are not finite.
    """
    Ts = float(errors.number("Ts", Ts, positive=True))
    errors.number("longest", longest, at_least=2)
    if alpha is not None:
        alpha = float(errors.number("alpha", alpha, positive=True))
    signal = np.asarray(errors.array("signal", signal, (None,), (None, None)), float)
    y = signal[:, None] if signal.ndim == 1 else signal
    if len(y) < LEAST or y.shape[1] == 0:
        raise errors.fail("signal", f"have at least {LEAST} rows", f"has {len(y) if y.shape[1] else 0}")
    given = {"Ts": Ts, "alpha": alpha}
    moving = np.ptp(y, axis=0) > STILL * np.abs(y).max(0)
    if not moving.any():
        still = np.zeros(y.shape[1])
        return Diagnosis(kind=Kind.QUIET, path=y, modes=np.zeros_like(y), amplitude=still, noise=still, **given)
    first, last = _looked_at(y[:, moving], longest)
    seen = y[first:last]
    found = find_modes(seen[:, moving], longest)
    kind, chosen = _judged(found, len(seen), longest)
    if kind in (Kind.GROWING, Kind.RINGING) and len(seen) >= 4 * LEAST:  # what it has come to, if that stays
        half = first + len(seen) // 2
        late = find_modes(y[half:last][:, moving], longest)
        later, of_late = _judged(late, last - half, longest)
        large = later is Kind.SUSTAINED and np.any(_range(late.parts[of_late]) > 0.1 * _range(found.parts))
        if large:
            first, seen, found, kind, chosen = half, y[half:last], late, later, of_late
    made = _described(kind, found, chosen, seen[:, moving], alpha, Ts)
    return Diagnosis(kind=kind, first=first, **_spread(made, moving, seen), **given)


def _range(parts):
    """(k,) of the sum of parts (g, N, k)."""
    return np.ptp(parts.sum(0), axis=0)


def _looked_at(y, longest):
    """(first, last) of the rows that move most: neither what precedes the motion nor more than MOST."""
    first, last = 0, len(y)
    if last > MOST:
        width = int(min(longest, last // 8))
        kernel = np.ones(width) / width
        fast = [c - np.convolve(np.pad(c, width, mode="edge"), kernel, "same")[width:-width] for c in y.T]
        size = sum((c / (np.std(c) + np.finfo(float).tiny)) ** 2 for c in fast)
        total = np.concatenate([[0.0], np.cumsum(size)])
        first = int(np.argmax(total[MOST:] - total[:-MOST]))
        last = first + MOST
    away = np.abs(y[first:last] - y[first]) > BEGUN * np.ptp(y[first:last], axis=0)
    begun = int(np.argmax(away.any(1)))
    return (first + begun, last) if last - first - begun >= LEAST else (first, last)


def _judged(found: Modes, N: int, longest):
    """(kind, indices of the modes that it is about, the dominant first)."""
    f, size, angle = found.factors, np.abs(found.factors), np.abs(np.angle(found.factors))
    energy = np.sum(found.parts**2 / (np.var(found.parts.sum(0) + found.path, axis=0) + 1e-300), axis=(1, 2))
    turns = N * angle / (2 * np.pi)
    dies = N * np.log(size) < np.log(LOST)
    fast = (angle * longest >= 2 * np.pi) & ((turns >= TURNS) | (dies & (turns >= 1)))
    fast &= np.log(size) * np.pi > np.log(SEEN) * angle
    own = fast | dies  # of the loop, and not of a path
    chosen = np.flatnonzero(fast)[np.argsort(-energy[fast])]
    if len(chosen) and _turns_back(found.parts[own].sum(0)):
        change = N * np.log(size[chosen[0]])
        if abs(change) < np.log(HELD):
            return Kind.SUSTAINED, chosen
        return (Kind.GROWING if change > 0 else Kind.RINGING), chosen
    real = np.flatnonzero(own & (np.abs(f.imag) < 0.5 * size) & (f.real > 0) & (size < 1))
    if len(real):
        return Kind.MONOTONE, real[np.argsort(-energy[real])]
    largest = np.abs(found.path).max(0) + np.abs(found.parts).sum(0).max(0)
    return (Kind.QUIET if np.all(found.noise <= 1e-9 * largest) else Kind.NOISE), chosen[:0]


def _turns_back(part) -> bool:
    """Whether (N, k) goes back and forth, and not one way only."""
    way, span = np.abs(np.diff(part, axis=0)).sum(0), np.ptp(part, axis=0)
    main = span > 0.1 * span.max()
    return bool(np.any(way[main] > (1 + BACK) * span[main]))


def _described(kind, found, chosen, y, alpha, Ts) -> dict:
    """Fields of a `Diagnosis`, over the columns that move."""
    rest = [i for i in range(len(found.factors)) if i not in chosen]
    made = {
        "factors": found.factors[[*chosen, *rest]],
        "noise": found.noise,
        "path": found.path,
        "modes": found.parts.sum(0),
        "amplitude": 0.5 * np.minimum(_range(found.parts[chosen]), _range(found.parts))
        if len(chosen)
        else np.zeros(y.shape[1]),
    }
    if kind in OSCILLATING:
        return made | _of_loop(kind, found.factors[chosen[0]], y, found, alpha, Ts)
    if kind is Kind.MONOTONE:
        slowest = float(np.abs(found.factors[chosen[0]]))
        note = f"A real factor leaves the dead time open; without any, z is 1 − {slowest:.4g} = {1 - slowest:.4g}"
        gain = "" if alpha is None else f", where alpha Ts is {alpha * Ts:.4g}"
        return made | {"growth": slowest, "note": f"{note}{gain}. No smaller gain is needed.", "z": 1 - slowest}
    return made


def _of_loop(kind, factor, y, found, alpha, Ts) -> dict:
    made = {"period": float(2 * np.pi / np.abs(np.angle(factor))), "growth": float(np.abs(factor))}
    late = loop_of(factor, y, trend(len(y)), found.noise)
    made |= {"delay": late.delay, "phase_delay": late.phase, "confidence": late.confidence, "pure": late.whole}
    notes = []
    if late.delay > LATEST:
        return made | {"z": gain_of(factor, late.delay), "note": "So late is no robot: this may be a path."}
    limits = limits_at(late.delay)
    z = limits.stable if kind is Kind.SUSTAINED else late.z
    made |= {"z": z, "stable": limits.stable, "monotone": limits.monotone, "recommended": limits.recommended}
    made |= {"factor": limits.recommended / z}
    if alpha is not None:
        made |= {"recommended_alpha": alpha * made["factor"]}
    if kind is Kind.SUSTAINED:
        notes.append(
            "An oscillation that keeps its size is clipped, by a limit of speed or by friction: z may be larger."
        )
    if made["period"] < 2.01:
        notes.append("Values return every second sample: z is above 1.")
    if alpha is not None and kind is not Kind.SUSTAINED and not 0.8 < alpha * Ts / z < 1.25:
        notes.append(
            f"alpha Ts is {alpha * Ts:.4g}, not z: drive or measurement change the gain by {z / (alpha * Ts):.3g}."
        )
    if not late.whole and late.confidence < 0.6:
        notes.append(
            f"The phase says {late.phase:.2f} samples: a drive that lags, of which a recorded step tells more (--step)."
        )
    return made | {"note": " ".join(notes)}


@functools.lru_cache(maxsize=256)
def limits_at(delay: int) -> DrivenLimits:
    """Limits of z of explicit Euler with dead time alone: they don't depend on Ts."""
    return driven_limits("EE", Ts=1.0, drive=Drive(delay=delay))


def _spread(made, moving, seen) -> dict:
    """The fields with columns that stand still put back in."""
    for name in ("amplitude", "noise"):
        every = np.zeros(len(moving))
        every[moving] = made[name]
        made[name] = every
    for name, still in (("path", seen), ("modes", np.zeros_like(seen))):
        every = np.array(still)
        every[:, moving] = made[name]
        made[name] = every
    return made


# --- in words -----------------------------------------------------------------------------------------


def _sentence(d: Diagnosis) -> str:
    if d.kind is Kind.QUIET:
        return "no oscillation, and no noise"
    if d.kind is Kind.NOISE:
        return f"no oscillation above noise with a standard deviation of {np.max(d.noise):.3g}"
    if d.kind is Kind.MONOTONE:
        return f"the error shrinks × {d.growth:.4g} per sample and never returns"
    said = f"period {d.period:.4g} samples ({d.period_seconds:.4g} s), × {d.growth:.4g} per sample"
    more = "at least " if d.kind is Kind.SUSTAINED else ""
    said += f", as of a loop with z = {more}{d.z:.4g} and {d.delay} samples ({d.delay_seconds:.4g} s) of dead time"
    if d.factor is None:
        return said
    most = "at most " if d.kind is Kind.SUSTAINED else ""
    if d.recommended_alpha is not None:
        return f"{said}; an alpha of {most}{d.recommended_alpha:.4g} 1/s (× {d.factor:.3g}) would end it"
    return f"{said}; {most}{d.factor:.3g} times the gain would end it"
