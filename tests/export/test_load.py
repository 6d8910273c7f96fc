"""Exported functions called from Python: the same records as the library's own, whole loops, many lanes."""

import shutil
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from tests.engine.compare import NEEDS_C
from tests.export.combinations import arm

pytestmark = NEEDS_C
Q = np.array([0.3, 0.5, -0.4])


def a_law(chain=None, **changes):
    return ck.Law(
        chain or ck.planar_arm([1.0, 0.8, 0.6]),
        ck.position("xy"),
        **{"alpha": 5.0, "inverse": ck.damped(0.1)} | changes,
    )


@pytest.fixture(scope="module")
def step():
    return ck.export.compiled(a_law(), method="EE", batch=True)


def test_a_step_is_a_step(step):
    made, wanted = step(Q, [0.9, 1.2], np.zeros(2), 0.01), ck.step(a_law(), ck.hold([0.9, 1.2]), Q, 0.0, 0.01, "EE")
    assert isinstance(made, ck.Step) and jax.tree.structure(ck.Step(**vars(wanted))) == jax.tree.structure(wanted)
    for name in ("q", "x", "e", "qdot", "residual", "contraction", "status"):
        assert np.allclose(getattr(made, name), getattr(wanted, name), rtol=0, atol=1e-13), name
    assert made.least > 0
    assert len(jax.tree.leaves(made)) == 8 and np.allclose(ck.replace(made, q=Q).q, Q)
    first = made.q.copy()
    step(Q + 1)
    assert (made.q == first).all()  # a result is one's own


def test_what_is_left_out_stays_and_what_does_not_fit_is_refused(step):
    made = step(Q, [0.9, 1.2], np.zeros(2), 0.01)
    assert (step(Q).q == made.q).all() and (step(Q, Ts=0.02).q != made.q).any()
    assert (step(list(Q), position=(0.9, 1.2), Ts=0.01).q == made.q).all()
    for wrong in (lambda: step(Q[:2]), lambda: step(Q, speed=1), lambda: step(Q, 1, 2, 3, 4), lambda: step.set(beta=1)):
        with pytest.raises(ck.ArgumentError):
            wrong()


def test_nan_is_told(step):
    assert step([np.nan, 0, 0], [0.9, 1.2]).status & ck.Status.NON_FINITE
    assert step(Q, [np.nan, 0.0]).status & ck.Status.NON_FINITE
    assert step(Q, [0.9, 1.2], [np.nan, 0.0]).status & ck.Status.NON_FINITE
    assert step(Q, [0.9, 1.2], np.zeros(2)).status == 0


@pytest.mark.parametrize("reference", [None, ck.circle([0.9, 1.2], 0.2, period=1.0)])
@pytest.mark.parametrize(("method", "Ts"), [("EE", 0.41), ("RK4", 0.01)])
def test_a_loop_is_a_trajectory(reference, method, Ts):
    law = a_law(inverse=ck.pseudoinverse())
    near = np.asarray(ck.forward(law.chain, Q).position)[:2] + 1e-3
    target = dict(position=near) if reference is None else {}
    solve = ck.export.compiled(law, reference, method=method, what="solve")
    run = solve(Q, Ts=Ts, N=9, **target)
    wanted = ck.solve(law, ck.hold(near) if reference is None else reference, Q, Ts, 9, method)
    for name in ("t", "q", "x", "e", "qdot", "residual", "contraction", "status", "evaluations"):
        assert np.allclose(getattr(run, name), getattr(wanted, name), rtol=1e-6, atol=1e-12), name
    if Ts > 0.4:  # z = 2.05
        assert (run.status & ck.Status.GROWING).any()
    assert solve(Q, Ts=Ts, N=0).q.shape == (1, 3)


def test_geometry_alone():
    chain = ck.panda()
    q = np.linspace(-1, 1, 7)
    at, wanted = ck.export.compiled(chain, what="fk")(q), ck.forward(chain, q)
    assert np.allclose(at.position, wanted.position, rtol=0, atol=1e-15)
    assert np.allclose(at.rotation, wanted.rotation, rtol=0, atol=1e-15)
    rows = ck.export.compiled(chain, what="jacobian")(q)
    assert np.allclose(rows, ck.jacobian(chain, q), rtol=0, atol=1e-15)


# --- damage -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A folder with an export, and its library built."""
    folder = ck.export.c(a_law(), out=tmp_path_factory.mktemp("export") / "arm", method="EE")
    ck.export.load(folder)
    return folder


def damaged(text, kind, random):
    at = int(random.integers(len(text)))
    return {"cut": text[:at], "turned": text[:at] + bytes([text[at] ^ 1 << int(random.integers(8))]) + text[at + 1 :]}[
        kind
    ]


@pytest.mark.parametrize("kind", ["cut", "turned"])
@pytest.mark.parametrize("file", ["export.json", "clik_step.c", "clik_step.h"])
def test_what_is_not_as_it_was_written_is_refused_in_a_line(exported, tmp_path, file, kind):
    folder, random = tmp_path / "arm", np.random.default_rng(0)
    shutil.copytree(exported, folder)
    text = (folder / file).read_bytes()
    for _ in range(30):
        (folder / file).write_bytes(damaged(text, kind, random))
        with pytest.raises(ck.ArgumentError, match="folder"):
            ck.export.load(folder)
    for words in (b"[" * 100_000, b"5", b"null", b'{"files": 5}', b"\xff", b""):
        (folder / file).write_bytes(words)
        with pytest.raises(ck.ArgumentError, match="folder"):
            ck.export.load(folder)


@pytest.mark.parametrize("kind", ["cut", "turned", "none of it", "device", "another's"])
def test_a_library_that_is_not_as_it_was_built_is_built_again(exported, tmp_path, kind):
    """Else it would end the process: what is mapped and not there is SIGBUS."""
    folder = tmp_path / "arm"
    shutil.copytree(exported, folder)
    (library,) = folder.glob("*.so")
    whole = library.read_bytes()
    library.unlink()
    if kind == "device":
        library.symlink_to("/dev/zero")
    elif kind == "another's":
        other = ck.export.c(a_law(alpha=1.0), out=tmp_path / "other", method="EE", runtime=())
        ck.export.load(other)
        shutil.copy(next(other.glob("*.so")), library)
    else:
        library.write_bytes(b"" if kind == "none of it" else damaged(whole, kind, np.random.default_rng(1)))
    wanted = ck.export.load(exported)(Q, [0.9, 1.2], Ts=0.01).q
    assert (ck.export.load(folder)(Q, [0.9, 1.2], Ts=0.01).q == wanted).all()


# --- many lanes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_many_lanes_are_lanes_to_rounding(dtype):
    law, random = a_law(arm(3), limits=ck.velocity_scaling()), np.random.default_rng(0)
    q = random.uniform(-1.5, 1.5, (203, 3)).astype(dtype)
    position = random.uniform(-1, 1, (203, 2)).astype(dtype)
    step = ck.export.compiled(law, method="EXP-MIDPOINT", dtype=dtype, batch=True)
    with jax.enable_x64(dtype == "float64"):

        def one(q, position):
            run = ck.solve(law, ck.hold(position), q, 0.01, 20)
            return run.q[-1], run.e[-1], run.x[-1], run.qdot[-1], jnp.bitwise_or.reduce(run.status & ~32)

        wanted = ck.lanes(one)(q, position)
    for cores in (1, 3):
        found = step.batch(q, position, Ts=0.01, N=20, cores=cores)
        near = 1e-12 if dtype == "float64" else 2e-5
        for name, value in zip(("q", "e", "x", "qdot"), wanted, strict=False):
            assert np.allclose(found[name], value, rtol=near, atol=near), name
        assert (found["status"] == wanted[-1]).all()


def test_anything_may_be_of_a_lane_and_no_lane_feels_its_neighbours(step):
    alphas = np.linspace(1.0, 50.0, 37)
    found = step.batch(Q, [0.9, 1.2], alpha=alphas, Ts=0.01, N=10)
    one = ck.export.compiled(a_law(), method="EE", what="solve", runtime=("alpha",))
    for k in (0, 20, 36):
        one.set(alpha=alphas[k])
        assert np.allclose(found["q"][k], one(Q, [0.9, 1.2], Ts=0.01, N=10).q[-1], rtol=0, atol=1e-13)
    q = np.tile(Q, (37, 1))
    clean = step.batch(q, [0.9, 1.2], alpha=5.0, N=10, Ts=0.01)["q"][0]
    q[1], q[2] = np.nan, 3e4  # the second takes libm's own sine
    mixed = step.batch(q, [0.9, 1.2], alpha=5.0, N=10, Ts=0.01)
    assert (np.delete(mixed["q"], [1, 2], 0) == clean).all()
    assert mixed["status"][1] & ck.Status.NON_FINITE and np.isfinite(mixed["q"][2]).all()


def test_only_what_is_wanted_is_computed():
    step = ck.export.compiled(a_law(), method="EE", batch=("q",))
    assert list(step.batch(np.tile(Q, (5, 1)), [0.9, 1.2], Ts=0.01, N=3)) == ["q"]


def test_a_batch_is_checked(step):
    many = np.tile(Q, (5, 1))
    for wrong in (
        lambda: step.batch(Q, [0.9, 1.2], Ts=0.01, N=3),  # no lanes at all
        lambda: step.batch(many, np.zeros((4, 2)), Ts=0.01, N=3),
        lambda: step.batch(many[:0], [0.9, 1.2], Ts=0.01, N=3),
        lambda: step.batch(many, [0.9, 1.2], Ts=0.01, N=-1),
        lambda: ck.export.compiled(a_law(), method="EE").batch(many, [0.9, 1.2], Ts=0.01, N=3),
    ):
        with pytest.raises(ck.ArgumentError):
            wrong()


def test_batches_run_side_by_side(step):
    many, found = np.tile(Q, (300, 1)), {}

    def run(k):
        found[k] = step.batch(many, [0.9, 1.2], Ts=0.01, N=5 + k, cores=2)["q"][0]

    threads = [threading.Thread(target=run, args=(k,)) for k in range(4)]
    [t.start() for t in threads]
    [t.join() for t in threads]
    assert all((found[k] == step.batch(many, [0.9, 1.2], Ts=0.01, N=5 + k)["q"][0]).all() for k in range(4))
