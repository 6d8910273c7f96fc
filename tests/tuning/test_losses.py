"""Losses: what their lines say, in plain NumPy."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik.tuning.losses import LOSSES, terms


class Run(NamedTuple):
    """As much of a `Trajectory` as losses look at."""

    t: jax.Array
    e: jax.Array
    qdot: jax.Array


def test_losses_are_what_their_lines_say():
    rng = np.random.default_rng(3)
    e, qdot, N, Ts = rng.normal(size=(13, 2)), rng.normal(size=(12, 3)), 12, 0.1
    run = Run(jnp.asarray(2.0 + Ts * np.arange(N + 1)), jnp.asarray(e), jnp.asarray(qdot))
    squares = np.sum(e[1:] ** 2, axis=1)
    jerks = np.sum((qdot[2:] - 2 * qdot[1:-1] + qdot[:-2]) ** 2, axis=1) / Ts**4
    wanted = {
        "tracking": np.sqrt(np.mean(squares)),
        "settling": Ts * np.sum(squares / (squares + 1e-6)),
        "effort": np.sqrt(np.mean(np.sum(qdot**2, axis=1))),
        "jerk": np.sqrt(np.mean(jerks)),
    }
    assert set(wanted) == set(LOSSES)
    for name, value in wanted.items():
        np.testing.assert_allclose(LOSSES[name](run), value, rtol=1e-12, err_msg=name)
    ((first, a), (second, b)) = terms({"tracking": 2.0, "jerk": 1e-3})
    total = 2 * wanted["tracking"] + 1e-3 * wanted["jerk"]
    np.testing.assert_allclose(a * first(run) + b * second(run), total, rtol=1e-12)
