"""Saturation level by level: Algorithm 4 of Flacco, De Luca & Khatib (2015), written out in NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.robot.model import modelled
from tests.robot.test_trees import ARMS, G1

RATE, COUNT = 10.0, 400
PANDA, TASK = ck.panda(), ck.stack(a=ck.position("xyz"), b=ck.orientation("xy"), c=ck.orientation("z"))
SMALL = ck.replace(ck.planar_arm([1.0, 0.8, 0.6]), lower=(-2.9,) * 3, upper=(2.0,) * 3, velocity_limit=(2.0,) * 3)
ORDERS = {
    "one row after one": (SMALL, ck.stack(a=ck.position("x"), b=ck.position("y")), (["a"], ["b"])),
    "two": (PANDA, TASK, (["a"], ["b", "c"])),
    "three": (PANDA, TASK, (["a"], ["b"], ["c"])),
}


def algorithm_4(levels, low, high):
    """(q̇, share of each level), or None where joints that are left can't move a level's coordinates apart."""
    n = len(low)
    qdot, null, shares = np.zeros(n), np.eye(n), []
    for j, v in levels:
        w, held, best = np.eye(n), np.zeros(n), (0.0, qdot)
        while True:
            locked = np.linalg.pinv((np.eye(n) - w) @ null)
            free = (np.eye(n) - locked) @ null
            inverse = np.linalg.pinv(j @ free, rcond=1e-9)
            if np.linalg.matrix_rank(j @ free, tol=1e-6) < len(j):
                break
            there = qdot + locked @ ((np.eye(n) - w) @ (held - qdot))
            a, b = inverse @ v, there - inverse @ (j @ there)
            over = np.maximum(a + b - high, low - a - b) * np.diag(w)
            if over.max() < 1e-9:
                best = (1.0, a + b)
                break
            with np.errstate(divide="ignore", invalid="ignore"):
                one, two = (low - b) / a, (high - b) / a
            most, least = np.maximum(one, two), np.minimum(one, two)
            cap = np.where((np.diag(w) > 0) & (over > 1e-9), most, np.inf)
            joint, moves = int(np.argmin(cap)), np.diag(w) > 0
            share, floor = min(cap.min(), 1.0), max(least[moves].max(), 0.0)
            if share >= floor and share > best[0]:
                best = (share, share * a + b)
            w[joint, joint] = 0.0
            held[joint] = high[joint] if (a + b)[joint] > high[joint] else low[joint]
        shares.append(best[0])
        qdot = best[1]
        null = null - np.linalg.pinv(j @ null, rcond=1e-9) @ j @ null
    return qdot, shares


@pytest.mark.parametrize("order", ORDERS)
def test_it_is_algorithm_4(order):
    rng, (arm, task, named) = np.random.default_rng(len(order)), ORDERS[order]
    lower, upper, speed = (np.array(v) for v in (arm.lower, arm.upper, arm.velocity_limit))
    rows, q = rng.normal(size=(COUNT, task.m, arm.n)), rng.uniform(lower, upper, (COUNT, arm.n))
    velocity = rng.normal(size=(COUNT, task.m)) * rng.choice([0.5, 2.0, 5.0], size=(COUNT, 1))
    made = ck.levels(*named, damping=(1e-7, 1e-6, 1e-5)[: len(named)]).on(task)

    def one(rows, velocity, q):
        found = ck.saturation(RATE)(made, modelled(arm), q, rows, velocity, None)
        return found.qdot, jnp.asarray(found.limited)

    qdot, limited = map(np.asarray, jax.jit(jax.vmap(one))(rows, velocity, q))
    low, high = (np.clip(RATE * (end - q), -speed, speed) for end in (lower, upper))
    assert np.all((qdot >= low) & (qdot <= high))
    level, same, shares = np.array(made.level), [], []
    for k in range(COUNT):
        parts = [(rows[k][level == i], velocity[k][level == i]) for i in range(level.max() + 1)]
        wanted, share = algorithm_4(parts, low[k], high[k])
        same.append(np.abs(qdot[k] - wanted).max() < 1e-4 * max(1.0, np.abs(wanted).max()))
        shares.append(share)
        assert limited[k] or min(share) == 1
    assert np.mean(same) > 0.99
    shares = np.array(shares)
    # Level 1 keeps its speed where it can, and what is below it is slowed.
    assert np.mean(shares[:, 0] == 1) > 0.3 and np.mean((shares[:, 0] == 1) & (shares[:, 1] < 1)) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("limits", [ck.saturation(), ck.bounded()], ids=["saturation", "bounded"])
def test_the_first_level_keeps_its_speed(limits):
    """A humanoid whose hands hurry keeps its feet where they are; without levels all of it slows down alike."""
    feet = ["left_ankle_roll_link", "right_ankle_roll_link"]
    robot = ck.load_urdf(G1, tips=[*feet, *ARMS])
    robot = ck.replace(robot, velocity_limit=(0.5,) * robot.n)
    both = {"feet": feet, "hands": ARMS}
    task = ck.stack(**{name: ck.position(tip=one) & ck.position(tip=other) for name, (one, other) in both.items()})
    q = 0.2 * np.ones(robot.n)
    held = ck.hold_at(robot, task, q)
    aims = {}
    for name, tips, way in (("feet", feet, [0.03, 0.0, 0.0]), ("hands", ARMS, [0.1, 0.0, 0.4])):
        at = [np.asarray(held[name][tip].curve.position) for tip in tips]
        aims[name] = ck.references(**{tip: ck.line(x, x + way, duration=0.5) for tip, x in zip(tips, at, strict=True)})
    law = ck.Law(robot, task, alpha=20.0, inverse=ck.levels(["feet"], ["hands"], damping=(1e-3, 0.05)), limits=limits)
    run = ck.solve(law, ck.references(**aims), q, 0.01, 20)
    together = ck.solve(ck.replace(law, inverse=ck.damped(0.01)), ck.references(**aims), q, 0.01, 20)
    missed = [float(np.abs(one["feet"].e[-1]).max()) for one in (run, together)]
    assert missed[0] < 1e-5 and np.abs(run["hands"].e[-1]).max() > 0.05
    assert missed[1] > 10 * missed[0]
    assert np.abs(run.qdot).max() <= 0.5 * (1 + 1e-9)
