"""Response: the motion of a drive after recorded commands, and the drives that a fit tries."""

import numpy as np

from cnclik.integrate.drive import MOST, Drive, sampled
from cnclik.record import record, replace

NUMBERS = ((), ("lag",), ("natural_frequency", "damping_ratio"))  # besides the dead time, by order
_BOUNDS = {"lag": (1e-2, 1e4), "natural_frequency": (1e-4, 10.0), "damping_ratio": (1e-2, 30.0)}  # in samples
_POWER = {"lag": 1, "natural_frequency": -1, "damping_ratio": 0}


@record
class Shape:
    """Which numbers a drive has: dead time [samples], then logarithms of the others."""

    start: Drive
    Ts: float
    order: int

    def numbers(self, values) -> dict:
        """A row of values by name, clipped to the bounds."""
        made = {"delay": float(min(abs(values[0]), MOST))}
        for name, value in zip(NUMBERS[self.order], values[1:], strict=True):
            low, high = (np.log(bound) + _POWER[name] * np.log(self.Ts) for bound in _BOUNDS[name])
            made[name] = float(np.exp(np.clip(value, low, high)))
        return made

    def drive(self, values) -> Drive:
        return replace(self.start, **self.numbers(values))


def response(drive: Drive, command, Ts):
    """(N, k) motions of a drive after commands (N, k), from rest at the first command; for velocities from 0."""
    model, N, begin = sampled(drive, Ts), len(command), command[0]
    u = command - begin  # the effect of the first command is added below
    if drive.command == "position" and not drive.steps_positions:
        u = np.diff(u, axis=0, prepend=0.0 * u[:1]) / Ts
    phi = model.phi.reshape(model.size, -1)
    rows = np.eye(1, model.size)  # x₀ of Φ^k x, for k = 0, 1, ...
    while len(rows) < N:
        rows, phi = np.concatenate([rows, rows @ phi]), phi @ phi
    impulse = np.zeros(N + model.whole + 2)
    impulse[model.whole + 1 : -1] += rows[:N] @ model.now.reshape(-1)
    if model.late is not None:
        impulse[model.whole + 2 :] += rows[:N] @ model.late.reshape(-1)
    made = _convolved(u, impulse[:N])
    return made + begin if drive.command == "position" else made + begin * Ts * np.arange(N)[:, None]


def _convolved(u, impulse):
    """The first N rows of a convolution of columns (N, k) with a row (N,)."""
    N = len(u)
    if N < 200:
        return np.stack([np.convolve(c, impulse)[:N] for c in u.T], 1)
    size = 1 << (2 * N - 1).bit_length()
    return np.fft.irfft(np.fft.rfft(u, size, axis=0) * np.fft.rfft(impulse, size)[:, None], size, axis=0)[:N]
