"""solve and step called with numbers: as C, what JAX gives; checked, and compiled, as before; NumPy in, NumPy out."""

import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.engine import plan
from cnclik.engine.compiler import can_build
from cnclik.integrate import solve as solving
from tests.oracles import close

ARM = ck.planar_arm([1.0, 0.8, 0.5])
LAW = ck.Law(ARM, ck.position("xy"), alpha=2.0)
WAVE = ck.lissajous([0.6, 0.9], [0.2, 0.1], period=4.0)
Q = np.array([0.3, 0.4, 0.5])
needs_compiler = pytest.mark.skipif(not can_build(), reason="no C compiler")


def same(found, wanted, tolerance):
    """Every number of two records, but a ratio of two differences that are roundings."""
    found, wanted = ([ck.replace(x, contraction=0.0) for x in (*steps, run)] for steps, run in (found, wanted))
    assert jax.tree.structure(found) == jax.tree.structure(wanted)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        assert a.dtype == b.dtype and a.shape == b.shape
        close(a, b, atol=tolerance, rtol=tolerance)


@needs_compiler
def test_a_step_is_that_of_a_program_of_ones_own_to_the_bit():
    made = ck.step(LAW, WAVE, Q, 0.3, 0.1)
    inside = jax.jit(lambda q: ck.step(LAW, WAVE, q, 0.3, 0.1))(Q)
    for a, b in zip(jax.tree.leaves(made), jax.tree.leaves(inside), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("engine", [None, "plain"])
def test_arrays_are_those_of_the_joint_values(engine):
    with ck.use_engine(engine):
        for q, kind in ((Q, np.ndarray), ([0.3, 0.4, 0.5], np.ndarray), (jnp.asarray(Q), jax.Array)):
            for made in (ck.step(LAW, WAVE, q, 0.0, 0.1), ck.solve(LAW, WAVE, q, 0.1, 3)):
                assert all(isinstance(x, kind) for x in jax.tree.leaves(made))
                assert kind is jax.Array or not any(x.flags.writeable for x in jax.tree.leaves(made))
        assert isinstance(jax.jit(lambda a: ck.step(ck.replace(LAW, alpha=a), WAVE, Q, 0.0, 0.1).q)(2.0), jax.Array)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"q": [0.3, 0.4]}, r"`q` must have 3 joint values"),
        ({"Ts": 0.0}, "`Ts` must be positive"),
        ({"reference": ck.hold([0.5])}, "position"),
    ],
)
def test_what_is_wrong_is_refused_after_any_call(changed, message):
    given = {"law": LAW, "reference": WAVE, "q": Q, "t": 0.0, "Ts": 0.1, "method": "EE"}
    for _ in range(2):
        ck.step(**given)
        with pytest.raises(ck.ArgumentError, match=message):
            ck.step(**given | changed)


@pytest.mark.parametrize("dtype", [">f8", ">f4", np.longdouble, np.float16, int])
def test_numbers_of_any_precision_and_order_of_bytes(dtype):
    q = np.array([1, 0, 1]).astype(dtype)
    wanted = ck.step(LAW, WAVE, np.array([1.0, 0.0, 1.0], np.float64 if q.itemsize >= 8 else np.float32), 0.0, 0.1).q
    np.testing.assert_array_equal(ck.step(LAW, WAVE, q, 0.0, 0.1).q, wanted)


@needs_compiler
def test_large_programs_are_the_source_unless_the_user_asks_for_c(monkeypatch):
    law, found = ck.Law(ck.planar_arm([1.0, 0.4]), ck.position("xy"), alpha=2.0), []
    monkeypatch.setattr(plan, "MOST_NODES", 100)
    for engine in (None, "native"):
        before = len(solving.a_run.entries)
        with ck.use_engine(engine):
            run = ck.solve(law, WAVE, Q[:2], 0.1, 6, "EE")
        found.append((len(solving.a_run.entries) - before, run))
    assert [new for new, _ in found] == [0, 1]
    same(([], found[0][1]), ([], found[1][1]), 1e-13)


@needs_compiler
def test_new_numbers_need_no_new_program():
    ck.step(LAW, WAVE, Q, 0.0, 0.1)
    before = len(solving.a_step.entries)
    for gain in (1.0, 3.0):
        law = ck.replace(LAW, alpha=gain)
        for target in (WAVE, ck.lissajous([0.5, 0.8], [0.1, 0.1], period=3.0)):
            with ck.use_engine("plain"):
                wanted = ck.step(law, target, Q + gain, gain, 0.1).q
            close(ck.step(law, target, Q + gain, gain, 0.1).q, wanted, atol=1e-12)
    assert len(solving.a_step.entries) == before


def test_arrays_that_the_caller_writes_to_are_read_anew():
    """A law that was taken apart and put together again holds the caller's own arrays."""
    gain = np.array(2.0)
    tree = jax.tree.structure(LAW)
    law = tree.unflatten([gain if np.array_equal(x, 2.0) else x for x in jax.tree.leaves(LAW)])
    assert law.alpha is gain
    found = []
    for gain[...] in (2.0, 1.0):
        found.append(ck.step(law, WAVE, Q, 0.0, 0.1, "EE").q)
    wanted = [ck.step(ck.replace(LAW, alpha=a), WAVE, Q, 0.0, 0.1, "EE").q for a in (2.0, 1.0)]
    np.testing.assert_array_equal(found, wanted)


def test_threads_do_not_share_numbers():
    wanted = {a: ck.step(LAW, WAVE, Q + a, 0.0, 0.1).q for a in (0.0, 0.1, 0.2)}
    wrong = []

    def work(a):
        for _ in range(300):
            if not np.array_equal(ck.step(LAW, WAVE, Q + a, 0.0, 0.1).q, wanted[a]):
                wrong.append(a)

    threads = [threading.Thread(target=work, args=(a,)) for a in wanted]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
