"""Random robots, tasks and walls: no NaN without a status, limits that hold, no run that passes a wall."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import cnclik as ck
from cnclik.problem.names import task_from
from cnclik.robot.model import modelled
from cnclik.task.parts import At
from tests.law.test_walls import check_least
from tests.robot.test_trees import ARMS, G1
from tests.task.test_shapes import DOWN, FRANKA, G1_PAIRS, HUMANOID, coal_distances

pytestmark = pytest.mark.slow
LAWS = {
    "pseudoinverse": {},
    "bounded": {"inverse": ck.damped(0.05), "limits": ck.bounded()},
    "scaled": {"inverse": ck.singular_damped(0.05, 0.1), "limits": ck.velocity_scaling()},
}


def wall_distance(law, q):
    """The distance to each wall at joint values (..., n), h (..., k); negative behind it."""
    each = lambda q: jnp.stack([w.distance(At(modelled(law.chain), q)) for w in law.limits.walls])  # noqa: E731
    return np.asarray(jax.jit(jnp.vectorize(each, signature="(n)->(k)"))(q))


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("task", ["xy", "pose", "rz"])
def test_no_nan_without_a_status(name, task):
    task = ck.pose("xyz", "x") if (name, task) == ("pseudoinverse", "pose") else task_from(task)  # more rows: damped
    size, bounds = st.floats(-2, 2) | st.sampled_from([0.0, np.pi / 2]), {"lower": [-2.0] * 4, "upper": [2.0] * 4}

    @settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck))
    @given(
        geometry=st.lists(size, min_size=12, max_size=12),
        q0=st.lists(st.floats(-3, 3), min_size=4, max_size=4),
        target=st.lists(st.floats(-5, 5) | st.just(1e150), min_size=3, max_size=3),
        z=st.floats(1e-3, 50),
    )
    def check(geometry, q0, target, z):
        a, alpha, d = np.reshape(geometry, (3, 4))  # all geometry in arrays: one compilation serves every example
        chain = ck.from_dh(a, alpha, d, kinds="RRRP", **bounds, velocity_limit=[3.0] * 4)
        law = ck.Law(chain, task, alpha=z / 0.1, **LAWS[name])
        turn = np.eye(3) if task.orientation else None
        run = ck.solve(law, ck.hold(np.array(target), turn), np.array(q0), 0.1, 12, "EE")
        finite = np.isfinite(np.asarray(run.q[1:])).all(1) & np.isfinite(np.asarray(run.e[:-1])).all(1)
        np.testing.assert_array_equal((np.asarray(run.status) & ck.Status.NON_FINITE) != 0, ~finite)
        if name == "bounded":  # within limits from wherever it starts, whatever is asked
            assert (np.abs(np.asarray(run.qdot)[finite]) <= 3.0 + 1e-6).all()
            assert not finite.all() or (np.abs(np.asarray(run.q)) <= np.maximum(2.0, np.abs(q0)) + 1e-6).all()

    check()


HAND = ck.sphere("panda_hand", 0.08)
PAIRS = [(HAND, ck.capsule("panda_link2", 0.09, *DOWN)),
         (HAND, ck.capsule(None, 0.1, (0.5, 0.3, 0), (0.5, 0.3, 0.6)))]  # fmt: skip


def crowded():
    """The Panda over a table, with its hand off its base and a pillar."""
    walls = [ck.wall(ck.distance(*pair), above=0.01) for pair in PAIRS]
    walls += [ck.wall(ck.position("z", tip="panda_hand"), above=0.14)]
    walls += [ck.wall(ck.position("z", tip="panda_link4"), above=0.3), ck.wall(ck.joints(["panda_joint4"]), below=-0.5)]
    robot, limits = ck.replace(FRANKA, velocity_limit=(2.0,) * 7), ck.bounded(walls=walls)
    return ck.Law(robot, ck.position(tip="panda_hand"), alpha=8.0, inverse=ck.damped(0.05), limits=limits)


@pytest.mark.parametrize(("method", "dtype", "most"), [("EE", np.float64, 1e-3), ("EXP-MIDPOINT", np.float64, 2e-5),
                                                      ("EXP-MIDPOINT", np.float32, 1e-4)])  # fmt: skip
def test_no_run_passes_a_wall_by_more_than_its_method(method, dtype, most):
    """From postures behind no wall, to targets that may be anywhere."""
    law, rng, count = crowded(), np.random.default_rng(1), 10_000
    q = rng.uniform(law.chain.lower, law.chain.upper, (12 * count, law.chain.n))
    q = q[wall_distance(law, q).min(1) > 0.0][:count]
    aims = rng.uniform([-0.6, -0.6, -0.1], [0.8, 0.7, 0.8], (count, 3))
    loop = ck.lanes(lambda q, aim: ck.solve(law, ck.hold(aim), q, 0.005, 200, method), cores=1)
    run = loop(q.astype(dtype), aims.astype(dtype))
    status = np.asarray(run.status)
    told = np.any(status & ck.Status.WALLS_CONTRADICT, axis=1)
    assert -wall_distance(law, np.asarray(run.q, float))[~told].min() < most and told.mean() < 0.05
    assert np.mean(np.abs(np.asarray(run.walls)).min(axis=(1, 2)) < 1e-4) > 0.5
    assert np.mean(status & ck.Status.NOT_CONVERGED != 0) < 1e-3


@pytest.mark.parametrize("name", ["panda", "g1"])
def test_velocities_are_the_least_behind_nine_walls(name):
    check_least(name, 0.05, 3000, 9, spared=1)


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
