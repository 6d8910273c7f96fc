"""The least singular value of every shape and rank, with derivatives; Cholesky factors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cnclik.law import dense
from cnclik.law.inverse import least_squared
from tests.oracles import close

SHAPES = [(1, 1), (4, 2), (6, 7)]


def with_singular_values(shape, values, rng):
    """A random matrix of this shape with these singular values (zeros after them)."""
    m, n = shape
    u, v = (np.linalg.qr(rng.normal(size=(k, k)))[0] for k in (m, n))
    s = np.zeros(shape)
    np.fill_diagonal(s, [*values, *[0.0] * (min(m, n) - len(values))])
    return u @ s @ v.T


def cases(shape):
    """Full rank, every lower rank, equal and nearly equal singular values, badly scaled, zero."""
    rng, k = np.random.default_rng(shape), min(shape)
    out = [rng.normal(size=shape) for _ in range(3)]
    out += [with_singular_values(shape, rng.uniform(0.5, 2, r), rng) for r in range(1, k + 1) for _ in range(2)]
    out += [with_singular_values(shape, [1.5] * r, rng) for r in range(1, k + 1)]
    out += [with_singular_values(shape, 1.5 + 1e-9 * np.arange(k), rng)]
    out += [np.eye(*shape), np.ones(shape), 1e-3 * out[0], 1e8 * out[1], np.zeros(shape)]
    return np.array(out)


def test_least_singular_value():
    """That of (Σ σᵢ⁻⁶⁴)^(-1/64): exact where it is alone, up to 3 % less where six are equal, 0 below rounding."""
    each, every = jax.vmap(lambda rows: jnp.sqrt(least_squared(rows))), [cases(shape) for shape in SHAPES]
    for a, least in zip(every, jax.jit(lambda every: [each(one) for one in every])(every), strict=True):
        values = np.linalg.svd(a, compute_uv=False)
        largest = np.maximum(values[:, 0], 1e-30)
        least, wanted = np.asarray(least) / largest, values[:, -1] / largest
        assert np.all(least <= wanted + 1e-6) and np.all(least >= 0.97 * wanted - 1e-6), a.shape
        alone = (values[:, -1] < 0.7 * values[:, -2]) | (wanted == 0) if min(a.shape[1:]) > 1 else wanted > 0
        close(least[alone], wanted[alone], atol=1e-6)
        assert alone.sum() >= 2, a.shape


def test_its_derivative_at_equal_values_is_the_mean_of_theirs():
    """A decomposition's has no meaning there. J = I: dσ_min² = 2 tr(dJ)/m, times m^(-1/32)."""
    d = np.random.default_rng(0).normal(size=(3, 3))
    value, slope = jax.jit(lambda *of: jax.jvp(least_squared, of[:1], of[1:]))(np.eye(3), d)
    assert value == pytest.approx(3 ** (-1 / 32), rel=1e-10)
    assert slope == pytest.approx(float(value) * 2 * np.trace(d) / 3, rel=1e-9)


def systems(m, count=20):
    rng = np.random.default_rng(m)
    j = rng.normal(size=(count, m, m + 2))
    return j @ j.mT + 0.1 * np.eye(m), rng.normal(size=(count, m)), rng.normal(size=(count, m, 3))


def solved(a, b, more):
    lower = dense.cholesky(a)
    return dense.cholesky_solve(lower, b), dense.cholesky_solve(lower, more), dense.inverse_trace(lower)


@pytest.mark.parametrize("m", [6, 26])
def test_a_batch_is_numpys_one_by_one(m):
    """Without LAPACK: in batches its threads may wait for each other for good, as in a loop of two arms they did."""
    given = systems(m)
    batch, alone = jax.jit(jax.vmap(solved)).lower(*given), jax.jit(solved).lower(*(v[0] for v in given))
    assert "lapack" not in batch.as_text() and "lapack" in alone.as_text()
    made = batch.compile()(*given)
    alone = alone.compile() if m == 6 else None
    for k, (a, b, more) in enumerate(zip(*given, strict=True)):
        wanted = np.linalg.solve(a, b), np.linalg.solve(a, more), np.trace(np.linalg.inv(a))
        found = (alone(a, b, more), [v[k] for v in made]) if alone and k < 2 else ([v[k] for v in made],)
        for values in found:
            for value, expected in zip(values, wanted, strict=True):
                close(value, expected, rtol=1e-9, atol=1e-12)


def test_right_sides_of_one_matrix_in_nested_batches():
    a, _, _ = systems(4, 1)
    b = np.random.default_rng(0).normal(size=(2, 3, 4, 5))  # columns in batches of batches
    found = jax.jit(jax.vmap(jax.vmap(lambda b: dense.cholesky_solve(dense.cholesky(a[0]), b))))(b)
    close(found, np.linalg.solve(a, b), rtol=1e-9, atol=1e-12)


def test_what_is_not_positive_has_no_factor():
    a = np.stack([np.eye(3), np.diag([1.0, -1.0, 1.0])])
    factor = lambda a: (lower := dense.cholesky(a), dense.inverse_trace(lower))  # noqa: E731
    batch, alone = jax.jit(lambda a: (jax.vmap(factor)(a), [factor(one) for one in a]))(a)
    for lower in (batch[0], [one[0] for one in alone]):
        assert np.isfinite(lower[0]).all() and np.isnan(lower[1]).any()
    assert np.isinf(batch[1][1])


@pytest.mark.parametrize(("lanes", "m"), [(False, 3), (True, 10)])
def test_derivatives_are_differences(lanes, m):
    """Forward, reverse and second ones, of one system and within a batch."""
    given = systems(m, count=2)

    def value(s, a, b, more):
        return sum(jnp.sum(jnp.sin(v)) for v in solved(a + s * jnp.cos(a), b + s, more))

    def slopes(s, *given):
        """Value and reverse, forward and second."""
        return jax.jvp(jax.value_and_grad(lambda s: value(s, *given)), (s,), (1.0,))

    run = jax.jit(jax.vmap(slopes, (None, 0, 0, 0)) if lanes else lambda s, *v: slopes(s, *(x[0] for x in v)))
    h = 1e-6
    ((_, reverse), (forward, second)), (ahead, _), (behind, _) = (run(s, *given) for s in (0.0, h, -h))
    close(forward, reverse, rtol=1e-9)
    close(reverse, (ahead[0] - behind[0]) / (2 * h), rtol=1e-5, atol=1e-6)
    close(second, (ahead[1] - behind[1]) / (2 * h), rtol=1e-4, atol=1e-5)


def damped_solve(rows, shift, b):
    matrix = dense.shifted(rows @ rows.T, shift)
    return dense.factored_solve(dense.cholesky(matrix), lambda x: rows @ (x @ rows) + shift * x, b)


def test_a_factored_solve_has_all_derivatives():
    """Forward, reverse and second ones by A, whose factor has none; breaks where the product leaves out the shift."""
    rng = np.random.default_rng(0)
    given = rng.normal(size=(3, 5)), np.array([0.1, 0.2, 0.3]), rng.normal(size=3)

    def plainly(rows, shift, b):
        return jnp.linalg.solve(rows @ rows.T + jnp.diag(shift), b)

    along = tuple(rng.normal(size=x.shape) for x in given)

    def slopes(fn):
        reverse = jax.grad(lambda *at: jnp.sum(jnp.sin(fn(*at))), (0, 1, 2))
        return jax.jit(lambda *at: (jax.jvp(fn, at, along), jax.jvp(reverse, at, along)))(*given)

    jax.tree.map(lambda a, b: close(a, b, rtol=1e-9, atol=1e-9), slopes(damped_solve), slopes(plainly))
