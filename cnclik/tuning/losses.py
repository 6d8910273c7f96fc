"""Losses: smooth functions of a run that a tuning minimizes.

A loss maps a `View` to a number in the unit that its description gives. Weighted sums of losses are losses, too. Times
beyond the horizon have weight 0, so that loops with different sampling times are compared over the same time.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from cnclik import errors
from cnclik.integrate.drive import Drive
from cnclik.integrate.trajectory import Trajectory
from cnclik.record import Array, Float
from cnclik.robot.rotations import safe_sqrt
from cnclik.tuning.linear import driven_map


class View(NamedTuple):
    """The quantities that a loss may use.

    Attributes:
      run: the `Trajectory`; its e is the true error. For a stack, each coordinate is multiplied by its weight over the
        damping of its level, at most 1, in the law that tuning starts from; by 0 of a posture that was not named.
      weight: (N,) shares of the horizon, of e[1] … e[N] and of the N steps, summing to 1; e[0] is given and does not
        count.
      Ts: sampling time [s].
      horizon: [s].
      tolerance: error that counts as settled [m, rad].
      maps: (K, m, m) one-step maps of the error at rest along the path.
    """

    run: Trajectory
    weight: Float[Array, " N"]
    Ts: Float[Array, ""]
    horizon: Float[Array, ""]
    tolerance: Float[Array, ""]
    maps: Float[Array, "K m m"]


def _squares(rows):
    return jnp.sum(rows * rows, axis=-1)


def _root_mean(view, rows, skip=0):
    """√ of the weighted mean of ‖row‖², without the first `skip` weights."""
    return safe_sqrt(jnp.sum(view.weight[skip:] * _squares(rows)))


def _sum_of_powers(a, q):
    """Σ AᵏQAᵏᵀ over k = 0 … 4095, by doubling."""
    for _ in range(12):
        q = q + a @ q @ jnp.swapaxes(a, -1, -2)
        a = a @ a
    return q


def _deviation(p):
    """RMS over axes and path of the standard deviations with covariances p (K, m, m)."""
    return safe_sqrt(jnp.mean(jnp.diagonal(p, axis1=-2, axis2=-1)))


def tracking(view: View):
    """RMS of ‖e‖ [m, rad]."""
    return _root_mean(view, view.run.e[1:])


def worst(view: View, power=16):
    """Largest ‖e‖, smoothly: (Σ w ‖e‖^2p / max w)^(1/2p), from 1 to N^(1/2p) times the largest [m, rad]."""
    squares = _squares(view.run.e[1:])
    counts = view.weight > 0
    top = lax.stop_gradient(jnp.max(jnp.where(counts, squares, 0.0)))
    top = jnp.where(top > 0, top, 1.0)
    share = view.weight / lax.stop_gradient(jnp.max(view.weight))
    return safe_sqrt(top) * jnp.sum(share * (squares / top) ** power) ** (0.5 / power)


def settling(view: View):
    """Time spent outside the tolerance, smoothly: ∫ ‖e‖²/(‖e‖² + tolerance²) dt [s]."""
    squares = _squares(view.run.e[1:])
    return view.horizon * jnp.sum(view.weight * squares / (squares + view.tolerance**2))


def effort(view: View):
    """RMS of ‖q̇‖ [rad/s, m/s]."""
    return _root_mean(view, view.run.qdot)


def jerk(view: View):
    """RMS of ‖Δ²q̇‖/Ts² [rad/s³, m/s³]."""
    second = jnp.diff(view.run.qdot, n=2, axis=0) / view.Ts**2
    return _root_mean(view, second, skip=2)


def noise(view: View):
    """Standard deviation of the error at rest per unit of white measurement noise, RMS over axes and path [1].

    A step does e ← A e + (A − I) w, so P = A P Aᵀ + (A − I)(A − I)ᵀ: √(z/(2 − z)) for explicit Euler.
    """
    change = view.maps - jnp.eye(view.maps.shape[-1], dtype=view.maps.dtype)
    return _deviation(_sum_of_powers(view.maps, change @ jnp.swapaxes(change, -1, -2)))


LATE = Drive(delay=1.0)


def delay(view: View):
    """Sensitivity to one sample of dead time: √(Σ ‖e[k]‖²) of a unit error, RMS over axes and path [1].

    e[k+1] = e[k] + (A − I) e[k−1]: √((1 + z)/((1 − z) z (2 + z))) for explicit Euler, least at z = 0.466; not finite if
    the delayed loop is unstable.
    """
    m = view.maps.shape[-1]
    start = jnp.zeros((2 * m, 2 * m), view.maps.dtype).at[:m, :m].set(jnp.eye(m, dtype=view.maps.dtype))
    return _deviation(jax.vmap(lambda a: _sum_of_powers(driven_map(a, LATE, 1.0), start)[:m, :m])(view.maps))


LOSSES = {f.__name__: f for f in (tracking, worst, settling, effort, jerk, noise, delay)}


def terms(loss):
    """A loss in the user's form (a name, {name: weight}, or a function of a `View`) as (function, weight) pairs."""
    if callable(loss):
        return ((loss, 1.0),)
    if isinstance(loss, str):
        loss = {loss: 1.0}
    if not isinstance(loss, dict) or not loss:
        raise errors.fail("loss", "be a name, a table of names and weights, or a function", f"is {loss!r}")
    for name, weight in loss.items():
        errors.number(f"weight of {name}", weight, at_least=0)
    if not any(weight > 0 for weight in loss.values()):
        raise errors.fail("loss", "give a weight above 0", "gives none")
    return tuple((LOSSES[errors.one_of("loss", name, LOSSES)], float(weight)) for name, weight in loss.items())


def in_words(loss) -> str:
    if isinstance(loss, str):
        return loss
    if isinstance(loss, dict):
        return " + ".join(f"{w:g} {name}" for name, w in loss.items())
    return getattr(loss, "__name__", "own function")
