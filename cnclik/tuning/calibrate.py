"""Calibrate: geometry from measured positions, by nonlinear least squares."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.precision import in_float64
from cnclik.record import Array, ArrayLike, Float
from cnclik.robot.chain import Chain
from cnclik.robot.model import frames, modelled
from cnclik.tuning.parameters import Parameter


class Calibrated(NamedTuple):
    """The calibrated value, RMS distances to the measured positions before and after [m], "converged" or "steps"."""

    value: np.ndarray
    rms_before: float
    rms_after: float
    status: str


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
) -> Calibrated:
    """Estimate geometry from measured positions of the tip; computed in float64, whatever JAX's setting is.

    Args:
      build: function (value) -> Chain, such as `planar_arm` of link lengths; must take traced arrays. For any robot:
        `functools.partial(cnclik.tuning.scaled_links, chain)`, with ones (n + 1,) as start.
      start: nominal value, an array, such as link lengths [m].
      q: (K, n) joint values [rad, m]. measured: (K, 3) positions of the tip there [m].
      lower, upper: bounds; default: 0.5 below and above the start.
      steps: evaluations, at most.
    Returns: `Calibrated`.
    Raises: ArgumentError for shapes that do not fit.
    """
    from scipy.optimize import least_squares

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

    @jax.jit
    def distances(value):
        chain = modelled(build(value.reshape(start.shape)))
        return (jax.vmap(lambda q: frames(chain, q).position)(q) - measured).ravel() / np.sqrt(len(q))

    bounds = p.lower.ravel(), p.upper.ravel()
    value = np.clip(start.ravel(), *bounds)
    before = float(np.linalg.norm(distances(value)))
    if not np.isfinite(before):
        raise errors.fail("start", "give finite positions", "does not")
    least = dict.fromkeys(("ftol", "xtol", "gtol"), 1e-14)
    best = least_squares(distances, value, jax.jit(jax.jacfwd(distances)), bounds, **least, max_nfev=steps)
    status = "converged" if best.status > 0 else "steps"
    return Calibrated(best.x.reshape(start.shape), before, float(np.linalg.norm(best.fun)), status)
