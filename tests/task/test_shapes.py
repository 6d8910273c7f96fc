"""Distances of shapes on links: against coal, of the Panda and of G1's arms; rows against differences; refusals."""

import functools

import jax
import numpy as np
import pytest

import cnclik as ck
from cnclik.robot.model import modelled
from cnclik.task.parts import At
from cnclik.task.shapes import Distance
from cnclik.task.task import Task, coordinates, rows
from tests.oracles import close, robot_file
from tests.refusals import refusals
from tests.robot.test_trees import ARMS, G1, postures
from tests.robot.test_urdf import Pinocchio, oracle

PANDA = robot_file("panda")
FRANKA = ck.load_urdf(PANDA, tips=["panda_hand", "panda_link4", "panda_link2"])
HUMANOID = ck.load_urdf(G1, tips=[*ARMS, "torso_link", "left_elbow_link", "right_elbow_link"])
DOWN, FOREARM = ((0, 0, -0.1), (0, 0, 0.12)), ((0, 0, 0), (0.2, 0, 0.02))
PANDA_PAIRS = {
    "spheres": (ck.sphere("panda_hand", 0.08), ck.sphere("panda_link2", 0.1, (0, -0.1, 0.02))),
    "sphere, capsule": (ck.sphere("panda_hand", 0.08), ck.capsule("panda_link2", 0.07, *DOWN)),
    "capsule, sphere": (ck.capsule("panda_link4", 0.07, *DOWN), ck.sphere(None, 0.2, (0.3, 0.2, 0.4))),
    "capsules": (ck.capsule("panda_hand", 0.05, *DOWN), ck.capsule("panda_link2", 0.07, (0, -0.3, 0), (0, 0.1, 0.05))),
}
G1_PAIRS = {
    "forearms": (ck.capsule("left_elbow_link", 0.05, *FOREARM), ck.capsule("right_elbow_link", 0.05, *FOREARM)),
    "forearm, torso": (ck.capsule("right_elbow_link", 0.05, *FOREARM), ck.capsule("torso_link", 0.12, *DOWN)),
}
CASES = {name: (FRANKA, PANDA, "panda_link0", pair) for name, pair in PANDA_PAIRS.items()}
CASES |= {name: (HUMANOID, G1, "pelvis", pair) for name, pair in G1_PAIRS.items()}


def by_coal(coal, shape, pose):
    """A shape and where it is, as coal has it: a capsule lies along its own z."""
    position, rotation = (np.zeros(3), np.eye(3)) if shape.tip is None else pose(shape.tip)[:2]
    ends = position + np.asarray(shape.ends) @ rotation.T
    if len(ends) == 1:
        return coal.Sphere(float(shape.radius)), coal.Transform3s(np.eye(3), ends[0])
    along = ends[1] - ends[0]
    length = np.linalg.norm(along)
    other = np.cross(along, [1.0, 0, 0] if abs(along[0]) < 0.9 * length else [0, 1.0, 0])
    axes = np.stack([other / np.linalg.norm(other), np.cross(along, other / np.linalg.norm(other)) / length], 1)
    turn = np.column_stack([axes, along / length])
    return coal.Capsule(float(shape.radius), length), coal.Transform3s(turn, ends.mean(0))


@functools.cache
def seen(name):
    """A call to the distance and its row at joint values."""
    robot, _, _, pair = CASES[name]
    task, chain = ck.distance(*pair).on(robot), modelled(robot)
    return jax.jit(lambda q: (coordinates(task, At(chain, q))[0], rows(task, At(chain, q))[0]))


def coal_distances(robot, path, base, pair, each):
    """Distances of two shapes at several joint values, by coal and Pinocchio."""
    coal = pytest.importorskip("coal")
    where = Pinocchio(path, oracle(path)[0])
    for q in each:
        one, other = (by_coal(coal, s, lambda tip, q=q: where.at(robot.joint_names, q, tip, base)) for s in pair)
        yield coal.distance(*one, *other, coal.DistanceRequest(), coal.DistanceResult())


@pytest.mark.parametrize("name", CASES)
def test_distances_are_those_of_coal(name):
    made, (robot, *of) = seen(name), CASES[name]
    each = postures(robot, 40, seed=2)
    for q, wanted in zip(each, coal_distances(robot, *of, each), strict=True):
        close(made(q)[0], wanted, atol=1e-6)  # where shapes overlap coal iterates to that


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_distances_of_almost_parallel_capsules(dtype):
    """The nearest point is an end. G1's forearms were 79 µm nearer than told, 0.9 mrad from parallel."""

    @jax.jit
    def found(angle):
        end = np.array([0.2, 0.1, 0.02]) - 0.15 * angle * np.array([0.0, 1.0, 0.0])
        one, other = ck.capsule(None, 0.01, (0, 0, 0), (0.3, 0, 0)), ck.capsule(None, 0.01, (0.05, 0.1, 0.02), end)
        task, q = Task(parts=(Distance(one=one, other=other),)), np.zeros(FRANKA.n, dtype)
        return coordinates(task, At(modelled(FRANKA), q))[0]

    for angle in (3e-2, 1e-3, 9e-4, 1e-4, 1e-6, 3e-8, 1e-9, 0.0):
        for turned in (angle, -angle):
            end = np.hypot(0.1 - 0.15 * max(turned, 0.0), 0.02)
            close(found(dtype(turned)), end - 0.02, atol=3e-9 if dtype is np.float64 else 3e-5)


@pytest.mark.parametrize("name", CASES)
def test_rows_are_derivatives(name):
    made, robot, rng = seen(name), CASES[name][0], np.random.default_rng(3)
    for q in postures(robot, 5, seed=3):
        along = rng.normal(size=robot.n)
        wanted = (made(q + 1e-6 * along)[0] - made(q - 1e-6 * along)[0]) / 2e-6
        close(made(q)[1] @ along, wanted, atol=1e-7)


test_what_does_not_fit_is_refused = refusals(
    (lambda: ck.sphere("hand", -1.0), "`radius` must"),
    (lambda: ck.capsule("hand", 0.1, (0, 0, 0), (0, 0, 0)), "`end` must be another point"),
    (lambda: ck.distance(ck.position(), ck.sphere("hand", 0.1)), r"`one` must be ck.sphere"),
    (lambda: ck.distance(ck.sphere("hand", 0.1), ck.sphere(None, 0.1)).on(FRANKA), "`tip` must"),
    (lambda: ck.distance(*[ck.sphere("a", 0.1)] * 2), "`one` must be on another link than `other`, but is on a, t"),
    (lambda: ck.distance(*[ck.sphere(None, 0.1)] * 2), "`one` must be on another .* the base, t"),
)
