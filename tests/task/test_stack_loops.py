"""Loops of stacks: every method keeps its order where targets of several tips move, and the step is pink's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from tests.oracles import close
from tests.robot.test_trees import ARMS, G1, postures


def two_arms():
    """A planar trunk of two joints, and two arms of two joints on it."""
    trunk, arm = ck.planar_arm([0.5, 0.4], joint_names=["a", "b"]), ck.planar_arm([0.3, 0.25], joint_names=["1", "2"])
    return ck.join(ck.join(trunk, arm, prefix="one", keep=True), arm, at="tip", prefix="two")


ROBOT = two_arms()
TIPS = [t.name for t in ROBOT.tips]
Q = np.array([0.2, -0.4, 0.7, 0.5, -0.6, -0.8])
TASK = ck.stack(one=ck.pose("xy", "z", tip=TIPS[0]), two=ck.position("xy", tip=TIPS[1]))
ALPHA = {"one": 6.0, "two": [3.0, 2.0]}
LAW = ck.Law(ROBOT, TASK, alpha=ALPHA, inverse=ck.levels(["one"], ["two"], damping=(0.05, 0.2)))


def paths():
    """Circles that begin a little off the tips, one of them turning."""
    found = {}
    for name, tip, period in (("one", TIPS[0], 3.0), ("two", TIPS[1], 2.0)):
        at = np.asarray(ck.forward(ROBOT, Q, tip=tip).position)[:2]
        found[name] = ck.circle(at - [0.1, 0.02], 0.1, period=period, rotation=np.eye(3) if name == "one" else None)
    turn = np.asarray(ck.forward(ROBOT, Q, tip=TIPS[0]).rotation)
    found["one"] = ck.replace(found["one"], curve=ck.replace(found["one"].curve, rotation=turn))
    return ck.references(**found)


PATHS = paths()


def ends(method, N):
    return np.asarray(ck.solve(LAW, PATHS, Q, 0.5 / N, N, method).q[-1])


def test_methods_keep_their_orders():
    """Those of docs/methods.md: with damping, exponential steps answer another question in first order."""
    exact = ends("RK4", 2000)
    for method, order, N in (("RK4", 4, 40), ("EXP-MIDPOINT", 1, 160)):
        coarse, fine = (np.linalg.norm(ends(method, n) - exact) for n in (N, 2 * N))
        assert np.log2(coarse / fine) == pytest.approx(order, abs=0.15), method


def test_gradients_are_differences():
    """Through gains of tasks and dampings of levels, forward and reverse."""

    @jax.jit
    def loss(gains, lams):
        inverse = ck.levels(["one"], ["two"], damping=(lams[0], lams[1]))
        law = ck.Law(ROBOT, TASK, alpha={"one": gains[0], "two": gains[1]}, inverse=inverse)
        run = ck.solve(law, PATHS, Q, 0.02, 4, "EE")
        return jnp.sum(run.e[-1] ** 2) + 1e-3 * jnp.sum(run.qdot**2)

    at = jnp.array([20.0, 10.0]), jnp.array([0.02, 0.1])
    reverse, forward = jax.grad(loss, (0, 1))(*at), jax.jacfwd(loss, (0, 1))(*at)
    for a, b in zip(reverse, forward, strict=True):
        close(a, b, rtol=1e-9)
    for k, h in ((0, 1e-4), (1, 1e-6)):
        for i in range(2):
            up, down = (tuple(v.at[i].add(s * h) if j == k else v for j, v in enumerate(at)) for s in (1, -1))
            close(reverse[k][i], (loss(*up) - loss(*down)) / (2 * h), rtol=1e-5)


def test_it_is_pinks_step():
    """The same costs, gains and damping; targets next to their tips, where pink's logarithm of a pose is our error."""
    pink, pin = pytest.importorskip("pink"), pytest.importorskip("pinocchio")
    pytest.importorskip("daqp")
    robot, dt = ck.load_urdf(G1, tips=ARMS), 0.01
    model = pin.buildModelFromUrdf(str(G1))
    q, (one, two) = postures(robot, 1, seed=7)[0], ARMS
    full = pin.neutral(model)
    places = [model.joints[model.getJointId(name)].idx_q for name in robot.joint_names]
    full[places] = q
    tasks, aims, rng = [], {}, np.random.default_rng(8)
    for tip, costs, gain in ((one, (1.0, 0.3), 0.4), (two, (0.5, 0.5), 0.1)):
        at = ck.forward(robot, q, tip=tip)
        where = np.asarray(at.position) + 1e-7 * rng.normal(size=3)
        aims[tip] = ck.hold(where, np.asarray(at.rotation))
        tasks.append(pink.FrameTask(tip, *costs, gain=gain))
        tasks[-1].set_target(pin.SE3(np.asarray(at.rotation), where))
    posture = pink.PostureTask(cost=0.05, gain=0.2)
    posture.set_target(pin.neutral(model))
    moved = pink.solve_ik(
        pink.Configuration(model, model.createData(), full), [*tasks, posture], dt, "daqp", damping=1e-4, limits=[]
    )
    weights = [[1.0] * 3 + [0.3] * 3, [0.5] * 6, np.full(robot.n, 0.05)]
    task = ck.stack(
        one=ck.pose(tip=one, weights=weights[0]), two=ck.pose(tip=two, weights=weights[1]),
        rest=ck.joints(robot.joint_names, weights=weights[2]),
    )  # fmt: skip
    alpha = {"one": 0.4 / dt, "two": 0.1 / dt, "rest": 0.2 / dt}
    law = ck.Law(robot, task, alpha=alpha, inverse=ck.damped(1e-2))
    reference = ck.references(one=aims[one], two=aims[two], rest=ck.hold(values=np.zeros(robot.n)))
    made = np.asarray(ck.step(law, reference, q, 0.0, dt, "EE").qdot)
    joints = [model.joints[model.getJointId(name)].idx_v for name in robot.joint_names]
    close(made, moved[joints], atol=1e-6)
