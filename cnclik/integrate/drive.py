"""Drive: what lies between a joint's command and its motion, and which joint values the controller uses. NumPy only.

The sampled model is exact for a constant command; `cnclik.stability` and the loop of `solve` use the same matrices.
"""

from __future__ import annotations

import math
from typing import Self

import numpy as np

from cnclik import errors, quantities
from cnclik.record import AnyArray, ArrayLike, Float, Number, is_literal, leaf, record, replace, xp_for

COMMANDS = ("velocity", "position")
FEEDBACKS = ("measured", "commanded", "rebased")
SMOOTHED = ("error", "command", "target")
MOST = 101  # samples of dead time and measurement delay together: the size of the gains' matrices
LARGEST = 1e12  # a quantity of a drive, or its inverse, at most: products of larger ones overflow
TERMS = 15  # terms of the exponential's series: 0.5^16/16! is below rounding
FASTEST = 5e4  # rates of a drive times Ts, at most: faster drives are at rest within a sample anyway
_QUANTITIES = ("lag", "natural_frequency", "damping_ratio")  # shared by all joints or one per joint


@record
class Drive:
    """Model of a robot's drives. The default is ideal: the motion equals the command and is known immediately.

    A velocity command is constant for a sample and followed by G(s) q̇_c; a position command steps from sample to
    sample and is followed by G(s) q_c. G(s) = 1, 1/(lag s + 1), or ω₀²/(s² + 2ζω₀ s + ω₀²). A servo with gains k_p and
    k_v on an inertia m has ω₀² = k_p/m and 2ζω₀ = k_v/m; a velocity servo with gain k_v on m has the lag m/k_v.

    A low-pass filter, y[k] = ρ y[k−1] + (1 − ρ) u[k], may smooth one signal of the loop. On the error or the command it
    lowers the gains; on the target it delays the motion by Ts ρ/(1 − ρ).

    Attributes:
      delay: dead time between command and motion [samples], at least 0, also fractions. On the command line a time has
        its unit, as in 34ms; in Python it is a known number, never traced.
      measurement_delay: delay of the measurement [whole samples], at least 0. Measurements are time-stamped: the error
        fed back is that at the time of the measurement. For stability both delays add up.
      lag: time constant of a first-order drive [s], one number or one per joint; 0 for none (positions: not of some).
      natural_frequency: natural frequency ω₀ of a second-order drive [rad/s], positive, in place of a lag. It is
        √(k_p/m) of a position servo. One number or one per joint.
      damping_ratio: damping ratio ζ of a second-order drive, positive; k_v/(2 m ω₀) of a position servo. Default: 1.
      command: what the drives take: velocity, or position, where the controller sums up its steps and sends joint
        values. Without lag both are the same. Default: velocity.
      feedback: joint values that the controller uses. measured: the robot's own; commanded: its own commands, so that
        drive, dead time and measurement delay do not enter the loop; rebased: measured, and each position command
        starts from them instead of the last command; there a late measurement is a delay. Default: measured.
      smoothing: low-pass filter: the share ρ of the old value that a moving average keeps, at least 0 and below 1.
      cutoff: cut-off frequency f of the low-pass filter [Hz], positive, in place of ρ = exp(−2π f Ts).
      smoothed: signal that the filter smooths: error, command or target. Default: error.

    Raises: ArgumentError for values that do not fit.
    """

    delay: float = 0.0
    measurement_delay: int = 0
    lag: ArrayLike = 0.0
    natural_frequency: ArrayLike | None = None
    damping_ratio: ArrayLike = 1.0
    command: str = "velocity"
    feedback: str = "measured"
    smoothing: Number = 0.0
    cutoff: Number | None = None
    smoothed: str = "error"

    def __post_init__(self):
        if not errors.concrete(self.delay):
            raise errors.fail("delay", "be a known number of samples", "is traced: there is a program for each")
        delay = float(errors.number("delay", self.delay, at_least=0))
        late = delay + errors.integer("measurement_delay", self.measurement_delay, at_least=0, at_most=errors.MOST)
        if late > MOST:
            raise errors.fail("delay", f"be at most {MOST} samples, that of a measurement included", f"is {late:g}")
        for name, words in (("command", COMMANDS), ("feedback", FEEDBACKS), ("smoothed", SMOOTHED)):
            errors.one_of(name, getattr(self, name), words)
        lag, servo, checked = not _none(self.lag), self.natural_frequency is not None, {"delay": delay}
        if lag and servo:
            raise errors.fail("natural_frequency", "be left out where there is a lag: use one of both", "is given")
        if not servo and not (is_literal(self.damping_ratio) and self.damping_ratio == 1):
            raise errors.fail("damping_ratio", "come with a natural_frequency", "comes without")
        if self.feedback == "rebased" and (self.measurement_delay or not self.steps_positions):
            must = "come with command position and a lag or servo, its dead time as delay alone, where it is rebased"
            found = f"command {self.command}, order {self.order}, measurement_delay {self.measurement_delay}"
            raise errors.fail("feedback", must, f"comes with {found}")
        for name in ["lag"] * lag + ["natural_frequency", "damping_ratio"] * servo:  # of positions no lag is 0
            may = {"at_least": 0} if lag and self.command == "velocity" else {"positive": True, "at_least": 1 / LARGEST}
            alike = [shape] if (shape := np.shape(checked.get("natural_frequency"))) else [(None,), (None, 1)]
            checked[name] = errors.array(name, getattr(self, name), (), *alike, **may, most=LARGEST)
        if not _none(self.smoothing):
            if self.cutoff is not None:
                raise errors.fail("cutoff", "be left out where there is a smoothing: use one of both", "is given")
            checked["smoothing"] = leaf(errors.number("smoothing", self.smoothing, at_least=0))
            if errors.concrete(self.smoothing) and not self.smoothing < 1:
                must = "be below 1, the share of the old value that is kept (a cut-off in Hz is `cutoff`)"
                raise errors.fail("smoothing", must, f"is {self.smoothing:g}")
        elif self.cutoff is not None:
            checked["cutoff"] = leaf(errors.number("cutoff", self.cutoff, positive=True))
        vars(self).update(checked)

    @property
    def order(self) -> int:
        """Order of G(s)."""
        return 2 if self.natural_frequency is not None else 0 if _none(self.lag) else 1

    @property
    def filters(self) -> str:
        """What the filter smooths: "error", "command" or "target"; "" without a filter."""
        return "" if self.cutoff is None and _none(self.smoothing) else self.smoothed

    def kept(self, Ts):
        """Return the share ρ of the old value that the filter keeps at a sampling time [s]."""
        return self.smoothing if self.cutoff is None else xp_for(self.cutoff, Ts).exp(-2 * np.pi * self.cutoff * Ts)

    @property
    def steps_positions(self) -> bool:
        """Whether the drive's input is a stepping position rather than a velocity."""
        return self.command == "position" and self.order > 0

    @property
    def adds_up(self) -> bool:
        """Whether the loop depends on the controller's sum of steps."""
        return self.feedback == "commanded" or (self.steps_positions and self.feedback == "measured")

    @property
    def prompt(self) -> bool:
        """Whether the loop equals the one without drives."""
        at_once = self.order == 0 and self.delay == 0 and self.measurement_delay == 0
        return at_once and self.feedback != "commanded" and not self.filters

    @property
    def lumped(self) -> Self:
        """The drive with all delays that act lumped into the dead time; stability is the same."""
        late = self.measurement_delay * (self.feedback != "commanded")  # whose controller measures nothing
        return replace(self, delay=self.delay + late, measurement_delay=0)

    @property
    def joints(self) -> list[Drive]:
        """One drive for each joint whose numbers differ; equal ones once."""
        each = {name: np.asarray(value, float) for name in _QUANTITIES if np.ndim(value := getattr(self, name))}
        rows = dict.fromkeys(zip(*(v.ravel().tolist() for v in np.broadcast_arrays(*each.values())), strict=True))
        return [replace(self, **dict(zip(each, row, strict=True))) for row in rows] or [self]


def _none(value) -> bool:
    """Return whether a quantity is known to be absent."""
    return is_literal(value) and value == 0


def check_drive(drive, chain) -> Drive:
    """Return the drive. Raises: ArgumentError unless it is a `Drive` that fits a chain."""
    errors.kind("drive", drive, Drive, "be Drive(...)")
    if chain.balls and drive.steps_positions:
        raise errors.fail("drive", "take velocities on a free base, whose positions are no sums", "takes positions")
    for name in _QUANTITIES:
        if np.ndim(getattr(drive, name)):
            errors.array(name, getattr(drive, name), (chain.n,))
    return drive


def drive_in_words(drive: Drive, Ts: float) -> str:
    """Return a drive in words: "17 samples (34 ms) of dead time, a lag of 100 ms"."""
    words = [f"{quantities.in_samples(drive.delay, Ts)} of dead time"] * bool(drive.delay)
    words += [f"measured {quantities.in_samples(drive.measurement_delay, Ts)} late"] * bool(drive.measurement_delay)

    def span(value, unit, scale=1.0):
        low, high = (scale * float(pick(np.asarray(value, float))) for pick in (np.min, np.max))
        return f"{low:.4g}{'' if low == high else f' to {high:.4g}'} {unit}".rstrip()

    if drive.order == 1:
        words.append(f"a lag of {span(drive.lag, 'ms', 1e3)}")
    if drive.order == 2:
        words.append(f"a servo of {span(drive.natural_frequency, 'rad/s')}, ζ = {span(drive.damping_ratio, '')}")
    words += ["position commands"] * drive.steps_positions
    fed = {"commanded": ["own commands as feedback"], "rebased": ["commands from the measured joints"]}
    words += fed.get(drive.feedback, [])
    if drive.filters:
        words.append(f"{drive.filters} filtered with ρ = {float(drive.kept(Ts)):.3g}")
    return ", ".join(words) or "ideal drives"


# --- sampled ------------------------------------------------------------------------------------------


@record
class Sampled:
    """A drive from sample to sample: x[k+1] = Φ x[k] + Γ₀ u[k−d] + Γ₁ u[k−d−1], q = x₀, u the command."""

    phi: Float[AnyArray, "*n s s"]
    now: Float[AnyArray, "*n s"]
    late: Float[AnyArray, "*n s"] | None  # None if the dead time is a whole number of samples
    whole: int  # d

    @property
    def size(self) -> int:
        """Number of states of a joint."""
        return self.phi.shape[-1]

    @property
    def remembered(self) -> int:
        """Number of past commands that still act."""
        return self.whole + (self.late is not None)

    def moved(self, x, line, u):
        """Return the states (..., n, s) one sample later. line: commands under way, the newest first; u: the new."""
        x = (self.phi @ x[..., None])[..., 0] + self.now * (line[self.whole - 1] if self.whole else u)[..., None]
        return x if self.late is None else x + self.late * line[self.whole][..., None]


def sampled(drive: Drive, Ts) -> Sampled:
    """Sample the drive, exactly for a constant command (zero-order hold); in NumPy if all is known.

    Γ₀ is the effect of a command in the part of the sample after its arrival, Γ₁ that of the previous command in the
    part before (Åström & Wittenmark 1997, Section 2.3).
    """
    whole = math.floor(drive.delay)
    share = drive.delay - whole
    if drive.order == 0:
        late = Ts * np.full(1, share) if share else None
        return Sampled(phi=np.ones((1, 1)), now=Ts * np.full(1, 1.0 - share), late=late, whole=whole)
    xp = xp_for(*(getattr(drive, name) for name in _QUANTITIES), Ts)
    a, b = _continuous(drive, Ts, xp)
    phi, gamma = _held(a, b, Ts * (1.0 - share), xp)
    if share == 0:
        return Sampled(phi=phi, now=gamma, late=None, whole=whole)
    first, late = _held(a, b, Ts * share, xp)
    return Sampled(phi=phi @ first, now=gamma, late=(phi @ late[..., None])[..., 0], whole=whole)


def _continuous(drive, Ts, xp):
    """Return A (..., s, s) and b (..., s) of ẋ = A x + b u with q = x₀; a leading axis is that of the joints.

    G's own states are y = 1/(lag s + 1) u, or ẏ₀ = ω₀ y₁, ẏ₁ = ω₀ (u − y₀) − 2ζω₀ y₁, which are well scaled.
    """
    if drive.order == 1:
        rate = 1.0 / xp.maximum(xp.asarray(drive.lag), Ts / FASTEST)
        rows, force = [[-rate]], [rate]
    else:
        w, zeta = xp.broadcast_arrays(xp.asarray(drive.natural_frequency), xp.asarray(drive.damping_ratio))
        slower = xp.minimum(1.0, FASTEST / (2 * zeta * w * Ts))  # of ω₀² and 2ζω₀, so the slow rate stays
        damping, w = slower * 2 * zeta * w, xp.minimum(xp.sqrt(slower) * w, FASTEST / Ts)
        rows, force = [[0 * w, w], [-w, -damping]], [0 * w, w]
    if not drive.steps_positions:  # q̇ = y₀
        zero = 0 * force[0]
        rows = [[zero, zero + 1.0, *[zero] * (len(rows) - 1)], *[[zero, *row] for row in rows]]
        force = [zero, *force]
    return xp.stack([xp.stack(row, -1) for row in rows], -2), xp.stack(force, -1)


def _held(a, b, h, xp):
    """Φ(h) = exp(A h) and Γ(h) = ∫₀ʰ exp(A s) b ds, from one exponential of a larger matrix (Van Loan 1978)."""
    whole = xp.concatenate([a, b[..., None]], -1)
    whole = h * xp.concatenate([whole, xp.zeros_like(whole[..., :1, :])], -2)
    if xp is np:
        exponential = _exponential(whole)
    else:
        import jax

        exponential = jax.scipy.linalg.expm(whole)
    return exponential[..., :-1, :-1], exponential[..., :-1, -1]


def _exponential(a):
    """Return exp(A) of (..., s, s) in NumPy: exp(A/2ᵏ) − 1 as a series, squared k times; SciPy's waits for threads."""
    size = np.abs(a).sum(-1).max()
    doublings = max(math.frexp(size)[1] + 1, 0)  # scales the norm to at most 1/2
    a, less = a / 2.0**doublings, np.zeros_like(a)
    for k in range(TERMS, 0, -1):
        less = (a + a @ less) / k
    for _ in range(doublings):
        less = 2 * less + less @ less
    return less + np.eye(a.shape[-1])
