"""native(fn): C inside JAX programs, under every transformation and to any order; closures, effects, trees, types."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import cnclik as ck
from cnclik.engine.program import Program, lane_avals
from cnclik.engine.reader import read, trace
from cnclik.errors import ArgumentError
from cnclik.threads import side_by_side
from engine.compare import NEEDS_C, same
from tests import bank


def own(case, k):
    """Nothing with robots in it: a loop, a stack, a whole number beside."""

    def step(c, _):
        return jnp.sin(c) * case["x"].sum() + k, c

    end, stack = lax.scan(step, case["x"], None, length=5)
    return {"end": end, "sum": jnp.sum(stack**2) * case["y"], "k": k + 1}


NATIVE = ck.native(own)
X, Y, K = np.linspace(0, 0.6, 3), 0.7, np.int32(2)
MANY = np.random.default_rng(0).normal(size=(4, 3))


def loss(fn):
    def of(x, y=Y, k=K):
        made = fn({"x": x, "y": y}, k)
        return jnp.sum(made["end"]) * made["sum"] + made["k"]

    return of


def through(fn):
    """Of a loop of one's own."""
    return jax.grad(
        lambda x: jnp.sum(lax.scan(lambda c, _: (fn({"x": c, "y": Y}, K)["end"] * 0.05, None), x, None, 3)[0])
    )


TRANSFORMED = {
    "call": lambda fn: fn({"x": X, "y": Y}, K),
    "jit": lambda fn: jax.jit(fn)({"x": X, "y": Y}, K),
    "vmap": lambda fn: jax.vmap(fn, ({"x": 0, "y": None}, None))({"x": MANY, "y": Y}, K),
    "vmap twice": lambda fn: jax.vmap(jax.vmap(loss(fn), (0, None)), (None, 0))(MANY, jnp.arange(2.0)),
    "vmap twice, together": lambda fn: jax.vmap(jax.vmap(loss(fn)))(MANY[None], jnp.ones((1, 4))),
    "jvp, a number's tangent": lambda fn: jax.vmap(lambda y: jax.jvp(lambda y: loss(fn)(X, y), (y,), (1.0,)))(MANY[0]),
    "grad": lambda fn: jax.grad(loss(fn), (0, 1))(X, Y),
    "grad of vmap": lambda fn: jax.grad(lambda m, y: jnp.sum(jax.vmap(lambda x: loss(fn)(x, y))(m)), (0, 1))(MANY, Y),
    "jacfwd": lambda fn: jax.jacfwd(lambda x: fn({"x": x, "y": Y}, K)["end"])(X),
    "jacrev": lambda fn: jax.jacrev(lambda x: fn({"x": x, "y": Y}, K)["end"])(X),
    "hessian": lambda fn: jax.hessian(loss(fn))(X),
    "reverse over reverse": lambda fn: jax.grad(lambda x: jnp.sum(jax.grad(loss(fn))(x) ** 2))(X),
    "scan": lambda fn: jax.jit(through(fn))(X),
    "checkpoint": lambda fn: jax.grad(jax.checkpoint(loss(fn)))(X),
    "no lanes": lambda fn: jax.vmap(loss(fn))(MANY[:0]),
}


def test_transformations():
    """As parts of one program, as XLA takes long for many small ones; three also alone."""
    found, wanted = (jax.jit(lambda fn=fn: {k: of(fn) for k, of in TRANSFORMED.items()})() for fn in (NATIVE, own))
    same(found, wanted, ulps=400)
    for name in ("call", "vmap", "grad"):
        same(TRANSFORMED[name](NATIVE), wanted[name], ulps=400)


def test_without_jit_it_is_the_function_step_by_step():
    with jax.disable_jit():
        found = jax.vmap(jax.grad(ck.native(lambda x: jnp.sum(jnp.sin(x) * x))))(MANY)
    same(found, np.sin(MANY) + MANY * np.cos(MANY), ulps=10)


@NEEDS_C
def test_a_large_batch_is_done_by_several_threads():
    """Also where several calls share them, and one of another size waits."""
    fn = jax.jit(jax.vmap(lambda x: NATIVE({"x": x, "y": Y}, K)))
    assert "lanes-" in fn.lower(MANY).as_text()
    several = [np.random.default_rng(n).normal(size=(n, 3)) for n in (5003, 4096, 70, 1001)]
    with side_by_side(4) as pool:
        found = list(pool.map(lambda x: jax.block_until_ready(fn(x)), 8 * several))
    wanted = jax.jit(jax.vmap(lambda x: own({"x": x, "y": Y}, K)))(np.concatenate(several))
    ends = np.cumsum([len(x) for x in several])
    for i, one in enumerate(found):
        own_lanes = slice(ends[i % 4] - len(several[i % 4]), ends[i % 4])
        same(one, {name: x[own_lanes] for name, x in wanted.items()}, ulps=400)


@NEEDS_C
def test_within_lanes_it_is_a_part_of_their_program():
    """Also batched, differentiated or in a loop there: a call of another program had no C form."""
    half = ck.native(lambda x: {"half": jnp.sin(x) / 2})

    def fn(x):
        once = jax.vmap(lambda v: half(v)["half"])(x)
        return jax.grad(lambda v: half(v)["half"] @ once)(x), lax.fori_loop(0, 3, lambda _, v: half(v)["half"], x)

    x = np.linspace(0.1, 2.0, 12, dtype=np.float32).reshape(4, 3)
    assert isinstance(ck.native(fn).of(x[0])[0].form("lanes", lane_avals([x]), np.inf), Program)
    same(ck.lanes(fn)(x), jax.jit(jax.vmap(fn))(x), ulps=10)


def test_without_a_c_form_it_is_the_function():
    def of(x):
        return jnp.linalg.svd(x, compute_uv=False)

    x = np.random.default_rng(0).normal(size=(5, 2, 2))
    found, wanted = (jax.jit(lambda x, fn=fn: (jax.vmap(fn)(x), jax.jacrev(fn)(x[0])))(x) for fn in (ck.native(of), of))
    same(found, wanted, ulps=100)


def test_a_key_of_random_numbers_may_be_an_argument_and_a_result():
    key = jax.random.key(0)

    def of(key, x):
        return x * jax.random.normal(key, (3,))

    found, wanted = (jax.jit(jax.grad(lambda x, fn=fn: jnp.sum(fn(key, x))))(X) for fn in (ck.native(of), of))
    same(found, wanted)
    found, two = ck.native(lambda key: (jax.random.split(key), 2.0))(key)
    assert jnp.all(found == jax.random.split(key)) and two == 2.0


def test_what_was_made_in_64_bits_may_be_used_in_32():
    """A path and joint values that hold arrays of JAX in float64; C read them as numbers of the other size."""
    path, law = ck.waypoints([0.0, 1.0], [[1.2, 0.9], [1.1, 0.8]]), bank.law("planar2")

    def end(q0):
        return ck.solve(law, path, q0, 0.01, 4, "EE").e[-1]

    q0 = jnp.array([0.3, 0.7])
    wanted = end(q0)
    with jax.enable_x64(False):
        for found in (end(np.asarray(q0)), end(q0), jax.jit(end)(q0), jax.vmap(end)(q0[None])[0]):
            assert found.dtype == np.float32
            np.testing.assert_allclose(found, wanted, atol=1e-6)


def test_empty_arrays():
    def of(x):
        sums = x.sum(), x.sum(0), x.prod(), jnp.cumsum(x, 0), x @ x, jnp.any(x > 1), jnp.all(x > 1)
        algebra = jnp.linalg.cholesky(x), jnp.linalg.solve(x, x[:, :0]), jnp.linalg.inv(x)
        places = jnp.ones(3).at[x.ravel().astype(int)].set(0.0), jnp.append(x.ravel(), jnp.ones(2)), jnp.pad(x, 1)
        return sums, algebra, places, lax.scan(lambda c, v: (c + v.sum(), v), 1.0, x)

    empty = np.zeros((0, 0))
    wanted = jax.jit(of)(empty)
    same(ck.native(of)(empty), wanted)
    same(ck.lanes(of)(empty[None]), jax.tree.map(lambda x: x[None], wanted))


def test_errors_are_the_functions_own():
    with pytest.raises(ArgumentError, match="`fn` must be a function of arrays"):
        ck.native(3)
    with pytest.raises(ZeroDivisionError):
        ck.native(lambda x: 1 / 0)(X)
    with pytest.raises(TypeError, match="dot_general"):
        ck.native(lambda x: x @ MANY)(X)


def moved(q0):
    return jnp.sum(ck.solve(bank.law("planar2"), ck.hold([1.2, 0.9]), q0, 0.01, 4, "EE").e[-1] ** 2)


@pytest.mark.parametrize("fn", [ck.lanes(moved), jax.vmap(jax.grad(moved))])
def test_for_a_gpu_it_is_jax_alone(fn):
    """Lowered for CUDA, without one: neither C nor LAPACK, and the engine's scalars."""
    text = jax.jit(fn).trace(np.zeros((300, 2))).lower(lowering_platforms=("cuda",)).as_text()
    assert "custom_call" not in text and "dot_general" not in text and "sine" in text


def test_the_tree_of_results_is_that_of_the_shapes_of_a_call():
    for quick in (ck.native(lambda x: tuple(2 * a for a in x)), ck.lanes(lambda x: tuple(2 * a for a in x))):
        for size in (2, 3, 2):
            assert len(quick(jnp.ones((size, size)))) == size


@pytest.mark.parametrize(
    "around",
    [
        lambda used: jax.jit(used)(2.0),
        lambda used: jax.grad(used)(2.0),
        lambda used: jax.vmap(used)(jnp.arange(3.0)),
        lambda used: lax.scan(lambda c, a: (used(a, c), c), 1.0, jnp.arange(3.0))[1],
    ],
)
def test_numbers_of_a_trace_around_it_may_be_closed_over(around):
    def used(of):
        return lambda a, x=0.5: of(lambda x: a * jnp.sin(x))(x)

    np.testing.assert_allclose(around(used(ck.native)), around(used(lambda fn: fn)), rtol=1e-6)


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
    whole = trace(lambda x: jax.lax.reduce_precision(x, 8, 23), [jax.typeof(x)])  # as jax.checkpoint has it
    assert read(whole.closed)


@pytest.mark.parametrize("dtype", [jnp.bfloat16, jnp.complex64])
def test_results_of_other_types_have_derivatives(dtype):
    def squared(x):
        return (x * jnp.array(2, dtype)) ** 2

    x, holomorphic = jnp.array(0.5, dtype), dtype == jnp.complex64

    def real(x):
        return ck.native(squared)(x.astype(dtype)).real.astype(float)

    found = [jax.grad(fn, holomorphic=holomorphic) for fn in (ck.native(squared), squared)]
    assert jax.jit(lambda x, y: [*(fn(x) for fn in found), jax.grad(real)(y)])(x, 0.5) == [4, 4, 4]


def test_places_of_a_small_type_reach_all_of_a_long_array():
    def placed(x, k):
        changed = jax.lax.dynamic_update_slice(x, x[:2], (k,))
        return x[k], jax.lax.dynamic_slice(x, (k,), (2,)), changed[k], x.at[k].add(1.0)[k]

    x, k = np.arange(300, dtype=np.float32), np.uint8(250)  # JAX 0.10.2 holds a start of an update below 298 - 256
    for got, right in zip(ck.native(placed)(x, k), (x[250], x[250:252], x[0], 251), strict=True):
        np.testing.assert_array_equal(got, right)
