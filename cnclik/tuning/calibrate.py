"""Calibrate: geometry from measured positions, by the descent of `tune`."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.precision import in_float64
from cnclik.record import AnyArray, Array, ArrayLike, Float, record
from cnclik.robot.chain import Chain
from cnclik.robot.model import frames, modelled
from cnclik.tuning.descent import Bounds, descend, evaluate
from cnclik.tuning.parameters import Parameter


class Calibrated(NamedTuple):
    """The calibrated value, RMS distances to the measured positions before and after [m], and a status of `tune`."""

    value: np.ndarray
    rms_before: float
    rms_after: float
    status: str


@record
class Distance:
    """The mean squared distance between measured positions and those of a chain built from a value."""

    nominal: Parameter
    q: Float[AnyArray, "K n"]
    measured: Float[AnyArray, "K 3"]

    def __call__(self, values):
        chain = modelled(self.nominal.put(values.reshape(self.nominal.start.shape)))
        away = jax.vmap(lambda q: frames(chain, q).position)(self.q) - self.measured
        return jnp.mean(jnp.sum(away**2, axis=-1)), jnp.zeros(0), None


@in_float64
def calibrate(
    build: Callable[[Array], Chain],
    start: ArrayLike,
    q: Float[ArrayLike, "K n"],
    measured: Float[ArrayLike, "K 3"],
    *,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    steps: int = 200,
    progress: Callable | None = None,
) -> Calibrated:
    """Estimate geometry from measured positions of the tip; computed in float64, whatever JAX's setting is.

    Args:
      build: function (value) -> Chain, such as `planar_arm` of link lengths; must take traced arrays. For any robot:
        `functools.partial(cnclik.tuning.scaled_links, chain)`, with ones (n + 1,) as start.
      start: nominal value, an array, such as link lengths [m].
      q: (K, n) joint values [rad, m]. measured: (K, 3) positions of the tip there [m].
      lower, upper: bounds; default: 0.5 below and above the start.
      steps, progress: as for `tune`.
    Returns: `Calibrated`.
    Raises: ArgumentError for shapes that do not fit.
    """
    errors.progress(progress)
    if not callable(build):
        raise errors.fail("build", "be a function of the value", f"is {build!r}")
    start, steps = np.asarray(errors.array("start", start), float), errors.integer("steps", steps, at_least=3)
    if not start.size:
        raise errors.fail("start", "hold numbers", "is empty")
    n = errors.kind("build", build(jnp.asarray(start)), Chain, "return a Chain").n
    q = np.asarray(errors.array("q", q, (None, n)), float)
    measured = np.asarray(errors.array("measured", measured, (q.shape[0], 3)), float)
    lower, upper = (start + away if bound is None else bound for bound, away in ((lower, -0.5), (upper, 0.5)))
    p = Parameter(name="start", start=start, lower=lower, upper=upper, put=build)
    bounds, objective = Bounds(p.lower.ravel(), p.upper.ravel()), Distance(nominal=p, q=q, measured=measured)
    u = bounds.within(bounds.free(start.ravel()))
    before = evaluate(objective, bounds, u).loss
    if not np.isfinite(before):
        raise errors.fail("start", "give finite positions", "does not")
    best, _, status = descend(objective, bounds, u, steps=steps, progress=progress)
    value = np.asarray(bounds.values(best.u)).reshape(start.shape)
    return Calibrated(value, before**0.5, best.loss**0.5, status)
