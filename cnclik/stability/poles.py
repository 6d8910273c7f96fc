"""Poles: the loop of one scalar error through a drive, closed by a step that removes a share s of it. NumPy only.

With one drive for all joints, every loop q̇ = J#(ẋ_d + K e) with its stack, dampings, weights, posture term, active
limits and walls is a set of such loops side by side, with shares s = 1 − R(μ α Ts), 0 ≤ μ ≤ 1 (docs/theory.md has the
proof). The loop gain is linear in s: all poles ζ solve 1 + s ℓ(ζ) = 0.

  velocity commands    ℓ = G F/Ts          positions             ℓ = G F/(1 − ζ⁻¹)
  own commands         ℓ = F/(ζ − 1)       rebased positions     ℓ = G F/(1 − G)

G is the sampled drive with its dead time, F = (1 − ρ)/(1 − ρ ζ⁻¹) a filter of the error or the command.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from cnclik.integrate.drive import Drive, Sampled, sampled

SETTLED = 1e-3  # share of a step, squared, down to which a response is continued
LONGEST, FAR = 1_000_000, 1e12  # samples of a response; what is larger counts as infinite
FINE = 2048  # frequencies at which a loop gain is evaluated
PARTS, ROUNDS = 16, 13  # of a search: as fine as rounding


@dataclasses.dataclass(frozen=True, eq=False)
class ScalarLoop:
    """x[k+1] = (A − s b C) x[k]: an open loop, closed by a step that removes a share s of y = C x.

    The states are the drive's, commands under way, their sum, and a filtered signal.
    """

    drive: Drive  # one for all joints, its delays lumped
    Ts: float
    model: Sampled
    A: np.ndarray  # (S, S), without a step
    b: np.ndarray  # (S,), of a step
    C: np.ndarray  # (S,), the error that the controller uses
    q: np.ndarray  # (S,), the motion
    noise: float  # what noise of one measurement adds to y
    disturbed: np.ndarray  # (S,), and to the states
    displaced: np.ndarray  # (S,), the states at rest at 1, when the target has just been moved to 0

    def matrix(self, s):
        """Return the closed loop (..., S, S) of shares s (...)."""
        return self.A - np.asarray(s)[..., None, None] * np.outer(self.b, self.C)

    def poles(self, s):
        """Return all poles (..., S) in the z-plane."""
        return np.linalg.eigvals(self.matrix(s))

    def radius(self, s):
        """Return the spectral radius (...)."""
        return np.abs(self.poles(s)).max(-1)

    def response(self, s, row, start, N: int):
        """Return a row (S,) of the states, such as `q`, at samples 0 … N, from states (S, r): (N + 1, r)."""
        power, rows = self.matrix(s), row[None]
        with np.errstate(all="ignore"):  # what grows ends as inf
            while len(rows) ** 2 <= N:
                rows, power = np.concatenate([rows, rows @ power]), power @ power
            values = [rows @ start]
            for _ in range(N // len(rows)):
                values.append(rows @ (start := power @ start))
        values = np.concatenate(values)[: N + 1]
        return np.where(np.abs(values) < FAR, values, np.inf)

    # --- in the frequency domain ------------------------------------------------------------------------

    def loop_gain(self, zeta, s):
        """Return L(ζ) at points ζ (...) of the z-plane, opened at the drive's input: 1 + L(ζ) = 0 at all poles."""
        zeta = np.asarray(zeta, complex)
        motion, drive = self._transfer(zeta), self.drive
        if drive.filters in ("error", "command"):
            kept = drive.kept(self.Ts)
            average = (1 - kept) / (1 - kept / zeta)
        else:
            average = 1.0
        if drive.feedback == "rebased":
            through = motion * (average if drive.filters == "command" else 1.0)
            return (s * (average if drive.filters == "error" else 1.0) - 1.0) * through
        return s * average * (motion / (1 - 1 / zeta) if drive.steps_positions else motion / self.Ts)

    def unit_gain(self, zeta):
        """Return ℓ(ζ) with 1 + s ℓ(ζ) = 0 at all poles."""
        none, unit = self.loop_gain(zeta, np.reshape([0.0, 1.0], (2, *[1] * np.ndim(zeta))))
        return (unit - none) / (1.0 + none)

    def _transfer(self, zeta):
        """G(ζ) from command to motion."""
        model, force = self.model, self.model.now * zeta[..., None] ** -self.model.whole
        if model.late is not None:
            force = force + model.late * zeta[..., None] ** -(model.whole + 1)
        resolvent = zeta[..., None, None] * np.eye(model.size) - model.phi
        try:
            return np.linalg.solve(resolvent, force[..., None])[..., 0, 0]
        except np.linalg.LinAlgError:  # a point is a pole of the drive, to the last digit
            return self._transfer(zeta * (1 + 1e-12))

    def delay_margin(self, s) -> float:
        """Return the dead time [s] that may be added: the least phase margin over its frequency; inf if |L| < 1."""
        at = crossings(lambda w: np.abs(self.loop_gain(np.exp(1j * w), s)) - 1.0, frequencies())
        margins = np.angle(-self.loop_gain(np.exp(1j * at), s)) % (2 * np.pi) / at
        return float(margins.min(initial=np.inf)) * self.Ts


def scalar_loop(drive: Drive, Ts: float) -> ScalarLoop:
    """Return the open loop of a drive with one number for each quantity.

    Every signal is a row over the states, the noise of one measurement, and the step.
    """
    drive = drive.lumped
    model, kept = sampled(drive, Ts), drive.kept(Ts)
    filters = drive.filters if drive.filters != "target" else ""
    size, under_way, sums = model.size, model.remembered, int(drive.adds_up)
    sizes = size, under_way, sums, int(bool(filters))
    *states, noise, step = np.eye(sum(sizes) + 2)
    x, line, total, mean = np.split(np.array(states), np.cumsum(sizes)[:-1])
    seen = total[0] if drive.feedback == "commanded" else x[0] + noise
    used = seen
    if filters == "error":
        used = mean = kept * mean[0] + (1 - kept) * seen
    sent = (seen if drive.feedback == "rebased" else total.sum(0)) + step
    command = sent if drive.steps_positions else step / Ts
    if filters == "command":
        command = mean = kept * mean[0] + (1 - kept) * command
    line = np.vstack([command, line])
    moved = model.phi @ x + np.outer(model.now, line[model.whole])
    if model.late is not None:
        moved = moved + np.outer(model.late, line[model.whole + 1])
    rows = np.vstack([moved, line[:under_way], *[sent] * sums, *[mean] * bool(filters)])
    held = float(drive.steps_positions)  # the command of a drive that rests at 1
    displaced = np.repeat([1.0, 0.0, held, 1.0, held * (filters == "command")], [1, size - 1, *sizes[1:]])
    used, rows, step = np.atleast_1d(np.squeeze(used)), rows, rows[:, -1]
    return ScalarLoop(
        drive=drive, Ts=Ts, model=model, A=rows[:, :-2], b=step, C=used[:-2], q=x[0][:-2],
        noise=float(used[-2]), disturbed=rows[:, -2], displaced=displaced,
    )  # fmt: skip


def within(drive: Drive) -> Drive:
    """Return the drive as the loop sees it: a loop on its own commands sees a filter of the error only."""
    if drive.feedback != "commanded":
        return drive
    return Drive(smoothing=drive.smoothing, cutoff=drive.cutoff) if drive.filters == "error" else Drive()


def frequencies():
    """Return ω·Ts of a loop gain, up to the Nyquist frequency: even, and geometric towards 0."""
    return np.unique(np.concatenate([np.geomspace(1e-6, np.pi, FINE // 2), np.linspace(1e-3, np.pi, FINE // 2)]))


def crossings(of, at):
    """Return where a real function changes sign between points `at`. of: maps arrays to arrays."""
    values = of(at)
    i = np.flatnonzero(values[:-1] * values[1:] < 0)
    low, high, below = at[i], at[i + 1], values[i] < 0
    for _ in range(ROUNDS):
        points = low + (high - low) * np.linspace(0.0, 1.0, PARTS + 1)[:, None]
        crossed = (of(points[1:]) < 0) != below
        crossed[-1] = True
        first = np.argmax(crossed, axis=0)
        low, high = (np.take_along_axis(points, (first + k)[None], 0)[0] for k in (0, 1))
    return 0.5 * (low + high)
