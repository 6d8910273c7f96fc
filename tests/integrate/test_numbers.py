"""solve and step called with numbers: as C, what JAX gives; checked, and compiled, as before; NumPy in, NumPy out."""

import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from tests.engine.compare import NEEDS_C

ARM = ck.planar_arm([1.0, 0.8, 0.5])
LAW = ck.Law(ARM, ck.position("xy"), alpha=2.0)
WAVE = ck.lissajous([0.6, 0.9], [0.2, 0.1], period=4.0)
Q = np.array([0.3, 0.4, 0.5])


@NEEDS_C
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
