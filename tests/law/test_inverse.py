"""pseudoinverse and damped against NumPy; what each inverse says of singularity."""

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


def wanted_matrix(name, a):
    if name == "pseudoinverse":
        return np.linalg.pinv(a)
    return a.T @ np.linalg.inv(a @ a.T + 0.2**2 * np.eye(len(a)))


SHAPES = [(1, 1), (1, 3), (2, 2), (2, 5), (3, 2), (3, 3), (6, 6), (6, 4)]
LONG = {(6, 6), (6, 4)}  # compile for seconds as a pseudoinverse; those of 3 rows take the same way


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        *(pytest.param("pseudoinverse", s, marks=pytest.mark.slow if s in LONG else ()) for s in SHAPES),
        *(("damped", s) for s in [(1, 3), (2, 2), (3, 2), (6, 6)]),
    ],
    ids=str,
)
def test_against_numpy(name, shape):
    rng = np.random.default_rng(4)
    for a in (rng.normal(size=shape), np.outer(rng.normal(size=shape[0]), rng.normal(size=shape[1]))):
        v = rng.normal(size=shape[0])
        if name == "pseudoinverse" and np.linalg.matrix_rank(a) < min(shape):
            matrix = np.linalg.pinv(a, rcond=1e-12)
        else:
            matrix = wanted_matrix(name, a)
        found, least = apply(INVERSES[name], a, v)
        close(found, matrix @ v, atol=1e-11 * np.abs(matrix).max())
        # `least` is an estimate from below; for the pseudoinverse within √m, and exact with two rows.
        s = np.linalg.svd(a, compute_uv=False)[-1]
        if name == "pseudoinverse":
            exact = min(shape) <= 2
            assert s * (1 if exact else min(shape) ** -0.5) - 1e-13 <= least <= s + 1e-13
        else:
            assert -1e-12 <= least <= s + 1e-5


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
