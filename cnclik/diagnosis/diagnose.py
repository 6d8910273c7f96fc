"""Diagnose: whether a recording rings, the dead time that it shows, and the gain that stops the ringing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from cnclik import errors
from cnclik.diagnosis import judge
from cnclik.diagnosis.advice import advice, advice_excited, growth_without_end
from cnclik.diagnosis.blocks import orthogonal, within
from cnclik.diagnosis.calm import is_as_large, is_calm
from cnclik.diagnosis.excited import excited
from cnclik.diagnosis.judge import LEAST, OSCILLATING, Kind, spans
from cnclik.diagnosis.modes import EXACT, Modes, find_modes, polynomials, shape_of, trend
from cnclik.diagnosis.recording import columns
from cnclik.precision import of_numbers
from cnclik.quantities import in_samples
from cnclik.record import ArrayLike, Float, record

LONGEST = 250  # samples of a period; slower motion counts as a path
WANDERS = 1.15  # factor between the periods of two parts of a recording beyond which no loop causes it
FADED = 0.3  # ratio of an oscillation's sizes in two parts below which they are not compared
NOISY = 0.05  # noise as a share of an oscillation above which noise may sustain it
MUCH, CLEAR, ALL = 10.0, 60.0, 0.8  # factor, likelihood and share of the motion above which growth is not a path's
PART = 0.25  # of a recording's range, up to which it may grow by a linear loop
SURELY = 0.9  # confidence in a loop above which growth in few periods is not the start of a swing
STILL = 1e-12  # share of the largest value that counts as rounding
UNFINISHED = (
    "It may be the start of an oscillation, a path, or columns that do not belong to one loop, such as commands (what "
    "joints do after commands is for `cnclik diagnose --step` and `fit_drive`): the gain cannot be judged. Record the "
    "loop at rest: push it and wait until it rests again. If it never does, its gain may be far too large: reduce the "
    "gain until it does."
)
HIDDEN = (
    "Whether its gain is a little too large cannot be known from this noise: push the loop at rest by ten times as "
    "much, and record that."
)
SLOW = "Slow motion is taken as a path; an error that grows as slowly looks alike. A longer recording decides."


@record
class Diagnosis:
    """What a recording shows, and the loop e[k+1] = e[k] − z e[k−d] behind it. A field that is unknown is None.

    Attributes:
      kind: a `Kind`.
      Ts: sampling time of recording and loop [s].
      period: of the oscillation [samples]; growth: factor of its amplitude per sample. A monotone decay has growth
        alone.
      factors: (g,) complex, of all modes, the dominant one first; one of each conjugate pair.
      z, delay: gain per sample, z = alpha Ts, and dead time d [samples]. SUSTAINED: z is a lower bound. For a
        wrong sign z is negative: −alpha·Ts, or, without alpha, the value without dead time.
      lag: time constant [s], if there is one; then d may be a fraction.
      cause: "dead time", "lag" (with dead time), "turned frames" or "wrong sign".
      angle, axis: of frames that are turned against each other [degrees], about an axis of the columns x, y, z: turn
        the error by −angle.
      phase_delay: dead time from the phase of the dominant factor alone, not a whole number.
      confidence: in d, 0 to 1. pure: whether gain and dead time explain the whole recording; otherwise a drive lags,
        too, and d includes its delay.
      stable, monotone, recommended: limits of z at this dead time, see `DrivenLimits`.
      factor: factor for the gain. alpha, recommended_alpha: present gain, if given, and recommended gain [1/s].
      amplitude: (k,) largest part of the oscillation, or decay, in each column [unit of the column].
      noise: (k,) standard deviation of the residual of each column.
      first: first row of the analysed part. path, modes: (n, k) the path and the modes in this part.
      note: further remarks.
    """

    kind: Kind
    Ts: float
    period: float | None = None
    growth: float | None = None
    factors: Sequence[complex] | np.ndarray = ()
    z: float | None = None
    delay: float | None = None
    lag: float | None = None
    cause: str | None = None
    angle: float | None = None
    axis: Float[np.ndarray, " 3"] | None = None
    phase_delay: float | None = None
    confidence: float | None = None
    pure: bool | None = None
    stable: float | None = None
    monotone: float | None = None
    recommended: float | None = None
    factor: float | None = None
    alpha: float | None = None
    recommended_alpha: float | None = None
    amplitude: Float[np.ndarray, " k"]
    noise: Float[np.ndarray, " k"]
    first: int = 0
    path: Float[np.ndarray, "n k"]
    modes: Float[np.ndarray, "n k"]
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


@of_numbers
def diagnose(
    signal: Float[ArrayLike, "N ..."],
    Ts: float,
    *,
    alpha: float | None = None,
    longest: float = LONGEST,
    progress: Callable | None = None,
) -> Diagnosis:
    """Whether a recording rings, the dead time that it shows, and the gain that stops the ringing.

    The recording may start at rest, have an offset, drift, follow a slow path and be noisy. Several columns, such as
    several joints, belong to one loop. The recording needs a row for each sample of the loop.

    Args:
      signal: (N,) or (N, k): joint values, errors, or commanded steps.
      Ts: sampling time [s]. alpha: gain of the loop [1/s], if known.
      longest: motion with a longer period [samples] is taken as motion of a path.
      progress: progress(done, total, note) is called as the work proceeds.
    Raises: ArgumentError for fewer than 16 rows, or values that are not finite, or beyond 1e30.
    """
    Ts = float(errors.number("Ts", Ts, positive=True))
    errors.number("longest", longest, at_least=2)
    if alpha is not None:
        alpha = float(errors.number("alpha", alpha, positive=True))
    y = columns("signal", signal)
    if len(y) < LEAST or y.shape[1] == 0:
        raise errors.fail("signal", f"have at least {LEAST} rows", f"has {len(y) if y.shape[1] else 0}")
    given: dict[str, Any] = {"Ts": Ts, "alpha": alpha}
    moving = np.ptp(y, axis=0) > STILL * np.abs(y).max(0)
    if not moving.any():
        still = np.zeros(y.shape[1])
        return Diagnosis(kind=Kind.QUIET, path=y, modes=np.zeros_like(y), amplitude=still, noise=still, **given)
    report = progress or (lambda *_: None)
    report(0, 4, "modes")
    size = np.where(moving, np.ptp(y, axis=0), 1.0)
    scaled = ((y - y[0]) / size)[:, moving]
    seen = judge.looked_at(scaled, longest)
    stepped = _stepped(scaled, seen)
    if stepped.any():
        moving[moving] = ~stepped
        scaled = scaled[:, ~stepped]
        seen = judge.looked_at(scaled, longest)
    first, last, found = _found(scaled, seen, longest)
    part = _part(first, scaled[first:last], found, longest)
    if stepped.any() and part.kind is Kind.MONOTONE:  # the response to these steps, perhaps, which is no loop's
        part = part._replace(kind=Kind.UNDECIDED)
    report(1, 4, "what it has come to")
    part = _come_to(part, longest)
    report(2, 4, "the loop behind it")
    made = _fields(part, scaled[:last], size[moving], longest, alpha, Ts, report)
    if made["kind"] is Kind.UNDECIDED and (start := _start(scaled[:last], seen[0], longest)):
        part, last = start, seen[0] + len(start.rows)
        made = _fields(part, scaled[:last], size[moving], longest, alpha, Ts, report)
    found, chosen = part.found, part.chosen
    rest = [i for i in range(len(found.factors)) if i not in chosen]
    most = np.minimum(spans(found.parts[chosen]), spans(found.parts)) if len(chosen) else np.zeros(moving.sum())

    def every(values):  # for all columns, in their units
        full = np.zeros((*values.shape[:-1], y.shape[1]))
        full[..., moving] = values
        return full * size

    return Diagnosis(
        factors=found.factors[[*chosen, *rest]],
        amplitude=every(0.5 * most),
        noise=every(found.noise),
        first=part.first,
        path=every(found.path) + y[0],
        modes=every(found.parts.sum(0)),
        **given,
        **made,
    )


def _stepped(y, seen):
    """Which columns (k,) rest from the first motion on, to rounding: their fit would be one of roundings."""
    _, begun, last = seen
    rests = np.ptp(y[begun:last], axis=0) <= EXACT
    return rests & ~rests.all()


class _Part(NamedTuple):
    """The rows to be judged, from `first` on, and the results of `judged`."""

    first: int
    rows: np.ndarray  # (N, k)
    found: Modes
    kind: Kind
    chosen: np.ndarray
    own: np.ndarray

    @property
    def factor(self):
        return self.found.factors[self.chosen[0]]


def _part(first, rows, found, longest) -> _Part:
    return _Part(first, rows, found, *judge.judged(rows, found, longest))


def _come_to(part, longest) -> _Part:
    """The second half of a growing or ringing part, if the oscillation is sustained there."""
    half = len(part.rows) // 2
    if part.kind not in (Kind.GROWING, Kind.RINGING) or len(part.rows) < 4 * LEAST:
        return part
    late = _part(part.first + half, part.rows[half:], find_modes(part.rows[half:], longest), longest)
    stays = late.kind is Kind.SUSTAINED
    stays = stays and np.any(spans(late.found.parts[late.chosen]) > 0.1 * spans(part.found.parts))
    return late if stays else part


def _fields(part, scaled, size, longest, alpha, Ts, report) -> dict:
    """Fields of the `Diagnosis` of a part of a recording (N, k), whose columns were divided by `size` (k,)."""
    kind, found, chosen = part.kind, part.found, part.chosen
    shape = shape_of(part.rows, found, chosen[0]) * (size / size.max()) if len(chosen) else None  # squares underflow
    stays = kind is Kind.GROWING and _moved_before(scaled, part.first)
    kind = Kind.SUSTAINED if stays else kind
    made: dict[str, Any] = {"kind": kind}
    whole, periods = True, None
    if kind in OSCILLATING:
        loop = part.rows - found.path - found.parts[~part.own].sum(0)
        made = advice(kind, part.factor, shape, loop, found.noise, alpha, Ts)
        whole = made.pop("whole", True)
        periods = _wandering(scaled, part.first, longest)
        begins = kind is Kind.GROWING and _begins(part, made, whole, alpha, periods)
        if begins or (kind is Kind.GROWING and not judge.likelier(part.rows, found)):
            kind, made, whole = Kind.UNDECIDED, {"kind": Kind.UNDECIDED}, True
    report(3, 4, "noise")
    noisy = kind in OSCILLATING and np.max(found.noise / np.maximum(spans(found.parts[chosen]), STILL)) > NOISY
    if kind is Kind.NOISE or not whole or periods or noisy or stays:
        driven = _noise_driven(scaled[-judge.MOST :], longest, alpha, Ts)
        if periods and not driven:
            made = {name: made[name] for name in ("kind", "period", "growth") if name in made}
            made["note"] = (
                f"The period goes from {periods[0]:.3g} to {periods[1]:.3g} samples, as of a sweep or another path, "
                "not of a loop: no gain is named."
            )
        if driven and (noisy or stays or periods or driven["confidence"] > made.get("confidence", 0)):
            made = driven  # all of it: a gain of the first answer does not stop another loop
    restless = made["kind"] is Kind.NOISE and not is_as_large(scaled)
    if restless or (made["kind"] in (Kind.MONOTONE, Kind.NOISE) and not is_calm(part.rows, longest)):
        kind, made = Kind.UNDECIDED, {"kind": Kind.UNDECIDED}
    if kind is Kind.DIVERGING:
        made |= growth_without_end(part.factor, shape, _is_clear(part), alpha, Ts)
    elif kind is Kind.UNDECIDED:
        made["note"] = UNFINISHED
    elif made["kind"] in (Kind.QUIET, Kind.NOISE):
        moved = np.ptp(found.path + found.parts.sum(0), axis=0)
        slow = np.any(moved > judge.ABOVE_NOISE * found.noise + STILL)
        made["note"] = SLOW if slow else HIDDEN if kind is Kind.NOISE else ""
    elif kind is Kind.MONOTONE:
        made |= _monotone(float(np.abs(part.factor)), alpha, Ts)
    return made


def _begins(part, made, whole, alpha, periods) -> bool:
    """Whether growth may be the start of a swing: it shows few periods, and its loop is not certain."""
    alone = made.get("pure") or alpha is not None  # with a lag, few rows fit many loops
    sure = "angle" in made or (whole and alone and made["confidence"] > SURELY)
    return len(part.rows) < judge.TURNS * made["period"] and not (sure or periods)


def _is_clear(part) -> bool:
    """Whether no path grows like this."""
    rows, found = part.rows, part.found
    most = np.max(spans(found.parts[part.chosen]) / np.ptp(rows, axis=0))
    grown = len(rows) * np.log(np.abs(part.factor)) > np.log(MUCH)
    return bool(most > ALL and grown and found.score < polynomials(rows) - CLEAR)


def _found(y, seen, longest):
    """(first row, last row, modes) of the rows to be judged. A growing motion is small at first, which is not rest.

    Args: seen: of `looked_at`.
    """
    first, begun, last = seen
    if begun > first and (found := judge.growing(y[first:last], longest)):
        return first, last, found
    begun, found = _explained(y[begun:last], begun, longest)
    return begun, last, found


def _start(y, first, longest) -> _Part | None:
    """The rows from `first` on in which a loop grows to a part of the range; beyond, it may move without a rule."""
    y = y[first : first + int(np.argmax(np.any(np.abs(y[first:] - y[first]) > PART, axis=1)))]
    found = judge.growing(y, longest) if len(y) >= 2 * LEAST else None
    part = found and _part(first, y, found, longest)
    return part if part and part.kind is Kind.GROWING else None


def _explained(seen, first, longest):
    """(first row, modes) of the longest last part that modes explain, as large motions are not linear.

    The whole if nothing is explained.
    """
    whole = first, find_modes(seen, longest)
    at, found = whole
    while not judge.explained(seen, found):
        cut = len(seen) // 4
        if len(seen) - cut < 4 * LEAST:
            return whole
        at, seen = at + cut, seen[cut:]
        if not np.all(np.ptp(seen, axis=0) > STILL):
            return whole
        found = find_modes(seen, longest)
    return at, found


def _moved_before(y, first) -> bool:
    """Whether a recording oscillated before row `first` as it does after: then it did not grow."""
    before, seen = y[max(2 * first - len(y), 0) : first], y[first:]
    least = np.std(np.diff(seen, axis=0), axis=0) / judge.HELD
    return len(before) >= LEAST and bool(np.any(np.std(np.diff(before, axis=0), axis=0) > least))


def _wandering(y, first, longest):
    """The periods (2,) of an oscillation in two parts of a recording, if they differ; otherwise None.

    The parts are the rows from `first` on and as many before it, or otherwise the halves.
    """
    N = len(y) - first
    parts = (y[first - N : first], y[first:]) if first >= N else (y[first : first + N // 2], y[first + N // 2 :])
    periods, sizes = [], []
    for part in parts:
        if len(part) < 2 * LEAST or not np.all(np.ptp(part, axis=0) > STILL):
            return None
        found = find_modes(part, longest)
        kind, chosen, _ = judge.judged(part, found, longest)
        if kind not in OSCILLATING:
            return None
        sizes.append(spans(found.parts[chosen]).max())
        periods.append(float(2 * np.pi / np.abs(np.angle(found.factors[chosen[0]]))))
    faded = min(sizes) < FADED * max(sizes)  # then noise may affect one of them
    return periods if max(periods) > WANDERS * min(periods) and not faded else None


def _noise_driven(seen, longest, alpha, Ts) -> dict:
    """Fields of a loop that noise excites, if there is one."""
    if len(seen) < 4 * LEAST or np.any(np.ptp(seen, axis=0) <= STILL):
        return {}
    basis, _ = orthogonal(trend(len(seen), longest if len(seen) > 3 * longest else None))
    loops = excited(seen - within(basis, seen), Ts, None if alpha is None else alpha * Ts, basis.shape[1])
    return advice_excited(loops, alpha, Ts) if loops else {}


def _monotone(slowest, alpha, Ts) -> dict:
    note = f"A real factor leaves the dead time open; without any, z is 1 − {slowest:.4g} = {1 - slowest:.4g}"
    gain = "" if alpha is None else f", where alpha·Ts is {alpha * Ts:.4g}"
    return {"growth": slowest, "z": 1 - slowest, "note": f"{note}{gain}. No smaller gain is needed."}


# --- in words -----------------------------------------------------------------------------------------


def _sentence(d) -> str:
    still = {
        Kind.QUIET: "no oscillation, and no noise",
        Kind.NOISE: f"no oscillation above noise with a standard deviation of {np.max(d.noise):.3g}",
        Kind.UNDECIDED: "no oscillation was found, and the motion has not come to rest",
    }
    if d.kind in still:
        return still[d.kind]
    if d.kind is Kind.MONOTONE:
        return f"the error shrinks × {d.growth:.4g} per sample"
    if d.kind is Kind.DIVERGING and d.cause == "wrong sign":
        return f"the error grows × {d.growth:.6g} per sample"
    end = " at the end" if d.z is None else ""
    said = f"period {in_samples(d.period, d.Ts)}{end}, amplitude × {d.growth:.4g} per sample"
    if end or d.cause == "turned frames":
        return said
    more = "at least " if d.kind is Kind.SUSTAINED else ""
    said += f", like a loop with z = {more}{d.z:.4g} and {in_samples(d.delay, d.Ts)} of dead time"
    said += "" if d.lag is None else f" and a lag of {d.lag:.3g} s"
    if d.factor is None:
        return said
    most = "at most " if d.kind is Kind.SUSTAINED else ""
    if d.recommended_alpha is not None:
        return f"{said}. Reduce alpha to {most}{d.recommended_alpha:.4g} 1/s (× {d.factor:.3g}) to stop it"
    return f"{said}. Multiply the gain by {most}{d.factor:.3g} to stop it"
