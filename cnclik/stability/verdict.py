"""Verdict: what a run of a loop did, in one sentence with its numbers and the remedy.

Two things are asked. What did the run do: did its error shrink, stay, grow; did its joints go back and forth? And
why: what are the eigenvalues of the loop's own step (law, inverse, damping, limits, gain, method and stage as they are)
where the run ended? The thresholds are the constants below and in `observed`; quarters are the run's, as for `outcome`.
"""

import enum
from typing import NamedTuple

import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive, check_drive
from cnclik.integrate.method import DEFAULT
from cnclik.integrate.stage import picard
from cnclik.integrate.status import Status
from cnclik.integrate.trajectory import check_run, one_lane
from cnclik.law import reference as ref
from cnclik.law.law import Law, check_loop
from cnclik.precision import in_float64
from cnclik.record import record
from cnclik.robot.chain import REVOLUTE
from cnclik.stability import reasons
from cnclik.stability.driven import each_drive, modes_of, overshoot
from cnclik.stability.linear import checked
from cnclik.stability.local import Instant, maps, radii, resting, targets
from cnclik.stability.observed import GROWN, Observed, observe, rms
from cnclik.stability.reasons import UNSTABLE, WILD
from cnclik.stability.spectrum import directions, spectrum_of

REVERSING = 0.15  # share of the joint speed that the next step takes back, from which on a loop shakes
OVERSHOOT = 0.4  # of an error by which a loop lands beyond the target, from which on it rings
FEW = 8  # instants of a run that is judged by its step's eigenvalues alone where these are unstable
LOOKED_AT = 9  # instants of the last quarter whose target is looked at


class Behaviour(enum.StrEnum):
    """What a run did."""

    SETTLED = "settled"
    LAGGING = "settled with lag"
    CONVERGING = "converging"
    RINGING = "ringing"
    SHAKING = "shaking"
    DIVERGING = "diverging"
    AT_LIMIT = "stuck at a limit"
    OUT_OF_REACH = "out of reach"
    STALLED = "no progress"


_UNSTABLE_KINDS = (Behaviour.SHAKING, Behaviour.DIVERGING)  # too fast because of that


@record
class Verdict:
    """What a run did, and what to do about it.

    Attributes:
      kind: a `Behaviour`.
      sentence: what it did, with the numbers, and the remedy.
      remedy: that part of it; empty where there is nothing to mend.
      radius: largest |eigenvalue| of one step over the task's directions, where the run ended (diverged: began).
      null_radius: the same over the null space of J; near 1 where nothing acts there.
      error: largest ‖e‖ in the last quarter [m, rad].
    """

    kind: Behaviour
    sentence: str
    remedy: str
    radius: float
    null_radius: float
    error: float

    def __str__(self):
        return self.sentence


@in_float64
def verdict(law, reference, run, *, Ts, method=DEFAULT, stage=picard(5), drive=Drive()) -> Verdict:
    """What a run did, why, and what to do about it: pure description, nothing is run again. In float64.

    Args:
      law, reference, Ts, method, stage, drive: what was run, see `solve`.
      run: its `Trajectory`, one lane.
    Raises: ArgumentError for a run of several lanes or of no step, or one with another Ts.
    """
    check_loop(law, reference)
    method, stage = checked(method, stage)
    one_lane(run)
    check_run(run, law)
    if len(run.residual) == 0:
        raise errors.fail("run", "have at least one step", "has none")
    step = float(run.t[-1] - run.t[0]) / len(run.residual)
    if not np.isclose(errors.number("Ts", Ts, positive=True), step, rtol=1e-2):
        raise errors.fail("Ts", f"be the run's, {step:.6g} s", f"is {float(Ts):g}")
    case = _case(law, reference, run, float(Ts), method, stage, check_drive(drive, law.chain.n))
    kind, what, remedy = _judged(case)
    if case.seen.over_velocity and kind not in _UNSTABLE_KINDS:
        what, remedy = f"{what}; {case.seen.over_velocity}", remedy or reasons.faster_than_its_joints(case)
    return Verdict(
        kind=kind,
        sentence=f"{kind}: {what}." + (f" {remedy[0].upper()}{remedy[1:]}." if remedy else ""),
        remedy=remedy,
        radius=case.radius,
        null_radius=case.null_radius,
        error=np.inf if case.seen.bad is not None else case.seen.largest,
    )


@in_float64
def prepare(law, reference, q, *, Ts, method=DEFAULT, stage=picard(5), drive=Drive()) -> None:
    """Compile what `verdict` will ask of such a run: beside other work, for who is going to ask."""
    _, end, _ = _instants(law, reference, np.tile(q, (LOOKED_AT + 1, 1)), np.zeros(LOOKED_AT + 1))
    maps(law, end, np.ones(1), float(Ts), *checked(method, stage))


class _Case(NamedTuple):
    """A run, the loop behind it, and what its step does where the run ended."""

    law: Law
    loop: tuple  # Ts, method, stage, drive
    seen: Observed
    t: np.ndarray  # (N + 1,)
    end: Instant
    start: Instant
    target: np.ndarray | None  # the position wanted at the end
    turn: np.ndarray | None  # and the rotation
    behind: float  # how far the target moves in a step, over the last quarter
    rows: np.ndarray  # J (m, n) at the end
    radius: float
    null_radius: float
    overshoot: float  # how far beyond the target an error lands, as a share of itself
    e: np.ndarray  # weighted error at the end
    size: str  # of the late error, in words


def _case(law, reference, run, Ts, method, stage, drive) -> _Case:
    seen = observe(law, run, Ts)
    t, q, e = (np.asarray(v, float) for v in (run.target_time, run.q, run.e))
    wild = seen.bad is not None or np.abs(q[-1]).max() > WILD
    last = 0 if wild else len(run.residual)
    some = np.linspace(max(last - len(seen.late) + 1, 0), last, LOOKED_AT).round().astype(int)
    at = np.append(some, 0)  # the last quarter, its end, the start
    wanted, end, start = _instants(law, reference, q[at], t[at])
    moved, rows = maps(law, end, np.ones(1), Ts, method, stage)
    task, radius, across = np.full(1, np.inf), np.inf, np.inf
    if np.isfinite(moved[0]).all():
        found = spectrum_of(moved[0], rows)
        task, radius, across = found.task, found.radius, found.null_radius
    if drive.prompt or not np.isfinite(radius):
        # |λ| to the power of the steps that half a turn takes.
        sizes, angle = np.minimum(np.abs(task), 1.0), np.abs(np.angle(task))
        beyond = np.max(np.where(angle > 0, sizes ** (np.pi / np.maximum(angle, 1e-9)), 0.0), initial=0.0)
    else:
        radius = float(radii(law, end, np.ones(1), Ts, method, stage, drive)[0])
        steps = modes_of(moved, directions(rows)[2], Drive())[0]
        beyond = max(overshoot(steps, one, Ts) for one in each_drive(drive)) if radius < 1 else 1.0
    late, p = e[: seen.bad][-len(seen.late) :], len(law.task.position)
    parts = ((late[:, :p], "m"), (late[:, p:], "rad"))
    return _Case(
        law=law,
        loop=(Ts, method, stage, drive),
        seen=seen,
        t=t,
        end=end,
        start=start,
        target=None if wanted[0] is None else wanted[0][-2],
        turn=None if wanted[1] is None else wanted[1][-2],
        behind=rms(np.linalg.norm(wanted[2][:-1], axis=1)) * Ts,
        rows=rows,
        radius=radius,
        null_radius=across,
        overshoot=float(beyond),
        e=e[last] if law.task.weights is None else e[last] * np.asarray(law.task.weights, float),
        size=" and ".join(f"{np.linalg.norm(v, axis=1).max():.3g} {unit}" for v, unit in parts if v.size),
    )


def _instants(law, reference, q, t):
    """What is wanted at times t (k,), and the last two instants of a run that is at q (k, n) then."""
    wanted = [v if v is None else np.asarray(v) for v in targets(reference, law.task, t)]

    def instant(k):
        position, rotation, velocity = (v if v is None else v[k] for v in wanted)
        return Instant(q[k], ref.with_feedforward(ref.hold(position, rotation), velocity))

    return wanted, instant(-2), instant(-1)


# --- what the run did, first match first: (kind, what it did, remedy) -----------------------------------


def _judged(case):
    law, seen, error = case.law, case.seen, f"the late error is up to {case.size}"
    radius = f"the loop's spectral radius at the end is {case.radius:.3g}"
    if seen.bad is not None:
        what = f"not finite from t = {case.t[seen.bad]:.4g} s on (step {seen.bad})"
        return Behaviour.DIVERGING, what, reasons.lower(case)
    if not np.any(np.asarray(law.alpha)):
        return Behaviour.STALLED, f"the gain is 0, so errors stay; {error}", "raise alpha"
    drive = case.loop[-1]
    if not drive.prompt and len(case.t) - 2 <= drive.delay + drive.measurement_delay:
        return Behaviour.STALLED, f"the run is over before its dead time is; {error}", "run for more steps"
    moving = case.behind > seen.floor
    shrinks = seen.shrinks and not (
        seen.reversing > REVERSING and not seen.arrived and _unstable(case, case.end, case.start)
    )
    restless = not (moving or seen.arrived or shrinks) and case.radius > UNSTABLE
    lasting = not seen.fades if seen.arrived else not (seen.soars or shrinks)
    if seen.visible and lasting and (seen.reversing > REVERSING or restless):
        kinds = {j.kind for j in law.chain.joints}
        unit = "rad" if kinds == {REVOLUTE} else "m" if REVOLUTE not in kinds else "rad or m"
        fast = f"joint velocities up to {seen.joint_speed:.3g} {unit}/s go back and forth"
        if seen.arrived and case.null_radius > 1:
            inside = f"in the null space of the task, where the spectral radius is {case.null_radius:.3g}"
            return Behaviour.SHAKING, f"{fast} {inside}", reasons.LESS_NULL
        if not seen.arrived and (gap := reasons.gap(case)):
            return Behaviour.OUT_OF_REACH, f"{gap}, and {fast}", reasons.reach_remedy(case)
        return Behaviour.SHAKING, f"{fast}, {error}; {radius}", reasons.lower(case)
    limited = law.limits is not None and seen.often(Status.AT_LIMIT)
    if limited and not (seen.arrived or seen.shrinks or (moving and seen.largest <= case.behind)):
        what, remedy = reasons.held_by(case, moving)
        return Behaviour.AT_LIMIT, f"{what}, and {error}", remedy
    grown = seen.largest > max(GROWN * seen.size[0], seen.floor) and not seen.shrinks
    if (seen.grows and not moving) or ((seen.grows or grown) and case.radius > UNSTABLE):
        return Behaviour.DIVERGING, f"the error has grown to {case.size}; {radius}", reasons.lower(case)
    if case.overshoot > OVERSHOOT and seen.swings >= 2 and case.radius <= UNSTABLE:
        swings = f"the error swings from side to side and keeps {case.overshoot:.2g} of itself each time"
        return Behaviour.RINGING, f"{swings}; {error}", reasons.faster(case)
    too_few = len(seen.size) <= FEW  # for what its error did to tell
    if too_few and _unstable(case, case.end):
        return Behaviour.DIVERGING, f"{error} so far, but any disturbance grows: {radius}", reasons.lower(case)
    return (_moving if moving else _held)(case, error, radius)


def _unstable(case, *rests):
    """Whether the loop is unstable by its last step, and as it would be at rest at one of these instants."""
    sizes = (radii(*resting(case.law, at), np.ones(1), *case.loop)[0] for at in rests)
    return case.radius > UNSTABLE and any(size > UNSTABLE for size in sizes)


def _held(case, error, radius):
    seen = case.seen
    if seen.arrived:
        unstable = max(case.radius, case.null_radius if callable(case.law.null_velocity) else 0.0)
        if unstable > UNSTABLE:
            what = f"at rest, but any disturbance grows: the loop's spectral radius is {unstable:.3g}"
            return Behaviour.DIVERGING, what, reasons.lower(case)
        return Behaviour.SETTLED, f"{error}; {radius}", ""
    if seen.shrinks:
        return Behaviour.CONVERGING, f"{error} and shrinking; {radius}", "run for more steps"
    if reasons.leaks(case):
        return Behaviour.STALLED, f"{error} and stays: {reasons.PULLED}", reasons.LESS_PULL
    if reasons.hopeless(case) or reasons.beyond(case) > 0:
        return Behaviour.OUT_OF_REACH, f"{error}, and {reasons.why_not(case)}", reasons.reach_remedy(case)
    if gap := reasons.gap(case):
        return Behaviour.OUT_OF_REACH, f"{error}; {gap}", reasons.reach_remedy(case)
    if np.all(np.diff(seen.late) < 0) and case.radius < 1:
        return Behaviour.CONVERGING, f"slowly, {error}; {radius}", "raise alpha, or run for more steps"
    if seen.often(Status.NEAR_SINGULAR):
        remedy = "start elsewhere, or move the target; damped(...) keeps velocities small"
        return Behaviour.STALLED, f"{error}, next to a singularity", remedy
    return Behaviour.STALLED, f"{error} and stays; {radius}", reasons.lower(case)


def _moving(case, error, radius):
    lag = rms(case.seen.late)
    if lag <= max(case.behind, case.seen.floor):
        if case.radius > UNSTABLE:
            return Behaviour.DIVERGING, f"{error} so far, but any disturbance grows: {radius}", reasons.lower(case)
        return Behaviour.SETTLED, f"it follows, {error}; {radius}", ""
    if reasons.hopeless(case):
        return Behaviour.OUT_OF_REACH, f"{error}, and {reasons.why_not(case)}", reasons.reach_remedy(case)
    if case.seen.shrinks:
        return Behaviour.CONVERGING, f"{error} and shrinking; {radius}", "run for more steps"
    what = f"{error}, {lag / case.behind * case.loop[0]:.3g} s behind a target that moves on; {radius}"
    if float(case.law.feedforward) != 1.0:
        return Behaviour.LAGGING, what, "feed the velocity forward (feedforward=1)"
    if case.loop[-1].prompt:
        return Behaviour.LAGGING, what, "raise alpha"
    return Behaviour.LAGGING, what, "raise alpha, no further than `stability` recommends for these drives"
