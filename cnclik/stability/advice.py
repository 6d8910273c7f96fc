"""Advice for a robot: gains with their reason, what they cost, and settings for other libraries."""

from __future__ import annotations

import functools

import numpy as np

from cnclik import errors
from cnclik.integrate.drive import MOST, Drive
from cnclik.integrate.method import DEFAULT, EE, MethodLike, named
from cnclik.integrate.stage import Stage, picard
from cnclik.law.law import Law
from cnclik.law.reference import Reference
from cnclik.precision import in_float64
from cnclik.quantities import in_samples
from cnclik.record import ArrayLike, Float, Number, record
from cnclik.stability.bounds import LimitAdvice, limit_advice, wall_advice
from cnclik.stability.driven import POINTS, driven_limits
from cnclik.stability.drives import SPARE, longer
from cnclik.stability.gain import Gain, gain_of
from cnclik.stability.linear import first_above
from cnclik.stability.loop import UNSTABLE, loop_at_rest
from cnclik.stability.rebased import WHERE, bearable_delay
from cnclik.stability.recommend import Analysis, analysis_of, assumed_of, recommendation_of, without_overshoot
from cnclik.stability.settings import ASSUMED_DELAY, ASSUMED_LAG, MOST_Z, REBASED, around_formula, settings
from cnclik.stability.spectrum import drift_of_numbers, rest_tolerance
from cnclik.stability.tasks import StackAdvice, at_any_posture, bounded_rates, stack_advice

SPEED = 0.1  # [m/s] of the tip, where none is given


@record
class Advice:
    """What to set on a robot. Gains are inf where any is stable, or has no overshoot.

    Attributes:
      largest_stable_alpha, fastest_monotone_alpha, recommended_alpha: [1/s] of the loop's method: the largest that is
        stable, that has no overshoot, and that would have none if the dead time were a sample longer. The first two
        are of the drive exactly as given, or, where nothing is known, of drives that follow at once. On a robot whose
        drives lag the largest stable gain may be several times less or more: its joints' inertia is coupled, and what
        a drive does within a sample counts. A recorded step shows between which gains it lies (`fit_drive`).
      assumed_dead_time, assumed_lag: [s] under which a gain is recommended where nothing is known of the drives; else
        None.
      assumption: what is assumed of the drives, and how to measure them, in words; "" where all is given.
      reason: why that one, in words.
      now, recommended: `Gain` as the law has it (None where that is unstable), and as recommended; where nothing is
        known of the drives, of those that are assumed.
      explicit_euler: the three gains of the step that other libraries take, by the same names.
      recommended_method: by name.
      speed: of the tip [m/s]. joint_speed: largest share of a joint's velocity limit that it takes, in the worst
        direction at rest; NaN where there is no limit, or no position among the task's coordinates.
      settings: {where: what to set there, or why no gain is named, in words}; empty where explicit Euler is stable
        with no gain.
      notes: what limits these numbers, in sentences; measured in results/loops.
      stack: `StackAdvice`, the gains that each task of a stack tolerates; None for one task. The gains above are then
        those of the task with the largest gain, all gains scaled in proportion.
      limits: `LimitAdvice`, how fast joints may near their limits; None where the law has none, or no rate.
      walls: {name: `WallAdvice`}; {} where the law has none.
      analysis: `Analysis`, on which this rests.
    """

    largest_stable_alpha: float
    fastest_monotone_alpha: float
    recommended_alpha: float
    assumed_dead_time: float | None
    assumed_lag: float | None
    assumption: str
    reason: str
    now: Gain | None
    recommended: Gain
    explicit_euler: dict
    recommended_method: str
    speed: float
    joint_speed: float
    settings: dict
    notes: tuple
    stack: StackAdvice | None
    limits: LimitAdvice | None
    walls: dict
    analysis: Analysis

    def __str__(self):
        at_once = ", if drives had no delay" * (self.assumed_dead_time is not None)
        some = {"": self} if self.stack is None else self.stack.tasks
        gains = [
            f"{name}{': ' * bool(name)}alpha recommended {one.recommended_alpha:.4g} 1/s ("
            f"{_up_to('without overshoot', one.fastest_monotone_alpha)}, "
            f"{_up_to('stable', one.largest_stable_alpha)}{at_once})"
            for name, one in some.items()
        ]
        settings = [f"  {where}: {what}" for where, what in self.settings.items()]
        own = f"{self.explicit_euler['recommended_alpha']:.4g} 1/s recommended"
        settings[:0] = [f"The same loop elsewhere, by explicit Euler ({own}):"] * bool(settings)
        assumed = [self.assumption] * bool(self.assumption)
        return "\n".join([*assumed, *gains, f"Recommended: {self.reason}.", *self.notes, *settings])


def _up_to(what, limit) -> str:
    return f"{what} to {limit:.4g}" if np.isfinite(limit) else f"{what} at any gain"


@in_float64
def advise(
    law: Law,
    reference: Reference | None,
    q: Float[ArrayLike, " n"],
    *,
    Ts: Number,
    method: MethodLike = DEFAULT,
    stage: Stage = picard(5),
    drive: Drive | None = None,
    speed: float = SPEED,
) -> Advice:
    """Gains for a robot, what they cost, and settings for the same loop in other libraries. In float64.

    Args:
      law, reference, q: the loop at rest, as for `recommend`. Ts: sampling time [s]. method, stage: as for `solve`.
      drive: what lies between command and motion; None: unknown. The stability limits are then those of drives without
        delay, and a gain is recommended for a dead time of 30 ms and a lag of 100 ms.
      speed: of the tip [m/s], for the joint velocities.
    Raises: ArgumentError where no gain is stable, as with a null-space velocity that is unstable by itself, or with
      some servos whose commands begin at the measured joints.
    """
    Ts, speed = float(errors.number("Ts", Ts, positive=True)), float(errors.number("speed", speed, at_least=0))
    method, known = named(method), Drive() if drive is None else drive
    loop = loop_at_rest(law, reference, q, method, stage, known)
    found = analysis_of(loop, Ts)
    gains, by = found.gains, loop._replace(method=EE)
    euler = gains if method.name == EE.name else recommendation_of(by, Ts)
    assert gains.z_monotone is not None and gains.z_recommended is not None  # as Ts is given
    assert euler.z_monotone is not None and euler.z_recommended is not None
    safe, chosen, by_euler, z_largest = known, gains.z_recommended, euler.z_recommended, gains.z_largest
    recommended = at_any = None
    if drive is None:
        safe = Drive(delay=min(ASSUMED_DELAY / Ts, MOST - SPARE), lag=ASSUMED_LAG)
        stable, recommended = shares(safe.delay, ASSUMED_LAG, Ts)
        chosen = min(chosen, removing(loop, recommended, Ts))
        _require_null(loop, safe, chosen, Ts)
        by_euler = min(by_euler, removing(by, recommended, Ts)) * (not _null_growth(by, safe, by_euler, Ts))
        z_largest = min(z_largest, removing(loop, stable, Ts))
    if bounded_rates(law):  # elsewhere tasks may get more of what they ask for than here
        at_any = at_any_posture(loop, Ts, recommended)
        euler_at_any = at_any if euler is gains else at_any_posture(by, Ts, recommended)
        chosen, by_euler = min(chosen, at_any[1]), min(by_euler, euler_at_any[1])
    chosen, by_euler = min(chosen, MOST_Z), min(by_euler, MOST_Z)
    if chosen == 0:
        raise _no_gain(loop, gains, Ts)
    return Advice(
        largest_stable_alpha=gains.z_largest / Ts,
        fastest_monotone_alpha=gains.z_monotone / Ts,
        recommended_alpha=chosen / Ts,
        assumed_dead_time=safe.delay * Ts if drive is None else None,
        assumed_lag=ASSUMED_LAG if drive is None else None,
        assumption=_assumption(loop, drive, safe, chosen, Ts),
        reason=_reason(gains, chosen, drive),
        now=gain_at(loop._replace(drive=safe), found.margin.z, Ts, z_largest) if found.margin.z < z_largest else None,
        recommended=gain_at(loop._replace(drive=safe), chosen, Ts, z_largest),
        explicit_euler={
            "largest_stable_alpha": euler.z_largest / Ts,
            "fastest_monotone_alpha": euler.z_monotone / Ts,
            "recommended_alpha": by_euler / Ts,
        },
        recommended_method=DEFAULT.name,
        speed=speed,
        joint_speed=_joint_speed(loop, Ts, speed),
        settings=settings(functools.partial(_borne, by, safe, by_euler, Ts), drive, safe, Ts) if by_euler else {},
        notes=(*_moved(law, loop, found.spectrum, chosen / Ts), *_notes(loop, drive, chosen, Ts)),
        stack=None if at_any is None else stack_advice(loop, safe, at_any, Ts),
        limits=limit_advice(law, safe, Ts),
        walls=wall_advice(loop, Ts, speed),
        analysis=found,
    )


@functools.lru_cache(maxsize=64)
def shares(delay: float, lag: float, Ts: float) -> tuple:
    """Shares of an error that a step may remove through dead time [samples] and a lag [s]: stable, recommended."""
    found = driven_limits("EE", Ts=Ts, drive=Drive(delay=delay, lag=lag))
    return found.stable, min(found.recommended, MOST_Z)


def _no_gain(loop, gains, Ts):
    """The error with the reason why no gain can be recommended."""
    if loop.drive.feedback == "rebased":
        late = loop.drive.lumped.delay
        must = (
            "be commanded (begin each position at the last command), or the command be a velocity: from "
            f"{in_samples(min(bearable_delay(loop.drive, Ts), late), Ts)} of dead time on this servo may swing and "
            "grow at any small gain"
        )
        return errors.fail("feedback", must, f"is rebased, with {in_samples(late, Ts)}")
    name = "law" if loop.law.null_velocity is None else "null_velocity"
    what, why = "stable", gains.limit
    if gains.z_largest > 0:
        own = np.abs(loop.modes(np.array([1e-9]), Ts)[0].sum(-1)).max()
        what, why = "without overshoot", f"by itself, through this J#, one step removes {own:.3g} of an error"
    return errors.fail(name, f"leave some gain {what} at Ts = {Ts:g} s: less of it, or a shorter Ts", why)


def _borne(loop, safe, known, Ts, drive) -> float:
    """The recommended z of a loop through a drive: known of one, the same for any posture of a stack."""
    if drive == safe:
        return known
    if bounded_rates(loop.law):
        return at_any_posture(loop._replace(drive=drive), Ts)[1]
    return without_overshoot(loop, longer(drive), Ts, MOST_Z, MOST_Z)


def removing(loop, share: float, Ts: float) -> float:
    """z up to MOST_Z with which a step removes a share of an error at rest, in any direction of the task."""
    return first_above(lambda z: np.abs(loop.modes(z, Ts)[0].sum(-1)).max(-1), share, MOST_Z, POINTS)


def gain_at(loop, z: float, Ts: float, z_largest: float) -> Gain:
    """What a gain of z does in a loop at rest, see `loop_at_rest`. Args: z_largest: the largest stable one."""
    (steps,), (null,) = loop.prompt.modes(np.array([z]), Ts)  # of a square arm each joint is one
    return gain_of(steps, loop.drive, Ts, z, z_largest, null if callable(loop.law.null_velocity) else ())


def _null_growth(loop, drive, z: float, Ts: float) -> float:
    """By what a step multiplies a motion in the null space through a drive, where that grows; else 0."""
    factor = float(loop._replace(drive=drive).radii(np.array([max(z, 1e-9)]), Ts)[1][0])
    return factor if factor > UNSTABLE else 0.0


def _require_null(loop, assumed, z: float, Ts: float) -> None:
    """Raise ArgumentError where a motion in the null space grows through assumed drives."""
    if factor := _null_growth(loop, assumed, z, Ts):
        drives = f"drives with {_ms(assumed.delay * Ts)} of dead time and a lag of {_ms(ASSUMED_LAG)}"
        must = f"be stable on {drives}, which are assumed: less of it, or give the drives"
        raise errors.fail("null_velocity", must, f"multiplies a motion by {factor:.4g} each step")


def _joint_speed(loop, Ts, speed) -> float:
    """Largest |J#_i v|/limit_i over the directions of v."""
    lengths, limit = loop.law.task.lengths, np.asarray(loop.law.chain.velocity_limit, float)
    if not lengths or not np.isfinite(limit).any():
        return np.nan
    rows = loop.maps(np.ones(1), np.full(1, Ts))[1]
    return float(np.max(np.linalg.norm(np.linalg.pinv(rows)[:, lengths], axis=1) * speed / limit))


# --- in words -----------------------------------------------------------------------------------------


_MEASURE = (
    "Measure yours: command a step of all joints at once, record commands and positions, and run `cnclik diagnose "
    "LOG.csv --step`; it prints the options to give here."
)


def _ms(seconds) -> str:
    return f"{1e3 * seconds:.3g} ms"


def _assumption(loop, drive, safe, chosen, Ts) -> str:
    if drive is None:
        return (
            f"Assumed, as nothing is known of your drives: {_ms(safe.delay * Ts)} of dead time and a lag of "
            f"{_ms(ASSUMED_LAG)}, as many position servos have. {_MEASURE} For drives without delay, as in a purely "
            "kinematic simulation, give a dead time of 0 (--delay 0, in Python drive=ck.Drive())."
        )
    said, late = assumed_of(drive, Ts), drive.lumped.delay
    if not (said and late):
        return said
    lagging = min(chosen, removing(loop, shares(late, ASSUMED_LAG, Ts)[1], Ts)) / Ts
    return (
        f"{said} With servos that lag by {1e3 * ASSUMED_LAG:.3g} ms, as many do, a step would overshoot: "
        f"use at most {lagging:.3g} 1/s for them. {_MEASURE}"
    )


def _reason(gains, chosen, drive) -> str:
    if drive is None:
        return "the largest gain that does not overshoot on the assumed drives, even with one more sample of dead time"
    if drive.feedback == "commanded":
        return (
            "the commands do not overshoot, even if the loop uses them one sample later. The loop uses its own "
            "commands only: dead time does not limit the gain, and the robot follows with that delay"
        )
    if chosen == MOST_Z < gains.z_recommended:
        return f"no gain overshoots; above z = {MOST_Z:g} noise increases more than the settling time decreases"
    late = drive.lumped.delay
    return f"the largest gain that does not overshoot, even with one more sample of dead time than the {late:g} given"


def _moved(law, loop, now, alpha):
    """Remarks on a null-space velocity: where the loop does not stay in this posture, and on the error that the motion
    which is removed at rest would leave."""
    if law.null_velocity is None:
        return
    if loop.growing().any():
        grows = f"a motion grows by {now.null_radius:.6g} each step, whatever the gain"
        where = "Ask again at the posture where it rests."
        yield f"In the null space the arm drifts away from this posture ({grows}). {where}"
    velocity = np.asarray(drift_of_numbers(law, loop.held, loop.q))
    pull = np.linalg.norm(loop.maps(np.ones(1), np.ones(1))[1] @ velocity)
    if not pull / alpha < rest_tolerance(law.chain):
        yield (
            f"With this J# the null-space velocity disturbs the task by {pull:.3g} [m/s, rad/s]: an error of about "
            f"{pull / alpha:.3g} [m, rad] remains at the recommended gain. Use inverse=pseudoinverse(), less damping "
            "or a slower null-space velocity."
        )


def _notes(loop, drive, chosen, Ts):
    """Remarks on what these numbers ignore."""
    if np.abs(np.imag(loop.modes(np.array([chosen]), Ts)[0])).max(initial=0.0) > 1e-9:
        yield (
            "The gain matrix rotates the error (complex eigenvalues), so that overshoot means little. Keep well below "
            "the largest stable gain."
        )
    if own := around_formula(loop.law, Ts):
        yield f"The settings for other libraries are gains only. There, set what this law has as well: {own}."
    if drive is not None and drive.feedback == "rebased":
        begins = "Each position command starts at the measured joints"
        yield f"{begins}: {REBASED}, and steady errors of the drives add up. {WHERE}."
