"""lanes means vmap: any size, any tree, both ways of compiling, under the transformations."""

import functools
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.integrate import lanes as laid_out
from cnclik.integrate.lanes import lanes
from tests.refusals import refusals

ARM = ck.planar_arm([1.0, 1.0], clockwise=True)
LAW = ck.Law(ARM, ck.position("xy"), alpha=5.0, inverse=ck.damped(0.1))


def _final(case):
    """One loop with its own gain and start; a tree in, a tree out."""
    run = ck.solve(ck.replace(LAW, alpha=case["alpha"]), ck.hold([1.0, 0.5]), case["q0"], 0.1, 4, "EE")
    return {"e": run.e[-1], "status": run.status, "norm": jnp.sum(run.e[-1] ** 2)}


RNG = np.random.default_rng(33)
CASES = {"alpha": jnp.asarray(RNG.uniform(1, 6, 33)), "q0": jnp.asarray(RNG.uniform(0.3, 1.5, (33, 2)))}


def first(count, tree):
    return jax.tree.map(lambda v: v[:count], tree)


@functools.cache
def reference():
    """The source as XLA compiles it."""
    with ck.use_engine("plain"):
        return jax.jit(jax.vmap(_final))(CASES)


@pytest.fixture
def small(monkeypatch):
    """Blocks of two tiles."""
    monkeypatch.setattr(laid_out, "TILE", 4)
    monkeypatch.setattr(laid_out, "LANES_PER_CALL", 8)


@pytest.mark.parametrize("engine", [None, "xla"])
def test_same_as_vmap(engine, small):
    with ck.use_engine(engine):
        tiled = lanes(_final, cores=2)
        runs = [(tiled(first(size, CASES)), first(size, reference())) for size in (1, 33)]
    for found, wanted in runs:
        assert jax.tree.structure(found) == jax.tree.structure(wanted)
        for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
            assert a.shape == b.shape and a.dtype == b.dtype
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-14)


def test_a_batch_may_be_of_runs(small):
    runs = jax.jit(jax.vmap(lambda q: ck.solve(LAW, ck.hold([1.0, 0.5]), q, 0.1, 2, "EE")))(CASES["q0"])
    with ck.use_engine("plain"):
        assert lanes(lambda run: jnp.linalg.svd(run.q, compute_uv=False), cores=1)(runs).shape == (33, 2)


def test_under_jit_grad_and_vmap():
    tiled, x = lanes(lambda x: jnp.sum(jnp.sin(x) * x)), jnp.linspace(0, 1, 15).reshape(5, 3)
    slope = jax.jit(jax.grad(lambda x: jnp.sum(tiled(x))))
    np.testing.assert_allclose(slope(x), jnp.sin(x) + x * jnp.cos(x), rtol=1e-12)
    np.testing.assert_allclose(jax.vmap(tiled)(jnp.stack([x, x[::-1]]))[1], tiled(x)[::-1], rtol=1e-12)


def test_one_program_for_all_blocks(small):
    traces = []

    def counted(x):
        traces.append(1)
        return 2 * x

    tiled = lanes(counted, cores=2)
    np.testing.assert_array_equal(tiled(jnp.arange(17.0)), 2 * np.arange(17.0))
    before = len(traces)
    np.testing.assert_array_equal(tiled(jnp.arange(1001.0)), 2 * np.arange(1001.0))
    assert len(traces) == before


test_batches_that_do_not_fit = refusals(
    (lambda: lanes(max)(), "`args` must .*have no arrays"),
    (lambda: lanes(max)(jnp.ones(3), jnp.ones(4)), "`args` must .*have 3, 4"),
    (lambda: lanes(max)([[1.0, 2.0], [3.0, 4.0]]), "`args` must .*have none"),
    (lambda: lanes(max)(jnp.ones((0, 2))), "`args` must .*hold 0"),
)


def test_several_devices():
    """Blocks go round all devices, in order; slopes by what all share are sums; in a process told to have three."""
    code = """
import jax, numpy as np, cnclik as ck
from cnclik.integrate import lanes
from cnclik.engine.plan import use_engine
assert len(jax.local_devices()) == 3
lanes.TILE, lanes.LANES_PER_CALL, seen = 4, 8, set()
tell = lambda x: 2 * x
x = np.arange(101.0, dtype=np.float32)
before = jax.device_put
jax.device_put = lambda part, device: seen.add(device.id) or before(part, device)
with use_engine('xla'):
    found = ck.lanes(tell)(x)
assert np.array_equal(found, 2 * x) and seen == {0, 1, 2}, seen
jax.device_put, P = before, jax.sharding.PartitionSpec
twice = ck.native(lambda a, x: jax.lax.fori_loop(0, 2, lambda _, s: s + a * x.sum(), 0.0))
mesh, total = jax.sharding.Mesh(jax.devices(), "i"), lambda a, x: jax.lax.psum(twice(a, x), "i")
assert jax.jit(jax.grad(jax.shard_map(total, mesh=mesh, in_specs=(P(), P("i")), out_specs=P())))(3.0, x[:6]) == 30
"""
    environment = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=3", "JAX_PLATFORMS": "cpu"}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)


def test_large_results_and_tiles(monkeypatch):
    """One large result that XLA would compute on several threads, and many small ones in one tile."""

    def curve(x):
        rows = x * np.linspace(0, 1, 800)  # NumPy's, where x is
        for k in range(1, 20):
            rows = 0.5 * rows * rows - 1 / k
        return rows

    for fn, tile, size in ((curve, 64, 2_000), (lambda x: jnp.sum(curve(x)[::100]), 1 << 14, 20_000)):
        x = np.linspace(0, 1, size)
        monkeypatch.setattr(laid_out, "TILE", tile)
        with ck.use_engine("xla"):
            found = ck.lanes(fn)(x)
        np.testing.assert_allclose(found[::97], [fn(one) for one in x[::97]], rtol=1e-13, atol=1e-13)


def test_second_derivatives_of_a_loop():
    """Forward over reverse, where tangents of a factor have a batch, and reverse over reverse, which a scan forgets."""
    slope = jax.grad(lambda q: jnp.sum(ck.solve(LAW, ck.hold([1.0, 0.5]), q, 0.1, 2, "EE").e[-1] ** 2))
    q, h = np.array([0.4, 1.2]), 1e-5 * np.eye(2)
    found = ck.lanes(jax.jacfwd(slope))(q[None])[0]
    up, down = np.split(np.asarray(ck.lanes(slope)(np.concatenate([q + h, q - h]))), 2)
    np.testing.assert_allclose(found, (up - down) / 2e-5, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(jax.jacrev(slope)(q), found, rtol=1e-12, atol=1e-12)
