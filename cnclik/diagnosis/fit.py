"""Fit: the drive between recorded commands and the recorded motion, by least squares over its exact samples.

A row of a recording is a sample: motion that is measured at t[k], and the command that is sent then. Before the first
row the first command holds.
"""

import itertools

import numpy as np

from cnclik import errors
from cnclik.diagnosis.judge import LEAST
from cnclik.integrate.drive import COMMANDS, MOST, Drive, sampled
from cnclik.record import record, replace

KINDS = ("delay", "lag", "second-order")  # by their order
DELAYS = 200  # samples of dead time that are looked at, at most
MOVED = 0.2  # share of the range by which something has clearly moved
TIMES = np.geomspace(0.2, 200, 16)  # of lag, or 1/ω₀, in samples, that are looked at
RATIOS = (0.1, 0.3, 0.7, 1.0, 2.0, 4.0)  # ζ
BETTER = 10.0  # by which another number must lower the information criterion
EXPLAINED = 0.5  # share of a motion below which a command has nothing to do with it
EXACT = 1e-5  # share of a motion that is rounding
EVALUATIONS = 200  # of a fit from one start
LARGEST = 1e30  # value of a recording: squares of far larger ones are no numbers


@record
class DriveFit:
    """A drive that was fitted to a recording.

    Attributes:
      drive: a `Drive`; its numbers are of all joints, or of each where they differ by more than their uncertainty.
      uncertainty: {name: standard deviation} of its numbers; of a joint alike the largest.
      rms: (k,) what the fit leaves of each motion [rad, m]. explained: share of the motions' variance.
      motion: (N, k) of the fit.
    """

    drive: Drive
    uncertainty: object
    rms: object
    explained: float
    motion: object

    @property
    def options(self) -> str:
        """As `cnclik stability` and `tune` take it."""
        drive = self.drive
        numbers = {"delay": drive.delay}
        if drive.order == 1:
            numbers["lag"] = drive.lag
        elif drive.order == 2:
            numbers |= {"natural-frequency": drive.natural_frequency, "damping-ratio": drive.damping_ratio}
        said = [f"--{name} " + " ".join(f"{v:.4g}" for v in np.ravel(value)) for name, value in numbers.items()]
        return " ".join([*said, f"--command {drive.command}"])

    def __str__(self):
        units = {"delay": " samples", "lag": " s", "natural_frequency": " rad/s", "damping_ratio": ""}
        said = []
        for name, deviation in self.uncertainty.items():
            value = ", ".join(f"{v:.4g}" for v in np.ravel(getattr(self.drive, name)))
            said.append(f"{name.replace('_', ' ')} {value} ± {deviation:.1g}{units[name]}")
        left = f"{np.max(self.rms):.3g} rms left of the motion, {100 * self.explained:.4g} % explained"
        return f"{KINDS[self.drive.order]}: {', '.join(said)}; {left}."


def fit_drive(t, command, motion, Ts=None, *, kind=None, command_kind="position") -> DriveFit:
    """The drive behind recorded commands and motion, as of a step: dead time, and a lag or a second-order servo.

    Each order is fitted by least squares with the exactly sampled drive; the lowest is taken that none beats by much
    in an information criterion (Schwarz 1978). The first command is taken to have held for long.

    Args:
      t: (N,) times [s], or None with a Ts. command, motion: (N,) or (N, k), a column per joint: what was sent at t,
        joint values or velocities, and the joint values that were measured then [rad, m].
      Ts: sampling time [s]; of t by default. kind: "delay", "lag" or "second-order"; None: what the recording bears.
      command_kind: "position" or "velocity".
    Raises: ArgumentError for a recording without motion, or with one that the command doesn't explain.
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
    if t is not None and len(t) != len(command):
        raise errors.fail("t", f"have the commands' {len(command)} rows", f"has {len(t)}")
    start = Drive(command=command_kind)
    found = [_fit_order(start, order, command, motion, Ts) for order in orders]
    best = found[0]
    for other in found[1:]:
        if other[0] < best[0] - BETTER:
            best = other
    _, shape, values, deviations = best
    made = _motion(shape, values, command, motion, Ts)
    left = motion - made
    explained = 1.0 - float(np.sum(left**2 / np.var(motion, axis=0)) / motion.size)
    if explained < EXPLAINED:
        raise errors.fail("motion", "be what the command leads to", f"only {100 * max(explained, 0):.0f} % of it are")
    names = ("delay", *_names(shape.order))
    return DriveFit(
        drive=_joined([shape.at(values, j) for j in range(shape.joints)]),
        uncertainty={
            n: float(max(deviations[shape.place(i, j)] for j in range(shape.joints))) for i, n in enumerate(names)
        },
        rms=np.sqrt(np.mean(left**2, axis=0)),
        explained=explained,
        motion=made,
    )


def sampling_time(t, Ts) -> float:
    """Ts [s] of times (N,), which are one every Ts. Raises: ArgumentError where they aren't, or none is given."""
    if t is None:
        return float(errors.number("Ts", Ts, positive=True))
    t = np.asarray(errors.array("t", t, (None,), most=LARGEST), float)
    step = np.diff(t)
    usual = float(np.median(step)) if len(step) else 0.0
    if usual <= 0:
        raise errors.fail("t", "increase", f"has a median step of {usual:g} s")
    if Ts is None:
        Ts = float(t[-1] - t[0]) / len(step)
        if abs(usual / Ts - 1) > 0.02:
            found = f"are {usual:.6g} s apart in the median and {Ts:.6g} s in the mean (digits are missing, or rows)"
            raise errors.fail("t", "be times that are equally far apart", found)
    Ts = float(errors.number("Ts", Ts, positive=True))
    if abs(usual / Ts - 1) > 0.02:
        raise errors.fail("Ts", f"be that of the recording, {usual:.6g} s", f"is {Ts:g}")
    off = np.abs(step - Ts) > 0.5 * Ts
    if off.any():
        k = int(np.argmax(off))
        raise errors.fail("t", f"have a row every {Ts:g} s", f"row {k + 2} comes {step[k]:.4g} s after the one before")
    return Ts


def columns(name, values):
    """A recording (N,) or (N, k) as columns (N, k). Raises: ArgumentError for values not finite or beyond LARGEST."""
    values = np.asarray(errors.array(name, values, (None,), (None, None), most=LARGEST), float)
    return values[:, None] if values.ndim == 1 else values


# --- one order ----------------------------------------------------------------------------------------


def _names(order):
    return ((), ("lag",), ("natural_frequency", "damping_ratio"))[order]


_BOUNDS = {"lag": (1e-2, 1e4), "natural_frequency": (1e-4, 10.0), "damping_ratio": (1e-2, 30.0)}  # in samples
_POWER = {"lag": 1, "natural_frequency": -1, "damping_ratio": 0}


@record
class _Shape:
    """Which numbers a drive has: dead time, then logarithms of the others, of all joints or of each in turn."""

    start: Drive
    Ts: float
    order: int
    joints: int
    own: bool  # whether joints have their own

    def place(self, number, joint):
        """Where among all values a number of a joint stands."""
        return number + self.order * joint * self.own if number else 0

    def at(self, values, joint) -> Drive:
        """The drive of one joint."""
        rest = {}
        for i, name in enumerate(_names(self.order), 1):
            low, high = (bound * self.Ts ** _POWER[name] for bound in _BOUNDS[name])
            rest[name] = float(np.clip(np.exp(values[self.place(i, joint)]), low, high))
        return replace(self.start, delay=min(abs(float(values[0])), MOST), **rest)


def _motion(shape, values, command, motion, Ts):
    """(N, k) of the fit, from where each motion is on average."""
    made = np.stack([response(shape.at(values, j), c, Ts) for j, c in enumerate(command.T)], 1)
    return made + np.mean(motion - made, axis=0)


def response(drive: Drive, command, Ts):
    """(N,) motion of a drive after commands (N,) that go on from rest at the first; of a velocity from 0 on."""
    model, N, begin = sampled(drive, Ts), len(command), command[0]
    u = command - begin  # what the first command does is added below
    if drive.command == "position" and not drive.steps_positions:
        u = np.diff(u, prepend=0.0) / Ts
    phi = model.phi.reshape(model.size, -1)
    rows = np.eye(1, model.size)  # x₀ of Φ^k x, for k = 0, 1, ...
    while len(rows) < N:
        rows, phi = np.concatenate([rows, rows @ phi]), phi @ phi
    impulse = np.zeros(N + model.whole + 2)
    impulse[model.whole + 1 : -1] += rows[:N] @ model.now.reshape(-1)
    if model.late is not None:
        impulse[model.whole + 2 :] += rows[:N] @ model.late.reshape(-1)
    made = _convolved(u, impulse[:N])
    return made + begin if drive.command == "position" else made + begin * Ts * np.arange(N)


def _convolved(u, impulse):
    """The first N of a convolution of two rows (N,)."""
    N = len(u)
    if N < 1000:
        return np.convolve(u, impulse)[:N]
    return np.fft.irfft(np.fft.rfft(u, 2 * N) * np.fft.rfft(impulse, 2 * N), 2 * N)[:N]


def _fit_order(start, order, command, motion, Ts):
    """(criterion, shape, values, their standard deviations) of the best drive of an order."""
    k = motion.shape[1]
    size = np.std(motion, axis=0)
    together = _Shape(start=start, Ts=Ts, order=order, joints=k, own=False)
    values = _least(together, _begin(together, command, motion, Ts), command, motion, Ts, size)
    found = _scored(together, values, command, motion, Ts, size)
    if k == 1 or order == 0:
        return found
    own = _Shape(start=start, Ts=Ts, order=order, joints=k, own=True)
    one = _Shape(start=start, Ts=Ts, order=order, joints=1, own=False)
    each = []
    for j in range(k):
        sent, moved = command[:, [j]], motion[:, [j]]
        each.append(_least(one, _begin(one, sent, moved, Ts), sent, moved, Ts, size[[j]]))
    begin = np.concatenate([[np.median([v[0] for v in each])], *[v[1:] for v in each]])
    values = _least(own, [begin], command, motion, Ts, size)
    other = _scored(own, values, command, motion, Ts, size)
    return other if other[0] < found[0] - BETTER else found


def _begin(shape, command, motion, Ts, most=2):
    """The best few of a grid of dead times and of the other numbers: values to begin from."""
    grid = [()] if shape.order == 0 else [(tau,) for tau in np.log(TIMES * Ts)]
    if shape.order == 2:
        grid = [(-tau, np.log(zeta)) for (tau,), zeta in itertools.product(grid, RATIOS)]
    delays = range(min(_latest(command, motion), len(motion) // 2, DELAYS) + 1)
    size, tried = np.std(motion, axis=0), []
    wanted = motion - motion.mean(0)
    for numbers in grid:
        values = np.array([0.0, *numbers])
        made = np.stack([response(shape.at(values, j), c, Ts) for j, c in enumerate(command.T)], 1)
        slope = (command[0] if shape.start.command == "velocity" else 0.0 * command[0]) * Ts
        for delay in delays:
            before = made[0] - slope * np.arange(delay, 0, -1)[:, None]
            late = np.concatenate([before, made[: len(made) - delay]])
            left = wanted - (late - late.mean(0))
            tried.append((float(np.sum((left / size) ** 2)), delay, numbers))
    tried.sort(key=lambda one: one[0])
    begun, chosen = set(), []
    for _, delay, numbers in tried:  # the best dead time of each of the other numbers
        if numbers not in begun and len(chosen) < most:
            begun.add(numbers)
            chosen.append(np.array([delay + 0.3 * (shape.order > 0), *numbers]))
    return chosen


def _latest(command, motion) -> int:
    """The most samples of dead time: from the first change of a command until something has clearly moved."""
    sent = np.argmax(np.any(command != command[0], axis=1))
    moved = np.argmax(np.any(np.abs(motion - motion[0]) > MOVED * np.ptp(motion, axis=0), axis=1))
    return max(int(moved - sent), 0)


def _least(shape, starts, command, motion, Ts, size):
    """Values of least squares, from several starts; dead time is the size of the first."""
    from scipy.optimize import least_squares

    def left(values):
        return ((motion - _motion(shape, values, command, motion, Ts)) / size).ravel()

    if shape.order == 0:  # between whole samples the motion is a straight line of the dead time: no slope to follow
        sides = sorted({max(values[0] + side, 0.0) for values in starts for side in (-0.5, 0.5)})
        starts = [np.array([side]) for side in sides]
    made = [
        least_squares(left, values, method="lm", x_scale=0.1, xtol=1e-9, ftol=1e-11, max_nfev=EVALUATIONS)
        for values in starts
    ]
    best = min(made, key=lambda one: one.cost).x
    return np.concatenate([np.abs(best[:1]), best[1:]])


def _scored(shape, values, command, motion, Ts, size):
    """(criterion, shape, values, their standard deviations)."""
    N, k = motion.shape

    def left(values):
        return (motion - _motion(shape, values, command, motion, Ts)) / size

    here = left(values)
    power = np.mean(here**2, axis=0) + EXACT**2
    score = N * float(np.sum(np.log(power))) + (len(values) + k) * np.log(N)
    steps = 1e-4 * np.eye(len(values))
    slope = np.stack([((left(values + s) - here) / (1e-4 * np.sqrt(power))).ravel() for s in steps], 1)
    deviations = np.sqrt(np.diag(np.linalg.pinv(slope.T @ slope)))
    scale = np.ones(len(values))
    scale[1:] = np.exp(values[1:])  # of a logarithm the relative deviation
    return score, shape, values, deviations * scale


def _joined(drives) -> Drive:
    """One drive for all joints."""
    first = drives[0]
    changes = {}
    for name in _names(first.order):
        values = np.array([float(getattr(d, name)) for d in drives])
        changes[name] = float(values[0]) if np.all(values == values[0]) else values
    return replace(first, **changes)
