"""Random numbers whose keys are known only as the program runs are JAX's own, in C and as JAX scalars."""

import jax
import numpy as np
import pytest
from jax import lax

import cnclik as ck
from cnclik.engine.compiler import can_build
from engine.compare import check, in_c, same

pytestmark = pytest.mark.skipif(not can_build(), reason="no C compiler")

SEEDS = np.arange(19, dtype=np.uint32)


def drawn(seed, x):
    one, other = jax.random.split(jax.random.fold_in(jax.random.key(seed), 3))
    numbers = jax.random.normal(one, (5,), x.dtype), jax.random.uniform(other, (3,), x.dtype)
    return (
        *numbers,
        jax.random.randint(other, (2,), 0, 50),
        jax.random.bits(jax.random.wrap_key_data(x.astype("float32").view("uint32")[:2])),
    )


def carried(seed, x):
    def one(key, _):
        key, own = jax.random.split(key)
        return key, jax.random.normal(own, dtype=x.dtype)

    return lax.scan(one, jax.random.key(seed), length=5)[1]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("fn", [drawn, carried], ids=lambda f: f.__name__)
def test_numbers_are_those_of_jax(fn, dtype):
    with jax.enable_x64(dtype == "float64"):
        check(fn, SEEDS, np.random.default_rng(0).normal(size=(19, 4)).astype(dtype), ulps=64, scalar_too=False)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_the_inverse_of_the_error_function(dtype):
    x = np.array([*np.linspace(-0.95, 0.95, 301), -1, 1, 1e-30, 1.5, np.nan], dtype)
    tail = (1 - np.geomspace(1e-6, 0.1, 50)).astype(dtype)  # where the rounding of 1 − x² is felt
    with jax.enable_x64(dtype == "float64"):
        check(lax.erf_inv, x, ulps=64, each=True, scalar_too=False)
        check(lax.erf_inv, tail, ulps=1e6 if dtype == "float64" else 64, each=True, scalar_too=False)


def test_each_lane_has_noise_of_its_own_seed():
    law = ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("xy"), alpha=4.0)
    drive = ck.Drive(joint_noise=0.01)

    def run(seed):
        return ck.solve(law, ck.hold([1.0, 1.0]), np.array([0.3, 0.9]), 0.05, 20, drive=ck.replace(drive, seed=seed)).q

    with jax.enable_x64(True):
        same(in_c(run, SEEDS), jax.vmap(run)(SEEDS), ulps=1e4)


def test_a_known_key_in_a_users_own_jit_and_vmap():
    """The program is made while the user's function is lowered, where what JAX computes would be traced."""
    key = jax.random.key(3)

    def walk(x, i):
        return x + jax.random.normal(jax.random.fold_in(key, i)), None

    walks = ck.native(lambda x: lax.scan(walk, x, np.arange(2))[0])
    np.testing.assert_array_equal(jax.jit(jax.vmap(walks))(np.zeros(3)), np.full(3, walks(0.0)))
