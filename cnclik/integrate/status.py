"""Status: what happened in each step, as bits; and the way to insist that nothing did."""

import enum

import jax.numpy as jnp
import numpy as np


class Status(enum.IntFlag):
    """Bits of a step's status; OK is 0."""

    OK = 0
    NOT_CONVERGED = 1  # an implicit stage's last change exceeded its tolerance
    NEAR_SINGULAR = 2  # least singular value of the task Jacobian below the law's `near_singular`
    AT_LIMIT = 4  # a joint at or beyond a limit after the step, or held back by one
    NON_FINITE = 8  # a joint value or error that is NaN or infinite


_REMEDY = {
    Status.NON_FINITE: "reduce alpha·Ts or use damped(...)",
    Status.NOT_CONVERGED: "reduce alpha·Ts, raise M, or use a method that needs no implicit stage",
    Status.NEAR_SINGULAR: "use damped(...), or move the path away from the singularity",
    Status.AT_LIMIT: "choose another start or path",
}


class StepError(RuntimeError):
    """A trajectory that is not OK; the message names the first bad step, its time, and a remedy."""


def names(status) -> str:
    """A status value in words, such as "NOT_CONVERGED|NEAR_SINGULAR"."""
    status = int(status)
    return "|".join(s.name for s in Status if s and s & status) or "OK"


def count(status) -> dict:
    """How many steps bear each name; a step may bear several."""
    status = np.asarray(status)
    counts = {"OK": int(np.sum(status == 0))}
    return counts | {s.name: int(np.sum((status & s.value) != 0)) for s in Status if s}


def require_ok(trajectory, *, allow=Status.OK):
    """The trajectory itself if no step has a status beyond `allow`; else StepError.

    The message names the first bad step (and lane), its time, and the remedy. Values are looked at, so this
    can't be used under jit.
    """
    status = np.asarray(trajectory.status) & ~int(allow)
    if not status.any():
        return trajectory
    # Earliest step over all lanes: the last axis is time.
    *lane, k = min(np.argwhere(status), key=lambda index: index[-1])
    bad = int(status[(*lane, k)])
    t = float(np.asarray(trajectory.t)[(*lane, k)])
    where = f" of lane {tuple(int(i) for i in lane)}" if lane else ""
    worst = next(s for s in _REMEDY if bad & s)
    raise StepError(f"Step {k}{where} (t = {t:.6g} s) is {names(bad)}: {_REMEDY[worst]}.")


def flags(chain, law, q, e, residual, tolerance, first):
    """Status bits of one step in component form; `first` is the law's evaluation at its start."""
    finite = jnp.isfinite(sum(q[1:], q[0]) + sum(e[1:], e[0]))
    status = jnp.where(residual > tolerance, int(Status.NOT_CONVERGED), 0)
    status |= jnp.where(first.least < law.near_singular, int(Status.NEAR_SINGULAR), 0)
    outside = [
        (value <= low) | (value >= high)
        for value, low, high in zip(q, chain.lower, chain.upper, strict=True)
        if np.isfinite(low) or np.isfinite(high)
    ]
    if first.held is not False:
        outside.append(first.held)
    for one in outside:
        status |= jnp.where(one, int(Status.AT_LIMIT), 0)
    return status | jnp.where(finite, 0, int(Status.NON_FINITE))
