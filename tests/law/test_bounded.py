"""Bounded least squares: the least that SciPy finds, its derivatives and levels; daqp is in test_walls."""

import functools
from types import SimpleNamespace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import lsq_linear

import cnclik as ck
from cnclik.robot.model import modelled
from tests.refusals import refusals
from tests.robot.test_trees import ARMS, G1

RATE, FASTEST = 8.0, 6.0  # [1/s, rad/s]; a rate that divides without rounding
FEET = ["left_ankle_roll_link", "right_ankle_roll_link"]
WEIGHTS = [1.0] * 3 + [0.5] * 3
ORDER = ([*FEET, *ARMS], ["torso_link"])


@functools.cache
def robot_and_task(name):
    if name == "panda":
        return ck.panda(), ck.pose(weights=WEIGHTS)
    robot = ck.load_urdf(G1, tips=[*FEET, "torso_link", *ARMS])
    return robot, ck.stack(**{tip: ck.pose(tip=tip, weights=WEIGHTS) for tip in (*FEET, "torso_link", *ARMS)})


class Draws(NamedTuple):
    """Postures with joints next to and beyond their limits, and what is asked of them."""

    rows: np.ndarray  # (count, m, n), weighted
    velocity: np.ndarray  # (count, m), weighted
    null: np.ndarray  # (count, n)
    low: np.ndarray
    high: np.ndarray
    q: np.ndarray


@functools.cache
def rows_of(name):
    """Weighted rows of a robot's task at ten postures: one program for any number of them."""
    robot, task = robot_and_task(name)
    law = ck.Law(robot, task, alpha=1.0, inverse=ck.damped(1.0))
    moving, weights = ck.replace(law, chain=modelled(robot)), np.asarray(law.task.weights)[:, None]
    return jax.jit(jax.vmap(lambda q: moving.task.rows_at(moving.chain, q) * weights))


def draws(name, count, seed, null=0.0) -> Draws:
    """Velocities from 0.03 to 10 times what joints do, a tenth of them out of their reach."""
    robot, rows_at_ten = robot_and_task(name)[0], rows_of(name)
    rng, lower, upper = np.random.default_rng(seed), np.array(robot.lower), np.array(robot.upper)
    least, most = np.nan_to_num(lower, neginf=-1.0), np.nan_to_num(upper, posinf=1.0)
    q = rng.uniform(least, most, (count, robot.n))
    at_lower, near = rng.random(q.shape) < 0.5, rng.uniform(-0.01, 0.1, q.shape)
    q = np.where(rng.random(q.shape) < 0.25, np.where(at_lower, least + near, most - near), q)
    rows = np.concatenate([rows_at_ten(q[k : k + 10]) for k in range(0, count, 10)])
    size = 10 ** rng.uniform(-1.5, 1.0, (count, 1))
    velocity = np.einsum("kmn,kn->km", rows, 2 * size * rng.normal(size=q.shape))
    velocity += 0.1 * size * rng.normal(size=velocity.shape)
    limits = np.array(robot.velocity_limit)
    most = np.where(np.isfinite(limits), np.minimum(limits, FASTEST), limits)
    low, high = (np.clip(RATE * (limit - q), -most, most) for limit in (lower, upper))
    return Draws(rows, velocity, null * size * rng.normal(size=q.shape), low, high, q)


def act(limits, inverse, rows, velocity, null, low, high):
    """A limits method at q = 0 of a chain whose velocities have these bounds."""
    far = jnp.full_like(low, jnp.inf)
    chain = SimpleNamespace(bounded=True, slowed=True, lower=low / RATE, upper=high / RATE, velocity_limit=far)
    return limits(inverse.shift(rows, velocity), chain, jnp.zeros_like(low), rows, velocity, null)


def least(rows, velocity, null, low, high, shift):
    """SciPy's."""
    root = 1 / np.sqrt(np.broadcast_to(shift, velocity.shape))
    a = np.concatenate([root[:, None] * rows, np.eye(len(low))])
    b = np.concatenate([root * velocity, null])
    return lsq_linear(a, b, (low, np.maximum(high, low + 1e-14)), method="bvls", tol=1e-14, max_iter=1000).x


def levels():
    return ck.levels(*ORDER, damping=(1e-2, 0.1)).on(robot_and_task("g1")[1])


INVERSES = {
    "damped": lambda: ck.damped(1e-3),
    "singular": lambda: ck.singular_damped(0.1, 0.3),
    "levels": levels,
}
CASES = [("panda", "damped"), ("panda", "singular"), ("g1", "levels")]


def bound(rate, made, of):
    """What `bounded` makes of a draw; dampings are parameters, and all of a kind share a program."""
    rate, made = jax.tree.map(lambda v: jnp.asarray(v, of[0].dtype), (rate, made))
    done = act(ck.bounded(rate), made, *of)
    return done.qdot, done.limited, done.factored.shift


several = functools.partial(jax.vmap, in_axes=(None, None, 0))
BOUND = {"panda": jax.jit(several(ck.native(bound))), "g1": jax.jit(several(bound))}  # as C, and as XLA has it


@pytest.mark.parametrize(("name", "inverse"), CASES)
def test_it_is_the_least_within_bounds(name, inverse):
    count = 100 if name == "panda" else 30
    made, drawn = INVERSES[inverse](), draws(name, count, seed=1, null=0.3)
    qdot, limited, shift = map(np.asarray, BOUND[name](RATE, made, drawn[:5]))
    assert np.all((qdot >= drawn.low) & (qdot <= drawn.high))
    for k in range(count):
        wanted = least(*(v[k] for v in drawn[:5]), shift[k])
        np.testing.assert_allclose(qdot[k], wanted, atol=1e-8 * max(np.abs(wanted).max(), 1e-3), err_msg=f"draw {k}")
        assert limited[k] == np.any((wanted <= drawn.low[k] + 1e-12) | (wanted >= drawn.high[k] - 1e-12))
    assert 0.5 < limited.mean() < 1


def test_an_arm_in_millimetres_moves_as_in_metres():
    rows, velocity, *rest = draws("panda", 100, seed=1)[:5]
    small, whole = (BOUND["panda"](RATE, ck.damped(0.05 * s), (s * rows, s * velocity, *rest))[0] for s in (1e-3, 1.0))
    np.testing.assert_allclose(small, whole, atol=1e-9)


def test_single_precision():
    drawn = draws("panda", 100, seed=4)
    both = [tuple(v.astype(dtype) for v in drawn[:5]) for dtype in (np.float64, np.float32)]
    wide, narrow = (BOUND["panda"](RATE, ck.damped(0.05), of)[0] for of in both)
    assert narrow.dtype == np.float32
    size = np.abs(wide).max(1, keepdims=True)
    np.testing.assert_allclose(narrow / size, wide / size, atol=1e-4)
    qdot, _, shift = map(np.asarray, BOUND["panda"](RATE, ck.damped(1e-4), both[1]))  # below rounding
    for k, of in enumerate(zip(*drawn[:5], strict=True)):
        np.testing.assert_allclose(qdot[k], least(*of, shift[k]), atol=0.05 * size[k, 0])


def test_derivatives_are_differences():
    """Forward over reverse: of each draw the slope along a direction, and the second derivative; of four joints."""
    rows, velocity, *joints = draws("panda", 20, seed=6, null=0.3)[:5]
    drawn, rng = (rows[:, :3, :4], velocity[:, :3], *(v[:, :4] for v in joints)), np.random.default_rng(6)
    toward = tuple(rng.normal(size=v.shape) * np.abs(v).max() for v in drawn)
    ends = rng.normal(size=drawn[-1].shape)

    @jax.jit
    @functools.partial(jax.vmap, in_axes=(None, 0, 0, 0))
    @ck.native
    def slopes(s, of, toward, end):
        def value(s):
            moved = (v + s * d + s * s * jnp.sin(d) for v, d in zip(of, toward, strict=True))
            return end @ act(ck.bounded(RATE), ck.damped(0.05), *moved).qdot

        return value(s), *jax.jvp(jax.grad(value), (s,), (1.0,))

    at, h = [slopes(s, drawn, toward, ends) for s in (0.0, 1e-7, -1e-7)], 1e-7
    for k in (0, 1):
        wanted = np.asarray(at[1][k] - at[2][k]) / (2 * h)
        np.testing.assert_allclose(at[0][k + 1], wanted, rtol=1e-4, atol=1e-4 * np.abs(wanted).max())


def test_a_descent_that_is_cut_short_is_no_worse_than_clipping():
    """One step more, clipped, had a million times the cost."""
    drawn = draws("g1", 60, seed=10)

    found = np.asarray(jax.jit(jax.vmap(lambda *of: act(ck.bounded(RATE, 1), levels(), *of).qdot))(*drawn[:5]))
    root = 1 / np.where(np.array(levels().level) == 0, 1e-2, 0.1)
    b = root[:, None] * drawn.rows
    sides = np.einsum("kmn,km->kn", b, root * drawn.velocity) + drawn.null
    asked = np.linalg.solve(b.mT @ b + np.eye(b.shape[-1]), sides[..., None])[..., 0]
    cost, clipped = (
        np.sum((root * (np.einsum("kmn,kn->km", drawn.rows, v) - drawn.velocity)) ** 2, 1)
        + np.sum((v - drawn.null) ** 2, 1)
        for v in (found, np.clip(asked, drawn.low, drawn.high))
    )
    assert np.all((found >= drawn.low) & (found <= drawn.high)) and np.all(cost <= clipped * (1 + 1e-9))


def test_a_descent_that_is_cut_short_is_told():
    """A step is NOT_CONVERGED where it is, and not where it has settled."""
    limits = {"lower": (-1.5,) * 5, "upper": (1.5,) * 5, "velocity_limit": (3.0,) * 5}
    robot, task = ck.replace(ck.planar_arm([0.5, 0.4, 0.3, 0.3, 0.2]), **limits), ck.pose("xy", "z")
    q = np.clip(np.random.default_rng(5).uniform(-2, 2, (40, 5)), -1.5, 1.5)
    held, law = ck.hold_at(robot, task, 0.3 * q[0]), ck.Law(robot, task, alpha=2.0, inverse=ck.damped(1e-3))

    @jax.jit
    @jax.vmap
    def status(q):
        return [ck.solve(ck.replace(law, limits=ck.bounded(passes=M)), held, q, 0.01, 2, "EE").status for M in (1, 40)]

    short, settled = status(q)
    assert np.any(short & ck.Status.NOT_CONVERGED) and not np.any(settled & ck.Status.NOT_CONVERGED)
    assert np.any(short & ck.Status.AT_LIMIT) and np.any(settled & ck.Status.AT_LIMIT)


test_what_does_not_fit_is_refused = refusals(
    (lambda: ck.bounded(rate=0.0), "`rate`"),
    (lambda: ck.bounded(passes=2.5), "`passes`"),
    (lambda: ck.Law(ck.panda(), ck.pose(), alpha=1.0, limits=ck.bounded()), "`inverse` must be damped with"),
)


def test_levels_with_small_dampings_keep_their_order():
    arm, q0 = ck.planar_arm([1.0, 1.0, 1.0]), np.array([0.3, 0.6, 0.5])
    task = ck.stack(a=ck.position("xy"), b=ck.position("xy"))
    p = np.asarray(ck.forward(arm, q0).position)[:2]
    aims = ck.references(a=ck.hold(p), b=ck.hold(p + np.array([0.1, 0.0])))
    law = ck.Law(arm, task, alpha=10.0, inverse=ck.levels(["a"], ["b"], damping=(1e-6, 1e-5)), limits=ck.bounded())
    run = ck.solve(law, aims, q0, 0.01, 200)
    np.testing.assert_allclose(run.e[-1], [-0.001, 0.0, 0.099, 0.0], atol=1e-4)
