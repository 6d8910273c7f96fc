"""The GPU's kernel means vmap: run by Pallas's interpreter here, and lowered to Triton where no GPU is."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.bench import loops
from cnclik.integrate import kernel
from cnclik.integrate.lanes import _kernel_or

LANES = 11  # not a multiple of the tile
PANDA = loops.ROBOTS["panda"]()
ARM = loops.ROBOTS["planar2"]()


def _to(case, law=None, method=ck.EE, stage=ck.picard(2), end=lambda run: run.e[-1]):
    """A short loop of the case as a function of one lane, reduced to its end."""

    def one(q0, position, rotation=None):
        return end(ck.solve(law or case.law, ck.hold(position, rotation), q0, 0.1, 4, method, stage))

    return case, one


LOOPS = {
    "EE": _to(PANDA),
    "CN": _to(PANDA, method=ck.CN),
    "TRAPEZOID by chord": _to(ARM, method=ck.TRAPEZOID, stage=ck.chord(2)),
    "J#": _to(ARM, law=ck.replace(ARM.law, inverse=ck.pseudoinverse())),
    "singular damping": _to(ARM, law=ck.replace(ARM.law, inverse=ck.singular_damped(0.1, 0.5))),
    "norm of the end": _to(ARM, end=lambda run: {"e": jnp.linalg.norm(run.e[-1]), "status": run.q[-1] > 0.5}),
    "gain matrix": _to(ARM, law=ck.replace(ARM.law, alpha=np.array([[5.0, 1.0], [1.0, 3.0]]))),
    "not stored": (PANDA, loops.loop(PANDA, 4, ck.EE, ck.picard(2))),
}


def _types(name):
    """Both for the quick ones."""
    return {"EE": ["float32"], "not stored": ["float32"], "CN": ["float64"]}.get(name, ["float64", "float32"])


@pytest.mark.parametrize(("name", "dtype"), [(n, d) for n in LOOPS for d in _types(n)])
def test_means_vmap(name, dtype):
    case, fn = LOOPS[name]
    given = tuple(loops.inputs(case, LANES, dtype).values())
    found = kernel.batched(fn, tile=8, interpret=True)(*given)
    wanted = jax.vmap(fn)(*given)
    assert jax.tree.structure(found) == jax.tree.structure(wanted)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        assert a.shape == b.shape and a.dtype == b.dtype
        np.testing.assert_allclose(a, b, atol=1e-12 if dtype == "float64" else 1e-6)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("name", ["CN", "TRAPEZOID by chord", "J#"])
def test_lowers_for_a_gpu(name, dtype):
    """To one Triton kernel and nothing in a loop around it."""
    case, fn = LOOPS[name]
    given = tuple(loops.inputs(case, LANES, dtype).values())
    made = jax.jit(kernel.batched(fn)).trace(*given).lower(lowering_platforms=("cuda",)).as_text()
    assert made.count("triton") == 1 and "stablehlo.while" not in made


def test_small_operations():
    """What users write around a loop: indexing, norms, products, choices."""

    def fn(x, y):
        turned = jnp.stack([x[1], -x[0], x[2]])[::-1]
        choice = jax.lax.cond(x[0] > y, lambda v: v * 2, lambda v: v - 1, turned)
        summed = jax.lax.scan(lambda s, k: (s + k * x, s), x, jnp.arange(3, 0, -1.0))[0]
        return choice, jnp.max(choice), jnp.linalg.norm(x) + jnp.dot(x, turned), summed, jnp.array([1.0, 2.0]) @ x[:2]

    rng = np.random.default_rng(0)
    given = rng.normal(size=(6, 3)), rng.normal(size=6)
    for a, b in zip(kernel.batched(fn, tile=4, interpret=True)(*given), jax.vmap(fn)(*given), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14)


@pytest.mark.parametrize(
    ("fn", "why"),
    [
        (lambda x: jax.lax.scan(lambda s, _: (s + x, s), x, None, length=3)[1], "more of a loop than its end"),
        (lambda x: jnp.sort(jnp.stack([x, -x])), "no sort"),
        (lambda x: jax.lax.scan(lambda s, k: (s + k, None), x, jnp.array([1.0, 5.0, 2.0]))[0], "scans over an array"),
    ],
)
def test_what_has_no_kernel_says_why(fn, why):
    with pytest.raises(kernel.UnsupportedError, match=why):
        kernel.batched(fn, tile=4, interpret=True)(np.ones(4))


def test_lanes_falls_back_to_xla(monkeypatch, caplog):
    """As on a GPU: the kernel where there is one, XLA where there is none, under one switch."""
    used = []
    original = kernel.batched

    def interpreted(fn, *, tile):
        made = original(fn, tile=tile, interpret=True)
        return lambda *args: used.append("kernel") or made(*args)

    monkeypatch.setattr(kernel, "batched", interpreted)
    over = jax.vmap(lambda x: 2 * x), jax.vmap(jnp.sort)
    x = np.arange(12.0).reshape(6, 2)[:, ::-1]
    with caplog.at_level("INFO", logger="cnclik"):
        doubled = _kernel_or(over[0], lambda x: 2 * x, 4)
        np.testing.assert_array_equal(doubled(x), 2 * x)
        assert used == ["kernel"] and not caplog.messages
        ordered = _kernel_or(over[1], jnp.sort, 4)
        np.testing.assert_array_equal(ordered(x), np.sort(x, axis=1))
        assert "no sort" in caplog.text
        with ck.hints(False):
            doubled(x + 1)
    assert used == ["kernel", "kernel"]
