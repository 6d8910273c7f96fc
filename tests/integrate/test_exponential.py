"""Exponential steps: exact decay, orders, what they know of the target, and the rest of the law with them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.robot.rotations import exp_so3
from tests.bank import screws, told
from tests.oracles import close

LENGTHS, START = [0.7, 1.1, 0.4], np.array([0.3, -0.9, 0.6])
ARM = ck.planar_arm(LENGTHS)
LAW = ck.Law(ARM, ck.position("xy"), alpha=4.0)
SLIDERS = screws([[0.0] * 3] * 2, [[1.0, 0, 0], [0, 1.0, 0]], [0.0, 0.0, 0.0], kinds="PP")


CIRCLE = ck.circle(np.asarray(ck.forward(ARM, START).position)[:2] - [0.2, 0.0], 0.2, period=4.0)  # from START


def by_steps(law, reference, q, Ts, N, method):
    """Joint values and errors of N steps, one by one: no compilation for another N."""
    qs, es = [q], []
    for k in range(N):
        made = ck.step(law, reference, qs[-1], k * Ts, Ts, method)
        qs.append(made.q)
        es.append(made.e)
    return np.array(qs), np.array(es)


WRIST = ck.from_dh([0.0, 0.0, 0.0], [np.pi / 2, -np.pi / 2, 0.0], [0.1, 0.0, 0.3])
TURNED = np.array([0.2, 0.7, -0.3])
HOME = np.asarray(ck.forward(WRIST, TURNED).rotation)


def tumbling(t):
    """A rotation whose angular velocities at different times don't commute."""
    v = jnp.array([0.6 * jnp.sin(t), 0.5 * (1 - jnp.cos(t)), 0.4 * jnp.sin(2 * t)])
    return ck.Pose(position=jnp.zeros(3), rotation=exp_so3(v) @ HOME)


@pytest.mark.parametrize(("method", "order"), [("EXP-EE", 1), ("EXP-MIDPOINT", 2), ("EXP-RK4", 4)])
def test_order_of_orientation(method, order):
    """With closure beyond order 2 it would be 2."""
    law, reference = ck.Law(WRIST, ck.orientation(), alpha=5.0), ck.path(tumbling)
    coarse, fine = (by_steps(law, reference, TURNED, 1 / N, N, method)[1][N // 2 :] for N in (40, 80))
    coarse, fine = np.sqrt(np.mean(coarse**2)), np.sqrt(np.mean(fine**2))
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.15) and fine < 0.002


def test_an_error_of_orientation_goes_along_with_the_targets_turn():
    """Half a radian off, with a target that turns: e(t + Ts) = e^{−z} T e(t), to second order in the turn."""
    law, reference, t0 = ck.Law(WRIST, ck.orientation(), alpha=5.0), ck.path(tumbling), 0.5
    rotation = jax.jit(lambda t: tumbling(t).rotation)

    def missed(method, Ts):
        q = TURNED + np.array([0.3, -0.2, 0.35])
        made = ck.step(law, reference, q, t0, Ts, method)
        after = ck.step(law, reference, made.q, t0 + Ts, Ts, method).e
        turn = np.asarray(rotation(t0 + Ts)) @ np.asarray(rotation(t0)).T
        return np.linalg.norm(after - np.exp(-5.0 * Ts) * turn @ made.e)

    for method, most in (("EXP-MIDPOINT", 1e-2), ("EXP-RK4", 3e-4)):
        coarse, fine = missed(method, 0.1), missed(method, 0.05)
        assert coarse < most and np.log2(coarse / fine) > 2.2


def test_a_causal_step_sees_the_targets_start_alone():
    """Two targets that agree in place and velocity at t are the same to it; a velocity told is all that is known."""
    law = ck.Law(SLIDERS, ck.position("xy"), alpha=2.0)
    q = np.array([0.2, 1.5])
    velocity, e = np.array([0.5, 0.25]), np.array([0.1, 1.6]) - q

    def ends(by):
        """Return where steps end: causal ones, ones that know the path, and one that is told a velocity."""
        bent = ck.path(lambda t: jnp.stack([0.1 + 0.3 * t + by * t**2, 1.6 - 0.1 * t - 3 * by * t**2]))
        made = [(path, name) for path in (ck.causal(bent), bent) for name in ("MIDPOINT", "EXP-MIDPOINT")]
        made += [(ck.causal(told(bent, velocity)), "EXP-MIDPOINT")]
        return jnp.stack([ck.step(law, path, q, 0.0, 0.1, name).q for path, name in made])

    ends = jax.jit(ck.native(ends))
    straight, bent = ends(0.0), ends(1.0)
    close(bent[:2], straight[:2], atol=1e-15)
    close(bent[:2], straight[2:4], atol=1e-15)
    close(bent[4], q + 0.1 * velocity - np.expm1(-0.2) * e, atol=1e-14)
    law = ck.Law(WRIST, ck.orientation(), alpha=5.0)
    steady = ck.path(lambda t: ck.Pose(position=jnp.zeros(3), rotation=exp_so3(t * jnp.array([0.9, -0.5, 0.7])) @ HOME))
    each = (steady, ck.causal(steady))
    both = jax.jit(ck.native(lambda q: [ck.step(law, path, q, 0.0, 0.1, "EXP-EE").q for path in each]))
    close(*both(TURNED + 0.3), atol=1e-14)


def test_a_path_of_unknown_future_leaves_that_of_another_task_known():
    law = ck.Law(SLIDERS, ck.stack(x=ck.position("x"), y=ck.position("y")), alpha=2.0)
    path = ck.path(lambda t: (0.3 + t**2,))
    both = (path, path), (ck.causal(path),) * 2, (path, ck.causal(path))
    known, unknown, mixed = (ck.step(law, ck.references(x=x, y=y), [0.2, 1.5], 0.1, 0.5, "EXP-EE").q for x, y in both)
    close(mixed, [known[0], unknown[1]], atol=1e-15)
    assert abs(known[0] - unknown[0]) > 0.2
