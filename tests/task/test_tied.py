"""Tasks in a tip's own frame, and of functions of the target: rows and velocities that change with the target.

Oracles: Pinocchio's Jacobian in the local frame, differences, and the factors and orders that the methods promise.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest

import cnclik as ck
from cnclik.law.law import observe, rows_at
from cnclik.law.paths import shifted
from cnclik.law.reference import aims_of
from cnclik.robot.model import modelled
from cnclik.task.parts import At
from cnclik.task.task import error
from tests.oracles import close
from tests.robot.test_trees import ARMS, BAXTER, G1, GRIPPERS, postures

PANDA = ck.panda()
Q = np.array([0.3, -0.5, 0.2, -1.8, 0.4, 1.6, 0.3])
HERE = ck.forward(PANDA, Q)


def direction(robot, q, target):
    """Where a target is in the tip's frame, as seen from it: two coordinates of its direction."""
    at = ck.forward(robot, q)
    away = at.rotation.T @ (target - at.position)
    return away[:2] / jnp.linalg.norm(away)


def looking(**given):
    """A camera at the tip that looks at a target that moves."""
    return ck.function(
        lambda robot, q: ck.forward(robot, q).rotation[:2, 2], ["across", "down"], ["1", "1"], error=direction,
        target=3, **given,
    )  # fmt: skip


TASKS = {
    "position": ck.position("xyz", frame="tip"),
    "two axes": ck.position("xz", frame="tip"),
    "orientation": ck.orientation(frame="tip"),
    "pose": ck.pose("xyz", "xyz", frame="tip"),
    "mixed": ck.pose("xy", "yz", frame="tip"),
    "look": looking() & ck.position("z"),
}


def paths(task, speed=1.0):
    """A target that moves and turns, off the tip: on a circle; what looks at it, and what is high, ahead of it."""
    turn = np.array([0.5, -0.4, 0.8]) * speed

    def pose(t, away=(0.0, 0.0, 0.0)):
        w, start = t * turn, np.asarray(HERE.rotation)
        k = jnp.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
        rotation = jax.scipy.linalg.expm(k) @ start
        around = 0.1 * jnp.stack([jnp.sin(2 * speed * t), 1 - jnp.cos(2 * speed * t), jnp.sin(speed * t)])
        return ck.Pose(position=HERE.position + jnp.asarray(away) + around, rotation=rotation)

    if task is TASKS["look"]:
        ahead = np.asarray(HERE.rotation)[:, 2] * 0.8 + np.array([0.05, 0.1, 0.0])
        high = ck.path(lambda t: HERE.position[2:] + 0.05 + 0.05 * jnp.sin(2 * t))
        return ck.references(function=ck.path(lambda t: pose(t, ahead).position), tip=high)
    return ck.path(lambda t: pose(t, (0.05, -0.03, 0.04)))


@pytest.mark.parametrize("tip", ARMS)
def test_rows_are_those_in_pinocchios_local_frame(tip):
    """Where no error is left; breaks for rows along the base's axes."""
    robot, model = ck.load_urdf(G1, tips=ARMS), pin.buildModelFromUrdf(str(G1))
    law = ck.Law(modelled(robot), ck.pose(tip=tip, frame="tip"), alpha=1.0)
    data, columns = model.createData(), [model.joints[model.getJointId(name)].idx_v for name in robot.joint_names]
    for q in postures(robot, 3, seed=3):
        full = np.zeros(model.nq)
        full[[model.joints[model.getJointId(name)].idx_q for name in robot.joint_names]] = q
        wanted = pin.computeFrameJacobian(model, data, full, model.getFrameId(tip), pin.LOCAL)[:, columns]
        close(rows_at(law, jnp.asarray(q)).rows, wanted, atol=1e-12)


@pytest.mark.parametrize("relative", [False, True])
def test_rows_and_velocities_are_what_the_error_does(relative):
    """Differences of the error, far from the target: of one axis, too, it changes as the others ask the tip to turn."""
    robot = ck.load_urdf(BAXTER, tips=GRIPPERS)
    own = {"tip": GRIPPERS[0], "relative_to": GRIPPERS[1] if relative else None, "frame": "tip"}
    task, q = ck.position("xz", **own), postures(robot, 1, seed=4)[0]
    start = np.asarray(ck.hold_at(robot, task, q).curve.position) + np.array([0.3, -0.2, 0.4])
    law, moving = (
        ck.Law(modelled(robot), task, alpha=1.0),
        ck.line(start, start + np.array([0.1, 0.3, -0.2]), duration=1.0),
    )

    @jax.jit
    def missing(q, t):
        return error(task, At(law.chain, q), aims_of(moving, task, t))

    at = jax.jit(lambda q: (lambda o: (o.rows, o.e, o.xdot_d))(observe(law, moving, 0.5, q)))(q)
    h = 1e-6
    differences = [(missing(q + d, 0.5) - missing(q - d, 0.5)) / (2 * h) for d in h * np.eye(robot.n)]
    close(at[0], -np.transpose(differences), atol=1e-8)
    close(at[2], (missing(q, 0.5 + h) - missing(q, 0.5 - h)) / (2 * h), atol=1e-8)


@pytest.mark.parametrize(("method", "factor"), [("EE", lambda z: 1 - z), ("EXP-EE", lambda z: np.exp(-z))])
def test_each_axis_decays_by_itself(method, factor):
    """Also where another axis, which is left free, misses half a metre; breaks for rows of the tip itself."""
    away = np.asarray(HERE.rotation) @ [1e-6, 1e-6, 0.5]
    law = ck.Law(PANDA, ck.position("xy", frame="tip"), alpha=[20.0, 60.0])
    run = ck.solve(law, ck.hold(np.asarray(HERE.position) + away), Q, 0.01, 1, method)
    close(run.e[1] / run.e[0], factor(np.array([0.2, 0.6])), atol=2e-5)


ORDERS = {"RK4": 4, "CN": 2, "EXP-EE": 1, "EXP-MIDPOINT": 2}
QUICK = [("EXP-MIDPOINT", "look"), ("EXP-MIDPOINT", "two axes")]
SLOW = [(method, name) for method in ("EXP-EE", "EXP-MIDPOINT") for name in TASKS]
SLOW += [(method, name) for method in ("RK4", "CN") for name in ("pose", "look")]
CASES = QUICK + [pytest.param(*case, marks=pytest.mark.slow) for case in SLOW if case not in QUICK]


def ends(method, N, name):
    """Joint values after half a second; of a redundant arm too, as J# is exact."""
    law = ck.Law(PANDA, TASKS[name], alpha=6.0)
    with ck.use_engine("plain"):
        return np.asarray(ck.solve(law, paths(TASKS[name]), Q, 0.5 / N, N, method, ck.newton(8)).q[-1])


@functools.cache
def exactly(name):
    return ends("RK4", 500, name)


@pytest.mark.parametrize(("method", "name"), CASES)
def test_methods_keep_their_orders(method, name):
    order = ORDERS[method]
    exact, N = exactly(name), {4: 40, 2: 80, 1: 160}[order]
    coarse, fine = (np.linalg.norm(ends(method, n, name) - exact) for n in (N, 2 * N))
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.15)


@pytest.mark.slow
def test_an_orientation_in_the_tips_own_frame_moves_the_arm_as_one_in_the_base():
    """Of all three axes and one gain: the frame is a matter of weights and gains alone."""
    runs = [
        ck.solve(ck.Law(PANDA, ck.orientation(frame=frame), alpha=8.0), paths(TASKS["orientation"]), Q, 0.01, 20)
        for frame in ("base", "tip")
    ]
    close(runs[1].q, runs[0].q, atol=1e-12)
    turned = np.asarray(ck.forward(PANDA, runs[0].q[-1]).rotation)
    close(runs[1].e[-1], turned.T @ runs[0].e[-1], atol=1e-11)


@pytest.mark.parametrize("name", ["position", "pose", "mixed", "look"])
def test_a_measured_error_is_the_one_that_is_fed_back(name):
    """Through a target that is moved: exactly in a tip's own frame, to first order for a function and a turn's axes."""
    task, size = TASKS[name], 1e-4 if name in ("look", "mixed") else 0.1
    law = ck.Law(modelled(PANDA), task, alpha=1.0)
    at = observe(law, paths(task), 0.1, jnp.asarray(Q))
    measured = at.e + size * jnp.asarray(np.random.default_rng(1).normal(size=task.m))
    parts = zip(law.task.parts, at.aims, law.task.slices, strict=True)
    w = jnp.concatenate([p.between(at.robot, aim, measured[where], at.e[where]) for p, aim, where in parts])
    moved = shifted(paths(task), law.task, w)
    close(observe(law, moved, 0.1, jnp.asarray(Q)).e, measured, atol={"look": 1e-7, "mixed": 5e-6}.get(name, 1e-12))


def test_lanes_are_the_plain_loop():
    q = Q + 0.1 * np.random.default_rng(2).normal(size=(8, 7))
    law = ck.Law(PANDA, TASKS["pose"], alpha=6.0, inverse=ck.damped(0.02))
    aim = ck.hold(np.asarray(HERE.position) + 0.05, np.asarray(HERE.rotation))
    made = np.asarray(ck.lanes(lambda q: ck.solve(law, aim, q, 0.01, 5).e[-1])(q))
    with ck.use_engine("plain"):
        close(made, [np.asarray(ck.solve(law, aim, one, 0.01, 5).e[-1]) for one in q], atol=1e-12)


def test_three_functions_are_one():
    """Rows and velocity of one's own, where they are those of the error."""
    task, wrong = looking(), []

    def rows(robot, q, target):
        wrong.append("asked")
        return -jax.jacfwd(lambda q: direction(robot, q, target))(q)

    def velocity(robot, q, target, motion):
        wrong.append("asked")
        return jax.jvp(lambda target: direction(robot, q, target), (target,), (motion,))[1]

    aim = paths(TASKS["look"])["function"]
    made = [
        ck.solve(ck.Law(PANDA, one, alpha=6.0), aim, Q, 0.01, 10).q[-1]
        for one in (task, looking(rows=rows, velocity=velocity))
    ]
    close(made[1], made[0], atol=1e-12)
    assert len(wrong) >= 2


def test_a_camera_keeps_looking_at_what_moves():
    law = ck.Law(PANDA, TASKS["look"], alpha=20.0)
    run = ck.solve(law, paths(TASKS["look"], 0.3), Q, 0.01, 300)
    assert np.abs(run.e[-1]).max() < 1e-5 < 0.05 < np.abs(run.e[0]).max()
    at, target = ck.forward(PANDA, run.q[-1]), paths(TASKS["look"], 0.3)["function"].curve(3.0)[0]
    seen = np.asarray(at.rotation).T @ np.asarray(target - at.position)
    assert seen[2] > 0 and np.abs(seen[:2]).max() < 1e-5


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ck.position(frame="hand"), "`frame` must be one of base, tip"),
        (
            lambda: _run(TASKS["two axes"], ck.hold([0.4, 0.1])),
            "give positions of 3 coordinates in the tip's",
        ),
        (lambda: _run(looking(), ck.hold(values=[0.4, 0.1])), r"`reference` must give 3 values \(across, down\)"),
        (lambda: _run(looking(), ck.hold_at(PANDA, looking(), Q)), "must give 3 values .*, but gives none"),
        (lambda: ck.function(abs, ["a"], ["m"], target=2), "`target` must come with an `error`"),
        (lambda: ck.function(abs, ["a"], ["m"], error=1), "`error` must be a function"),
        (
            lambda: _run(looking(rows=lambda *_: jnp.zeros((2, 3))), ck.hold([0.4] * 3)),
            r"`rows` must return shape .2, 7",
        ),
    ],
)
def test_what_is_refused(make, message):
    with pytest.raises(ck.ArgumentError, match=message):
        make()


def _run(task, reference):
    return ck.solve(ck.Law(PANDA, task, alpha=1.0), reference, Q, 0.01, 1)
