"""The pseudoinverse: every shape and rank, values and derivatives; Cholesky factors."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnclik.engine.reader import read
from cnclik.engine.source import write
from cnclik.engine.tracing import to_be_read
from cnclik.hints import equations
from cnclik.law import dense
from tests.oracles import central_differences, close


def pinv(a):
    return dense.pinv(a)[0].T


def batched(fn):
    """Compiled, for any number of matrices; always for so many that a shape is one compilation."""
    many = jax.jit(jax.vmap(fn))

    def call(a):
        chunks = [a[i : i + BATCH] for i in range(0, len(a), BATCH)]
        found = [many(np.concatenate([c, np.repeat(c[:1], BATCH - len(c), axis=0)])) for c in chunks]
        return jax.tree.map(lambda *parts: np.concatenate(parts)[: len(a)], *found)

    return call


BATCH = 32
many = batched(dense.pinv)


def many_pinv(a):
    return many(a)[0].transpose(0, 2, 1)


def applied(rows, t):
    return dense.pinv_applied(rows, dense.pinv(rows)[0], t)


many_applied = jax.jit(jax.vmap(applied))


def many_least(a):
    return many(a)[1]


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
    out += [np.eye(*shape), np.ones(shape), 1e-8 * out[0], 1e8 * out[1], np.zeros(shape)]
    return np.array(out)


SHAPES = [(m, n) for m in range(1, 7) for n in range(1, 8)]
# One compilation each: wide, square and tall; the others behind `slow`.
QUICK = {(1, 1), (2, 3), (3, 3), (3, 4), (4, 2), (6, 1)}


@pytest.mark.parametrize(
    "shape", [s if s in QUICK else pytest.param(s, marks=pytest.mark.slow) for s in SHAPES], ids=str
)
def test_against_numpy(shape):
    a = cases(shape)
    for found, matrix in zip(many_pinv(a), a, strict=True):
        wanted = np.linalg.pinv(matrix, rcond=1e-12)
        close(found, wanted, atol=1e-12 * max(1e-300, np.abs(wanted).max()) * 10)


@pytest.mark.parametrize(
    "shape",
    [(2, 5), (3, 4), (4, 2), *(pytest.param(s, marks=pytest.mark.slow) for s in [(3, 3), (6, 6), (6, 7)])],
    ids=str,
)
def test_least_singular_value(shape):
    """Exact with two rows or columns, and where rows are nearly dependent; else from below, within √m."""
    a = cases(shape)
    wanted = np.linalg.svd(a, compute_uv=False)
    largest = np.maximum(wanted[:, 0], 1e-300)
    found, least = many_least(a) / largest, wanted[:, -1] / largest
    nearly = (least < 1e-6) | (min(shape) <= 2)
    close(found[nearly], least[nearly], atol=1e-14)
    assert np.all(found <= least * (1 + 1e-9) + 1e-14)
    assert np.all(found >= least / np.sqrt(min(shape)) - 1e-14)


@pytest.mark.parametrize(
    ("dtype", "m"),
    [(np.float32, 3), *(pytest.param(d, 6, marks=pytest.mark.slow) for d in (np.float32, np.float64))],
)
def test_the_quick_way_is_as_good_as_any(dtype, m):
    """Conditions from 1 to where J J^T loses all digits: the error of J# stays a small multiple of eps times κ."""
    draw, eps = np.random.default_rng(3), np.finfo(dtype).eps
    for condition in (1.0, 10.0, eps**-0.25, eps ** (-1 / 3), eps**-0.5):
        u, v = (np.linalg.qr(draw.normal(size=(50, k, k)))[0] for k in (m, m + 1))
        a = ((u * np.geomspace(1.0, 1.0 / condition, m)) @ v[:, :m]).astype(dtype)
        wanted = np.linalg.pinv(a.astype(float), rcond=1e-14)
        error = np.abs(np.asarray(many_pinv(a), float) - wanted).max(axis=(1, 2)) / condition
        assert error.max() < 50 * eps * condition
        t = draw.normal(size=(50, m)).astype(dtype)
        error = np.abs(many_applied(a, t) - np.einsum("bij,bj->bi", wanted, t)).max(axis=1) / condition
        assert error.max() < 100 * eps * condition


@pytest.mark.parametrize(
    ("shape", "many"),
    [
        ((3, 4), many_pinv),
        pytest.param((6, 7), many_pinv, marks=pytest.mark.slow),
    ],
    ids=["(3, 4)", "(6, 7)"],
)
def test_ill_conditioned_keeps_relative_accuracy(shape, many):
    """Singular values down to 1e-8 of the largest count, as they do in numpy."""
    rng = np.random.default_rng(0)
    a = np.array([with_singular_values(shape, [1, 0.3, 1e-2, 1e-4, 1e-6, 1e-8][-shape[0] :], rng)])
    wanted = np.linalg.pinv(a[0], rcond=1e-12)
    close(many(a)[0], wanted, atol=1e-6 * np.abs(wanted).max())


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 10**9), rank=st.integers(0, 3), scale=st.floats(-6, 6))
def test_penrose_conditions(seed, rank, scale):
    rng = np.random.default_rng(seed)
    a = 10**scale * with_singular_values((3, 4), rng.uniform(0.3, 3, rank), rng)
    p = np.asarray(many_pinv(a[None])[0])
    size = np.abs(a).max() or 1.0
    close(a @ p @ a / size, a / size, atol=1e-13)
    close(p @ a @ p * size, p * size, atol=1e-11)
    close(a @ p, (a @ p).T, atol=1e-13)
    close(p @ a, (p @ a).T, atol=1e-13)


# --- derivatives --------------------------------------------------------------------------------------


@functools.cache
def derivatives(shape):
    """Compiled: values of a batch of flat matrices, and first and second directional derivatives of one."""
    flat = lambda x: pinv(x.reshape(shape)).ravel()  # noqa: E731
    second = lambda x, d: jax.jvp(lambda x: jax.jvp(flat, (x,), (d,))[1], (x,), (d,))[1]  # noqa: E731
    both = jax.jit(lambda x, d: (jax.jacfwd(flat)(x), jax.jacrev(flat)(x), second(x, d)))
    return lambda x: many_pinv(x.reshape(-1, *shape)).reshape(len(x), -1), both


@pytest.mark.parametrize(
    "shape", [(1, 3), (3, 3), (4, 2), *(pytest.param(s, marks=pytest.mark.slow) for s in [(2, 2), (2, 5)])], ids=str
)
def test_derivative_at_full_rank(shape):
    many, all_three = derivatives(shape)
    rng, k = np.random.default_rng(1), min(shape)
    for values in (np.linspace(0.7, 2, k), [1.2] * k):  # distinct and equal singular values
        x = with_singular_values(shape, values, rng).ravel()
        wanted = central_differences(many, x)
        size = np.abs(wanted).max()
        d = rng.normal(size=x.shape)
        forward, reverse, second = all_three(x, d)
        close(forward, wanted, atol=1e-8 * size)
        close(reverse, forward, atol=1e-13 * size)
        h = 1e-5
        slope = lambda x: np.asarray(all_three(x, d)[0]) @ d  # noqa: B023, E731
        numeric = (slope(x + h * d) - slope(x - h * d)) / (2 * h)
        close(second, numeric, atol=1e-7 * np.abs(numeric).max())


@pytest.mark.slow  # 6 rows; 3 rows are below and above
def test_derivative_of_a_whole_pose():
    """6×7, in one direction: the size of a pose task on a redundant arm."""
    rng = np.random.default_rng(5)
    a, d = rng.normal(size=(2, 6, 7))
    _, found = jax.jit(lambda a, d: jax.jvp(pinv, (a,), (d,)))(a, d)
    h = 1e-5
    after, before = (np.linalg.pinv(a + s * d) for s in (h, -h))
    wanted = (after - before) / (2 * h)
    close(found, wanted, atol=1e-7 * np.abs(wanted).max())


@pytest.mark.parametrize(
    "shape", [(3, 3), (4, 2), *(pytest.param(s, marks=pytest.mark.slow) for s in [(2, 2), (2, 5)])], ids=str
)
def test_derivative_where_the_rank_is_deficient(shape):
    """Along a path of constant rank it is the derivative; in any direction, and to second order, it is finite."""
    many, all_three = derivatives(shape)
    rng = np.random.default_rng(2)
    left, right = rng.normal(size=(2, shape[0], 1)), rng.normal(size=(2, 1, shape[1]))
    path = lambda t: ((left[0] + t * left[1]) @ (right[0] + t * right[1])).ravel()  # noqa: E731
    h = 1e-5
    numeric = (many(path(h)[None]) - many(path(-h)[None]))[0] / (2 * h)
    velocity = (path(h) - path(-h)) / (2 * h)
    for made in all_three(path(0), velocity)[:2]:
        close(made @ velocity, numeric, atol=1e-8 * np.abs(numeric).max())
    for x in (path(0), np.zeros(np.prod(shape)), np.ones(np.prod(shape))):
        assert all(np.all(np.isfinite(made)) for made in all_three(x, rng.normal(size=x.shape)))


def test_derivatives_of_what_is_applied_factor_once():
    t = np.ones(3)

    def both(rows):
        columns, _ = dense.pinv(rows)
        return dense.pinv_applied(rows, columns, t) + dense.pinv_applied(rows, columns, 2 * t)

    traced = jax.make_jaxpr(jax.jacfwd(both))(np.eye(3, 4)).jaxpr
    assert sum(e.primitive.name == "cholesky" for e in equations(traced)) == 1


def test_float32():
    rng = np.random.default_rng(3)
    a = np.array([with_singular_values((3, 4), v, rng) for v in ([1, 0.5, 0.1], [1, 1], [1], [])], np.float32)
    found = many_pinv(a)
    assert found.dtype == jnp.float32
    for one, matrix in zip(found, a, strict=True):
        close(one, np.linalg.pinv(matrix.astype(float), rcond=1e-5), atol=5e-5)
    t = rng.normal(size=(len(a), 3)).astype(np.float32)
    close(many_applied(a, t), np.einsum("bij,bj->bi", found, t), atol=5e-5)  # of singular ones, too
    close(*(jax.vmap(jax.jacrev(f))(a, t) for f in (applied, lambda a, t: t @ dense.pinv(a)[0])))
    assert np.all(np.isfinite(jax.jit(jax.vmap(jax.jacfwd(pinv)))(a)))


# --- Cholesky factors ---------------------------------------------------------------------------------


@pytest.mark.parametrize("m", range(1, 7))
def test_factors_solve_and_trace(m):
    rng = np.random.default_rng(m)
    a = rng.normal(size=(m, m + 1))
    b = rng.normal(size=m)

    @jax.jit
    def solve(a, b):
        lower = dense.cholesky(dense.shifted(a @ a.T, jnp.asarray(0.01)))
        return dense.cholesky_solve(lower, b), dense.inverse_trace(lower)

    s = a @ a.T + 0.01 * np.eye(m)
    x, trace = solve(a, b)
    close(x, np.linalg.solve(s, b), rtol=1e-11)
    assert trace == pytest.approx(np.trace(np.linalg.inv(s)), rel=1e-11)


def damped_solve(rows, shift, b):
    matrix = dense.shifted(rows @ rows.T, shift)
    return dense.factored_solve(dense.cholesky(matrix), lambda x: rows @ (x @ rows) + shift * x, b)


def test_a_factored_solve_has_all_derivatives():
    """Forward, reverse and second ones by A, whose factor has none; breaks where the product leaves out the shift."""
    rng = np.random.default_rng(0)
    given = rng.normal(size=(3, 5)), np.array([0.1, 0.2, 0.3]), rng.normal(size=3)

    def plainly(rows, shift, b):
        return jnp.linalg.solve(rows @ rows.T + jnp.diag(shift), b)

    for differentiated in (jax.jacfwd, jax.jacrev, lambda f, by: jax.jacfwd(jax.jacrev(f, by), by)):
        found, wanted = (differentiated(f, (0, 1, 2))(*given) for f in (damped_solve, plainly))
        jax.tree.map(lambda a, b: close(a, b, rtol=1e-9, atol=1e-9), found, wanted)


def test_a_derivative_is_one_more_solve():
    """In C, 12 rows with a derivative cost 1.3 times the value; with the derivative of the factor 2.5 times."""
    given = [jnp.ones(shape) for shape in ((12, 17), (), (12,))]

    def pushed(*given):
        return jax.jvp(damped_solve, given, given)

    with to_be_read():
        operations = [write(*read(f, *given)[:3], [given[2]] * n)[1] for n, f in ((1, damped_solve), (2, pushed))]
    assert operations[1] < 2 * operations[0]
