"""Losses: differentiable functions of a run that `tune` minimizes. The initial error is given, so none counts it."""

from __future__ import annotations

import jax.numpy as jnp

from cnclik import errors
from cnclik.integrate.trajectory import Trajectory
from cnclik.robot.rotations import safe_sqrt


def tracking(run: Trajectory):
    """Return the RMS of ‖e‖ [m, rad]."""
    return _root_mean(run.e[1:])


def settling(run: Trajectory, tolerance=1e-3):
    """Return the time outside a tolerance [m, rad], smoothed: ∫ ‖e‖²/(‖e‖² + tolerance²) dt [s]."""
    squares = jnp.sum(run.e[1:] ** 2, axis=-1)
    return (run.t[-1] - run.t[0]) * jnp.mean(squares / (squares + tolerance**2))


def effort(run: Trajectory):
    """Return the RMS of ‖q̇‖ [rad/s, m/s]."""
    return _root_mean(run.qdot)


def jerk(run: Trajectory):
    """Return the RMS of ‖Δ²q̇‖/Ts² [rad/s³, m/s³]."""
    return _root_mean(jnp.diff(run.qdot, n=2, axis=0)) / (run.t[1] - run.t[0]) ** 2


def _root_mean(rows):
    return safe_sqrt(jnp.mean(jnp.sum(rows * rows, axis=-1)))


LOSSES = {fn.__name__: fn for fn in (tracking, settling, effort, jerk)}


def terms(loss) -> tuple:
    """Return (function, weight) pairs of a loss: a name, {name: weight}, or a function of a `Trajectory`."""
    if callable(loss):
        return ((loss, 1.0),)
    loss = {loss: 1.0} if isinstance(loss, str) else loss
    if not isinstance(loss, dict) or not loss:
        raise errors.fail("loss", "be a name, a table of names and weights, or a function", f"is {loss!r}")
    for name, weight in loss.items():
        errors.one_of("loss", name, LOSSES)
        errors.number(f"weight of {name}", weight, positive=True)
    return tuple((LOSSES[name], float(weight)) for name, weight in loss.items())
