"""Fit: the drive between recorded commands and motion, by output error with exact step responses. NumPy only.

A constant command between samples is a sum of steps, so the motion is the sum of the drive's step responses. Offset,
gain and drift of each joint enter linearly: each evaluation eliminates them (Golub & Pereyra 1973). Every joint is
fitted by itself, and the information of all is added up.
"""

from __future__ import annotations

import numpy as np

from cnclik import errors
from cnclik.diagnosis.recording import LARGEST, columns, sampling_time, unwrapped
from cnclik.integrate.drive import COMMANDS, MOST, Drive
from cnclik.record import ArrayLike, Float, record, replace
from cnclik.stability.gain import gains

NUMBERS = {  # of each model besides the dead time
    "delay": (),
    "lag": ("lag",),
    "second-order": ("natural_frequency", "damping_ratio"),
    "velocity PI": ("lag", "integral"),  # v' = (u − v + ∫(u − v)/integral)/lag
}
BOUNDS = {"lag": (0.05, 1e3), "natural_frequency": (1e-3, 20.0), "damping_ratio": (0.03, 20.0), "integral": (0.3, 1e4)}
SCALES = {"lag": 1, "integral": 1, "natural_frequency": -1, "damping_ratio": 0}  # powers of Ts: bounds are in samples
TIMES, RATIOS = np.geomspace(0.3, 150, 12), (0.3, 0.8, 2.0)  # lags [samples] and ζ to start from, a factor of 2 apart
STEPS = 25  # of Gauss and Newton, from within a factor of two
EXACT = 1e-4  # share of a motion that no model explains: roundings, jitter
BETTER = 10.0  # decrease of the information criterion that is "very strong" evidence (Raftery 1995)
EXPLAINED, OTHER_UNIT = 0.5, 5.0  # share of a joint's motion that is its command's; gains beyond are units or signs
OFF = 0.02  # difference of a gain from 1 that deserves a note
OPEN, STEP = 0.35, 0.1  # deviation of a gain's logarithm, over a factor of four in its interval; change that is tried
WIDE = 5.0  # largest deviation of a number that is said
NORMAL, APART = 1.96, 3.1  # deviations in half an interval of 95 %; and one in 1,000, beyond which joints differ
NOT_REBASED = "No gain is safe where position commands begin at the measured joints: begin each at the last one."


@record
class DriveFit:
    """A drive that was fitted to a log.

    Attributes:
      drive: a `Drive`; its numbers are shared by all joints, or one per joint where they differ by more than their
        uncertainty. Of a velocity servo with an integral part, its lag without that part.
      interval: {name: (low, high)} of 95 % of each number. gain: (k,) motion per commanded motion.
      drift: (k,) motion without a command [rad/s, m/s]. rms: (k,) RMS residual [rad, m]; motion: (N, k) of the fit.
      Ts: sampling time [s]. explained: share of the motions' variance.
      recommended_alpha: gain of a loop on these measured joints that does not overshoot [1/s], by any method and over
        the interval, divided by the largest gain of a joint; None where the log does not determine it, see `note`.
    """

    drive: Drive
    Ts: float
    interval: dict[str, tuple]
    gain: Float[np.ndarray, " k"]
    drift: Float[np.ndarray, " k"]
    rms: Float[np.ndarray, " k"]
    explained: float
    recommended_alpha: float | None
    motion: Float[np.ndarray, "N k"]
    note: str = ""

    @property
    def options(self) -> str:
        """As `cnclik stability` and `solve` take it, with any Ts."""
        said = [f"--delay {_said(1e3 * self.Ts * self.drive.delay)}ms"]
        said += [f"--{name.replace('_', '-')} {_said(getattr(self.drive, name))}" for name in [*self.interval][1:]]
        return " ".join([*said, f"--command {self.drive.command}"])

    def __str__(self):
        units = {"delay": " samples", "lag": " s", "natural_frequency": " rad/s", "damping_ratio": ""}
        said = []
        for name, (low, high) in self.interval.items():
            value, wide = _said(getattr(self.drive, name)).replace(" ", ", "), _said(np.max(np.subtract(high, low)) / 2)
            said.append(f"{name.replace('_', ' ')} {value}{units[name]} (± {wide})")
        kind = ("dead time", "lag", "second order")[self.drive.order]
        left = f"{np.max(self.rms):.3g} rms left of the motion, {100 * self.explained:.4g} % explained"
        alpha = f"Recommended alpha: {self.recommended_alpha:.4g} 1/s." if self.recommended_alpha else ""
        return " ".join(filter(None, (f"{kind}: {', '.join(said)}; {left}.", alpha, self.note)))


def _said(value) -> str:
    """One number or several, as text; values below a millionth are 0."""
    return " ".join(f"{0.0 if abs(v) < 1e-6 else v:.4g}" for v in np.ravel(value))


def fit_drive(
    t: Float[ArrayLike, " N"] | None,
    command: Float[ArrayLike, "N ..."],
    motion: Float[ArrayLike, "N ..."],
    Ts: float | None = None,
    *,
    command_kind: str = "position",
) -> DriveFit:
    """Fit a drive to recorded commands and motion, such as of a step: dead time, and a lag or a second-order servo.

    Each model is fitted by least squares with the exactly sampled drive, with a gain and a drift of each joint; of
    velocity commands a servo with an integral part, too. The simplest one is chosen unless another is much better by an
    information criterion (Schwarz 1978).
    The first command is assumed to be constant for a long time before the log.

    Args:
      t: (N,) times [s], or None with a Ts. command, motion: (N,) or (N, k), a column per joint: the joint values or
        velocities sent at t, and the joint values measured then [rad, m].
      Ts: sampling time [s]; default: from t. command_kind: "position" or "velocity".
    Raises: ArgumentError for a log without motion, or with motion that the command does not explain.
    """
    velocity = errors.one_of("command_kind", command_kind, COMMANDS) == "velocity"
    command = columns("command", command, "fit_drive")
    measured = columns("motion", motion, "fit_drive", like=command)
    motion, wraps = unwrapped(measured)
    if not velocity:
        command = np.where(wraps.any(0), np.unwrap(command, axis=0), command)  # else a turn may be meant
    for name, values in (("command", command), ("motion", motion)):
        if np.any(np.ptp(values, axis=0) <= np.maximum(1e-12 * np.abs(values).max(0), 1 / LARGEST)):
            raise errors.fail(name, "move in every column", "stands still")
    log = _Log(command, motion, sampling_time(t, Ts, len(command)), velocity)
    best, score, fitted = "", np.inf, np.empty(0)
    for kind in list(NUMBERS)[: 3 + velocity]:
        values, lower = _least(log, kind, _starts(log, kind))
        if lower < score - BETTER:
            best, score, fitted = kind, lower, values
    fit = _fitted(log, best, fitted)
    return replace(fit, motion=fit.motion + measured - motion)  # in the log's own turns


class _Log:
    """A log in samples: (k, N) motions as shares of their deviation, and the changes of commands in frequencies."""

    def __init__(self, command, motion, Ts, velocity):
        self.command, self.motion, self.Ts, self.velocity = command, motion, Ts, velocity
        self.t, self.k = np.arange(len(motion)), motion.shape[1]
        self.size = np.std(motion, axis=0)[:, None]
        self.y = motion.T / self.size
        unit = (Ts if velocity else 1.0) / self.size  # motion per sample and command
        self.base = unit * command[0][:, None] * (self.t if velocity else 1.0 + 0 * self.t)
        self.length = 1 << (2 * len(motion) - 1).bit_length()
        self.changes = np.fft.rfft(unit * np.diff(command, axis=0, prepend=command[:1]).T, self.length)
        self.line = np.linalg.qr(np.vander(np.linspace(-1, 1, len(motion)), 2))[0].T  # (2, N) orthonormal

    def response(self, kind, values, joint):
        """(..., N) motions, without the first command's, of drives (..., p): dead time, logarithms of numbers."""
        steps = step_response(kind, np.exp(values[..., None, 1:]), self.t - values[..., :1], self.velocity)
        return np.fft.irfft(self.changes[joint] * np.fft.rfft(steps, self.length), self.length)[..., : len(self.t)]

    def free(self, a):
        """Rows (..., N) without offset and drift."""
        return a - (a @ self.line.T) @ self.line

    def left(self, kind, values, joint):
        """((..., N) residuals, (...) gains) of drives (..., p) of joints (...)."""
        moved, wanted = self.free(self.response(kind, values, joint) + self.base[joint]), self.free(self.y[joint])
        gain = np.sum(moved * wanted, -1) / np.maximum(np.sum(moved**2, -1), 1e-300)
        return wanted - gain[..., None] * moved, gain

    def slopes(self, kind, values, joint):
        """((..., N) residuals, (..., N, p) their derivatives by the values)."""
        p, step = values.shape[-1], 1e-4
        left, _ = self.left(kind, values[..., None, :] + step * np.eye(p + 1, p, -1), joint[..., None])
        return left[..., 0, :], np.moveaxis((left[..., 1:, :] - left[..., :1, :]) / step, -2, -1)


def step_response(kind, numbers, t, velocity):
    """Return the motion (..., N) at times t [samples] after a unit step of the command at 0.

    Args: numbers: (..., 1, p) in samples. velocity: whether the command is one; then motion is per sample.
    """
    after = np.maximum(t, 0.0)
    if kind == "delay":  # a position drive without a lag moves on a line from sample to sample
        return after if velocity else np.minimum(after, 1.0)
    if kind == "lag":
        rest = -np.expm1(-after / numbers[..., 0])
        return after - numbers[..., 0] * rest if velocity else rest
    w, zeta, slope = numbers[..., 0], numbers[..., 1], 0.0
    if kind == "velocity PI":  # G = (slope s + w²)/((s − p)(s − p̄))
        slope, w = 1 / w, 1 / np.sqrt(w * zeta)
        zeta = slope / (2 * w)
    apart = zeta**2 - 1
    root = np.sqrt(np.where(np.abs(apart) < 1e-7, 1e-7, apart).astype(complex))
    total, ahead = 0.0, 0.0
    for sign in (1, -1):
        pole = -w * (zeta + sign * root)
        weight = (slope * pole + w**2) / (-2 * sign * w * root * pole)  # of the pole in G/s
        total = total + np.exp(pole * after) * weight / (pole if velocity else 1.0)
        ahead = ahead + weight / pole
    return after - ahead.real + total.real if velocity else np.where(t > 0, 1.0 + total.real, 0.0)


def _starts(log, kind):
    """(k, s, p) for each joint the best two points of a grid, each with its best whole dead time."""
    grid = {
        "delay": [()],
        "lag": [(tau,) for tau in TIMES],
        "second-order": [(2 * ratio / tau, ratio) for tau in TIMES for ratio in RATIOS],
        "velocity PI": [(tau, more * tau) for tau in TIMES for more in (2.5, 8.0)],
    }[kind]
    values, N = np.array([[0.0, *np.log(numbers)] for numbers in grid]), len(log.t)
    latest = min(MOST - 1, N // 2)
    moved = log.response(kind, values[:, None], np.arange(log.k))  # (grid, k, N)
    spectrum = np.conj(np.fft.rfft(moved, log.length))

    def across(row):  # with motions that are late by 0, 1, … samples
        return np.fft.irfft(np.fft.rfft(row, log.length) * spectrum, log.length)[..., : latest + 1]

    power = np.cumsum(moved**2, -1)[..., N - 1 - np.arange(latest + 1)] - sum(across(row) ** 2 for row in log.line)
    cost = -(across(log.free(log.y - log.base)) ** 2) / np.maximum(power, 1e-9 * N)
    order = np.argsort(np.min(cost, -1), axis=0)[:2]
    found = values[order]  # (1 or 2, k, p)
    found[..., 0] = np.take_along_axis(np.argmin(cost, -1), order, 0) + 0.2 * (kind != "delay")
    if kind == "delay":  # piecewise linear in the dead time: no slope at whole samples
        found = np.concatenate([np.abs(found - 0.4), found + 0.4])
    return np.moveaxis(found, 0, 1)


def _least(log, kind, starts, late=None) -> tuple:
    """(Values (k, p): dead time [samples], logarithms of numbers in samples; information criterion) of least squares.

    Args: starts: (k, s, p), of which the better one counts for each joint. late: the dead time, if that is fixed.
    """
    delay = (0.0, MOST - 1.0) if late is None else (late, late)
    low, high = np.array([delay, *(np.log(BOUNDS[name]) for name in NUMBERS[kind])]).T
    N = len(log.t)
    values = np.clip(starts, low, high)
    joint = np.broadcast_to(np.arange(log.k)[:, None], values.shape[:2])
    here, slope = log.slopes(kind, values, joint)
    power, damping = np.sum(here**2, -1), np.full(values.shape[:2], 1e-3)
    for _ in range(STEPS):
        slope = slope * (high > low)
        normal = np.einsum("...ni,...nj->...ij", slope, slope)
        scale = damping[..., None] * (np.einsum("...ii->...i", normal) + 1e-12)
        downhill = np.einsum("...ni,...n->...i", slope, here)
        step = np.linalg.solve(normal + scale[..., None] * np.eye(len(low)), downhill[..., None])[..., 0]
        tried = np.clip(values - np.clip(step, -1.5, 1.5), low, high)
        there, slopes = log.slopes(kind, tried, joint)
        better = np.sum(there**2, -1) < power
        ends = np.all(better | (damping > 1e3)) and np.all((np.abs(tried - values) < 1e-4) | ~better[..., None])
        values, here = np.where(better[..., None], tried, values), np.where(better[..., None], there, here)
        slope, power = np.where(better[..., None, None], slopes, slope), np.sum(here**2, -1)
        damping = np.clip(np.where(better, damping / 5, damping * 10), 1e-7, 1e5)
        if ends:
            break
    each = np.arange(log.k), np.argmin(power, 1)
    score = N * np.sum(np.log(power[each] / N + EXACT**2)) + log.k * len(low) * np.log(N)
    return values[each], float(score)


def _fitted(log, kind, fitted) -> DriveFit:
    """The fit of all joints as one drive, its interval, its gain."""
    names, every = NUMBERS[kind], np.arange(log.k)
    values, covs = _together(log, kind, fitted)
    each = np.broadcast_to(values, fitted.shape)
    left, gain = log.left(kind, each, every)
    explained = 1.0 - np.mean(left**2, -1)  # of each motion's variance; a joint may also move as others shake it
    if explained[worst := int(np.argmin(explained))] < EXPLAINED:
        found = f"only {100 * max(explained[worst], 0):.0f} % of column {worst + 1} are"
        raise errors.fail("motion", "be what the command leads to", found)
    if len(odd := np.flatnonzero((gain < 1 / OTHER_UNIT) | (gain > OTHER_UNIT))):
        found = f"moves by {gain[odd[0]]:.3g} times it in column {odd[0] + 1}: a sign, other units, or velocities"
        raise errors.fail("motion", "move by about what is commanded", found)
    alpha, notes = _recommended(log, kind, values, covs, gain)
    wide = NORMAL * np.minimum(np.sqrt(np.diagonal(covs, axis1=1, axis2=2)), WIDE)
    interval = {"delay": tuple(float(max(values[0, 0] + s * wide[0, 0], 0.0)) for s in (-1, 1))}
    for i, name in enumerate(names, 1):
        ends = [np.exp(values[:, i] + s * wide[:, i]) * log.Ts ** SCALES[name] for s in (-1, 1)]
        interval[name] = tuple(end if len(values) > 1 else float(end[0]) for end in ends)
    if (integral := interval.pop("integral", None)) is not None:
        said = f"Its velocity servo has an integral part ({_said(np.mean(integral))} s), which the drive leaves out"
        notes.append(f"{said}: gains for its lag alone are low enough.")
    if np.any(np.abs(gain - 1) > OFF):
        said = _said(gain).replace(" ", ", ")
        notes.append(f"Motion is {said} times what is commanded: the recommended alpha is divided by the largest.")
        notes += [NOT_REBASED] * (not log.velocity)
    moved = gain[:, None] * (log.response(kind, each, every) + log.base)
    return DriveFit(
        drive=_drive(log, kind, values),
        Ts=log.Ts,
        interval=interval,
        gain=gain,
        drift=np.polyfit(log.t * log.Ts, (log.y - moved).T, 1)[0] * log.size[:, 0],
        rms=np.sqrt(np.mean(left**2, -1)) * log.size[:, 0],
        explained=float(explained.mean()),
        recommended_alpha=alpha,
        motion=log.motion - (left * log.size).T,
        note=" ".join(notes),
    )


def _together(log, kind, fitted) -> tuple:
    """(values (1, p) that all joints share, or of each (k, p), with one dead time; their covariances)."""
    left, slope = log.slopes(kind, fitted, np.arange(log.k))
    power = (np.sum(left**2, -1) / max(len(log.t) - slope.shape[-1] - 3, 1) + 1e-12) * [correlated(row) for row in left]
    information = np.einsum("kni,knj->kij", slope, slope) / power[:, None, None]
    shared, each = np.linalg.pinv(information.sum(0)), np.linalg.pinv(information)
    mean = shared @ np.einsum("kij,kj->i", information, fitted)
    apart = np.einsum("ki,kij,kj->", fitted - mean, information, fitted - mean)
    free = (log.k - 1) * len(mean)
    if len(mean) == 1 or free == 0 or apart <= free + APART * np.sqrt(2 * free):  # of χ², which is nearly normal
        return mean[None], shared[None]
    late = np.average(fitted[:, 0], weights=1 / each[:, 0, 0])
    each[:, 0, 0] = 1 / np.sum(1 / each[:, 0, 0])
    return _least(log, kind, fitted[:, None], late)[0], each


def correlated(left) -> float:
    """The correlation length of a residual (N,) [samples], 1 for white noise, by which it counts as fewer rows."""
    left = left - left.mean()
    N, power = len(left), float(left @ left) or 1.0
    share = np.fft.irfft(np.abs(np.fft.rfft(left, 2 * N)) ** 2, 2 * N)[: N // 2] / power
    last = int(np.argmax(share < 2 / np.sqrt(N))) or len(share)
    return float(max(1.0, 1.0 + 2.0 * np.sum(share[1:last])))


def _drive(log, kind, values) -> Drive:
    """The `Drive` of values (1, p), or (k, p) of joints that differ."""
    names = [name for name in NUMBERS[kind] if name != "integral"]
    numbers = {name: np.exp(values[:, i]) * log.Ts ** SCALES[name] for i, name in enumerate(names, 1)}
    shared: dict = {name: float(v[0]) if len(v) == 1 else v for name, v in numbers.items()}
    delay = float(np.clip(values[0, 0], 0, MOST - 1))
    return Drive(command="velocity" if log.velocity else "position", delay=delay, **shared)


def _recommended(log, kind, values, covs, gain) -> tuple:
    """(gain [1/s] over the interval, or None; [why there is none]) of values (k, p) and their covariances (k, p, p)."""
    for i, name in enumerate(NUMBERS[kind], 1):
        slow = np.log(BOUNDS[name][SCALES[name] > 0])  # the end at which a drive is slow, or swings
        if name != "integral" and np.any(np.abs(values[:, i] - slow) < OFF):
            said = name.replace("_", " ")
            return None, [f"No gain: the {said} is at the end of what is tried. Record a longer step."]
    drive = _drive(log, kind, values)
    rows = len(log.t) - np.argmax(np.any(log.command != log.command[0], axis=1))
    slow = drive.lag if drive.order < 2 else 2 * np.maximum(np.pi, drive.damping_ratio) / drive.natural_frequency
    if rows * log.Ts < np.max(slow):
        return None, ["No gain: the log is shorter than the drive's own period. Record until it rests."]

    def alpha(shape) -> float:
        return max(gains(Ts=log.Ts, drive=_drive(log, kind, shape), method="EE").recommended, 1e-9)

    best, j = alpha(values), int(np.argmax(slow)) if np.ndim(slow) else 0  # the slowest joint decides
    one = values[j : j + 1]
    slowest = alpha(one) if len(values) > 1 else best
    slope = np.log([alpha(one + STEP * way) / slowest for way in np.eye(one.size)]) / STEP
    spread = np.sqrt(max(slope @ covs[j] @ slope, 0.0))
    if best < 1e-6 or spread > OPEN:
        return None, ["No gain: gains for the drives that explain the log differ too much. Record a larger step."]
    return float(best * np.exp(-NORMAL * spread) / np.max(gain)), []
