"""Gains: which gain a loop tolerates on its drives, what a gain does, and the same loop elsewhere. NumPy only.

No robot is asked: each rate of the loop is a weighted mean of its gains, so one scalar loop decides for every robot,
posture, task and stack, see `cnclik.stability.poles`. A drive limits the share s = 1 − R(z) of an error that a step may
remove, and a method gives the gain that removes it.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import NamedTuple

import numpy as np

from cnclik import errors
from cnclik.integrate.drive import LARGEST, MOST, Drive, drive_in_words
from cnclik.integrate.method import DEFAULT, Method, MethodLike, named
from cnclik.record import Number, replace
from cnclik.stability.linear import describe, first_beyond, gain_removing, passes_of, removed
from cnclik.stability.poles import LONGEST, SETTLED, ScalarLoop, crossings, frequencies, scalar_loop, within

# Of an arm of which nothing is known: 34 ms of dead time were measured of a UR, 30 ms of others; the position servos of
# the MuJoCo menagerie lag by k_v/k_p = 0.1 s, some by 0.2 s.
ASSUMED_DELAY, ASSUMED_LAG = 0.03, 0.1  # [s]
MOST_Z = 1.0  # a recommended gain removes no more than 63 % of an error per step, or all of it by explicit Euler
SPARE = 1.0  # samples of dead time under which a recommended gain still does not overshoot
OVERSHOOT = 0.01  # of a step, that counts as none
WITHIN = 0.02  # share of a step within which it has settled
SWING = 1e-4  # relative imaginary part of a pole that counts as 0: rounding separates equal poles
SLOWEST, ZERO = 1e-6, 1e-9  # poles within a share of the slowest are as slow; smaller poles count as 0
BESIDE = 1e-6  # share of a limit below it where two poles that meet are still apart
RATES = (1e-6, 30.0, 1024)  # of real poles times Ts, among which is looked: from, to, points
ROUNDS = 4  # of a search around the maximum, each 16 times finer
SMALL = 1e-4  # share of a limit at which a loop must be stable, too
INERTIA = (0.5, 2.0)  # of a rebased servo, as a share of that of the posture where it was identified
TINY = 1e-300  # of a pole at 0, whose logarithm is taken


@dataclasses.dataclass(frozen=True)
class Response:
    """What a loop does with one gain. Of joints with different drives each number is the worst.

    Attributes:
      alpha: the gain [1/s].
      damping_ratio: ζ of the slowest poles; 1 of real ones.
      overshoot: by how much the motion passes a step of the target, as a share of it.
      settling_time: time until the motion stays within 2 % of a step [s]; inf where it does not.
      gain_margin: factor by which the gain may grow.
      delay_margin: dead time that may be added [s].
      noise_gain: standard deviation of the motion per unit of white measurement noise.
      velocity_noise_gain: the same of the commanded velocity [1/s].
      lag: delay behind a ramp [s]. lag_fed_forward: the same with feed-forward [s].
      start_error: largest error after a ramp starts, with feed-forward, per unit of its speed [s].
    """

    alpha: float
    damping_ratio: float
    overshoot: float
    settling_time: float
    gain_margin: float
    delay_margin: float
    noise_gain: float
    velocity_noise_gain: float
    lag: float
    lag_fed_forward: float
    start_error: float


@dataclasses.dataclass(frozen=True)
class Gains:
    """Gains [1/s] that a loop tolerates, at any posture of any robot with these drives; inf: any gain.

    Attributes:
      largest_stable: the largest that is stable.
      without_overshoot: the largest with which a step of the target is not passed by more than 1 %.
      recommended: the same even with one more sample of dead time, at most 1/Ts, and at most the gain with which a step
        removes the most of an error; 0 where there is none.
      Ts: sampling time [s]. method, M: of the loop. drive: of all joints, as given or as assumed.
      assumed: whether nothing was known of the drives, so that a dead time of 30 ms and a lag of 100 ms are assumed.
      shares: the three limits as shares of an error that a step may remove, whatever the method.
      response: what the loop does with the recommended gain; None without one.
    """

    largest_stable: float
    without_overshoot: float
    recommended: float
    Ts: float
    method: Method
    M: int | None
    drive: Drive
    assumed: bool
    shares: tuple[float, float, float]

    @functools.cached_property
    def response(self) -> Response | None:
        return self.at(self.recommended) if self.recommended else None

    def at(self, alpha: float) -> Response | None:
        """Return what the loop does with a gain [1/s]; None where it is unstable."""
        alpha = float(errors.number("alpha", alpha, positive=True))
        return _worst(self, alpha) if alpha < self.largest_stable else None

    def by(self, method: MethodLike, M: int | None = None) -> Gains:
        """Return the gains of the same loop by another method."""
        return _gains(self.shares, self.Ts, named(method), passes_of(M), self.drive, self.assumed)

    @property
    def reason(self) -> str:
        """The meaning of the recommended gain, in words."""
        if not self.recommended and self.drive.feedback == "rebased":
            return (
                "no gain: each position command starts at the measured joints, and with this servo and dead time the "
                "loop may swing and grow however small alpha is, here or in a posture of other inertia. Start commands "
                'at the last one (feedback="commanded"), or send velocities'
            )
        if not self.recommended:
            drive = drive_in_words(self.drive, self.Ts)
            return f"no gain: the motion overshoots by more than {100 * OVERSHOOT:g} % with any, on {drive}"
        if self.drive.feedback == "commanded":
            return (
                "the motion does not overshoot, even if the loop uses its commands one sample later. The drives are "
                "outside of this loop: the robot follows its commands late, and steady errors of it are not corrected"
            )
        if self.recommended < 0.999 * min(gain_removing(self.shares[2], self.method, self.M), MOST_Z) / self.Ts:
            return "here a step of this method removes the most: with a larger gain it removes less of an error"
        if np.isclose(self.recommended * self.Ts, MOST_Z):
            return f"above z = alpha·Ts = {MOST_Z:g} noise increases more than the settling time decreases"
        late = "the assumed dead time" if self.assumed else f"the {self.drive.lumped.delay:g} given"
        return f"the largest gain that does not overshoot, even with one more sample of dead time than {late}"

    @property
    def elsewhere(self) -> dict[str, Setting]:
        """The same loop by explicit Euler in other libraries: {where: `Setting`}."""
        return settings(self)

    def __str__(self):
        how = f"{describe(self.method, self.M)}, Ts = {1e3 * self.Ts:g} ms"
        lines = [f"{how}, {drive_in_words(self.drive, self.Ts)}{', assumed' * self.assumed}"]
        for name in ("largest stable", "without overshoot", "recommended"):
            alpha = getattr(self, name.replace(" ", "_"))
            lines.append(f"  {name:<18}{in_words(alpha)}{' 1/s' * (0 < alpha < np.inf)}")
        return "\n".join([*lines, f"Recommended: {self.reason}."])


def gains(*, Ts: Number, drive: Drive | None = None, method: MethodLike = DEFAULT, M: int | None = None) -> Gains:
    """Return the gains that a loop tolerates on its drives, for any robot, posture, task and stack.

    Each rate of the loop at rest is a weighted mean of its gains (docs/theory.md has the proof). So alpha <
    `largest_stable` is stable for every J# = Jᵀ(JJᵀ + D)⁻¹, and exactly the limit where J# is exact. With one gain for
    all tasks, joints may have different drives. It is linear: nothing is said of large errors or of limits that switch.

    Args:
      Ts: sampling time [s].
      drive: what lies between command and motion, with a filter if there is one; None: unknown, so that a dead time of
        30 ms and a lag of 100 ms are assumed. `Drive()`: ideal.
      method: by name, or a `Method`; default: EXP-MIDPOINT.
      M: fixed-point passes of an implicit stage, picard(M); None: solved exactly, as by chord and newton.
    Returns: `Gains`; one with a recommended gain of 0 where no gain is safe, see its `reason`.
    Raises: ArgumentError for values that do not fit.
    """
    for name, values in (("Ts", [Ts]), ("drive", vars(drive).values() if isinstance(drive, Drive) else [])):
        if not all(map(errors.concrete, values)):
            raise errors.fail(name, "hold numbers", "is traced by JAX: call gains outside of jit, vmap and grad")
    Ts = float(errors.array("Ts", errors.number("Ts", Ts, positive=True), (), most=LARGEST))
    method, M = named(method), passes_of(M)
    known = assumed_drive(Ts) if drive is None else errors.kind("drive", drive, Drive, "be Drive(...)")
    return _gains(limits(known, Ts), Ts, method, M, known, assumed=drive is None)


def _gains(shares, Ts, method, M, drive, assumed) -> Gains:
    stable, smooth, recommended = (gain_removing(share, method, M) for share in shares)
    z = np.linspace(0.0, min(recommended, MOST_Z), 1025)
    most = float(z[removed(method, z, M).argmax()])  # passes of odd number remove less again beyond, IE's nothing at 1
    return Gains(stable / Ts, smooth / Ts, most / Ts, Ts, method, M, drive, assumed, shares)


def gain_table(*, Ts, dead_time, drive: Drive = Drive(), method: MethodLike = DEFAULT, M: int | None = None):
    """Return the gains over sampling times and dead times as an xarray.Dataset over (Ts, dead_time).

    Args:
      Ts: (a,) [s]. dead_time: (b,) [s], that of the measurement included, in place of the drive's own.
      drive, method, M: as for `gains`.
    """
    import xarray as xr

    Ts, dead_time = (np.asarray(errors.array(k, v, (None,)), float) for k, v in (("Ts", Ts), ("dead_time", dead_time)))
    drive = replace(errors.kind("drive", drive, Drive, "be Drive(...)"), measurement_delay=0)
    rows = [[gains(Ts=T, drive=replace(drive, delay=d / T), method=method, M=M) for d in dead_time] for T in Ts]
    names = ("largest_stable", "without_overshoot", "recommended")
    return xr.Dataset(
        {
            name: (("Ts", "dead_time"), [[getattr(cell, name) for cell in row] for row in rows], {"units": "1/s"})
            for name in names
        },
        coords={
            "Ts": ("Ts", Ts, {"units": "s", "long_name": "sampling time"}),
            "dead_time": ("dead_time", dead_time, {"units": "s", "long_name": "dead time"}),
        },
        attrs={"method": describe(named(method), passes_of(M)), "drive": repr(drive)},
    )


def assumed_drive(Ts: float) -> Drive:
    """Return the drive that is assumed where nothing is known."""
    if ASSUMED_DELAY / Ts > MOST:
        must = f"be given, such as a delay: the 30 ms of dead time that are assumed are more than {MOST} samples"
        raise errors.fail("drive", must, f"is unknown, with a Ts of {1e3 * Ts:g} ms")
    return Drive(delay=ASSUMED_DELAY / Ts, lag=ASSUMED_LAG)


# --- limits -------------------------------------------------------------------------------------------


def limits(drive: Drive, Ts: float) -> tuple[float, float, float]:
    """Return the largest shares of an error that a step may remove: stable; without overshoot; the same with one more
    sample of dead time. Of joints with different drives the least, and stable in any mixture of them."""
    each = drive.joints
    stable = mixed_share(each, Ts)
    smooth = min(smooth_share(one, Ts, stable) for one in each)
    late = [_later(one, Ts) for one in each]
    recommended = min(smooth, *(smooth_share(one, Ts, min(stable, stable_share(one, Ts))) for one in late))
    if drive.feedback == "rebased" and not all(stable_share(one, Ts) for joint in late for one in _inertias(joint)):
        recommended = 0.0
    return stable, smooth, recommended


def _later(drive: Drive, Ts: float) -> Drive:
    """The drive with SPARE more samples of dead time; of a loop on its own commands, that alone."""
    if drive.feedback == "commanded":
        return replace(within(drive), delay=SPARE)
    return replace(drive, delay=min(drive.lumped.delay + SPARE, MOST), measurement_delay=0)


def _inertias(drive: Drive):
    """The servo in postures of other inertia: k_p and k_v stay, and ω₀ and ζ fall with the root of the inertia."""
    if drive.order < 2:
        return [drive]
    w, ratio = drive.natural_frequency, drive.damping_ratio
    return [replace(drive, natural_frequency=w / h**0.5, damping_ratio=ratio / h**0.5) for h in (*INERTIA, 1.0)]


def stable_share(drive: Drive, Ts: float) -> float:
    """Return the largest share s up to which the loop is stable, its gain margin at s = 1; 0 where no small s is.

    It is the least −1/ℓ(e^{iω}) over the frequencies where ℓ is real and negative, ω·Ts = π included.
    """
    loop = scalar_loop(within(drive), Ts)
    at = np.append(crossings(lambda w: loop.unit_gain(np.exp(1j * w)).imag, frequencies()), np.pi)
    there = loop.unit_gain(np.exp(1j * at)).real
    limit = float(np.min(-1.0 / there[there < 0], initial=np.inf))
    return limit if loop.radius(SMALL * min(limit, 1.0)) < 1 else 0.0


def mixed_share(drives, Ts: float) -> float:
    """Return the largest share up to which a loop with one gain is stable, whichever joints have which drive.

    At each frequency −1 must stay outside of s · conv{0, ℓ₁, …, ℓₙ}: exact over all robots. "The slowest drive is safe"
    is false in general.
    """
    alone = [stable_share(one, Ts) for one in drives]
    if len(drives) == 1 or drives[0].feedback == "commanded":
        return min(alone)
    zeta = np.exp(1j * frequencies())
    each = np.array([scalar_loop(one, Ts).unit_gain(zeta) for one in drives])
    one, other = each[np.array(np.triu_indices(len(each)))]
    with np.errstate(all="ignore"):
        share = np.where(one.imag == other.imag, 0.0, one.imag / (one.imag - other.imag))
        across = np.where(one.imag * other.imag <= 0, one.real + share * (other.real - one.real), 0.0)
    return min(-1.0 / min(float(np.nanmin(across)), -1e-9), *alone)


def smooth_share(drive: Drive, Ts: float, stable: float) -> float:
    """Return the largest share up to `stable` without overshoot: the slowest pole is real and positive, and the motion
    passes a step by at most OVERSHOOT, also where the drive is outside of the loop."""
    if not stable:
        return 0.0
    loop, whole = scalar_loop(within(drive), Ts), scalar_loop(drive, Ts)

    def swings(s):
        poles = loop.poles(s)
        size = np.abs(poles)
        slow = (size >= size.max(-1, keepdims=True) * (1 - SLOWEST)) & (size > ZERO)
        return (slow & ((poles.real < 0) | (np.abs(poles.imag) > SWING * size))).any(-1)

    share = min(stable, double_pole(loop))
    if np.isfinite(share) and swings(share * (1 - BESIDE)):  # another pole is slower before
        share = first_beyond(swings, share, points=128, halvings=40)
    if not np.isfinite(share) or overshoot(whole, share) <= OVERSHOOT:
        return share
    low, high = 0.0, share
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if overshoot(whole, middle) > OVERSHOOT else (middle, high)
    return low


def double_pole(loop: ScalarLoop) -> float:
    """Return the share with which the pole that starts at ζ = 1 meets another real one, or 0: the first maximum of
    s(ζ) = −1/ℓ(ζ) from 1 downwards; inf where it grows without limit."""

    def share(rate):
        with np.errstate(all="ignore"):
            return -1.0 / loop.unit_gain(np.exp(-rate)).real

    rates = np.geomspace(*RATES)  # ζ = e^{−rate}
    shares = share(rates)
    falls = np.flatnonzero(~(shares[1:] >= shares[:-1]))
    if not falls.size:
        return float(shares[-1])
    i = falls[0]
    if not 0 <= shares[i + 1] <= shares[i]:
        return np.inf
    for _ in range(ROUNDS):
        rates = np.linspace(rates[max(i - 1, 0)], rates[i + 1], 33)
        shares = share(rates)
        i = min(int(shares.argmax()), 31)
    return float(shares[i])


def overshoot(loop: ScalarLoop, s: float) -> float:
    """Return by how much the motion passes a step of the target, as a share of it."""
    passed = loop.response(s, loop.q, -loop.displaced[:, None], settled_by(loop, s))
    return max(float(passed.max()), 0.0)


def settled_by(loop: ScalarLoop, s: float) -> int:
    """Return the samples by which a response has settled to SETTLED², that of what is outside of the loop included."""
    own = np.abs(np.append(np.linalg.eigvals(loop.model.phi), loop.drive.kept(loop.Ts)))
    inside = scalar_loop(within(loop.drive), loop.Ts)
    slowest = max(float(inside.radius(s)), own[own < 1 - 1e-9].max(initial=0.0))
    wanted = 2 * np.log(SETTLED) / np.log(slowest) if 0 < slowest < 1 else LONGEST
    return int(min(wanted + 4 * loop.drive.delay + 50, LONGEST))


# --- what a gain does ---------------------------------------------------------------------------------


def _worst(gains: Gains, alpha: float) -> Response:
    """The worst of the responses of all joints."""
    s = float(removed(gains.method, alpha * gains.Ts, gains.M))
    each = [respond(joint, gains.Ts, s, alpha, gains.largest_stable / alpha) for joint in gains.drive.joints]
    least = {"damping_ratio", "gain_margin", "delay_margin"}
    names = [field.name for field in dataclasses.fields(Response)]
    return Response(**{k: (min if k in least else max)(getattr(joint, k) for joint in each) for k in names})


def respond(drive: Drive, Ts: float, s: float, alpha: float, gain_margin: float) -> Response:
    """Return the response of a loop that removes a share s of an error in each step."""
    loop, inside, kept = scalar_loop(drive, Ts), scalar_loop(within(drive), Ts), float(drive.kept(Ts))
    N = settled_by(loop, s)

    def filtered(signal):  # by the filter of the command or target
        weights, length = (1 - kept) * kept ** np.arange(N + 1), 1 << (2 * N + 1).bit_length()
        return np.fft.irfft(np.fft.rfft(signal, length) * np.fft.rfft(weights, length))[: len(signal)]

    noisy = loop.disturbed - s * loop.b * loop.noise
    away, fed, noise = loop.response(s, loop.q, np.stack([loop.displaced, loop.b, noisy], -1), N).T
    late = drive.measurement_delay * (drive.feedback != "commanded")  # which no feed-forward waits for
    fed = np.append(fed, np.zeros(late))[late:]
    asked = np.r_[-s * loop.noise, loop.response(s, -s * loop.C, noisy[:, None], N - 2)[:, 0]]
    poles = inside.poles(s)
    slowest = np.log(poles[np.abs(poles) >= np.abs(poles).max() * (1 - SLOWEST)].astype(complex) + TINY)
    behind, forward = np.cumsum(away[:N]) * Ts, np.cumsum((away - fed)[:N]) * Ts  # a ramp is a sum of steps
    start_error, later = float(np.abs(forward).max()), 0.0
    lag_fed_forward = float(forward[-1]) if abs(forward[-1]) > SETTLED * start_error else 0.0
    if drive.filters == "command":
        asked = filtered(asked)
    if drive.filters == "target":  # a step and a ramp come late through it, the feed-forward at once
        later, away = Ts * kept / (1 - kept), 1 - filtered(1 - away)
        start_error = float(np.abs(np.cumsum(away - fed)).max() * Ts)
    outside = np.flatnonzero(~(np.abs(away) <= WITHIN))
    return Response(
        alpha=alpha,
        damping_ratio=float(np.abs(np.cos(np.angle(slowest))).min()),  # 1 also of a pole that rounds to 1 or above
        overshoot=max(float(-away.min()), 0.0),
        settling_time=np.inf if outside[-1] == N else float(outside[-1] + 1) * Ts,
        gain_margin=gain_margin,
        delay_margin=np.inf if drive.feedback == "commanded" else loop.delay_margin(s),
        noise_gain=float(np.linalg.norm(noise)),
        velocity_noise_gain=float(np.linalg.norm(asked)) / Ts,
        lag=float(behind[-1]) + later,
        lag_fed_forward=lag_fed_forward + later,
        start_error=start_error,
    )


# --- in words -----------------------------------------------------------------------------------------


def in_words(alpha: float) -> str:
    """Return a gain as text: "10.04", "no limit" or "none"."""
    return "none" if alpha == 0 else f"{alpha:.4g}" if alpha < np.inf else "no limit"


# --- the same loop elsewhere --------------------------------------------------------------------------


LOOKAHEAD = 0.03  # [s], the least lag of a UR's servoj
OWN_COMMANDS = 0.25  # z of a loop on its own commands: d^d/(d + 1)^(d + 1) for d = 1


class Setting(NamedTuple):
    """A gain of the same loop in another library: its number, None where none is safe, and what the number means."""

    value: float | None
    meaning: str


def settings(found: Gains) -> dict[str, Setting]:
    """Return the recommended gain of the same loop by explicit Euler in other libraries.

    These loops were run: pink, mink and Placo themselves, and copies of Isaac Lab's, MoveIt Servo's and servoj's.
    """
    Ts, drive, unknown = found.Ts, found.drive, found.assumed

    def gain(drive: Drive) -> float | None:
        return min(MOST_Z, (found.shares if drive is found.drive else limits(drive, Ts))[2]) or None

    z = gain(drive if drive.feedback == "measured" else replace(drive, feedback="measured"))
    per_step = (
        "gain per step of FrameTask and PostureTask, dt = Ts, where the configuration is measured; "
        f"{OWN_COMMANDS} where it is the last command"
    )
    share = "share of the way from the measured state to the target at which each solve's target lies"
    rate = "x, y, z and angular_proportional_gain [1/s], publish_period = Ts, joint velocities published"
    k_val, why = None, "each position target starts at the measured joints"
    if unknown or (drive.order == 0 and not drive.prompt):
        why += (
            ", and servos with ζ below 0.71 and dead time may run away: identify yours first (cnclik diagnose --step)"
        )
    elif drive.order and drive.command == "velocity":
        why += ", and the drive given is a velocity servo: identify it with position commands"
    else:
        k_val = gain(replace(drive.lumped, command="position", feedback="rebased")) if drive.order else MOST_Z
        why += "" if k_val else ", and this servo may then swing or run away"
    if not unknown and drive.order and drive.command == "velocity":
        servoj = Setting(None, "alpha: servoj takes positions, and the drive given is a velocity servo")
    else:
        most = gain(_of_servoj(drive, Ts, unknown))
        from_last = "error and J at the measured joints, q_cmd += q̇ Ts from the last q_cmd"
        servoj = Setting(most and most / Ts, f"alpha [1/s], {from_last}, lookahead_time {LOOKAHEAD}")
    return {
        "pink": Setting(z, per_step),
        "mink": Setting(z, per_step),
        "Placo": Setting(z, share),
        "MoveIt Servo": Setting(z and z / Ts, rate),
        "Isaac Lab": Setting(k_val, f"k_val of DifferentialIKControllerCfg: {why}"),
        "UR servoj": servoj,
    }


def _of_servoj(drive: Drive, Ts: float, unknown: bool) -> Drive:
    """The drive with the lag of servoj's look-ahead; where there is another, as dead time."""
    drive = replace(drive, feedback="measured", command="position").lumped
    if unknown or drive.order == 0:
        return replace(drive, lag=LOOKAHEAD)
    return replace(drive, delay=min(drive.delay + LOOKAHEAD / Ts, MOST - SPARE))
