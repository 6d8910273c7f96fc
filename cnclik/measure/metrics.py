"""Metrics: the result of one loop in numbers.

Each metric is a pure function of a run, its law and its reference. Norms have derivative 0 (not NaN) at 0, and counts
have none. A value that is not finite counts as infinitely large, so that a diverged loop is never mistaken for a
missing one. NaN means "not defined", and occurs only where a metric's description states it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive, check_drive
from cnclik.integrate.status import Status
from cnclik.integrate.trajectory import Trajectory, check_run
from cnclik.law.inverse import least_squared
from cnclik.law.law import Law, check_loop, weighted
from cnclik.law.paths import Reference
from cnclik.law.reference import References, sample
from cnclik.measure.outcome import judge, stable
from cnclik.record import Number, cast
from cnclik.robot.model import modelled, one_off
from cnclik.robot.rotations import safe_sqrt


@jax.tree_util.register_pytree_node_class
class Metrics(dict):
    """Values by name, and their `units`. A pytree."""

    def __init__(self, values, units):
        super().__init__(zip(units, values, strict=True))
        self.units = units

    def tree_flatten(self):
        return tuple(self.values()), tuple(self.units.items())

    @classmethod
    def tree_unflatten(cls, units, values):
        return cls(values, dict(units))


class Measured(NamedTuple):
    """The run that is measured: what a metric may look at."""

    run: Trajectory  # one lane
    law: Law
    reference: Reference | References
    tolerance: Number  # of ‖e‖ [m, rad]
    swings: bool = False  # whether errors may, as through a drive

    @property
    def size(self):
        """‖e‖ at each instant."""
        return _norms(self.run.e)


class Metric(NamedTuple):
    """A metric: its function of a `Measured` run, a number; its unit and its meaning."""

    fn: Callable
    unit: str  # begins with "e" for the unit of the error, or "q" for that of the joints
    label: str
    needs: str = ""  # "lengths" or "angles": coordinates that the task must have


def _finite(value):
    return jnp.where(jnp.isfinite(value), value, jnp.inf)


def _norms(rows):
    return safe_sqrt(_finite(jnp.sum(rows * rows, axis=-1)))


def _root_mean(rows):
    return safe_sqrt(jnp.mean(_finite(jnp.sum(rows * rows, axis=-1))))


def _max(values):
    """Return the largest of non-negative values, over all axes."""
    return jnp.max(_finite(values), initial=0)


def _count(hit):
    return jnp.sum(hit.astype(jnp.int32))


def _along(of):
    """Return the position error along the path (N + 1, 1), positive if behind; 0 at rest. And along its tangent."""
    task = of.law.task
    # A user's path may allow no vmap.
    v = jax.lax.map(lambda t: sample(of.reference, task, t)[1], of.run.t)[:, np.array(task.lengths)]
    speed = _norms(v)[:, None]
    tangent = jnp.where(speed > 0, v / jnp.where(speed > 0, speed, 1.0), 0.0)
    along = jnp.sum(_position(of) * tangent, axis=-1, keepdims=True)
    return along, along * tangent


def _steps_to_tolerance(of):
    return jnp.min(jnp.where(of.size <= of.tolerance, jnp.arange(len(of.run.t)), jnp.inf))


def _ending(of):
    ending = judge(of.size, of.run.status, swings=of.swings).ending
    return jnp.where((of.size[0] == 0) | (not of.reference.still), jnp.nan, ending)


def _stable(of):
    ending = _ending(of)
    return jnp.where(jnp.isnan(ending), jnp.nan, stable(ending))


def _past_limit(of):
    q, chain = of.run.q, of.law.chain
    past = jnp.maximum(jnp.asarray(chain.lower) - q, q - jnp.asarray(chain.upper))
    return _max(jnp.where(jnp.isfinite(q), jnp.maximum(past, 0.0), jnp.inf))


def chatter(qdot):
    """Return the RMS speed that the next step reverses, over the second half of a run's (N, n) [rad/s, m/s].

    A joint that moves at a in one step and at −b in the next reverses min(a, b); one that slows down, however
    hard, reverses nothing. Alternation at ±a measures a·√n' for n' such joints, smooth motion 0.
    """
    qdot = jnp.asarray(qdot)
    late = qdot[len(qdot) // 2 :]
    if len(late) < 2:
        return jnp.zeros((), qdot.dtype)
    before, after = late[:-1], late[1:]
    back = jnp.where(before * after < 0, jnp.minimum(jnp.abs(before), jnp.abs(after)), 0.0)
    return jnp.where(jnp.all(jnp.isfinite(late)), _root_mean(back), jnp.inf)


def _least_singular_value(of):
    """Return σ_min, with the derivative of the Rayleigh quotient instead of that of a decomposition."""
    task, model = of.law.task, modelled(of.law.chain)

    def least(q):
        return safe_sqrt(least_squared(weighted(task, task.rows_at(model, q))))

    sigma = jax.lax.map(least, of.run.q)  # vmap would write out C for each posture
    return jnp.min(jnp.where(jnp.isfinite(sigma), sigma, 0.0))


def _errors(name, rows, unit, label, needs=""):
    """Return the metrics of one part of the error, rows(of): its size at the end and over the run."""
    return {
        f"final_{name}": Metric(lambda of: _norms(rows(of)[-1]), unit, f"{label}, at the end", needs),
        f"mean_{name}": Metric(lambda of: jnp.mean(_norms(rows(of))), unit, f"{label}, mean", needs),
        f"rms_{name}": Metric(lambda of: _root_mean(rows(of)), unit, f"{label}, RMS", needs),
        f"max_{name}": Metric(lambda of: _max(_norms(rows(of))), unit, f"{label}, max", needs),
    }


def _position(of):
    return of.run.e[:, np.array(of.law.task.lengths)]


def _rotation(of):
    return of.run.e[:, np.array(of.law.task.angles)]


def _marked(bit):
    return Metric(lambda of: _count((of.run.status & bit) != 0), "1", f"steps marked {bit.name}")


_MARKED = {str(bit.name).lower(): _marked(bit) for bit in Status if bit}
METRICS = {
    **_errors("error", lambda of: of.run.e, "e", "error ‖e‖"),
    **_errors("position_error", _position, "m", "position error", "lengths"),
    **_errors("rotation_error", _rotation, "rad", "rotation error", "angles"),
    **_errors("along", lambda of: _along(of)[0], "m", "position error along the path", "lengths"),
    **_errors("across", lambda of: _position(of) - _along(of)[1], "m", "position error across the path", "lengths"),
    "steps_to_tolerance": Metric(_steps_to_tolerance, "1", "first k with ‖e[k]‖ ≤ tolerance, inf if none"),
    "evaluations_to_tolerance": Metric(
        lambda of: _steps_to_tolerance(of) * of.run.evaluations / max(of.run.residual.shape[-1], 1),
        *("1", "evaluations of f to the tolerance"),
    ),
    "converged": Metric(lambda of: (of.size[-1] <= of.tolerance) * 1.0, "1", "1 if ‖e[N]‖ ≤ tolerance"),
    "ending": Metric(_ending, "1", "ending: 0 converged … 4 near singular; NaN at e₀ = 0 and for moving targets"),
    "stable": Metric(_stable, "1", "1 if the loop converged, or still does; NaN as ending"),
    "max_qdot": Metric(lambda of: _max(jnp.abs(of.run.qdot)), "q/s", "largest |q̇ᵢ|"),
    "velocity_ratio": Metric(
        lambda of: _max(jnp.abs(of.run.qdot) / jnp.asarray(of.law.chain.velocity_limit)),
        *("1", "largest |q̇ᵢ| over its limit"),
    ),
    "past_limit": Metric(_past_limit, "q", "how far the farthest joint goes beyond its limit, 0 if none does"),
    "chatter": Metric(lambda of: chatter(of.run.qdot), "q/s", "RMS speed that the next step reverses, second half"),
    "least_singular_value": Metric(_least_singular_value, "J", "least σ_min of the task Jacobian"),
    "residual": Metric(lambda of: _max(of.run.residual), "q", "largest last change of an implicit stage"),
    "evaluations": Metric(lambda of: jnp.asarray(of.run.evaluations, float), "1", "evaluations of f(q, t)"),
    "ok": Metric(lambda of: _count(of.run.status == 0), "1", "steps with status OK"),
    **_MARKED,
}
DEFAULT = ("final_error", "mean_error", "rms_error", "max_error", "steps_to_tolerance", "converged", "max_qdot")
DEFAULT += ("residual", "evaluations", "ok", *_MARKED)


def measure_run(
    run: Trajectory,
    law: Law,
    reference: Reference | References,
    names: Sequence[str] = DEFAULT,
    *,
    tolerance: Number = 1e-3,
    drive: Drive | None = None,
) -> Metrics:
    """Return metrics of one trajectory; pure, for use under jit, vmap and grad, in the precision of the run.

    In float32 errors differ from those in float64 by some 10 roundings of the arm's length, velocities by that over Ts.

    Args:
      run: `Trajectory` of solve(law, reference, ...), one lane; for a batch use `jax.vmap`.
      names: of metrics, see `METRICS`.
      tolerance: of ‖e‖, for converged and steps to the tolerance [m, rad].
      drive: of the run; through one an error may swing while the loop converges.

    Returns: `Metrics` in the order of `names`, with units.
    Raises: ArgumentError for a batch, for an unknown name (the nearest is suggested), or a metric without such a task.
    """
    check_run(run, lanes=False)
    check_loop(law, reference)
    errors.number("tolerance", tolerance, positive=True)
    check(names, law)
    check_run(run, law)
    names, swings = tuple(dict.fromkeys(names)), drive is not None and not check_drive(drive, law.chain).prompt
    values = _values(run, law, reference, np.asarray(tolerance, run.e.dtype), swings=swings, names=names)
    return Metrics(values, {name: unit_of(name, law) for name in names})


@functools.partial(one_off, static_argnames=("swings", "names"))
def _values(run, law, reference, tolerance, *, swings, names):
    measured = Measured(run, *cast((law, reference), run.q.dtype), tolerance, swings)
    values = [jnp.asarray(METRICS[name].fn(measured)) for name in names]
    return [v.astype(run.q.dtype) if jnp.issubdtype(v.dtype, jnp.floating) else v for v in values]


def check(names, law: Law) -> None:
    """Raise ArgumentError unless every name is a metric that the law's task has."""
    for name in errors.kind("metrics", names, Iterable, "be a list of names"):
        needs = METRICS[errors.one_of("metrics", name, METRICS)].needs
        if needs and not getattr(law.task, needs):
            raise errors.fail("metrics", f"be ones of the task ({', '.join(law.task.names)})", f"include {name!r}")


def unit_of(name: str, law: Law) -> str:
    """Return the unit of a metric for a law, as it depends on the task and the joints."""
    written, joints = METRICS[name].unit, sorted(set(law.chain.units), reverse=True)
    of_law = {"e": dict.fromkeys(law.task.units), "q": joints, "J": ["m" if law.task.lengths else "1"]}
    head, tail = written[:1], written[1:]
    if head not in of_law or tail[:1].isalpha():
        return written
    return ", ".join(unit + tail for unit in of_law[head])
