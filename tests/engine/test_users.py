"""Engine: what users do with `native` beside arithmetic: closures, effects, trees, types."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck


def wave(a, x):
    return a * jnp.sin(x)


def test_the_tree_of_results_is_that_of_the_shapes_of_a_call():
    for quick in (ck.native(lambda x: tuple(2 * a for a in x)), ck.lanes(lambda x: tuple(2 * a for a in x))):
        for size in (2, 3, 2):
            assert len(quick(jnp.ones((size, size)))) == size


@pytest.mark.parametrize(
    "around",
    [
        lambda of: jax.jit(lambda a: of(lambda x: wave(a, x))(0.5))(2.0),
        lambda of: jax.grad(lambda a: of(lambda x: wave(a, x))(0.5))(2.0),
        lambda of: jax.vmap(lambda a: of(lambda x: wave(a, x))(0.5))(jnp.arange(3.0)),
        lambda of: jax.lax.scan(lambda c, a: (of(lambda x: wave(a, x))(c), c), 1.0, jnp.arange(3.0))[1],
        lambda of: jax.jit(lambda a: jax.vmap(of(lambda x: wave(a, x)))(jnp.arange(3.0)))(2.0),
    ],
)
def test_numbers_of_a_trace_around_it_may_be_closed_over(around):
    np.testing.assert_allclose(around(ck.native), around(lambda fn: fn), rtol=1e-6)


def test_effects_and_named_axes_are_those_of_the_function():
    seen = []

    def shares(x):
        jax.debug.callback(lambda v: seen.append(float(v)), x)
        return x / jax.lax.psum(x, "lane")

    made = jax.jit(jax.vmap(ck.native(shares), axis_name="lane"))(jnp.arange(1.0, 4.0))
    jax.effects_barrier()
    np.testing.assert_allclose(made, np.arange(1, 4) / 6, rtol=1e-6)
    assert sorted(seen) == [1, 2, 3]


def test_numbers_are_rounded_where_a_precision_is_asked_for():
    rounds, x = lambda x: jax.lax.reduce_precision(x, 8, 7), jnp.float32(1.2345678)
    assert ck.native(rounds)(x) == rounds(x) != x


@pytest.mark.parametrize("dtype", [jnp.bfloat16, jnp.float16, jnp.complex64])
def test_results_of_other_types_have_derivatives(dtype):
    def squared(x):
        return (x * jnp.array(2, dtype)) ** 2

    x, holomorphic = jnp.array(0.5, dtype), dtype == jnp.complex64
    got = jax.grad(ck.native(squared), holomorphic=holomorphic)(x)
    assert got == jax.grad(squared, holomorphic=holomorphic)(x) == 4
    assert jax.grad(lambda x: ck.native(squared)(x.astype(dtype)).real.astype(float))(0.5) == 4


@pytest.mark.parametrize("dtype", [np.uint8, np.int16])
def test_places_of_a_small_type_reach_all_of_a_long_array(dtype):
    def placed(x, k):
        changed = jax.lax.dynamic_update_slice(x, x[:2], (k,))
        return x[k], jax.lax.dynamic_slice(x, (k,), (2,)), changed, x.at[k].add(1.0)

    x, k = np.arange(300, dtype=np.float32), dtype(250)
    changed, more = x.copy(), x.copy()
    changed[250:252], more[250] = x[:2], 251  # JAX 0.10.2 holds a uint8 start of an update below 298 - 256
    for got, right in zip(ck.native(placed)(x, k), (x[250], x[250:252], changed, more), strict=True):
        np.testing.assert_array_equal(got, right)
