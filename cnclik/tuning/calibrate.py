"""Calibration: geometry from measured positions, with the descent that `tune` uses."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.precision import in_float64
from cnclik.record import Array, ArrayLike, Float, record
from cnclik.robot.chain import Chain
from cnclik.robot.model import frames, modelled
from cnclik.tuning import parameters as pm
from cnclik.tuning.descent import Descent, descend


@record
class PositionObjective:
    """Mean squared distance between measured positions and those of a chain built from the parameters' values."""

    parameters: tuple[pm.Parameter, ...]
    build: Callable[..., Chain]  # function of the values
    q: Float[Array, "K n"]
    measured: Float[Array, "K 3"]

    def __call__(self, values):
        chain = self.build(*values)
        found = jax.vmap(lambda q: frames(modelled(chain), q).position)(self.q)
        return jnp.mean(jnp.sum((found - self.measured) ** 2, axis=-1)), jnp.zeros((0,), found.dtype)


class Calibrated(NamedTuple):
    """Calibrated values, and RMS distances to the measured positions before and after [m]."""

    values: tuple[np.ndarray, ...]
    rms_before: float
    rms_after: float
    status: str
    history: np.ndarray


@in_float64
def calibrate(
    build: Callable[[Array], Chain],
    start: ArrayLike,
    q: Float[ArrayLike, "K n"],
    measured: Float[ArrayLike, "K 3"],
    *,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    descent: Descent = Descent(steps=200, rounds=4),
    progress: Callable | None = None,
) -> Calibrated:
    """Estimate geometry from measured positions of the tip; computed in float64, whatever JAX's setting is.

    Args:
      build: function (value) -> Chain, such as `planar_arm` of link lengths; must take traced arrays.
      start: nominal value, an array, such as link lengths [m].
      q: (K, n) joint values [rad, m]. measured: (K, 3) positions of the tip there [m].
      lower, upper: bounds; default: 0.5 below and above the start.
      descent, progress: as for `tune`; one start.
    Returns: `Calibrated`.
    Raises: ArgumentError for shapes that do not fit.
    """
    if errors.kind("descent", descent, Descent, "be Descent(...)").starts != 1:
        raise errors.fail("descent", "have one start, as what is nominal is one", f"has {descent.starts}")
    start = np.asarray(errors.array("start", start), float)
    if not start.size:
        raise errors.fail("start", "hold numbers", "is empty")
    if not callable(build):
        raise errors.fail("build", "be a function of the value", f"is {build!r}")
    n = errors.kind("build", build(jnp.asarray(start)), Chain, "return a Chain").n
    q = jnp.asarray(errors.array("q", q, (None, n)))
    measured = jnp.asarray(errors.array("measured", measured, (q.shape[0], 3)))
    lower, upper = (start + d if b is None else b for b, d in ((lower, -0.5), (upper, 0.5)))
    p = pm.parameter("geometry", start, lower, upper, build)
    objective = PositionObjective(parameters=(p,), build=build, q=q, measured=measured)
    before = float(jax.jit(objective)((jnp.asarray(start),))[0])
    if not np.isfinite(before):
        raise errors.fail("start", "give finite positions", "does not")
    scale = np.array([1.0 / before if before > 0 else 1.0])
    done = descend(
        objective, pm.free(p, start)[None], scale, constraints=0, descent=descent, tolerance=1e-9, progress=progress
    )
    values = tuple(np.asarray(v) for v in pm.values_of((p,), jnp.asarray(done.best[0])))
    rms = (before**0.5, float(done.best_loss[0]) ** 0.5)
    return Calibrated(values, *rms, done.why, np.sqrt(done.history.loss[0]))
