"""Losses: what their lines say, in plain NumPy and closed forms."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik.tuning.losses import LOSSES, View, terms


def test_noise_loss_is_the_stationary_deviation():
    """e ← (1 − z) e − z w has the variance σ² z/(2 − z)."""
    for z in (0.2, 1.0, 1.7):
        maps = (1 - z) * jnp.eye(2)[None]
        view = View(run=None, weight=None, Ts=0.1, horizon=1.0, tolerance=1e-3, maps=maps)
        np.testing.assert_allclose(LOSSES["noise"](view), np.sqrt(z / (2 - z)), rtol=1e-9)


def test_delay_loss_is_what_is_left_of_a_unit_error():
    """e[k+1] = e[k] − z e[k−1] from e = 1: Σ e² = (1 + z)/((1 − z) z (2 + z))."""
    for z in (0.1, 0.466, 0.8):
        view = View(None, None, 0.1, 1.0, 1e-3, maps=(1 - z) * jnp.eye(2)[None])
        e = [1.0, 1.0]
        for _ in range(2000):
            e.append(e[-1] - z * e[-2])
        np.testing.assert_allclose(LOSSES["delay"](view), np.sqrt(np.sum(np.square(e))), rtol=1e-9)
        np.testing.assert_allclose(LOSSES["delay"](view) ** 2, (1 + z) / ((1 - z) * z * (2 + z)), rtol=1e-9)
    unstable = View(None, None, 0.1, 1.0, 1e-3, maps=-0.2 * jnp.eye(2)[None])  # z = 1.2: late, it grows
    assert not np.isfinite(LOSSES["delay"](unstable))


class Run(NamedTuple):
    """As much of a `Trajectory` as losses look at."""

    e: jax.Array
    qdot: jax.Array


def test_losses_are_what_their_lines_say():
    rng = np.random.default_rng(3)
    e, qdot, N, Ts = rng.normal(size=(13, 2)), rng.normal(size=(12, 3)), 12, 0.1
    view = View(Run(jnp.asarray(e), jnp.asarray(qdot)), jnp.full(N, 1 / N), Ts, N * Ts, 0.5, maps=None)
    squares = np.sum(e[1:] ** 2, axis=1)
    jerks = np.sum((qdot[2:] - 2 * qdot[1:-1] + qdot[:-2]) ** 2, axis=1) / Ts**4
    wanted = {
        "tracking": np.sqrt(np.mean(squares)),
        "settling": Ts * np.sum(squares / (squares + 0.25)),
        "effort": np.sqrt(np.mean(np.sum(qdot**2, axis=1))),
        "jerk": np.sqrt(np.sum(jerks) / N),
    }
    for name, value in wanted.items():
        np.testing.assert_allclose(LOSSES[name](view), value, rtol=1e-12, err_msg=name)
    largest = np.sqrt(np.max(squares))
    assert largest <= LOSSES["worst"](view) <= largest * N ** (1 / 32)
    ((first, a), (second, b)) = terms({"tracking": 2.0, "jerk": 1e-3})
    total = 2 * wanted["tracking"] + 1e-3 * wanted["jerk"]
    np.testing.assert_allclose(a * first(view) + b * second(view), total, rtol=1e-12)
    # Times beyond the horizon do not count.
    half = view._replace(weight=jnp.asarray(np.repeat([1 / 6, 0.0], 6)))
    np.testing.assert_allclose(LOSSES["tracking"](half), np.sqrt(np.mean(squares[:6])), rtol=1e-12)
