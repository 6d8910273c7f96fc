"""Stacks of tasks: rows of several tips, weights, levels, gains and references of each; what can't be is refused.

Oracles: Pinocchio for tips and for one tip in another's frame, NumPy's least squares, and the recursion of Siciliano
and Slotine.
"""

import jax
import numpy as np
import pytest

import cnclik as ck
from cnclik.law.reference import aims_of
from cnclik.robot.model import modelled
from cnclik.task.parts import At
from cnclik.task.task import error, rows
from tests.bank import robot as robot_of
from tests.oracles import close
from tests.refusals import refusals
from tests.robot.test_trees import ARMS, BAXTER, G1, GRIPPERS, postures
from tests.robot.test_urdf import Pinocchio, oracle

FEET = ["left_ankle_roll_link", "right_ankle_roll_link"]
HUMANOID = ck.load_urdf(G1, tips=[*ARMS, *FEET, "torso_link"])
STACK = ck.stack(
    feet=ck.pose(tip=FEET[0]) & ck.pose(tip=FEET[1]),
    hands=ck.pose(tip=ARMS[0], weights=[1.0] * 3 + [0.3] * 3) & ck.position(tip=ARMS[1]),
    torso=ck.orientation("xy", tip="torso_link"),
)
PLANAR = ck.planar_arm([0.5, 0.4, 0.3, 0.2])
LEFT, RIGHT = ck.position(tip="l"), ck.position(tip="r")


@jax.jit
def seen(robot, task, q, reference):
    at = At(robot, q)
    return error(task, at, aims_of(reference, task, 0.0)), rows(task, at)


def test_a_tip_in_the_frame_of_another():
    """Rows are derivatives of what Pinocchio says of one gripper as seen from the other."""
    robot = ck.load_urdf(BAXTER, tips=GRIPPERS)
    task = ck.pose(tip=GRIPPERS[0], relative_to=GRIPPERS[1])
    where = Pinocchio(BAXTER, oracle(BAXTER)[0])
    for q in postures(robot, 3, seed=1):

        def at(q):
            return where.at(robot.joint_names, q, GRIPPERS[0], GRIPPERS[1])

        position, rotation = at(q)[:2]
        e, made = seen(modelled(robot), task, q, ck.hold(position, rotation))
        close(e, 0, atol=1e-12)
        h = 1e-6
        for i, step in enumerate(h * np.eye(robot.n)):
            (p, r), (p0, r0) = at(q + step)[:2], at(q - step)[:2]
            turned = (r - r0) @ rotation.T / (2 * h)
            wanted = [*(p - p0) / (2 * h), turned[2, 1], turned[0, 2], turned[1, 0]]
            close(np.asarray(made)[:, i], wanted, atol=1e-8)


def test_weights_wait_for_the_robot_to_say_how_many_joints_there_are():
    hand = ck.position(tip=ARMS[0], weights=[2.0, 3.0, 4.0])
    for rest, each, said in ((ck.joints(), 1.0, "None"), (ck.joints(weights=0.1), 0.1, "0.1")):
        task = ck.stack(hand=hand & ck.position("x", tip=ARMS[1]), rest=rest)
        assert repr(task).endswith(f"; rest: all joints, weights ([2, 3, 4], [1], {said})")
        found = np.asarray(ck.Law(HUMANOID, task, alpha=1.0, inverse=ck.damped(0.1)).task.weights)
        close(found, [2.0, 3.0, 4.0, 1.0, *np.full(HUMANOID.n, each)], atol=0)
    close(ck.position("xy", weights=2.0).weights, [2.0, 2.0], atol=0)


def test_a_stack_may_have_one_task():
    """It takes its path by name, as a larger one does."""
    task, q = ck.stack(hand=ck.position("xy")), np.full(4, 0.3)
    paths = ck.hold_at(PLANAR, task, q, hand=ck.hold([0.5, 0.5]))
    run = ck.solve(ck.Law(PLANAR, task, alpha=5.0), paths, q, 0.1, 50)
    close(run["hand"].x[-1], [0.5, 0.5], atol=1e-5)


def test_the_least_singular_value_is_that_of_the_worst_task():
    task, q = ck.stack(rest=ck.joints(), hand=ck.position("xy")), np.full(4, 0.1)
    law = ck.Law(PLANAR, task, alpha=5.0, inverse=ck.damped(0.1))
    made = ck.step(law, ck.hold_at(PLANAR, task, q, hand=ck.hold([0.5, 0.5])), q, 0.0, 0.1)
    wanted = np.linalg.svd(ck.jacobian(PLANAR, q)[:2], compute_uv=False)[-1]
    assert 0.3 * wanted < made.least < wanted * (1 + 1e-9) < 0.5


def recursion(levels, lams):
    """Damped priorities with the projectors that match (Siciliano & Slotine 1991): [(J, v)] of each level."""
    n = levels[0][0].shape[1]
    q, null = np.zeros(n), np.eye(n)
    for (j, v), lam in zip(levels, lams, strict=True):
        s = np.linalg.inv(j @ null @ j.T + lam**2 * np.eye(len(j)))
        q = q + null @ j.T @ s @ (v - j @ q)
        null = null - null @ j.T @ s @ j @ null
    return q


@pytest.mark.parametrize("lams", [(1e-4, 1e-2, 0.1), (1e-2, 1.01e-2, 1.02e-2)])
def test_levels_are_the_recursion(lams):
    """Breaks for a damping that is another level's, or squared twice."""
    q, order = np.array([0.3, 0.5, -0.4, 0.6]), ("angle", "tip", "rest")
    task = ck.stack(tip=ck.position("xy"), angle=ck.orientation("z"), rest=ck.joints())
    there = ck.hold_at(PLANAR, task, q + 0.1)
    aims = ck.hold_at(PLANAR, task, np.add(q, [0.2, -0.1, 0.1, 0.0]), tip=there["tip"], rest=ck.hold(values=-q))
    gains = {"angle": 4.0, "tip": np.array([3.0, 5.0]), "rest": 2.0}
    law = ck.Law(PLANAR, task, alpha=gains, inverse=ck.levels(*([n] for n in order), damping=lams))
    e, j = (np.asarray(v) for v in seen(modelled(PLANAR), law.task, q, aims))
    parts = {name: law.task.of(name) for name in order}
    wanted = recursion([(j[rows], gains[name] * e[rows]) for name, rows in parts.items()], lams)
    close(ck.step(law, aims, q, 0.0, 1e-3, "EE").qdot, wanted, atol=1e-8 * np.abs(wanted).max())


def test_a_run_tells_what_each_task_did():
    robot = robot_of("two arms")
    (one, other), q = (tip.name for tip in robot.tips), np.zeros(robot.n)
    hands = ck.position("xy", tip=one) & ck.position("x", tip=other)
    task = ck.stack(angle=ck.orientation("z", tip=other), hands=hands)
    hand = ck.hold(np.asarray(ck.forward(robot, q, tip=one).position)[:2] + 0.1)
    held = ck.hold_at(robot, task, q)["hands"]
    hands = ck.references(**(dict(zip(held.names, held.each, strict=True)) | {one: hand}))
    alpha = {"angle": 10.0, "hands": 250.0}  # straight arms are the hands' singularity
    law = ck.Law(robot, task, alpha=alpha, inverse=ck.damped(0.02), near_singular=0.02)
    run = ck.solve(law, ck.hold_at(robot, task, q, hands=hands), q, 0.01, 8, "EE")
    bits = int(np.bitwise_or.reduce(run.status))
    assert bits & ck.Status.GROWING and bits & ck.Status.NEAR_SINGULAR
    close(run["hands"].e, run.e[:, 1:], atol=0)
    assert run["angle"].x.shape == (9, 1) and "hands: ‖e‖" in repr(run)
    data = ck.measure.to_dataset(run, law)
    assert list(data.task.values) == ["angle", "hands"]
    assert list(data.axis_task.values) == ["angle", "hands", "hands", "hands"]
    with pytest.raises(ck.ArgumentError, match="`name` must be one of angle, hands"):
        run["legs"]
    with pytest.raises(ck.ArgumentError, match="the run is of no stack"):
        ck.solve(ck.Law(PLANAR, ck.position("xy"), alpha=1.0), ck.hold([0.5, 0.5]), np.ones(4), 0.1, 1)["hands"]


test_what_is_refused = refusals(
    (lambda: ck.stack(), "`tasks` must be at least one, such as hands"),
    (lambda: ck.stack(a=ck.stack(b=LEFT)), "`a` must be a task without names of its own, but is a stack"),
    (lambda: ck.stack(a=LEFT) & RIGHT, "`task` must be joined before it has names"),
    (
        lambda: ck.position("x") & ck.position("y"),
        "`task` must have each position, .* once, tip by tip, but is Task: x ",
    ),
    (lambda: LEFT & RIGHT & ck.orientation(tip=LEFT.parts[0].tip), "`task` must have each .* once, tip by tip"),
    (lambda: ck.joints(["a"]) & ck.joints(["b"]), "`task` must have each .* joints once"),
    (lambda: ck.Law(HUMANOID, ck.joints(["head"]), alpha=1.0), "`joints` must be one of "),
    (lambda: ck.Law(ck.panda(), ck.pose(), alpha={}), "`alpha` must have a gain for each task; they are none"),
    (lambda: law(alpha={"feet": 1.0}), "`alpha` must have a gain for each task; they are feet, hands, torso"),
    (lambda: law(inverse=ck.levels(["feet"], damping=(0.1,))), "`inverse` must have each task of the law in one"),
    (lambda: ck.levels("feet", damping=(0.1,)), "`names` must be a list of names for each level"),
    (lambda: ck.joints([]), r"`names` must be texts, at least one, but is \[\]"),
    (lambda: ck.pose(tip="a", relative_to="a"), "`relative_to` must be another tip than `tip`, but is 'a'"),
    (
        lambda: ck.Law(PLANAR, ck.position("xy") & ck.joints(weights=[2.0]), alpha=1.0),
        "`weights` must be a single number or have 4 numbers",
    ),
    (lambda: ck.levels(["a"], ["b"], damping=(0.1, 0.1)), r"`damping` must be positive and grow .* is \[0.1, 0.1\]"),
    (lambda: ck.levels(["a"], damping=(0.0,)), "`damping` must be positive"),
    (lambda: ck.levels(["a"], ["b"], damping=(0.1,)), "`damping` must have 2 dampings, but has 1"),
    (lambda: ck.Law(PLANAR, ck.position("xy"), alpha={"a": 1.0}), "none: they are given names by ck.stack"),
    (lambda: run(ck.hold([0.0] * 3)), r"`reference` must give a target for each, by ck.references\(feet=..., hands"),
    (
        lambda: run(held(hands=ck.hold([0.0] * 3))),
        r"`reference` must give a target for each, by ck.references\(left_rubber_hand=..., right_rubber_hand=...\)",
    ),
    (lambda: run(held(torso=ck.hold([0.0] * 3))), "`reference.torso` must give"),
    (
        lambda: ck.hold_at(PLANAR, ck.position("xy"), np.ones(4), hand=ck.hold([0.5, 0.5])),
        "`others` must be left out for one task that is no stack",
    ),
    (lambda: held(arms=ck.hold([0.0] * 3)), "`others` must be one of feet"),
)


def law(**changes):
    return ck.Law(HUMANOID, STACK, **({"alpha": 1.0, "inverse": ck.damped(0.1)} | changes))


def held(**others):
    return ck.hold_at(HUMANOID, STACK, np.zeros(29), **others)


def run(reference):
    return ck.solve(law(), reference, np.zeros(29), 0.01, 2)
