"""Elimination in component form against LAPACK."""

import jax
import jax.numpy as jnp
import numpy as np

from cnclik.law import dense


def components(matrix):
    return tuple(tuple(row) for row in matrix)


def test_solve_agrees_with_numpy_where_pivots_vanish():
    rng = np.random.default_rng(3)
    for n in (1, 2, 4, 6):
        a, b = rng.normal(size=(n, n)), rng.normal(size=n)
        if n > 1:
            a[0, 0] = 0.0  # no elimination without a row exchange
            a[1, 1] = a[1, 0] * a[0, 1] / 1e-13 if n > 4 else a[1, 1]
        x = jax.jit(lambda a, b: jnp.stack(dense.solve(components(a), tuple(b))))(jnp.asarray(a), jnp.asarray(b))
        np.testing.assert_allclose(x, np.linalg.solve(a, b), rtol=1e-9, atol=1e-12)


def test_solve_of_many_lanes_pivots_each_on_its_own():
    rng = np.random.default_rng(4)
    a, b = rng.normal(size=(200, 3, 3)), rng.normal(size=(200, 3))
    x = jax.vmap(lambda a, b: jnp.stack(dense.solve(components(a), tuple(b))))(jnp.asarray(a), jnp.asarray(b))
    np.testing.assert_allclose(x, np.linalg.solve(a, b[..., None])[..., 0], rtol=1e-7, atol=1e-9)
