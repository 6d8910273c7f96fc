"""pseudoinverse and damped against NumPy; what each inverse says of singularity."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from tests.oracles import close

INVERSES = {"pseudoinverse": ck.pseudoinverse(), "damped": ck.damped(0.2)}


@jax.jit
def apply(inverse, a, v):
    factored = inverse(a)
    return factored.apply(v), factored.least


def damped_matrix(a):
    return a.T @ np.linalg.inv(a @ a.T + 0.2**2 * np.eye(len(a)))


@pytest.mark.parametrize(
    ("name", "shape"), [*itertools.product(INVERSES, [(1, 3), (2, 2), (6, 7)]), ("damped", (3, 2))], ids=str
)
def test_against_numpy(name, shape):
    rng = np.random.default_rng(4)
    given = rng.normal(size=shape[0])
    for a in (rng.normal(size=shape), np.outer(rng.normal(size=shape[0]), rng.normal(size=shape[1]))):
        matrix = np.linalg.pinv(a, rcond=1e-12) if name == "pseudoinverse" else damped_matrix(a)
        singular = name == "pseudoinverse" and np.linalg.matrix_rank(a) < min(shape)
        v = (
            a @ (a.T @ given) if singular else given
        )  # next to a singularity what is out of reach is damped, and not cut off
        found, least = apply(INVERSES[name], a, v)
        close(found, matrix @ v, atol=1e-9 * np.abs(matrix @ v).max())
        s = np.linalg.svd(a, compute_uv=False)[-1]
        assert -1e-12 <= least <= s + 1e-5
        assert name == "damped" or least >= s * min(shape) ** -0.5 - 1e-6


@pytest.mark.parametrize(("smallest", "error"), [(1e-2, 1e-13), (1e-4, 1e-10), (1e-5, 1e-6), (1e-6, 2e-3)])
def test_the_pseudoinverse_near_a_singularity(smallest, error):
    """It errs by (λ²/(σ² + λ²))², as its docstring says; in any direction not by more."""
    rng = np.random.default_rng(5)
    u, w = (np.linalg.qr(rng.normal(size=(k, k)))[0] for k in (6, 7))
    values = np.array([1, 0.9, 0.8, 0.5, 0.3, smallest])
    a = u * values @ w[:6]
    j = np.linalg.pinv(a, rcond=1e-12)
    found = np.array([apply(INVERSES["pseudoinverse"], a, v)[0] for v in np.eye(6)]).T
    assert np.linalg.norm(found - j, 2) < error * np.linalg.norm(j, 2)
    assert smallest > 1e-3 or np.linalg.norm(found - j, 2) > error / 100 * np.linalg.norm(j, 2)


def test_its_derivatives_are_those_of_the_closed_form():
    """Golub & Pereyra 1973, eq. 4.12, at full rank; finite at a singularity, and second ones with them."""
    a, d = np.random.default_rng(1).normal(size=(2, 3, 4))
    v = np.array([1.0, -2.0, 0.5])
    p, j = np.linalg.pinv(a), lambda a: apply(ck.pseudoinverse(), a, v)[0]
    wanted = -p @ d @ p + p @ p.T @ d.T @ (np.eye(3) - a @ p) + (np.eye(4) - p @ a) @ d.T @ p.T @ p
    close(jax.jvp(j, (a,), (d,))[1], wanted @ v, rtol=1e-8, atol=1e-9)
    close(jax.jacrev(j)(a), jax.jacfwd(j)(a), rtol=1e-8, atol=1e-8)
    for bad in (np.ones((3, 4)), np.zeros((3, 4))):
        assert np.all(np.isfinite(jax.jacfwd(jax.jacrev(j))(bad)))


def test_damping_is_lambda_and_not_its_square():
    found, _ = apply(ck.damped(0.5), np.array([[2.0]]), np.array([1.0]))
    assert found[0] == pytest.approx(2 / (4 + 0.25), rel=1e-15)


def test_damping_is_a_leaf():
    """Another damping needs no new program, and can be differentiated."""
    assert len(jax.tree.leaves(ck.damped(0.1))) == len(jax.tree.leaves(ck.damped(jnp.asarray(0.1)))) == 1
    value = lambda d: apply(ck.damped(d), jnp.array([[2.0]]), jnp.array([1.0]))[0][0]  # noqa: E731
    assert jax.grad(value)(0.5) == pytest.approx(-2 * 2 * 0.5 / 4.25**2, rel=1e-14)


@pytest.mark.parametrize("name", INVERSES)
def test_float32_at_a_singularity(name):
    inverse = ck.damped(0.05) if name == "damped" else INVERSES[name]
    inverse = jax.tree.map(lambda v: jnp.asarray(v, jnp.float32), inverse)
    a = np.array([[1, 1, 1], [1, 1, 1]], np.float32)
    found, least = apply(inverse, a, np.array([0.5, -0.25], np.float32))
    assert found.dtype == jnp.float32 and np.all(np.isfinite(found))
    assert least < 0.01


@pytest.mark.parametrize("bad", [0.0, -1, np.nan, "x", [0.1, 0.2]])
def test_bad_damping(bad):
    with pytest.raises(ck.ArgumentError, match="Argument `damping` must be"):
        ck.damped(bad)
