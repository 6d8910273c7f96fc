"""Status: what happened in each step, as bits; and a function that insists on OK."""

from __future__ import annotations

import enum
from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.law.law import metric
from cnclik.law.reference import motion
from cnclik.precision import of_numbers
from cnclik.record import ArrayLike
from cnclik.robot.rotations import library, safe_sqrt

Run = TypeVar("Run", bound=Any)  # a `Trajectory`, whose class is in a later module


class Status(enum.IntFlag):
    """Bits of a step's status; OK is 0."""

    OK = 0
    NOT_CONVERGED = 1  # an implicit stage's last change exceeded its tolerance, or `bounded` was cut short
    NEAR_SINGULAR = 2  # least singular value of the task Jacobian below the law's `near_singular`
    AT_LIMIT = 4  # a joint at or beyond a limit after the step, or stopped by one
    NON_FINITE = 8  # a joint value or error that is NaN or infinite
    OVER_VELOCITY = 16  # a joint faster than its velocity limit
    GROWING = 32  # the error grew by more than its target moved, see `growing`; not set by `step`
    TASK_TOO_LARGE = 64  # more task coordinates than joints: the remaining error is a compromise
    DIVERGED = 256  # joint values too large to be meaningful, see `far`, but finite
    WALLS_CONTRADICT = 1024  # no joint velocities within bounds keep all walls: see `Trajectory.walls`


LOST = Status.NON_FINITE | Status.DIVERGED | Status.GROWING

_REMEDY = {
    Status.NON_FINITE: "reduce alpha·Ts, use damped(...), or clamp the error (error_clamp)",
    Status.DIVERGED: "reduce alpha·Ts, use damped(...) near a singularity, or count joint angles from a turn nearby",
    Status.TASK_TOO_LARGE: "control fewer coordinates, such as position()",
    Status.GROWING: "reduce alpha·Ts, use damped(...) near a singularity, or clamp the error (error_clamp)",
    Status.NOT_CONVERGED: "reduce alpha·Ts, raise M (of bounded limits: passes), or use an explicit method",
    Status.NEAR_SINGULAR: "use damped(...), or move the path away from the singularity",
    Status.AT_LIMIT: "choose another start or path",
    Status.OVER_VELOCITY: "reduce alpha, slow the path down, or use limits=velocity_scaling() or bounded()",
    Status.WALLS_CONTRADICT: "move apart the walls whose `walls` of the run are negative, or allow faster joints",
}


class StepError(RuntimeError):
    """A trajectory that is not OK; the message names the first bad step, its time, and a remedy."""


def names(status: ArrayLike) -> str:
    """Return a status value in words, such as "NOT_CONVERGED|NEAR_SINGULAR"."""
    return str(Status(int(np.asarray(status))).name)


def level(status: ArrayLike) -> np.ndarray:
    """Return the severity of each status: 0 fine, 1 warning, 2 lost."""
    status = np.asarray(status)
    return np.where(status & LOST.value, 2, np.where(status, 1, 0))


def count(status: ArrayLike) -> dict[str, int]:
    """Return the number of steps with each status name; a step may have several."""
    status = np.asarray(status)
    return {"OK": int(np.sum(status == 0))} | {str(s.name): int(np.sum((status & s.value) != 0)) for s in Status}


def counted(status) -> str:
    """Return the names that occur with their numbers of steps, such as "OK 99, AT_LIMIT 1"."""
    return ", ".join(f"{name} {steps}" for name, steps in count(status).items() if steps)


@of_numbers
def require_ok(run: Run, *, allow: Status = Status.OK) -> Run:
    """Return the run if no step has a status beyond `allow`; or raise StepError.

    The message names the first bad step (and lane), its time, and a remedy. The values are read, so this cannot be used
    under jit.
    """
    if not (hasattr(run, "status") and hasattr(run, "t")):  # a Trajectory's class is in a later module
        raise errors.fail("run", "be a Trajectory", f"is {type(run).__name__}")
    status = np.asarray(run.status) & ~int(errors.kind("allow", allow, (Status, int)))
    if not status.any():
        return run
    # Earliest step over all lanes: the last axis is time.
    *lane, k = min(np.argwhere(status), key=lambda index: index[-1])
    bad = int(status[(*lane, k)])
    t = float(np.asarray(run.t)[(*lane, k)])
    where = f" of lane {tuple(int(i) for i in lane)}" if lane else ""
    worst = next(s for s in _REMEDY if bad & s)
    raise StepError(f"Step {k}{where} (t = {t:.6g} s) is {names(bad)}: {_REMEDY[worst]}.")


def rounding_of(qdot):
    """Return how much a wall may be missed by rounding [m/s, rad/s], at joint velocities (..., n): (..., 1)."""
    xp = library(qdot)
    return 1e-4 * (1 + xp.max(xp.abs(qdot), axis=-1, keepdims=True))


def flags(law, q, qdot, residual, tolerance, first):
    """Return the status bits of one step; `first` is the law's evaluation at its start."""
    chain = law.chain
    size = jnp.sum(jnp.abs(q))  # an error that is not finite is in q, after the step
    status = jnp.where((residual > tolerance) | first.cut, int(Status.NOT_CONVERGED), 0)
    status |= jnp.where(size > far(residual.dtype), int(Status.DIVERGED), 0)
    # A singular value that is NaN counts as too small.
    status |= jnp.where(jnp.min(first.least) >= law.near_singular, 0, int(Status.NEAR_SINGULAR))
    fast, at_limit = False, first.limited
    if chain.slowed:  # by more than rounding
        fast = jnp.any(jnp.abs(qdot) > chain.velocity_limit * (1 + 64 * jnp.finfo(qdot.dtype).eps))
    if chain.bounded:  # a joint whose limits are equal is at none, at that value
        low, high = chain.lower, chain.upper
        at_limit |= jnp.any(((q <= low) | (q >= high)) & ((q != low) | (q != high)))
    missed = False if first.walls is None else jnp.any(first.walls < -rounding_of(first.qdot))
    for bit, holds in ((Status.AT_LIMIT, at_limit), (Status.OVER_VELOCITY, fast), (Status.WALLS_CONTRADICT, missed)):
        if holds is not False:
            status |= jnp.where(holds, int(bit), 0)
    if law.task.m > chain.n and not law.task.tasks:
        status |= int(Status.TASK_TOO_LARGE)
    return status | jnp.where(jnp.isfinite(size), 0, int(Status.NON_FINITE))


def far(dtype) -> float:
    """Return Σ|q_i| [rad, m] above which joint values mean nothing: 1e6, or where floats are 0.002 apart (float32)."""
    return min(1e6, 2.0**-9 / float(jnp.finfo(dtype).eps))


GROWTH = 1.01  # an error grows if it exceeds this times the one before
REVERSAL = 0.999  # or if its sign changes and it exceeds this times the one before


def growing(law, reference, t, e):
    """Return GROWING or 0 for each step (N,), from its errors e (N + 1, m) at t (N + 1,).

    An error grows in a step if ‖e[k+1]‖ > 1.01 ‖e[k]‖ + s, or if e[k+1]·e[k] < 0 and ‖e[k+1]‖ > 0.999 ‖e[k]‖ + s. Here
    s is the target's own motion in the step, plus rounding, 64 eps (1 + ‖e[k]‖). With |R(z)| < 1 the loop stays below
    both, even if it rings; from |R(z)| = 1 on it does not, even if it is bounded. For a stack the norm includes its
    weights and levels, see `cnclik.law.law.metric`: otherwise a task that gives way to others would count as growing.
    """
    e = metric(law) * e if law.task.tasks else e
    sizes, along = safe_sqrt(jnp.sum(e * e, axis=1)), jnp.sum(e[1:] * e[:-1], axis=1)
    rounding = 64 * jnp.finfo(e.dtype).eps * (1 + sizes[:-1])
    grown = jnp.where(along < 0, REVERSAL, GROWTH) * sizes[:-1] + motion(reference, law.task, t) + rounding
    return jnp.where(sizes[1:] > grown, int(Status.GROWING), 0)
