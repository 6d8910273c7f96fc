"""Diagnose: whether a recording rings, how late the robot is by that, and which gain would end it."""

import numpy as np

from cnclik import errors
from cnclik.diagnosis.advice import advice
from cnclik.diagnosis.fit import columns
from cnclik.diagnosis.judge import LEAST, OSCILLATING, Kind, explained, judged, looked_at, spans
from cnclik.diagnosis.modes import find_modes
from cnclik.record import record

LONGEST = 250  # samples of a period: what is slower is taken for a path
STILL = 1e-12  # share of the largest value that is rounding


@record
class Diagnosis:
    """What a recording shows, and the loop e[k+1] = e[k] − z e[k−d] behind it; None where it doesn't say.

    Attributes:
      kind: a `Kind`.
      Ts: sampling time of recording and loop [s].
      period: of the oscillation [samples]; growth: factor of its size per sample. Of a monotone decay growth alone.
      factors: (g,) complex, of all modes that were found, the dominant first; of each pair one.
      z, delay: gain per sample, z = alpha Ts, and dead time d [samples]. SUSTAINED: z is at least that.
      lag: time constant [s], where alpha and the oscillation say that there is one; then d is no whole number.
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
    delay: float | None = None
    lag: float | None = None
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
    Raises: ArgumentError for fewer than 16 rows, or values that are not finite, or beyond 1e30.
    """
    Ts = float(errors.number("Ts", Ts, positive=True))
    errors.number("longest", longest, at_least=2)
    if alpha is not None:
        alpha = float(errors.number("alpha", alpha, positive=True))
    y = columns("signal", signal)
    if len(y) < LEAST or y.shape[1] == 0:
        raise errors.fail("signal", f"have at least {LEAST} rows", f"has {len(y) if y.shape[1] else 0}")
    given = {"Ts": Ts, "alpha": alpha}
    moving = np.ptp(y, axis=0) > STILL * np.abs(y).max(0)
    if not moving.any():
        still = np.zeros(y.shape[1])
        return Diagnosis(kind=Kind.QUIET, path=y, modes=np.zeros_like(y), amplitude=still, noise=still, **given)
    size = np.where(moving, np.ptp(y, axis=0), 1.0)
    scaled = (y - y[0]) / size
    first, last = looked_at(scaled[:, moving], longest)
    first, found = _explained(scaled[first:last, moving], first, longest)
    seen = scaled[first:last, moving]
    kind, chosen, own = judged(seen, found, longest)
    if kind in (Kind.GROWING, Kind.RINGING) and len(seen) >= 4 * LEAST:  # what it has come to, if that stays
        half = len(seen) // 2
        late = find_modes(seen[half:], longest)
        later, of_late, own_late = judged(seen[half:], late, longest)
        if later is Kind.SUSTAINED and np.any(spans(late.parts[of_late]) > 0.1 * spans(found.parts)):
            first, seen, found, kind, chosen, own = first + half, seen[half:], late, later, of_late, own_late
    made = given | {"kind": kind, "first": first}
    if kind in OSCILLATING:
        loop = seen - found.path - found.parts[~own].sum(0)
        made |= advice(kind, found.factors[chosen[0]], loop, found.noise, alpha, Ts)
    elif kind is Kind.MONOTONE:
        made |= _monotone(float(np.abs(found.factors[chosen[0]])), alpha, Ts)
    rest = [i for i in range(len(found.factors)) if i not in chosen]
    most = np.minimum(spans(found.parts[chosen]), spans(found.parts)) if len(chosen) else np.zeros(seen.shape[1])

    def every(values):  # of all columns, in their units
        full = np.zeros((*values.shape[:-1], y.shape[1]))
        full[..., moving] = values
        return full * size

    return Diagnosis(
        factors=found.factors[[*chosen, *rest]],
        amplitude=every(0.5 * most),
        noise=every(found.noise),
        path=every(found.path) + y[0],
        modes=every(found.parts.sum(0)),
        **made,
    )


def _explained(seen, first, longest):
    """(first row, its modes) of as much as modes explain: a large motion is no linear loop's, its last part is.

    Where nothing is explained, the whole.
    """
    whole = first, find_modes(seen, longest)
    at, found = whole
    while not explained(seen, found):
        cut = len(seen) // 4
        if len(seen) - cut < 4 * LEAST:
            return whole
        at, seen = at + cut, seen[cut:]
        if not np.all(np.ptp(seen, axis=0) > STILL):
            return whole
        found = find_modes(seen, longest)
    return at, found


def _monotone(slowest, alpha, Ts) -> dict:
    note = f"A real factor leaves the dead time open; without any, z is 1 − {slowest:.4g} = {1 - slowest:.4g}"
    gain = "" if alpha is None else f", where alpha·Ts is {alpha * Ts:.4g}"
    return {"growth": slowest, "z": 1 - slowest, "note": f"{note}{gain}. No smaller gain is needed."}


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
    said += f", as of a loop with z = {more}{d.z:.4g} and {d.delay:.4g} samples ({d.delay_seconds:.4g} s) of dead time"
    said += "" if d.lag is None else f" and a lag of {d.lag:.3g} s"
    if d.factor is None:
        return said
    most = "at most " if d.kind is Kind.SUSTAINED else ""
    if d.recommended_alpha is not None:
        return f"{said}; an alpha of {most}{d.recommended_alpha:.4g} 1/s (× {d.factor:.3g}) would end it"
    return f"{said}; {most}{d.factor:.3g} times the gain would end it"
