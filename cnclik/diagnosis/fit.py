"""Fit: the drive between recorded commands and the recorded motion, by least squares with exact sampling.

A row of a recording is a sample: the motion measured at t[k], and the command sent then. Before the first row the first
command is constant. Each joint has an offset and, if the recording needs them, a gain and a drift: motion = gain ·
(drive's motion) + offset + drift · t. These enter linearly, so the search eliminates them (Golub & Pereyra 1973).
"""

from __future__ import annotations

import itertools

import numpy as np

from cnclik import errors
from cnclik.diagnosis.judge import LEAST
from cnclik.diagnosis.recording import LARGEST, columns, sampling_time
from cnclik.diagnosis.response import NUMBERS, Shape, response
from cnclik.diagnosis.spread import correlated, stable_range
from cnclik.integrate.drive import COMMANDS, Drive
from cnclik.precision import of_numbers
from cnclik.record import ArrayLike, Float, record, replace

KINDS = ("delay", "lag", "second-order")  # by their order
DELAYS = 200  # samples of dead time to be tried, at most
MOVED = 0.2  # share of the range that counts as a clear motion
TIMES = np.geomspace(0.2, 200, 16)  # lags, or 1/ω₀, to start from [samples]
RATIOS = (0.1, 0.3, 0.7, 1.0, 2.0, 4.0)  # ζ
BETTER = 10.0  # decrease of the information criterion that justifies another number
EXPLAINED = 0.5  # share of a motion that a command must explain
EXACT = 1e-5  # share of a motion that counts as rounding
EVALUATIONS = 15  # evaluations per number, in a fit from one start
OFF = 0.02  # difference of a gain from 1 that deserves a note
REST = 5e-3  # share of a motion by which its last two tenths may differ at rest
OTHER_UNIT = 5.0  # factor of a gain beyond which something is wrong: units, another joint, the sign
STRUCTURE = 4.0  # correlation length of the residual [samples] above which the model is too simple
SEEN = 2e-3  # unless the residual is below this share of a motion's range
PARTS = (("gain", "drift"), ("gain",), ())  # of a joint, besides its offset
CAUGHT_UP = 0.5  # share of a velocity drive's delay; a larger residual hides a lag
NOT_REBASED = (
    "No gain is safe for a loop whose position commands begin at the measured joints (feedback rebased): the "
    "difference adds up, so that it runs away or does not arrive. Begin each command at the last one."
)


@record
class DriveFit:
    """A drive that was fitted to a recording.

    Attributes:
      drive: a `Drive`; its numbers are shared by all joints, or one per joint where they differ by more than their
        uncertainty.
      uncertainty: {name: standard deviation} of its numbers; the largest one over the joints.
      gain: (k,) motion per commanded motion. drift: (k,) [rad/s, m/s] motion without a command.
      rms: (k,) RMS residual of each motion [rad, m]. explained: share of the motions' variance.
      largest_stable_alpha: (low, high) [1/s]: the range in which explicit Euler with measured joints becomes unstable;
        None where the recording does not determine it.
      motion: (N, k) of the fit. note: further remarks.
    """

    drive: Drive
    uncertainty: dict[str, float]
    gain: Float[np.ndarray, " k"]
    drift: Float[np.ndarray, " k"]
    rms: Float[np.ndarray, " k"]
    explained: float
    largest_stable_alpha: tuple[float, float] | None
    motion: Float[np.ndarray, "N k"]
    note: str = ""

    @property
    def options(self) -> str:
        """As `cnclik stability` and `tune` take it."""
        drive = self.drive
        said = [f"--{name.replace('_', '-')} {_said(getattr(drive, name))}" for name in self.uncertainty]
        return " ".join([*said, f"--command {drive.command}"])

    def __str__(self):
        units = {"delay": " samples", "lag": " s", "natural_frequency": " rad/s", "damping_ratio": ""}
        said = []
        for name, deviation in self.uncertainty.items():
            value = _said(getattr(self.drive, name)).replace(" ", ", ")
            said.append(f"{name.replace('_', ' ')} {value} ± {deviation:.1g}{units[name]}")
        left = f"{np.max(self.rms):.3g} rms left of the motion, {100 * self.explained:.4g} % explained"
        more = ""
        if self.largest_stable_alpha is not None:
            low, high = self.largest_stable_alpha
            more = f"With measured joints explicit Euler becomes unstable at an alpha of {low:.4g} to {high:.4g} 1/s."
        return " ".join(filter(None, (f"{KINDS[self.drive.order]}: {', '.join(said)}; {left}.", more, self.note)))


def _said(value) -> str:
    """One number or several, as text; values below a millionth are 0."""
    return " ".join(f"{0.0 if abs(v) < 1e-6 else v:.4g}" for v in np.ravel(value))


@of_numbers
def fit_drive(
    t: Float[ArrayLike, " N"] | None,
    command: Float[ArrayLike, "N ..."],
    motion: Float[ArrayLike, "N ..."],
    Ts: float | None = None,
    *,
    kind: str | None = None,
    command_kind: str = "position",
) -> DriveFit:
    """Fit a drive to recorded commands and motion, such as of a step: dead time, and a lag or a second-order servo.

    Each order is fitted by least squares with the exactly sampled drive, with and without a gain and a drift of each
    joint. The simplest one is chosen unless another is much better by an information criterion (Schwarz 1978). The
    first command is assumed to be constant for a long time before the recording.

    Args:
      t: (N,) times [s], or None with a Ts. command, motion: (N,) or (N, k), a column per joint: the joint values or
        velocities sent at t, and the joint values measured then [rad, m].
      Ts: sampling time [s]; default: from t. kind: "delay", "lag" or "second-order"; None: the simplest that explains
        the recording.
      command_kind: "position" or "velocity".
    Raises: ArgumentError for a recording without motion, or with motion that the command does not explain.
    """
    errors.one_of("command_kind", command_kind, COMMANDS)
    orders = range(3) if kind is None else (KINDS.index(errors.one_of("kind", kind, KINDS)),)
    command, motion = columns("command", command), columns("motion", motion)
    if command.shape != motion.shape:
        raise errors.fail("motion", f"have the shape of the commands, {command.shape}", f"has {motion.shape}")
    if len(motion) < LEAST:
        raise errors.fail("motion", f"have at least {LEAST} rows", f"has {len(motion)}")
    for name, values in (("command", command), ("motion", motion)):
        if np.any(np.ptp(values, axis=0) <= np.maximum(1e-12 * np.abs(values).max(0), 1 / LARGEST)):
            raise errors.fail(name, "move in every column", "stands still")
    Ts = sampling_time(t, Ts)
    if t is not None and np.size(t) != len(command):
        raise errors.fail("t", f"have the commands' {len(command)} rows", f"has {np.size(t)}")
    log = _Log(command, motion, Ts)
    shapes = [Shape(start=Drive(command=command_kind), Ts=Ts, order=order) for order in orders]
    best = _best(shapes, log)
    if hides := _catches_up(best, log):
        log.rates = True
        best = _best(shapes if kind else shapes[1:2], log)
    return _made(best, log, hides)


def _best(shapes, log):
    found = sorted((fit for shape in shapes for fit in _fits(shape, log)), key=lambda fit: fit.count)
    best = found[0]
    for other in found[1:]:
        if other.score < best.score - BETTER:
            best = other
    return best


def _catches_up(fit, log) -> bool:
    """Whether the residual amounts to more than half of the fit's delay.

    A velocity servo with an integral part makes up for its lag, so its joints are hardly delayed at the end; only the
    velocities show the lag.
    """
    if fit.shape.start.command != "velocity":
        return False
    left = log.motion - log.motions(fit.shape, fit.values, fit.parts)[0]
    length, most = np.array([correlated(c) for c in left.T]), np.abs(left).max(0)
    speed = np.abs(np.diff(log.motion, axis=0)).max(0) / log.Ts
    late = max(float(fit.shape.drive(values).late_by(log.Ts)) for values in fit.values)
    seen = (length > STRUCTURE) & (most > SEEN * np.ptp(log.motion, axis=0))
    return bool(np.any(seen & (most > CAUGHT_UP * late * speed)))


def _made(fit, log, hides) -> DriveFit:
    motion, k = log.motion, log.motion.shape[1]
    made, gain, drift = log.motions(fit.shape, fit.values, fit.parts)
    left = motion - made
    explained = 1.0 - float(np.sum(left**2 / np.var(motion, axis=0)) / motion.size)
    if explained < EXPLAINED:
        raise errors.fail("motion", "be what the command leads to", f"only {100 * max(explained, 0):.0f} % of it are")
    odd = np.flatnonzero((gain < 1 / OTHER_UNIT) | (gain > OTHER_UNIT))
    if len(odd):
        found = f"moves by {gain[odd[0]]:.3g} times it in column {odd[0] + 1}: a sign, other units, or velocities"
        raise errors.fail("motion", "move by about what is commanded", found)
    length = np.array([correlated(c) for c in left.T])  # correlated residuals carry less information
    deviations = log.deviations(fit.shape, fit.values, fit.parts, fit.own) * np.sqrt(length)[:, None]
    numbers = [fit.shape.numbers(values) for values in fit.values]
    same = all(row == numbers[0] for row in numbers)
    changes = {n: float(numbers[0][n]) if same else np.array([row[n] for row in numbers]) for n in numbers[0]}
    drive = replace(fit.shape.start, **changes | {"delay": numbers[0]["delay"]})
    rms = np.sqrt(np.mean(left**2, axis=0))
    structured = hides or bool(np.any((length > STRUCTURE) & (rms > SEEN * np.ptp(motion, axis=0))))
    scale = np.array([[1.0, *list(row.values())[1:]] for row in numbers])  # the deviation of a logarithm is relative
    stable, why = stable_range(fit, deviations, gain, structured, log.command)
    uncertainty = dict(zip(numbers[0], (deviations * scale).max(0).tolist(), strict=True))
    return DriveFit(
        drive=drive,
        uncertainty=uncertainty,
        gain=gain,
        drift=drift,
        rms=rms,
        explained=explained,
        largest_stable_alpha=stable,
        motion=made,
        note=" ".join(_notes(_at_rest(log, gain, drift, drive.command), structured, k, why, drive.command)),
    )


def _at_rest(log, gain, drift, command_kind):
    """Gains (k,) of position drives, from where commands and motions have come to rest, if they have: joints that
    oscillate together distort the fitted gains.
    """
    last = len(log.motion) // 10
    if command_kind != "position" or last < 2 or np.any(log.command[-2 * last :] != log.command[-1]):
        return gain
    still = log.motion - np.arange(len(log.motion))[:, None] * log.Ts * drift
    before, after = still[-2 * last : -last].mean(0), still[-last:].mean(0)
    moved, sent = after - still[0], log.command[-1] - log.command[0]
    rests = (np.abs(after - before) < REST * np.abs(moved)) & (sent != 0)
    return np.where(rests, moved / np.where(rests, sent, 1.0), gain)


def _notes(gain, structured, k, why, command_kind) -> list:
    said = []
    off = np.flatnonzero(np.abs(gain - 1) > OFF)
    if len(off):
        where = "" if k == 1 else f" (joint {', '.join(str(i + 1) for i in off)})"
        least, most = gain[off].min(), gain[off].max()
        span = f"{least:.3g}" if most - least < 5e-3 else f"{least:.3g} to {most:.3g}"
        said.append(
            f"Motion is {span} times what is commanded{where}, and a loop has as many times its alpha: divide the "
            f"gains that are recommended for this drive by {gain.max():.3g}."
        )
        if command_kind == "position":
            said.append(NOT_REBASED)
    if structured:
        said.append(
            "What is left has a structure: the drive has friction, play, a limit or a higher order, which the numbers "
            "leave out."
        )
    return [*said, why] if why else said


class _Log:
    """A recording, and the residual that a drive leaves."""

    def __init__(self, command, motion, Ts, rates=False):
        self.command, self.motion, self.Ts, self.rates = command, motion, Ts, rates
        self.size, self.change = np.std(motion, axis=0), np.std(np.diff(motion, axis=0), axis=0)
        self.time = np.linspace(-1, 1, len(motion))

    def joint(self, j):
        return _Log(self.command[:, [j]], self.motion[:, [j]], self.Ts, self.rates)

    def moved(self, shape, values):
        """(N, k) motions of drives with values (k, p), without offsets."""
        if np.all(values == values[0]):
            return response(shape.drive(values[0]), self.command, self.Ts)
        each = [response(shape.drive(v), self.command[:, [j]], self.Ts) for j, v in enumerate(values)]
        return np.hstack(each)

    def motions(self, shape, values, parts):
        """((N, k) fitted motions, gains (k,), drifts (k,) [1/s])."""
        moved, k = self.moved(shape, values), self.motion.shape[1]
        made, gain, drift = np.empty_like(moved), np.empty(k), np.empty(k)
        for j in range(k):
            columns = {"offset": np.ones(len(moved)), "gain": moved[:, j] - moved[:, j].mean(), "drift": self.time}
            fixed = 0.0 if "gain" in parts else columns["gain"]
            base = np.stack([columns[name] for name in ("offset", *parts)], 1)
            weights = np.linalg.lstsq(base, self.motion[:, j] - fixed, rcond=1e-12)[0]
            made[:, j] = fixed + base @ weights
            fitted = dict(zip(parts, weights[1:], strict=True))
            gain[j] = fitted.get("gain", 1.0)
            drift[j] = fitted.get("drift", 0.0) * 2 / ((len(moved) - 1) * self.Ts)
        return made, gain, drift

    def left(self, shape, values, parts):
        """(N, k) residual of each motion, or of its changes, as shares of its standard deviation."""
        left = self.motion - self.motions(shape, values, parts)[0]
        return np.diff(left, axis=0) / self.change if self.rates else left / self.size

    def deviations(self, shape, values, parts, own):
        """(k, p) standard deviations of drives' values for white noise. own: whether each joint has its own values."""
        here = self.left(shape, values, parts)
        power = np.mean(here**2, axis=0) + EXACT**2
        slopes = [
            (self.left(shape, values + step, parts) - here) / (1e-4 * np.sqrt(power))
            for step in 1e-4 * np.eye(values.shape[1])
        ]
        slope = np.stack(slopes, -1)  # (N, k, p)
        each = np.einsum("nki,nkj->kij", slope, slope)
        each = each if own else np.broadcast_to(each.sum(0), each.shape)
        made = np.sqrt(np.abs(np.diagonal(np.linalg.pinv(each), axis1=-2, axis2=-1)))
        return np.minimum(made, 1e3)  # for a number that hardly matters


@record
class Fit:
    """A fitted drive: values (k, p) of the joints, equal if they share them, and the criterion."""

    shape: Shape
    values: Float[np.ndarray, "k p"]
    parts: tuple
    own: bool
    score: float
    count: int  # number of fitted values


def _fits(shape, log):
    """The drives of an order, for each of PARTS: with shared values, and with values per joint if that is better."""
    starts = _begin(shape, log)
    k = log.motion.shape[1]
    own = [_begin(shape, log.joint(j), most=1) for j in range(k)] if k > 1 and shape.order else None
    for parts in PARTS:  # each is a subset of the one before, and starts from its values
        least = _least(shape, starts, log, parts)
        starts, values = [least], np.tile(least, (k, 1))
        fit = _scored(shape, values, log, parts, own=False)
        if own is not None:
            each = [_least(shape, begin, log.joint(j), parts) for j, begin in enumerate(own)]
            certain = 1 / (log.deviations(shape, np.array(each), parts, own=True)[:, 0] ** 2 + 1e-12)
            delay = float(np.average([values[0] for values in each], weights=certain))  # shared by all joints
            own = [[v] for v in each]
            each = [_least(shape, [v], log.joint(j), parts, delay) for j, v in enumerate(each)]
            other = _scored(shape, np.array(each), log, parts, own=True)
            if other.score < fit.score - BETTER:
                fit = other
            else:
                own = None  # fewer parts need none, either
        yield fit


def _begin(shape, log, most=2):
    """The best few points of a grid, each with its best dead time, to start from."""
    grid = [()] if shape.order == 0 else [(tau,) for tau in np.log(TIMES * log.Ts)]
    if shape.order == 2:
        grid = [(-tau, np.log(zeta)) for (tau,), zeta in itertools.product(grid, RATIOS)]
    N = len(log.motion)
    delays = min(_latest(log.command, log.motion), N // 2, DELAYS) + 1
    wanted, tried = (log.motion - log.motion.mean(0)) / log.size, []
    for numbers in grid:
        made = response(shape.drive(np.array([0.0, *numbers])), log.command, log.Ts)
        slope = (made[1] - made[0]) if shape.start.command == "velocity" else 0.0 * made[0]
        left = np.zeros(delays)
        for j in range(made.shape[1]):
            before = made[0, j] - slope[j] * np.arange(delays - 1, 0, -1)
            late = np.lib.stride_tricks.sliding_window_view(np.concatenate([before, made[:, j]]), N)[::-1] / log.size[j]
            power = np.sum(late**2, 1) - np.sum(late, 1) ** 2 / N
            left += np.sum(wanted[:, j] ** 2) - (late @ wanted[:, j]) ** 2 / np.maximum(power, 1e-300)
        tried.append((left.min(), np.array([np.argmin(left) + 0.3 * (shape.order > 0), *numbers])))
    return [values for _, values in sorted(tried, key=lambda start: start[0])[:most]]


def _latest(command, motion) -> int:
    """The largest possible dead time [samples]: from the first change of a command until a clear motion."""
    sent = np.argmax(np.any(command != command[0], axis=1))
    moved = np.argmax(np.any(np.abs(motion - motion[0]) > MOVED * np.ptp(motion, axis=0), axis=1))
    return max(int(moved - sent), 0)


def _least(shape, starts, log, parts, delay=None):
    """Values (p,) of least squares, the best of several starts, at a given dead time if there is one."""
    from scipy.optimize import least_squares

    k = log.motion.shape[1]
    fixed = [] if delay is None else [delay]
    if shape.order == 0 and delay is None:  # motion is piecewise linear in the dead time: no slope at whole samples
        starts = [[side] for side in sorted({max(v[0] + s, 0.0) for v in starts for s in (-0.5, 0.5)})]

    def left(free):
        return log.left(shape, np.tile([*fixed, *free], (k, 1)), parts).ravel()

    made = [
        least_squares(left, values[len(fixed) :], method="lm", x_scale=0.1, xtol=1e-8, ftol=1e-9,
                      max_nfev=EVALUATIONS * len(values))
        for values in starts
    ]  # fmt: skip
    best = min(made, key=lambda end: end.cost).x
    return np.concatenate([np.abs([*fixed, *best][:1]), [*fixed, *best][1:]])


def _scored(shape, values, log, parts, *, own):
    N, k = log.motion.shape
    power = np.mean(log.left(shape, values, parts) ** 2, axis=0) + EXACT**2
    numbers = 1 + len(NUMBERS[shape.order]) * (k if own else 1) + k * (1 + len(parts))
    score = N * float(np.sum(np.log(power))) + numbers * np.log(N)
    return Fit(shape=shape, values=values, parts=parts, own=own, score=score, count=numbers)
