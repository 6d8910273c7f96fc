"""Rounds: one program for any number of rounds gives what jax.vmap gives for each."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import cnclik as ck
from cnclik.engine.numbers import Numbers
from cnclik.engine.program import Program, lane_avals
from cnclik.engine.rounds import RoundsError, any_rounds
from engine.compare import NEEDS_C, same
from tests.compiling import compiled

A = np.random.default_rng(5).normal(size=(3, 3)) / 3
SIZE = 19


def cut(x, start, end):
    return lax.slice_in_dim(x, start, end)


def track(q, N):
    """A loop and all that it passes, without the last round."""

    def step(q, k):
        q = q + 0.1 * jnp.sin(A @ q + jnp.where(k < N - 1, k, 0.0)).astype(q.dtype)
        return q, (q, jnp.sum(q * q), k < 3)

    end, (qs, sizes, early) = lax.scan(step, q, jnp.arange(N).astype(q.dtype))
    return end, cut(qs, 0, N - 1), sizes, early


def numbers_of_rows(q, N):
    """Sums, extremes and means of what a loop stacks."""
    end, qs, sizes, _ = track(q, N)
    return jnp.sum(qs, 0), jnp.max(sizes), jnp.mean(sizes), jnp.sum(jnp.ones(N, q.dtype) * end[0]), jnp.argmax(q) + N


def moved(q, N):
    """Reversed, joined, differences, running sums, and a second loop over all of them."""
    _, qs, sizes, _ = track(q, N)
    whole = jnp.concatenate([q[None], qs])
    gaps = cut(whole, 1, N) - cut(whole, 0, N - 1)
    back = jnp.flip(whole, 0)
    found, ys = lax.scan(lambda c, x: (c + x[0] * x[1], c[:2]), q, (back, sizes), reverse=True)
    return found, ys, jnp.cumsum(gaps, 0), jnp.pad(gaps, ((1, 2), (0, 0)))


def inside(q, N):
    """A loop within the loop, and the counter as a whole number."""

    def step(q, k):
        q, ins = lax.scan(lambda q, j: (q + 0.05 * jnp.cos(A @ q + j).astype(q.dtype), q[0]), q, jnp.arange(4.0))
        return q, (jnp.sum(ins), k + 1)

    return lax.scan(step, q, jnp.arange(N))[1]


@NEEDS_C
@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("fn", [track, numbers_of_rows, moved, inside])
def test_one_program_for_all(fn, dtype):
    q = np.random.default_rng(1).normal(size=(SIZE, 3)).astype(dtype)
    whole = Program(functools.partial(fn, N=any_rounds()), lane_avals([q]))
    for N in (8, 50, 131):
        found = jax.tree.unflatten(whole.tree, whole.of_rounds(N)([q], SIZE))
        same(found, jax.vmap(functools.partial(fn, N=N))(q), ulps=1000)


@NEEDS_C
@pytest.mark.parametrize("fn", [lambda x, N: x * len(range(N)), lambda x, N: x * (2 if N > 20 else 1)])
def test_what_depends_on_the_number_has_a_program_for_each(fn):
    with pytest.raises(RoundsError, match="rounds"):
        Program(functools.partial(fn, N=any_rounds()), [jax.ShapeDtypeStruct((), float)])
    for N in (8, 30):
        run = Numbers(lambda x, N: fn(x, N), lets_go=True)
        assert run((), (np.float64(1.5),), N=N) == fn(1.5, N)


@NEEDS_C
@pytest.mark.parametrize("method", ["EXP-MIDPOINT", "RK4"])
def test_a_run_of_another_length_needs_no_new_program(method):
    robot, q0 = ck.planar_arm([0.31, 0.42, 0.23]), np.array([0.3, 0.7, -0.4])
    law = ck.Law(robot, ck.position("xy"), alpha=8.0)
    path = ck.circle([0.5, 0.4], 0.1, period=2.0)
    ck.solve(law, path, q0, 0.01, 40, method)
    with compiled() as found:
        runs = {N: ck.solve(law, path, q0, 0.01, N, method) for N in (8, 41, 300)}
    assert not found
    with ck.use_engine("plain"):
        same(runs[41], ck.solve(law, path, q0, 0.01, 41, method), ulps=1000)
    for N, run in runs.items():
        for one, other in ((run.q, runs[300].q), (run.e, runs[300].e), (run.status, runs[300].status)):
            np.testing.assert_array_equal(one, other[: len(one)])
        same(jax.tree.map(np.asarray, ck.solve(law, path, jnp.asarray(q0), 0.01, N, method)), run, ulps=1000)
