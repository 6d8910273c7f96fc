"""Trial: what a remedy changes is changed and the loop is run again, before the remedy is named."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from cnclik.integrate import stage as stages
from cnclik.integrate.drive import Drive
from cnclik.integrate.method import named
from cnclik.integrate.solve import solve
from cnclik.integrate.trajectory import truncate
from cnclik.law import inverse, limits
from cnclik.law.reference import hold
from cnclik.record import record, replace
from cnclik.stability.observed import ARRIVED

LEAST_TRIED = 1 << 12  # steps that a trial takes, at least; another power of two where more are asked for
MOST_TRIED = 1 << 14  # and at most
BETTER = 0.9  # ratio of two errors below which a loop does better
GONE = 0.25  # and below which a longer run has shrunk it
CALMER = 0.4  # ratio of two errors, or of the joint velocities that reverse, below which a loop is calmer
SLOWER = 0.75  # ratio of two joint velocities below which a loop is slower
HUGE = 1e300  # stands for what is not finite
PLACES = ("center", "start", "end")  # what a shift moves of a path
UNTRIED = {"speed", "dtype", "task", "limits"}  # another program or problem; limits do what they say by construction


@record
class Run:
    """What is run: law, reference, start, what `solve` is told besides; turn: rotation wanted at the end."""

    law: object
    reference: object
    q0: np.ndarray
    N: int
    method: object
    stage: object
    drive: Drive
    turn: object = None


def changed(run: Run, change: dict) -> Run:
    """The same run with a remedy's change."""
    law, reference, change = run.law, run.reference, dict(change)
    curve = reference.curve
    made = {"N": change.pop("N", run.N), "q0": np.asarray(change.pop("q0", run.q0), float)}
    made["method"] = named(change.pop("method")) if "method" in change else run.method
    made["drive"] = replace(run.drive, feedback=change.pop("feedback", run.drive.feedback))
    made["stage"] = getattr(stages, change.pop("stage"))(change.pop("M")) if "stage" in change else run.stage
    if "target" in change:
        reference = hold(np.asarray(change.pop("target"), float), run.turn)
    if "shift" in change:
        shift = np.asarray(change.pop("shift"), float)
        moved = {name: np.asarray(getattr(curve, name)) + shift for name in PLACES if hasattr(curve, name)}
        reference = replace(reference, curve=replace(curve, **moved))
    if "period" in change:
        field = "period" if hasattr(curve, "period") else "duration"
        reference = replace(reference, curve=replace(curve, **{field: jnp.asarray(float(change.pop("period")))}))
    if change.pop("inverse", None) == "pseudoinverse":
        law = replace(law, inverse=inverse.pseudoinverse())
        change.pop("damping")
    if "damping" in change:
        law = replace(law, inverse=inverse.damped(jnp.asarray(change.pop("damping"))))
    if "limits" in change:
        law = replace(law, limits=getattr(limits, change.pop("limits").replace("-", "_"))())
    if "null_gain" in change:
        law = replace(law, null_velocity=_slower(law.null_velocity, change.pop("null_gain")))
    arrays = {name: np.asarray(change.pop(name), float) for name in ("alpha", "error_clamp") if name in change}
    law = replace(law, **arrays | {name: change.pop(name) for name in ("feedforward",) if name in change})
    assert not change, change
    return Run(law=law, reference=reference, turn=run.turn, **made)


def _slower(null, share):
    """A null-space velocity times a share."""
    if hasattr(null, "rate"):
        return replace(null, rate=null.rate * share)
    return functools.partial(_times, null, share) if callable(null) else np.asarray(null) * share


def _times(null, share, *q):
    return jax.tree.map(lambda v: share * v, null(*q))


class Trials:
    """Runs of a case's loop, with remedies and without."""

    def __init__(self, case):
        Ts, method, stage, drive = case.loop
        how = dict(N=case.steps, method=method, stage=stage, drive=drive, turn=case.turn)
        self.case, self.Ts = case, Ts
        self.given = Run(law=case.law, reference=case.reference, q0=case.start.q, **how)
        self.unchanged = functools.cache(lambda steps: self._run(self.given, steps))

    def longer(self, N):
        """The loop as it is, for N steps."""
        return truncate(self.unchanged(_power(N)), N)

    def _run(self, made, steps):
        law = replace(made.law, alpha=jnp.asarray(made.law.alpha, float))  # one program for all gains
        how = dict(t0=self.case.t[0]) if made.drive.prompt else dict(drive=made.drive)
        run = solve(law, made.reference, made.q0, self.Ts, steps, made.method, made.stage, **how)
        return jax.tree.map(np.asarray, run)

    def better(self, remedy) -> bool:
        """Whether the loop does better with a remedy: in the run's own steps, or in the end; True where that can't be
        tried."""
        curve, change, N = self.case.reference.curve, remedy.change, self.case.steps
        after = change.get("N", N)
        fixed = "shift" in change and not any(hasattr(curve, name) for name in PLACES)
        if UNTRIED & set(change) or fixed or max(N, after) > MOST_TRIED:
            return True
        steps = _power(max(N, after))
        was, now = self.unchanged(steps), self._run(changed(self.given, change), steps)
        was_here, now_here = truncate(was, N), truncate(now, after)
        if remedy.mends == "velocity":
            return self._excess(now_here) < SLOWER * self._excess(was_here)
        gone = max(ARRIVED * self.case.seen.size[0], self.case.seen.floor)

        def ratio(before, later):
            return max(_late(later), gone) / max(_late(before), gone)

        in_the_end = ratio(was, now)
        if remedy.mends == "motion":
            turns = _reversed(now_here) < CALMER * _reversed(was_here)
            calmer = turns or min(in_the_end, ratio(truncate(was, 5 * N), truncate(now, 5 * N))) < CALMER
            return in_the_end <= 1 and (calmer or _late(now) <= gone)
        if _late(now_here) <= gone:
            return True
        here = ratio(was_here, now_here)
        if only_longer(change, self.case.period):
            return here < GONE
        return here < BETTER and (in_the_end <= 1 or bool({"shift", "period"} & set(change)))  # another path

    def _excess(self, run):
        """Largest joint velocity over its limit."""
        return float(np.max(np.abs(run.qdot) / np.maximum(np.array(self.case.law.chain.velocity_limit, float), 1e-12)))


def only_longer(change, period):
    """Whether a change makes the run longer, its path as it is, and nothing else."""
    return set(change) <= {"N", "period"} and change.get("period", period) == period


def _power(N):
    """Steps of a trial of N."""
    return max(LEAST_TRIED, 1 << (N - 1).bit_length())


def _late(run):
    """Largest error of the last quarter; huge where one is not finite."""
    size = np.linalg.norm(run.e[-max(len(run.e) // 4, 1) :], axis=1)
    return min(float(size.max()), HUGE) if np.isfinite(size).all() else HUGE


def _reversed(run):
    """Largest joint velocity that the next step reverses, in the second half; huge where one is not finite."""
    v = run.qdot[len(run.qdot) // 2 - 1 :]
    back = np.where(v[1:] * v[:-1] < 0, np.minimum(np.abs(v[1:]), np.abs(v[:-1])), 0.0)
    return min(float(np.max(back, initial=0.0)), HUGE) if np.isfinite(v).all() else HUGE
