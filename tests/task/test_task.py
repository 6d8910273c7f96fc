"""Tasks: coordinates, rows, the rotation-vector error; functions of joint values."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cnclik as ck
from cnclik.law.reference import aims_of
from cnclik.robot.model import modelled
from cnclik.task.parts import At
from cnclik.task.task import error, rows
from tests.bank import screws
from tests.oracles import close
from tests.refusals import refusals

ARM = screws(
    [[0.0, 0, 0], [0, 0, 0.3], [0, 0.4, 0.3], [0, 0.8, 0.3]],
    [[0.0, 0, 1], [1, 0, 0], [1, 0, 0], [0.6, 0, 0.8]],
    [0.1, 1.0, 0.3],
)
Q = np.array([0.3, -0.7, 1.1, 0.4])


@jax.jit
def measure(task, q, reference):
    robot = At(modelled(ARM), q)
    return error(task, robot, aims_of(reference, task, 0.0)), rows(task, robot)


TASKS = {
    "xy": (ck.position("xy"), [0, 1]),
    "z": (ck.position("z"), [2]),
    "turn": (ck.orientation(), [3, 4, 5]),
    "turn about y": (ck.orientation("y"), [4]),
    "pose": (ck.pose(), [0, 1, 2, 3, 4, 5]),
    "plane": (ck.pose("xy", "z"), [0, 1, 5]),
}


@pytest.mark.parametrize("name", TASKS)
def test_error_and_jacobian(name):
    task, picked = TASKS[name]
    at = ck.forward(ARM, Q)
    target = np.array([0.5, 0.2, -0.4])
    turn = Rotation.from_rotvec([0.4, -1.3, 2.0])
    rotation_d = (turn * Rotation.from_matrix(at.rotation)).as_matrix()
    e, made = measure(task, Q, ck.hold(target[: len(task.position)] if task.position else None, rotation_d))
    linear = [i for i in picked if i < 3]
    wanted = np.concatenate([target[: len(linear)] - np.asarray(at.position)[linear], turn.as_rotvec()])
    close(e, wanted[[*range(len(linear)), *(len(linear) + i - 3 for i in picked if i > 2)]], atol=1e-14)
    close(made, np.asarray(ck.jacobian(ARM, Q))[picked], atol=1e-14)


def test_task_coordinates_are_position_and_rotation_vector():
    law = ck.Law(ARM, ck.pose(), alpha=1.0, inverse=ck.damped(0.1))  # six coordinates of four joints
    run = ck.solve(law, ck.hold(ck.forward(ARM, Q)), Q, 0.1, 1, "EE")
    at = ck.forward(ARM, Q)
    wanted = np.concatenate([at.position, Rotation.from_matrix(at.rotation).as_rotvec()])
    close(run.x, [wanted, wanted], atol=1e-14)
    close(run.e, 0, atol=1e-14)


def test_a_function_has_the_rows_of_what_it_is():
    """A camera at the tip sees a point; forwards and, for walls and start postures, of several postures at once."""
    point = np.array([0.9, 0.2, 0.7])

    def seen(robot, q):
        at = ck.forward(robot, q)
        away = at.rotation.T @ (point - at.position)
        return away[:2] / jnp.linalg.norm(away)

    task, h = ck.function(seen, ["across", "down"], ["1", "1"]), 1e-6
    e, made = measure(task, Q, ck.hold(values=[0.4, 0.1]))
    at = jax.jit(lambda q: seen(ARM, q))
    close(e, np.array([0.4, 0.1]) - at(Q), atol=1e-14)
    differences = [np.asarray(at(Q + d) - at(Q - d)) / (2 * h) for d in h * np.eye(4)]
    close(made, np.transpose(differences), atol=1e-8)
    close(task.rows_at(modelled(ARM), np.stack([Q, Q]))[1], made, atol=1e-14)


test_bad_input = refusals(
    (lambda: ck.function(3, ["a"], ["m"]), "`value` must be a function"),
    (
        lambda: _run(ck.function(lambda robot, q: q[:2], ["a"], ["m"]), ck.hold(values=[0.4])),
        "`value` must return shape",
    ),
    (lambda: _run(ck.position("xy"), ck.hold([0.1])), r"`reference` must give 2 values \(x, y\), but gives 1"),
    (lambda: ck.position("yx"), "`axes` must be letters of \"xyz\" in that order, but is 'yx'"),
    (lambda: ck.pose("xy", "zz"), "`rotation_axes` must be letters"),
    (lambda: ck.position("xy", weights=[1]), r"`weights` must be a single number or have 2 numbers, but has 1"),
    (lambda: ck.position("xy", weights=[1, 0]), r"`weights` must be positive, but is 0"),
)


def _run(task, reference):
    return ck.solve(ck.Law(ARM, task, alpha=1.0), reference, Q, 0.01, 1)
