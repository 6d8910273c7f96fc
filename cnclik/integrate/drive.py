"""Drive: the dynamics between a command and the motion, and the measurement that the controller gets.

A command passes the dead time, is constant for a sample, and is followed by G(s): immediately, with a lag, or like a
second-order servo. Each joint may have its own. The sampled model is exact for a constant command; theory and loop use
the same matrices.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors, quantities
from cnclik.record import AnyArray, Array, ArrayLike, Float, is_literal, leaf, record, replace
from cnclik.robot import chart

COMMANDS = ("velocity", "position")
FEEDBACKS = ("measured", "commanded", "rebased")
MOST = 101  # samples of dead time and measurement delay together, the number of rows of theory's matrices
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

    Attributes:
      delay: dead time between command and motion [samples], also fractions; a known number, never traced.
      measurement_delay: delay of the measurement [whole samples]. Measurements are time-stamped: the error that is fed
        back is the error at the time of the measurement, so that a known path is followed without additional error. For
        stability both delays add up.
      lag: time constant of a first-order drive [s], one number or one per joint (n,).
      natural_frequency, damping_ratio: ω₀ [rad/s] and ζ of a second-order drive, in place of a lag.
      command: "velocity", or "position": the controller sums up its steps and sends joint values. Without lag both are
        the same.
      feedback: joint values that the controller uses. "measured": the robot's own, while commands are summed up
        separately; "commanded": its own commands, so that drive, dead time and measurement delay do not enter the
        loop; "rebased": measured, and each position command starts from them instead of the last command.

    Raises: ArgumentError for values that do not fit.
    """

    delay: float = 0.0
    measurement_delay: int = 0
    lag: ArrayLike = 0.0
    natural_frequency: ArrayLike | None = None
    damping_ratio: ArrayLike = 1.0
    command: str = "velocity"
    feedback: str = "measured"

    def __post_init__(self):
        if isinstance(self.delay, str):
            found = f"is {self.delay!r}{quantities.in_python(self.delay, quantities.SAMPLES)}"
            raise errors.fail("delay", "be a number of samples", found)
        if not errors.concrete(self.delay):
            raise errors.fail("delay", "be a known number of samples", "is traced: there is a program for each")
        errors.number("delay", self.delay, at_least=0)
        errors.integer("measurement_delay", self.measurement_delay, at_least=0, at_most=errors.MOST)
        if self.delay + self.measurement_delay > MOST:
            late = float(self.delay) + self.measurement_delay
            raise errors.fail("delay", f"be at most {MOST} samples, that of a measurement included", f"is {late:g}")
        object.__setattr__(self, "delay", float(self.delay))
        errors.one_of("command", self.command, COMMANDS)
        errors.one_of("feedback", self.feedback, FEEDBACKS)
        if self.natural_frequency is not None and not _none(self.lag):
            must = "be left out where there is a lag: a drive has one of both"
            raise errors.fail("natural_frequency", must, "is given")
        if self.natural_frequency is None and not (is_literal(self.damping_ratio) and self.damping_ratio == 1):
            raise errors.fail("damping_ratio", "come with a natural_frequency", "comes without")
        if self.feedback == "rebased" and not self.steps_positions:
            must = "come with command position and a lag or servo where it is rebased: velocities begin nowhere else"
            raise errors.fail("feedback", must, f"comes with command {self.command}, order {self.order}")
        for name in _QUANTITIES:
            value = getattr(self, name)
            if name == "damping_ratio" and self.natural_frequency is None:
                continue
            if value is None and name == "lag":
                raise errors.fail("lag", "be a number, 0 for none", "is None")
            if value is not None and not (name == "lag" and _none(value)):
                known = _check(name, value)
                object.__setattr__(self, name, known if np.ndim(known) else leaf(value))

    @property
    def order(self) -> int:
        """Order of G(s)."""
        return 2 if self.natural_frequency is not None else 0 if _none(self.lag) else 1

    @property
    def steps_positions(self) -> bool:
        """Whether the drive's input is a stepping position rather than a velocity."""
        return self.command == "position" and self.order > 0

    @property
    def adds_up(self) -> bool:
        """Whether the loop depends on the controller's sum of steps."""
        return self.feedback == "commanded" or (self.steps_positions and self.feedback == "measured")

    @property
    def ideal(self) -> bool:
        """Whether the motion equals the command."""
        return self.order == 0 and self.delay == 0

    @property
    def prompt(self) -> bool:
        """Whether the loop equals the one without drives."""
        return self.ideal and self.measurement_delay == 0 and self.feedback != "commanded"

    @property
    def lumped(self) -> Self:
        """The drive with all delays lumped into the dead time; stability is the same."""
        return replace(self, delay=self.delay + self.measurement_delay, measurement_delay=0)

    def late_by(self, Ts):
        """Return the delay of a motion at constant speed behind its command [s]: the dead time plus the lag or 2ζ/ω₀.

        For stepping positions it is half a sample less, as each is sent at the start of its sample.
        """
        lag = 2 * self.damping_ratio / self.natural_frequency if self.order == 2 else self.lag
        return self.delay * Ts + lag - 0.5 * Ts * self.steps_positions


def _none(value) -> bool:
    """Return whether a quantity is known to be absent."""
    return is_literal(value) and value == 0


def _check(name, value):
    value = errors.array(name, value, (), (None,), (None, 1), most=LARGEST)
    if not errors.concrete(value):
        return value
    known = np.asarray(value, float)
    if np.any(known <= 0):
        raise errors.fail(name, "be positive", f"is {known.min():g}")
    if np.any(known < 1 / LARGEST):
        raise errors.fail(name, f"be at least {1 / LARGEST:g}", f"is {known.min():g}")
    return value


def check_drive(drive, chain) -> Drive:
    """Return the drive. Raises: ArgumentError unless it is a `Drive` that fits a chain."""
    errors.kind("drive", drive, Drive, "be Drive(...)")
    if chain.balls and drive.steps_positions:
        raise errors.fail("drive", "take velocities on a free base, whose positions are no sums", "takes positions")
    for name in _QUANTITIES:
        if np.ndim(getattr(drive, name)):
            errors.array(name, getattr(drive, name), (chain.n,))
    return drive


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

    def beside(self):
        """Return several drives with two more axes after theirs."""
        late = None if self.late is None else np.expand_dims(self.late, (-3, -2))
        return replace(self, phi=np.expand_dims(self.phi, (-4, -3)), now=np.expand_dims(self.now, (-3, -2)), late=late)

    def transfer(self, at):
        """Return the transfer function from command to motion at points z (...), for one drive shared by all joints."""
        at = np.asarray(at)[..., None]
        force = self.now * at**-self.whole
        if self.late is not None:
            force = force + self.late * at ** -(self.whole + 1)
        return np.linalg.solve(at[..., None] * np.eye(self.size) - self.phi, force[..., None])[..., 0, 0]


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
    known = all(map(errors.concrete, jax.tree.leaves((drive, Ts))))
    a, b = _continuous(drive, Ts, np if known else jnp)
    phi, gamma = _held(a, b, Ts * (1.0 - share), known)
    if share == 0:
        return Sampled(phi=phi, now=gamma, late=None, whole=whole)
    first, late = _held(a, b, Ts * share, known)
    return Sampled(phi=phi @ first, now=gamma, late=(phi @ late[..., None])[..., 0], whole=whole)


def _continuous(drive, Ts, xp):
    """Return A (..., s, s) and b (..., s) of ẋ = A x + b u with q = x₀; a leading axis is that of the joints.

    G's own states are y = 1/(lag s + 1) u, or ẏ₀ = ω₀ y₁, ẏ₁ = ω₀ (u − y₀) − 2ζω₀ y₁, which are well scaled.
    """
    if drive.order == 1:
        rate = xp.minimum(1.0 / xp.asarray(drive.lag), FASTEST / Ts)
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


def _held(a, b, h, known):
    """Return Φ(h) = exp(A h) and Γ(h) = ∫₀ʰ exp(A s) b ds, from one exponential of a larger matrix (Van Loan 1978)."""
    xp = np if known else jnp
    whole = xp.concatenate([a, b[..., None]], -1)
    whole = h * xp.concatenate([whole, xp.zeros_like(whole[..., :1, :])], -2)
    made = _exponential(whole) if known else jax.scipy.linalg.expm(whole)
    return made[..., :-1, :-1], made[..., :-1, -1]


def _exponential(a):
    """Return exp(A) of (..., s, s) in NumPy: exp(A/2ᵏ) − 1 as a series, squared k times.

    SciPy's calls LAPACK, whose threads wait for each other longer than such a small matrix takes.
    """
    size = np.abs(a).sum(-1).max(initial=0.0)
    doublings = max(math.frexp(size)[1] + 1, 0)  # scales the norm to at most 1/2
    a, less = a / 2.0**doublings, np.zeros_like(a)
    for k in range(TERMS, 0, -1):
        less = (a + a @ less) / k
    for _ in range(doublings):
        less = 2 * less + less @ less
    return less + np.eye(a.shape[-1])


# --- in a loop ----------------------------------------------------------------------------------------


class Driven(NamedTuple):
    """The state of the drives."""

    x: Float[Array, "n s"]
    line: Float[Array, "d n"]  # commands that still act, newest first
    sent: Float[Array, " n"]  # the sum of the controller's steps
    late: tuple[Array, ...] = ()  # measured errors on their way, newest first


def resting(chain, drive: Drive, model: Sampled, q, late=()) -> Driven:
    """Return drives at rest at q (n,), commanded to stay there. Args: late: the errors on their way."""
    x = jnp.zeros((*q.shape, model.size), q.dtype).at[..., 0].set(chart.centre(chain, q))
    held = q if drive.steps_positions else jnp.zeros_like(q)
    return Driven(x, jnp.tile(held, (model.remembered, 1)), q, late)


def driven(chain, drive: Drive, model: Sampled, at: Driven, q, seen, step, Ts) -> tuple[Array, Driven]:
    """Return the joint values (n,) one sample after q (n,), and the drives then.

    Args: seen, step: (n,) the joint values that the controller used, and its step from there.
    """
    sent = chart.moved(chain, seen if drive.feedback == "rebased" else at.sent, step)
    u = sent if drive.steps_positions else step / Ts
    line = jnp.concatenate([u[None], at.line])[: len(at.line)]
    x = model.moved(at.x, at.line, u)
    after = chart.out(chain, q, x[:, 0])
    if chain.balls:
        x = x.at[:, 0].set(chart.centre(chain, after))
    return after, at._replace(x=x, line=line, sent=sent)
