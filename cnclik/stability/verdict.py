"""Verdict: what a run of a loop did, in one sentence with its numbers and the remedy.

Two things are asked. What did the run do: did its error shrink, stay, grow; did its joints go back and forth? And
why: what are the eigenvalues of the loop's own step (law, inverse, damping, limits, gain, method and stage as they are)
where the run ended? The thresholds are the constants below and in `observed`; quarters are the run's, as for `outcome`.
"""

import enum

import numpy as np

from cnclik import errors
from cnclik.integrate.method import EE
from cnclik.integrate.stage import Picard, picard
from cnclik.integrate.status import Status
from cnclik.law import reference as ref
from cnclik.law.law import Law
from cnclik.law.limits import Saturated
from cnclik.precision import in_float64
from cnclik.record import record
from cnclik.robot.chain import REVOLUTE
from cnclik.robot.posture import arm_length
from cnclik.stability.linear import named
from cnclik.stability.local import GAINS, Instant, fastest_share, maps, stable_share, targets
from cnclik.stability.observed import GROWN, observe, rms
from cnclik.stability.spectrum import at_rest, null_radius, spectrum_of

REVERSING = 0.15  # share of the joint speed that the next step takes back, from which on a loop shakes
OVERSHOOT = 0.4  # of an error by which a loop lands beyond the target, from which on it rings
UNSTABLE = 1.01  # spectral radius beyond which a loop that seems to rest doesn't: smaller excess is the error's own
WILD = 1e3  # joint values, in rad or m, of a run that has left its senses: it is judged where it began
GRADIENT = 0.02  # ‖Jᵀe‖/(‖J‖‖e‖) below which no joint motion reduces the error


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
def verdict(law, reference, run, *, Ts, method=EE, stage=picard(5)) -> Verdict:
    """What a run did, why, and what to do about it: pure description, nothing is run again. In float64.

    Args:
      law, reference, Ts, method, stage: what was run, see `solve`.
      run: its `Trajectory`, one lane.
    Raises: ArgumentError for a run of several lanes or of no step.
    """
    if not isinstance(law, Law):
        raise errors.fail("law", "be a Law", f"is {type(law).__name__}")
    method, stage = named(method, stage)
    if np.ndim(run.residual) != 1 or len(run.residual) == 0:
        raise errors.fail("run", "be one run of at least one step", f"has steps of shape {np.shape(run.residual)}")
    seen = observe(law, run, float(Ts))
    return _Judge(law, reference, run, float(Ts), method, stage, seen).verdict()


class _Judge:
    """The run and the loop behind it, and the questions asked of them in turn."""

    def __init__(self, law, reference, run, Ts, method, stage, seen):
        self.law, self.run, self.Ts, self.method, self.stage, self.seen = law, run, Ts, method, stage, seen
        wild = seen.bad is not None or np.abs(np.asarray(run.q)[-1]).max() > WILD
        last = 0 if wild else len(run.residual)
        self.t = np.asarray(run.t, float)
        some = np.linspace(max(last - len(seen.late) + 1, 0), last, 9).round().astype(int)
        at = np.append(some, 0)  # the last quarter, its end, the start
        position, rotation, velocity = targets(reference, law.task, self.t[at])
        self.speed = rms(np.linalg.norm(np.asarray(velocity)[:-1], axis=1))

        def instant(k):
            held = ref.hold(*(None if v is None else np.asarray(v)[k] for v in (position, rotation)))
            return Instant(np.asarray(run.q, float)[at[k]], ref.with_feedforward(held, np.asarray(velocity)[k]))

        self.end, self.start = instant(-2), instant(-1)
        self.target = None if position is None else np.asarray(position)[-2]
        moved, self.rows = maps(law, self.end, np.ones(GAINS), Ts, method, stage)
        self.finite = bool(np.isfinite(moved[0]).all())
        found = spectrum_of(moved[0], self.rows) if self.finite else None
        self.task = found.task if self.finite else np.array([np.inf])
        self.radius = found.radius if self.finite else np.inf
        self.null_radius = found.null_radius if self.finite else np.inf
        # |λ| to the power of the steps that half a turn takes: how far beyond the target an error lands.
        size, angle = np.minimum(np.abs(self.task), 1.0), np.abs(np.angle(self.task))
        self.overshoot = float(np.max(np.where(angle > 0, size ** (np.pi / np.maximum(angle, 1e-9)), 0.0), initial=0.0))
        weights = 1.0 if law.task.weights is None else np.asarray(law.task.weights, float)
        self.e = weights * np.asarray(run.e, float)[last]

    # --- what the run did, first match first ---

    def verdict(self) -> Verdict:
        kind, what, remedy = self._kind()
        sentence = f"{kind}: {what}." + (f" {remedy[0].upper()}{remedy[1:]}." if remedy else "")
        return Verdict(
            kind=kind,
            sentence=sentence,
            remedy=remedy,
            radius=float(self.radius),
            null_radius=float(self.null_radius),
            error=np.inf if self.seen.bad is not None else self.seen.largest,
        )

    def _kind(self):
        seen, radius = self.seen, f"the loop's spectral radius at the end is {self.radius:.3g}"
        if seen.bad is not None:
            k = seen.bad
            return Behaviour.DIVERGING, f"not finite from t = {self.t[k]:.4g} s on (step {k})", self._lower()
        if not np.any(np.asarray(self.law.alpha)):
            return Behaviour.STALLED, f"the gain is 0, so errors stay; {self._error()}", "raise alpha"
        moving = self.speed * self.Ts > seen.floor
        restless = not (moving or seen.arrived or seen.shrinks) and self.radius > UNSTABLE
        lasting = not seen.fades if seen.arrived else not (seen.soars or seen.shrinks)
        if seen.visible and lasting and (seen.reversing > REVERSING or restless):
            fast = f"joint velocities up to {seen.joint_speed:.3g} {self._unit()}/s go back and forth"
            if seen.arrived and self.null_radius > 1:
                inside = f"in the null space of the task, where the spectral radius is {self.null_radius:.3g}"
                return Behaviour.SHAKING, f"{fast} {inside}", "reduce the gain of the null-space velocity"
            return Behaviour.SHAKING, f"{fast}, {self._error()}; {radius}", self._lower()
        limited = self.law.limits is not None and seen.often(Status.AT_LIMIT)
        held = limited and not seen.arrived and not seen.shrinks
        if held and not (moving and seen.largest <= self.speed * self.Ts):
            remedy = "choose another start, posture or path"
            if not isinstance(self.law.limits, Saturated):
                remedy += ", or limits saturation(), which lets other joints take over"
            return Behaviour.AT_LIMIT, f"{self._limit()}, and {self._error()}", remedy
        grown = seen.largest > max(GROWN * seen.size[0], seen.floor) and not seen.shrinks
        if (seen.grows and not moving) or ((seen.grows or grown) and self.radius > UNSTABLE):
            return Behaviour.DIVERGING, f"the error has grown to {self._size()}; {radius}", self._lower()
        if self.overshoot > OVERSHOOT and seen.swings >= 2 and self.radius <= UNSTABLE:
            swings = f"the error swings from side to side and keeps {self.overshoot:.2g} of itself each time"
            return Behaviour.RINGING, f"{swings}; {self._error()}", self._faster()
        return self._moving(radius) if moving else self._held(radius)

    def _held(self, radius):
        seen = self.seen
        if seen.arrived:
            unstable = max(self.radius, self.null_radius if callable(self.law.null_velocity) else 0.0)
            if unstable > UNSTABLE:
                what = f"at rest, but any disturbance grows: the loop's spectral radius is {unstable:.3g}"
                return Behaviour.DIVERGING, what, self._lower()
            return Behaviour.SETTLED, f"{self._error()}; {radius}", ""
        if seen.shrinks:
            return Behaviour.CONVERGING, f"{self._error()} and shrinking; {radius}", "run for more steps"
        if self._hopeless() or self._beyond() > 0:
            return Behaviour.OUT_OF_REACH, f"{self._error()}, and {self._reach()}", self._reach_remedy()
        if np.all(np.diff(seen.late) < 0) and self.radius < 1:
            return Behaviour.CONVERGING, f"slowly, {self._error()}; {radius}", "raise alpha, or run for more steps"
        if seen.often(Status.NEAR_SINGULAR):
            what = f"{self._error()}, next to a singularity"
            return Behaviour.STALLED, what, "start elsewhere, or move the target; damped(...) keeps velocities small"
        return Behaviour.STALLED, f"{self._error()} and stays; {radius}", self._lower()

    def _moving(self, radius):
        seen, behind = self.seen, self.speed * self.Ts
        lag = rms(seen.late)
        if lag <= max(behind, seen.floor):
            if self.radius > UNSTABLE:
                what = f"{self._error()} so far, but any disturbance grows: {radius}"
                return Behaviour.DIVERGING, what, self._lower()
            return Behaviour.SETTLED, f"it follows, {self._error()}; {radius}", ""
        if self._hopeless():
            return Behaviour.OUT_OF_REACH, f"{self._error()}, and {self._reach()}", self._reach_remedy()
        if seen.shrinks:
            return Behaviour.CONVERGING, f"{self._error()} and shrinking; {radius}", "run for more steps"
        what = f"{self._error()}, {lag / self.speed:.3g} s behind a target that moves on; {radius}"
        slow = float(self.law.feedforward) != 1.0
        return Behaviour.LAGGING, what, "feed the velocity forward (feedforward=1)" if slow else "raise alpha"

    # --- its parts in words ---

    def _error(self):
        return f"the error is {self._size()}"

    def _size(self):
        """The late error with its units."""
        p, late = len(self.law.task.position), np.asarray(self.run.e, float)[: self.seen.bad][-len(self.seen.late) :]
        parts = [(late[:, :p], "m"), (late[:, p:], "rad")]
        sizes = [f"{np.linalg.norm(v, axis=1).max():.3g} {unit}" for v, unit in parts if v.shape[1]]
        return " and ".join(sizes)

    def _unit(self):
        kinds = {j.kind for j in self.law.chain.joints}
        return "rad" if kinds == {REVOLUTE} else "m" if REVOLUTE not in kinds else "rad or m"

    def _limit(self):
        chain, q = self.law.chain, self.end.q
        near = 1e-3 * (1 + np.abs(q))
        stopped = [
            name
            for name, value, low, high, d in zip(chain.joint_names, q, chain.lower, chain.upper, near, strict=True)
            if value <= low + d or value >= high - d
        ]
        if stopped:
            return f"{', '.join(stopped)} {'is' if len(stopped) == 1 else 'are'} at a limit"
        return "joints are held at their velocity limits"

    def _hopeless(self):
        """Whether no joint motion reduces the error."""
        size = np.linalg.norm(self.e)
        push = np.linalg.norm(self.rows.T @ self.e)
        return bool(size > self.seen.floor and push < GRADIENT * np.linalg.norm(self.rows, 2) * size)

    def _beyond(self):
        """By how much the target lies beyond the stretched arm [m]; negative where it doesn't, or that isn't known."""
        if self.target is None:
            return -np.inf
        base = np.array([float(v) for v in self.law.chain.joints[0].origin.position])
        base = base if len(self.target) == 3 else base[list(self.law.task.linear)]
        return float(np.linalg.norm(self.target - base) - arm_length(self.law.chain))

    def _reach(self):
        beyond, (m, n) = self._beyond(), self.rows.shape
        if beyond > 0:
            return f"the target is {beyond:.3g} m beyond the stretched arm"
        if np.linalg.matrix_rank(self.rows) < m and m > n:
            return f"the task asks for {m} coordinates of an arm with {n} joints"
        return "no joint motion makes it smaller"

    def _reach_remedy(self):
        m, n = self.rows.shape
        if m > n:
            return "ask for fewer coordinates"
        if not np.any(self._damping()):
            return "bring the target nearer, or use damped(...) and error_clamp to stop quietly before it"
        return "bring the target nearer, or start from another posture"

    def _damping(self):
        return np.asarray(getattr(self.law.inverse, "damping", 0.0), float)

    def _lower(self):
        """What stops a loop that shakes or diverges: less gain, by what is stable at rest at both ends of the run."""
        law = self.law
        ends = [at for at in (self.end, self.start) if np.isfinite(at.q).all() and np.abs(at.q).max() <= WILD]
        ends = [Instant(at.q, at_rest(law, None, at.q)) for at in ends]
        if callable(law.null_velocity) and any(self._null_radius(at) > UNSTABLE for at in ends):
            return "reduce the gain of the null-space velocity"
        share = min((stable_share(law, at, self.Ts, self.method, self.stage) for at in ends), default=1.0)
        if 0 < share < 1:
            remedy = f"reduce {self._gain(share)}"
            if self.method.implicit and isinstance(self.stage, Picard):
                remedy += ", or solve the stage with chord(2)"
            return remedy
        if share == 0:
            return "no gain is stable in this posture: use damped(...)"
        if self._beyond() > 0:
            return f"{self._reach()}: bring it nearer, or use damped(...) and error_clamp"
        if self.seen.often(Status.NEAR_SINGULAR):
            return "it is next to a singularity: use damped(...), and error_clamp if the target is far"
        return "the error is too large for a gain that is stable near rest: clamp it (error_clamp), or reduce alpha"

    def _null_radius(self, at):
        moved, rows = maps(self.law, at, np.ones(GAINS), self.Ts, self.method, self.stage)
        return float(null_radius(moved[:1], rows)[0])

    def _faster(self):
        resting = Instant(self.end.q, at_rest(self.law, None, self.end.q))
        share = fastest_share(self.law, resting, self.Ts, self.method, self.stage)
        return f"reduce {self._gain(share, 'to about')}, which settles soonest" if share < 1 else "reduce alpha"

    def _gain(self, share, word="below"):
        alpha = np.asarray(self.law.alpha, float)
        if alpha.ndim == 0:
            return f"alpha {word} {share * float(alpha):.3g} 1/s at this Ts"
        return f"alpha {word} {share:.2g} of what it is at this Ts"
