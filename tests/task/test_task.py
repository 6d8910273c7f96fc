"""Tasks: coordinates, rows, the rotation-vector error; functions of joint values and of a target that moves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cnclik as ck
from cnclik.law.law import observe
from cnclik.law.reference import aims_of
from cnclik.robot.model import modelled
from cnclik.task.parts import At
from cnclik.task.task import error, rows
from tests.oracles import close
from tests.refusals import refusals

ARM = ck.from_screws(
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
    run = ck.solve(law, ck.hold(ck.forward(ARM, Q)), Q, 0.1, 1)
    at = ck.forward(ARM, Q)
    wanted = np.concatenate([at.position, Rotation.from_matrix(at.rotation).as_rotvec()])
    close(run.x, [wanted, wanted], atol=1e-14)
    close(run.e, 0, atol=1e-14)


test_bad_input = refusals(
    (lambda: ck.position("yx"), "`axes` must be letters of \"xyz\" in that order, but is 'yx'"),
    (lambda: ck.pose("xy", "zz"), "`rotation_axes` must be letters"),
    (lambda: ck.position("xy", weights=[1]), r"`weights` must be a single number or have 2 numbers, but has 1"),
    (lambda: ck.position("xy", weights=[1, 0]), r"`weights` must be positive, but is \[1.0, 0.0\]"),
)


PANDA = ck.panda()
BENT = np.array([0.3, -0.5, 0.2, -1.8, 0.4, 1.6, 0.3])
HERE = ck.forward(PANDA, BENT)


def direction(robot, q, target):
    """Where a target is in the tip's frame, as seen from it: two coordinates of its direction."""
    at = ck.forward(robot, q)
    away = at.rotation.T @ (target - at.position)
    return away[:2] / jnp.linalg.norm(away)


def looking():
    """A camera at the tip that looks at a target that moves."""
    return ck.function(
        lambda robot, q: ck.forward(robot, q).rotation[:2, 2], ["across", "down"], ["1", "1"], error=direction,
        target=3,
    )  # fmt: skip


LOOK = looking() & ck.position("z")


def paths(speed=1.0):
    """A target that moves on a circle ahead of the tip, and the tip's height."""
    ahead = np.asarray(HERE.position) + np.asarray(HERE.rotation)[:, 2] * 0.8 + np.array([0.05, 0.1, 0.0])

    def seen(t):
        return ahead + 0.1 * jnp.stack([jnp.sin(2 * speed * t), 1 - jnp.cos(2 * speed * t), jnp.sin(speed * t)])

    high = ck.path(lambda t: HERE.position[2:] + 0.05 + 0.05 * jnp.sin(2 * t))
    return ck.references(function=ck.path(seen), tip=high)


def test_rows_and_velocities_are_what_the_error_does():
    """Differences of the error."""
    law, moving = ck.Law(modelled(PANDA), LOOK, alpha=1.0), paths()

    @jax.jit
    def missing(q, t):
        return error(law.task, At(law.chain, q), aims_of(moving, law.task, t))

    rows, velocity = jax.jit(lambda q: (lambda o: (o.rows, o.xdot_d))(observe(law, moving, 0.5, q)))(BENT)
    h = 1e-6
    differences = [(missing(BENT + d, 0.5) - missing(BENT - d, 0.5)) / (2 * h) for d in h * np.eye(7)]
    close(rows, -np.transpose(differences), atol=1e-8)
    close(velocity, (missing(BENT, 0.5 + h) - missing(BENT, 0.5 - h)) / (2 * h), atol=1e-8)


test_functions_that_are_refused = refusals(
    (lambda: _run(looking(), ck.hold(values=[0.4, 0.1])), r"`reference` must give 3 values \(across, down\)"),
    (lambda: _run(looking(), ck.hold_at(PANDA, looking(), BENT)), "must give 3 values .*, but gives 0"),
    (lambda: ck.function(abs, ["a"], ["m"], target=2), "`target` must come with an `error`"),
    (lambda: ck.function(abs, ["a"], ["m"], error=1), "`error` must be a function"),
)


def _run(task, reference):
    return ck.solve(ck.Law(PANDA, task, alpha=1.0), reference, BENT, 0.01, 1)
