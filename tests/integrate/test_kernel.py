"""The GPU's kernel means vmap: run by Pallas's interpreter here, and lowered to Triton where no GPU is."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.integrate import kernel
from cnclik.integrate.lanes import _kernel_or
from cnclik.integrate.solve import advance, cast
from tests.oracles import close

LANES = 11  # not a multiple of the tile
WRIST = ck.from_dh([0.0, 0.1, 0.0], [np.pi / 2, -np.pi / 2, 0.0], [0.1, 0.0, 0.3])
TURNING = ck.Law(WRIST, ck.orientation(), alpha=5.0, inverse=ck.damped(0.05))
REACHING = ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("xy"), alpha=5.0, inverse=ck.damped(0.05))
REAL = ck.Law(ck.panda(), ck.pose_task(), alpha=5.0, inverse=ck.damped(0.05))


def _to(law, method=ck.EE, stage=ck.picard(2), end=lambda run: run.e[-1]):
    """A short loop as a function of one lane, its start and its target, reduced to its end."""

    def one(q0, position, rotation):
        return end(ck.solve(law, ck.hold(position, rotation), q0, 0.1, 4, method, stage))

    return law, one


def _not_stored(q0, position, rotation):
    law, target = cast((REACHING, ck.hold(position, rotation)), q0.dtype)

    def one(q, k):
        return advance(law, target, q, 0.1 * k, jnp.asarray(0.1, q0.dtype), ck.EE, ck.picard(1)).q, None

    return jnp.stack(jax.lax.scan(one, tuple(q0), jnp.arange(4).astype(q0.dtype))[0])


LOOPS = {
    "EE": _to(TURNING),
    "CN": _to(TURNING, method=ck.CN),
    "TRAPEZOID by chord": _to(REACHING, method=ck.TRAPEZOID, stage=ck.chord(2)),
    "exponential": _to(TURNING, method="EXP-MIDPOINT"),
    "with a memory": _to(REACHING, method="EXP-AB2"),
    "J#": _to(ck.replace(REACHING, inverse=ck.pseudoinverse())),
    "singular damping": _to(ck.replace(REACHING, inverse=ck.singular_damped(0.1, 0.5))),
    "norm of the end": _to(REACHING, end=lambda run: {"e": jnp.linalg.norm(run.e[-1]), "status": run.q[-1] > 0.5}),
    "gain matrix": _to(ck.replace(REACHING, alpha=np.array([[5.0, 1.0], [1.0, 3.0]]))),
    "not stored": (REACHING, _not_stored),
    "a real robot": _to(REAL),
}


def _inputs(law, dtype):
    """Starts and targets of LANES lanes: poses of joint values nearby."""
    rng = np.random.default_rng(0)
    q0, goal = rng.uniform(0.3, 0.9, (2, LANES, law.chain.n))
    with jax.enable_x64(True):
        at = jax.jit(jax.vmap(lambda q: ck.pose(law.chain, q)))(goal)
    return tuple(np.asarray(v, dtype) for v in (q0, at.position, at.rotation))


DOUBLE = ("J#", "gain matrix")  # the others in single precision: each of the two is a compilation
SLOW = [
    pytest.param(name, "float32", marks=pytest.mark.slow) for name in ("CN", "a real robot")
]  # CN: "TRAPEZOID by chord" is an implicit one


@pytest.mark.parametrize(
    ("name", "dtype"),
    [*((n, "float64" if n in DOUBLE else "float32") for n in LOOPS if n not in ("CN", "a real robot")), *SLOW],
)
def test_means_vmap(name, dtype):
    law, fn = LOOPS[name]
    given = _inputs(law, dtype)
    found = kernel.batched(fn, tile=8, interpret=True)(*given)
    wanted = jax.vmap(fn)(*given)
    assert jax.tree.structure(found) == jax.tree.structure(wanted)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        assert a.shape == b.shape and a.dtype == b.dtype
        close(a, b, atol=1e-12 if dtype == "float64" else 16 * np.finfo(np.float32).eps)


def _a_gpu():
    """Context manager: one to lower for, which jax 0.12 asks for."""
    device = jax.sharding.AbstractDevice(device_kind="NVIDIA H100", num_cores=None, platform="gpu")
    return jax.sharding.use_abstract_mesh(jax.sharding.AbstractMesh((), (), abstract_device=device))


@pytest.mark.parametrize(("name", "dtype"), [("TRAPEZOID by chord", "float32"), ("J#", "float32"), *SLOW])
def test_lowers_for_a_gpu(name, dtype):
    """To one Triton kernel and nothing in a loop around it."""
    law, fn = LOOPS[name]
    with _a_gpu():
        made = jax.jit(kernel.batched(fn)).trace(*_inputs(law, dtype)).lower(lowering_platforms=("cuda",)).as_text()
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


@pytest.fixture
def interpreted(monkeypatch):
    """Kernels run by the interpreter, as on a GPU; the list notes which were."""
    used, original = [], kernel.batched

    def made(fn, *, tile):
        one = original(fn, tile=tile, interpret=True)
        return lambda *args: used.append("kernel") or one(*args)

    monkeypatch.setattr(kernel, "batched", made)
    return used


X = np.arange(12.0).reshape(6, 2)[:, ::-1]


def test_lanes_takes_the_kernel_where_there_is_one(interpreted):
    doubled = _kernel_or(jax.vmap(lambda x: 2 * x), lambda x: 2 * x, 4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_array_equal(doubled(X), 2 * X)
        with ck.use_hints(False):
            doubled(X + 1)
    assert interpreted == ["kernel"]


def test_lanes_falls_back_to_xla_and_warns_once(interpreted):
    ordered = _kernel_or(jax.vmap(jnp.sort), jnp.sort, 4)
    with pytest.warns(UserWarning, match="no GPU kernel for sort.*: a kernel has no sort") as told:
        np.testing.assert_array_equal(ordered(X), np.sort(X, axis=1))
        ordered(X)
        ordered(np.ones((6, 3)))  # another kind of call
    assert len(told) == 1


def test_a_kernel_that_does_not_compile_is_refused(monkeypatch):
    """Here by asking a CPU for a Triton kernel."""
    doubled = _kernel_or(jax.vmap(lambda x: 2 * x), lambda x: 2 * x, 4)
    with pytest.warns(UserWarning, match="no GPU kernel"):
        np.testing.assert_array_equal(doubled(X), 2 * X)


def test_errors_that_are_not_the_kernels_are_not_hidden(interpreted):
    def wrong(x):
        raise ZeroDivisionError("the user's own")

    with pytest.raises(ZeroDivisionError, match="the user's own"):
        _kernel_or(jax.vmap(wrong), wrong, 4)(X)
