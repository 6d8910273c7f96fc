"""Random runs of a Panda and of G1 among walls: none passes one by more than its method, by coal's distances too."""

import functools

import numpy as np
import pytest

import cnclik as ck
from tests.law.test_walls import check_least, wall_distance
from tests.robot.test_trees import ARMS, G1
from tests.task.test_shapes import DOWN, FRANKA, G1_PAIRS, HUMANOID, PANDA, coal_distances

pytestmark = pytest.mark.slow
HAND = ck.sphere("panda_hand", 0.08)
PAIRS = [(HAND, ck.capsule("panda_link2", 0.09, *DOWN)),
         (HAND, ck.capsule(None, 0.1, (0.5, 0.3, 0), (0.5, 0.3, 0.6)))]  # fmt: skip


@functools.cache
def crowded():
    """The Panda over a table, with its hand off its base and a pillar."""
    walls = [ck.wall(ck.distance(*pair), above=0.01) for pair in PAIRS]
    walls += [ck.wall(ck.position("z", tip="panda_hand"), above=0.14)]
    walls += [ck.wall(ck.position("z", tip="panda_link4"), above=0.3), ck.wall(ck.joints(["panda_joint4"]), below=-0.5)]
    robot = ck.replace(FRANKA, velocity_limit=(2.0,) * 7)
    limits = ck.bounded(walls=walls)
    return ck.Law(robot, ck.position(tip="panda_hand"), alpha=8.0, inverse=ck.damped(0.05), limits=limits)


@functools.cache
def runs(count, seed, dtype=np.float64, method="EE"):
    """Runs from postures behind no wall, to targets that may be anywhere."""
    law, rng = crowded(), np.random.default_rng(seed)
    q = rng.uniform(law.chain.lower, law.chain.upper, (12 * count, law.chain.n))
    q = q[wall_distance(law, q).min(1) > 0.0][:count]
    aims = rng.uniform([-0.6, -0.6, -0.1], [0.8, 0.7, 0.8], (count, 3))
    loop = ck.lanes(lambda q, aim: ck.solve(law, ck.hold(aim), q, 0.005, 200, method), cores=1)
    return loop(q.astype(dtype), aims.astype(dtype))


@pytest.mark.parametrize("name", ["panda", "g1"])
def test_velocities_are_the_least_behind_nine_walls(name):
    check_least(name, 0.05, 3000, 9)


@pytest.mark.parametrize(("method", "dtype", "most"), [("EE", np.float64, 1e-3), ("EXP-MIDPOINT", np.float64, 2e-5),
                                                      ("EXP-MIDPOINT", np.float32, 1e-4)])  # fmt: skip
def test_no_run_passes_a_wall_by_more_than_its_method(method, dtype, most):
    law, made = crowded(), runs(10_000, 1, dtype, method)
    status = np.asarray(made.status)
    told = np.any(status & ck.Status.WALLS_CONTRADICT, axis=1)
    assert -wall_distance(law, np.asarray(made.q, float))[~told].min() < most and told.mean() < 0.05
    assert np.mean(np.abs(np.asarray(made.walls)).min(axis=(1, 2)) < 1e-4) > 0.5
    assert np.mean(status & ck.Status.NOT_CONVERGED != 0) < 1e-3


def test_no_run_of_the_panda_collides_by_coal():
    """At the posture of each run that is nearest to a wall, by coal's distances of its hand, base, table and pillar."""
    law, made = crowded(), runs(100, 3, method="EXP-MIDPOINT")
    h = wall_distance(law, made.q)
    for i, pair in enumerate(PAIRS):
        nearest = np.asarray(made.q)[np.arange(100), h[..., i].argmin(1)]
        found = np.array(list(coal_distances(FRANKA, PANDA, "panda_link0", pair, nearest)))
        np.testing.assert_allclose(found, 0.01 + h[..., i].min(1), atol=1e-6)
        assert np.all(found > 0.01 - 2e-5) and np.any(found < 0.011)


def test_no_arm_of_g1_collides_by_coal():
    """Both hands are asked to go into each other, and then into the chest: hands, forearms and torso stay apart."""
    task = ck.stack(one=ck.position(tip=ARMS[0]), other=ck.position(tip=ARMS[1]), rest=ck.joints())
    walls = [ck.wall(ck.distance(*pair), above=0.01) for pair in G1_PAIRS.values()]
    inverse = ck.levels(["one", "other"], ["rest"], damping=(0.02, 0.5))
    law = ck.Law(HUMANOID, task, alpha=5.0, inverse=inverse, limits=ck.bounded(walls=walls))
    q0, least = np.zeros(HUMANOID.n), []
    for x in (0.3, 0.15, 0.0):
        aim = ck.hold([x, 0.0, 0.15])
        run = ck.solve(law, ck.hold_at(HUMANOID, task, q0, one=aim, other=aim), q0, 0.01, 300)
        assert not np.any(run.status & ck.Status.WALLS_CONTRADICT)
        for i, pair in enumerate(G1_PAIRS.values()):
            found = np.array(list(coal_distances(HUMANOID, G1, "pelvis", pair, np.asarray(run.q)[::10])))
            np.testing.assert_allclose(found, 0.01 + wall_distance(law, run.q)[::10, i], atol=1e-6)
            least.append(found[15:].min())  # a forearm starts in the torso
    assert 0.0099 < min(least) < 0.011, least
