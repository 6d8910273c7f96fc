"""Factorisations in batches, which are made without LAPACK: its threads wait for each other for good."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cnclik.law import dense
from tests.oracles import close

LOOP = """
import faulthandler; faulthandler.dump_traceback_later(100, exit=True)
import jax, numpy as np, cnclik as ck
from tests.robot.test_trees import BAXTER, GRIPPERS
robot = ck.load_urdf(BAXTER, tips=GRIPPERS)
task = ck.pose(tip=GRIPPERS[0]) & ck.pose(tip=GRIPPERS[1])
law = ck.Law(robot, task, alpha=10.0, inverse=ck.damped(0.05), limits=ck.bounded())
q = np.array([0, -0.5, 0, 1.2, 0, 0.8, 0] * 2) + 0.1 * np.random.default_rng(0).normal(size=(1024, 14))
held = ck.hold_at(robot, task, q[0])
with ck.use_engine("plain"):
    print(np.isfinite(jax.jit(jax.vmap(lambda q: ck.solve(law, held, q, 0.01, 5, "EE").q[-1]))(q)).all())
"""


def test_a_batch_of_two_arms_within_limits_ends():
    """In a program of the user's own: as LAPACK's batches, it hung on two cores in every run."""
    done = subprocess.run([sys.executable, "-c", LOOP], capture_output=True, text=True, timeout=150)
    assert done.stdout.split() == ["True"], done.stderr[-500:]


def systems(m, seed=0, count=20):
    rng = np.random.default_rng(seed)
    j = rng.normal(size=(count, m, m + 2))
    return j @ np.swapaxes(j, -1, -2) + 0.1 * np.eye(m), rng.normal(size=(count, m)), rng.normal(size=(count, m, 3))


def solved(a, b, more):
    lower = dense.cholesky(a)
    return dense.cholesky_solve(lower, b), dense.cholesky_solve(lower, more), dense.inverse_trace(lower)


@pytest.mark.parametrize("m", [6, 26])
def test_a_batch_is_numpys_one_by_one(m):
    given = systems(m)
    made = jax.jit(jax.vmap(solved))(*given)
    alone = [jax.jit(solved)(*one) for one in zip(*given, strict=True)]
    for k, (a, b, more) in enumerate(zip(*given, strict=True)):
        wanted = np.linalg.solve(a, b), np.linalg.solve(a, more), np.trace(np.linalg.inv(a))
        for one, other, value in zip((v[k] for v in made), alone[k], wanted, strict=True):
            close(one, value, rtol=1e-9, atol=1e-12)
            close(other, value, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("lanes", "m"), [(False, 3), (True, 10)])
def test_derivatives_are_differences(lanes, m):
    """Forward, reverse and second ones, of one system and within a batch."""
    a, b, more = systems(m, seed=1, count=2)

    def value(s, a, b, more):
        return sum(jnp.sum(jnp.sin(v)) for v in solved(a + s * jnp.cos(a), b + s, more))

    def along(fn):
        each = jax.vmap(fn, (None, 0, 0, 0))
        return jax.jit(each if lanes else lambda s, a, b, more: fn(s, a[0], b[0], more[0]))

    first, forward, second = (along(fn) for fn in (jax.grad(value), jax.jacfwd(value), jax.grad(jax.grad(value))))
    one, h = along(value), 1e-6
    wanted = (one(h, a, b, more) - one(-h, a, b, more)) / (2 * h)
    close(first(0.0, a, b, more), wanted, rtol=1e-5, atol=1e-6)
    close(forward(0.0, a, b, more), first(0.0, a, b, more), rtol=1e-9)
    wanted = (first(h, a, b, more) - first(-h, a, b, more)) / (2 * h)
    close(second(0.0, a, b, more), wanted, rtol=1e-4, atol=1e-5)


def test_what_is_not_positive_has_no_factor():
    a = np.stack([np.eye(3), np.diag([1.0, -1.0, 1.0])])
    for found in (jax.vmap(dense.cholesky)(a), jnp.stack([dense.cholesky(one) for one in a])):
        assert np.isfinite(found[0]).all() and np.isnan(found[1]).any()
    assert np.isinf(jax.vmap(lambda a: dense.inverse_trace(dense.cholesky(a)))(a)[1])
