"""The loop at rest as matrices: bounds of the spectral radius, delay, and up to where an error keeps its sign."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.integrate.drive import Drive
from cnclik.tuning.linear import (
    driven_map,
    largest_share,
    maps_at_rest,
    radius_bound,
    radius_estimate,
    radius_over,
)

BOUNDS = jax.jit(lambda a: (radius_bound(a), radius_estimate(a)))


def test_radius_bound_is_an_upper_bound_and_tight():
    rng = np.random.default_rng(1)
    for a in rng.normal(size=(5, 3, 3)) / 3:
        rho = np.abs(np.linalg.eigvals(a)).max()
        bound, estimate = map(float, BOUNDS(jnp.asarray(a)))
        assert rho * (1 - 1e-12) <= bound <= rho * 1.01
        assert rho / 3 ** (1 / 2048) * (1 - 1e-12) <= estimate < bound
    bound, estimate = map(float, BOUNDS(0.7 * jnp.eye(3)))
    np.testing.assert_allclose(bound, 0.7 * 3 ** (1 / 2048), rtol=1e-12)
    np.testing.assert_allclose(estimate, 0.7, rtol=1e-12)
    same = jax.jit(jax.grad(lambda s: radius_bound(s * jnp.eye(3))))(0.5)  # all eigenvalues at once
    np.testing.assert_allclose(same, 1.0, rtol=1e-3)
    assert float(BOUNDS(jnp.zeros((3, 3)))[0]) == 0


@pytest.mark.parametrize("delay", range(6))
def test_an_error_keeps_its_sign_up_to_the_monotone_limit(delay):
    def errors(z, steps=5000):
        e = [1.0] * (delay + 1)
        while len(e) < steps and e[-1] > 0:
            e.append(e[-1] - z * e[-1 - delay])
        return np.array(e)

    limit = largest_share(Drive(delay=delay), 0.1, 0.0, 2.0)
    np.testing.assert_allclose(limit, delay**delay / (delay + 1) ** (delay + 1), rtol=1e-6)
    assert errors(limit * (1 - 1e-6)).min() >= 0 > errors(limit * 1.02)[-1]
    # Where the two slowest roots meet, d/(d + 1): eigenvalues that coincide are known to √eps.
    radius = np.abs(np.linalg.eigvals(np.asarray(driven_map((1 - limit) * jnp.eye(1), Drive(delay=delay), 0.1)))).max()
    np.testing.assert_allclose(radius, delay / (delay + 1), atol=1e-3)


def test_late_loops_over_gains_are_those_of_the_theory():
    arm, q = ck.planar_arm([1.0, 0.8, 0.6]), np.array([0.4, 0.8, -0.5])
    law = ck.Law(arm, ck.position("xy"), alpha=3.0)
    alpha, Ts = np.array([2.0, 5.0, 15.0]), np.array([0.1, 0.05])
    for delay in (0, 2):
        radius = radius_over(law, q, alpha, Ts, ck.EE, ck.picard(5), drive=Drive(delay=delay))
        theory = [
            [np.abs(np.roots([1.0, -1.0, *[0.0] * (delay - 1), z])).max() if delay else abs(1 - z) for z in alpha * T]
            for T in Ts
        ]
        np.testing.assert_allclose(radius, theory, rtol=1e-6)


def test_maps_tell_the_task_from_the_null_space():
    arm, q = ck.planar_arm([1.0, 0.8, 0.6, 0.5]), jnp.array([0.4, 0.8, -0.5, 0.3])
    law = ck.Law(arm, ck.position("xy"), alpha=3.0)
    task, across, *_ = jax.jit(lambda q: maps_at_rest(law, q, 0.1, ck.EE, ck.picard(5)))(q)
    np.testing.assert_allclose(task, 0.7 * np.eye(2), atol=1e-12)
    np.testing.assert_allclose(np.sort(np.abs(np.linalg.eigvals(across))), [0, 0, 1, 1], atol=1e-12)
    # Nothing acts in its null space: the upper bound is 2^(1/2p) there, which no bound of 1 can ask for.
    bound, estimate = map(float, BOUNDS(across))
    assert bound > 1 + 3e-4 and estimate <= 1
