"""solve and step: what comes back, under which transformations, and what is refused."""

import functools
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from tests.bank import screws
from tests.engine.compare import NEEDS_C
from tests.oracles import close
from tests.refusals import refusals

LENGTHS = [0.7, 1.1, 0.4]
ARM = ck.planar_arm(LENGTHS)
LAW = ck.Law(ARM, ck.position("xy"), alpha=4.0)
Q = np.array([0.3, -0.9, 0.6])
TARGET = [0.6, 1.3]
HOLD, WAVE = ck.hold(TARGET), ck.lissajous([0.6, 0.9], [0.2, 0.1], period=4.0)
solve = functools.partial(ck.solve, LAW, HOLD)
N = 6


def run():
    return ck.solve(LAW, HOLD, Q, 0.1, N, "CN", ck.picard(3))


def test_trajectory():
    made = run()
    assert made.t.shape == (N + 1,) and made.q.shape == (N + 1, 3) and made.x.shape == made.e.shape == (N + 1, 2)
    assert made.qdot.shape == (N, 3) and made.residual.shape == made.contraction.shape == made.status.shape == (N,)
    close(made.t, 0.1 * np.arange(N + 1), atol=1e-15)
    close(made.q[0], Q)
    close(made.qdot, np.diff(made.q, axis=0) / 0.1, atol=1e-13)
    close(made.x + made.e, np.broadcast_to(TARGET, (N + 1, 2)), atol=1e-15)
    for q, x in zip(made.q, made.x, strict=True):
        close(ck.forward(ARM, q).position[:2], x, atol=1e-14)
    assert made.evaluations == N * 4


@pytest.mark.parametrize("noise", [None, np.zeros((0, 2))], ids=["exact", "noise"])
def test_no_steps(noise):
    made = ck.solve(LAW, HOLD, Q, 0.1, 0, "EE", noise=noise)
    assert made.q.shape == (1, 3) and made.qdot.shape == (0, 3) and made.status.shape == (0,)
    assert ck.require_ok(made) is made


def test_step_by_step_is_solve():
    made, q = run(), Q
    for k in range(N):
        one = ck.step(LAW, HOLD, q, 0.1 * k, 0.1, "CN", ck.picard(3))
        close(one.e, made.e[k], atol=1e-14)
        close(one.qdot, made.qdot[k], atol=1e-13)
        close(one.residual, made.residual[k], atol=1e-14)
        q = one.q
        close(q, made.q[k + 1], atol=1e-14)


@pytest.mark.parametrize(("inverse", "dtype"), [(ck.pseudoinverse(), np.float32), (ck.damped(0.1), np.float64)])
def test_robots_with_a_constant_jacobian(inverse, dtype):
    """Literals all the way: an xy table, and a joint that the task does not see."""
    table = screws([[0.0] * 3] * 2, [[1.0, 0, 0], [0, 1.0, 0]], [0.0] * 3, kinds="PP")
    blind = screws([[0.0] * 3] * 2, [[0.0, 0, 1], [0, 0, 1.0]], [1.0, 0, 0], kinds="RP")
    for chain, task, moving in ((table, "xy", [0, 1]), (blind, "z", [1])):
        law = ck.Law(chain, ck.position(task), alpha=1.0, inverse=inverse)
        made = ck.solve(law, ck.hold([1.0] * len(moving)), np.zeros(2, dtype), 0.1, 2, "CN", ck.picard(2))
        assert made.q.dtype == made.x.dtype == dtype
        gain = 1 / 1.01 if isinstance(inverse, type(ck.damped(0.1))) else 1.0
        z = 0.1 * gain
        factor = 1 - z / 2 * (1 + 1 - z + z * z)
        wanted = np.zeros((3, 2))
        wanted[:, moving] = 1 - factor ** np.arange(3.0)[:, None]
        close(made.q, wanted, atol=1e-6 if dtype == np.float32 else 1e-15)


def test_no_new_compilation_for_new_numbers():
    """A task's function is called while the loop is traced, and never again."""
    traced = []

    def tip(robot, q):
        traced.append(None)
        return ck.forward(robot, q).position[:2]

    task = ck.function(tip, ["x", "y"], ["m", "m"])
    law = ck.replace(LAW, task=task, inverse=ck.damped(0.1))

    def solve(alpha, Ts, target, q, t0=0.0, damping=0.1, feedforward=1.0):
        changed = ck.replace(law, alpha=alpha, inverse=ck.damped(damping), feedforward=feedforward)
        return ck.solve(changed, ck.line(target, [1.0, 1.0], duration=2.0), q, Ts, N, "EE", t0=t0)

    solve(4.0, 0.1, TARGET, Q)
    once = len(traced)
    assert once > 0
    solve(5.0, 0.2, [0.1, 0.2], Q + 1, t0=3.0, damping=0.2, feedforward=0.5)
    solve(5, 0.2, np.array([1, 0]), tuple(Q), damping=np.asarray(0.3))
    solve(np.float64(5), 0.2, (0, 1), list(Q))
    assert len(traced) == once
    ck.solve(law, HOLD, Q, 0.1, N + 1, "EE")
    assert len(traced) > once


test_bad_input = refusals(
    (lambda: solve(Q[:2], 0.1, 3), r"`q0` must have 3 joint values, but has 2\."),
    (lambda: solve([0, np.nan, 0], 0.1, 3), r"`q0` must be finite, but is nan at index \(1,\)\."),
    (lambda: solve(["a", 0, 0], 0.1, 3), "`q0` must be an array of real numbers"),
    (lambda: solve(Q, -0.1, 3), r"`Ts` must be positive, but is -0\.1\."),
    (lambda: solve(Q, np.inf, 3), r"`Ts` must be finite, but is inf\."),
    (lambda: solve(Q, "0.1", 3), r"`Ts` must be a number, but is '0\.1'\."),
    (lambda: solve(Q, 0.1, -3), "`N` must be at least 0, but is -3"),
    (lambda: solve(Q, 0.1, 3.0), r"`N` must be an integer, but is 3\.0\."),
    (lambda: solve(Q, 0.1, 3, 7), "`method` must be one of EE"),
    (lambda: solve(Q, 0.1, 3, "IE", 5), r"`stage` must be a stage such as picard\(5\), but is 5"),
    (lambda: solve(Q, 0.1, 3, "IE", ck.picard), "`stage` must be a stage such as picard"),
    (lambda: solve(Q, 0.1, 3, t0=np.nan), "`t0` must be finite, but is nan"),
    (lambda: ck.solve(ARM, HOLD, Q, 0.1, 3), "`law` must be a Law, but is Chain"),
    (lambda: ck.solve(LAW, [1, 2], Q, 0.1, 3), r"`reference` must be a Reference such as hold\(...\), .* but is list"),
    (lambda: ck.solve(LAW, ck.hold([1]), Q, 0.1, 3), "`reference` must give 2 values"),
    (lambda: ck.step(LAW, HOLD, Q[:1], 0, 0.1), r"`q` must have 3 joint values, but has 1"),
    (lambda: ck.step(LAW, HOLD, Q, None, 0.1), "`t` must be a number, but is None"),
    (lambda: jax.jit(lambda q: solve(q, 0.1, 3).q)(Q[:2]), r"`q0` must have 3 joint values, but has 2\."),
)


@pytest.mark.parametrize("around", [jax.jit, jax.vmap, jax.grad], ids=lambda f: f.__name__)
def test_nothing_traced_is_kept(around):
    """The first solve of a law may be inside a user's own transformation; the next ones must not find its tracers."""
    law = ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("xy"), alpha=3.0)
    target, q0 = ck.hold(np.array([1.0, 0.5])), jnp.array([0.3, 0.5])

    def scaled(factor):
        return factor * ck.solve(law, target, q0, 0.0625, 3, "EE").e[-1, 0]

    around(scaled)(jnp.ones(2) if around is jax.vmap else 1.0)
    fresh = ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("xy"), alpha=3.0)
    wanted = ck.solve(fresh, ck.hold(np.array([1.0, 0.5])), q0, 0.0625, 3, "EE").e
    np.testing.assert_array_equal(ck.solve(law, target, q0, 0.0625, 3, "EE").e, wanted)


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
            for made in (ck.step(LAW, WAVE, q, 0.0, 0.1, "EE"), ck.solve(LAW, WAVE, q, 0.1, 3, "EE")):
                assert all(isinstance(x, kind) for x in jax.tree.leaves(made))
                assert kind is jax.Array or not any(x.flags.writeable for x in jax.tree.leaves(made))
        assert isinstance(
            jax.jit(lambda a: ck.step(ck.replace(LAW, alpha=a), WAVE, Q, 0.0, 0.1, "EE").q)(2.0), jax.Array
        )


def test_arrays_that_the_caller_writes_to_are_read_anew():
    """A law that was taken apart and put together again holds the caller's own arrays."""
    gain = np.array(4.0)
    tree = jax.tree.structure(LAW)
    law = tree.unflatten([gain if np.array_equal(x, 4.0) else x for x in jax.tree.leaves(LAW)])
    assert law.alpha is gain
    found = []
    for gain[...] in (4.0, 1.0):
        found.append(ck.step(law, WAVE, Q, 0.0, 0.1, "EE").q)
    wanted = [ck.step(ck.replace(LAW, alpha=a), WAVE, Q, 0.0, 0.1, "EE").q for a in (4.0, 1.0)]
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
