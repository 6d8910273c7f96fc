"""Functions of joint values and target as tasks: rows and velocities that change with the target.

Oracles: differences, and the orders that the methods promise.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.law.law import observe
from cnclik.law.reference import aims_of
from cnclik.robot.model import modelled
from cnclik.task.parts import At
from cnclik.task.task import error
from tests.oracles import close

PANDA = ck.panda()
Q = np.array([0.3, -0.5, 0.2, -1.8, 0.4, 1.6, 0.3])
HERE = ck.forward(PANDA, Q)


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

    rows, velocity = jax.jit(lambda q: (lambda o: (o.rows, o.xdot_d))(observe(law, moving, 0.5, q)))(Q)
    h = 1e-6
    differences = [(missing(Q + d, 0.5) - missing(Q - d, 0.5)) / (2 * h) for d in h * np.eye(7)]
    close(rows, -np.transpose(differences), atol=1e-8)
    close(velocity, (missing(Q, 0.5 + h) - missing(Q, 0.5 - h)) / (2 * h), atol=1e-8)


def test_a_camera_keeps_looking_at_what_moves():
    law = ck.Law(PANDA, LOOK, alpha=20.0)
    run = ck.solve(law, paths(0.3), Q, 0.01, 300)
    assert np.abs(run.e[-1]).max() < 1e-5 < 0.05 < np.abs(run.e[0]).max()
    at, target = ck.forward(PANDA, run.q[-1]), paths(0.3)["function"].curve(3.0)[0]
    seen = np.asarray(at.rotation).T @ np.asarray(target - at.position)
    assert seen[2] > 0 and np.abs(seen[:2]).max() < 1e-5


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: _run(looking(), ck.hold(values=[0.4, 0.1])), r"`reference` must give 3 values \(across, down\)"),
        (lambda: _run(looking(), ck.hold_at(PANDA, looking(), Q)), "must give 3 values .*, but gives 0"),
        (lambda: ck.function(abs, ["a"], ["m"], target=2), "`target` must come with an `error`"),
        (lambda: ck.function(abs, ["a"], ["m"], error=1), "`error` must be a function"),
    ],
)
def test_what_is_refused(make, message):
    with pytest.raises(ck.ArgumentError, match=message):
        make()


def _run(task, reference):
    return ck.solve(ck.Law(PANDA, task, alpha=1.0), reference, Q, 0.01, 1)
