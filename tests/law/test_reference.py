"""References: where they are, how fast they move, and that the two agree."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import cnclik as ck
from cnclik.law.paths import interval
from cnclik.law.reference import motion, sample
from tests.oracles import close
from tests.refusals import refusals

POSE, TURN = ck.pose(), np.eye(3)


@jax.jit
def _sample(reference, t, task):
    aims, xdot = sample(reference, task, t)
    found = {part.turns: aim for part, aim in zip(task.parts, aims, strict=True)}
    return found.get(False), found.get(True), xdot


TASKS = {"xy": ck.position("xy"), "xyz": ck.position(), "pose": POSE}


def at(reference, t, task):
    return _sample(reference, jnp.asarray(t, float), TASKS[task])


def rotvec(a, b):
    """Rotation vector, in the base frame, from a to b."""
    return (Rotation.from_matrix(b) * Rotation.from_matrix(a).inv()).as_rotvec()


R0, R1, _, R3 = Rotation.random(4, rng=5)
TIMES = np.array([0.5, 1.0, 2.5, 3.0, 4.0])
POINTS = np.random.default_rng(6).normal(size=(5, 3))


def screw(t):
    """A pose as a function of time."""
    turn = ck.line([0.0, 0, 0], [1.0, 0, 0], duration=3.0, rotation=R0.as_matrix(), rotation_end=R1.as_matrix())
    position, rotation = turn.curve(t)
    return ck.Pose(position=position * t, rotation=rotation)


REFERENCES = {
    "hold-pose": (ck.hold([1.0, 2, 3], R0.as_matrix()), "pose"),
    "line-turning": (
        ck.line([0.0, 1, 2], [3.0, -1, 0], duration=4.0, rotation=R0.as_matrix(), rotation_end=R1.as_matrix()),
        "pose",
    ),
    "circle": (ck.circle([1.0, 2.0], 0.5, period=3.0, phase=0.3), "xy"),
    "circle-3d": (ck.circle([1.0, 2.0, 0], 0.5, period=-3.0, normal=[1.0, 2, -1]), "xyz"),
    "lissajous": (ck.lissajous([1, 2], [0.5, 0.25], period=3, phase=[0.1, 0]), "xy"),
    "waypoints-pose": (ck.waypoints(TIMES, POINTS, Rotation.random(5, rng=9).as_matrix()), "pose"),
    "path": (ck.path(lambda t: (jnp.cos(t), 1.0, t**2)), "xyz"),
    "path-pose": (ck.path(screw), "pose"),
}


@pytest.mark.parametrize("name", REFERENCES)
def test_velocity_is_the_derivative_of_the_path(name):
    reference, task = REFERENCES[name]
    h = 1e-5
    for t in (0.61, 1.3, 2.2, 2.91):
        _, rotation, xdot = at(reference, t, task)
        before, after = at(reference, t - h, task), at(reference, t + h, task)
        wanted = (after[0] - before[0]) / (2 * h)
        if rotation is not None:
            r = np.asarray(rotation)
            close(r @ r.T, np.eye(3), atol=1e-14)
            wanted = np.concatenate([wanted, rotvec(before[1], after[1]) / (2 * h)])
        assert len(xdot) == len(wanted)
        close(xdot, wanted, atol=2e-8)


def test_motion_bounds_what_the_target_moves():
    """From above: positions exactly, turns by their chord, π/2 too large at most."""
    t = jnp.linspace(0.0, 4.0, 9)
    for name in ("line-turning", "circle-3d", "hold-pose", "path-pose"):
        reference, task = REFERENCES[name]
        places = [at(reference, one, task) for one in t]
        wanted = []
        for one, two in itertools.pairwise(places):
            turned = 0.0 if one[1] is None else np.linalg.norm(rotvec(one[1], two[1]))
            wanted.append(np.hypot(np.linalg.norm(two[0] - one[0]), turned))
        found = np.asarray(jax.jit(functools.partial(motion, task=TASKS[task]))(reference, t=t))
        assert np.all(found >= np.array(wanted) - 1e-12) and np.all(found <= 1.571 * np.array(wanted) + 1e-12)


def wave(t):
    return [1 + 0.5 * np.sin(2 * np.pi * t + 0.1), 2 + 0.25 * np.sin(4 * np.pi * t / 3)]


CLOSED_FORMS = {
    "line": (ck.line([1, 1], [0, 1], duration=3), lambda t: [1 - min(t, 3) / 3, 1]),  # Case II of the paper
    "circle": (
        ck.circle([1.0, 2.0], 0.5, period=3.0, phase=0.3),
        lambda t: [1 + 0.5 * np.cos(2 * np.pi * t / 3 + 0.3), 2 + 0.5 * np.sin(2 * np.pi * t / 3 + 0.3)],
    ),
    "lissajous": (ck.lissajous([1, 2], [0.5, 0.25], period=3.0, frequency=[3, 2], phase=[0.1, 0]), wave),
    "its default": (ck.lissajous([0, 0], [1, 1], period=1), lambda t: np.sin(2 * np.pi * t * np.array([1, 2]))),
}


@pytest.mark.parametrize("name", CLOSED_FORMS)
def test_closed_forms(name):
    reference, formula = CLOSED_FORMS[name]
    for t in (0.0, 0.1, 0.4, 1.7, 2.0, 2.9, 3.0, 3.01, 4.0):
        close(at(reference, t, "xy")[0], formula(t), atol=1e-14)
    speeds = [np.linalg.norm(at(reference, t, "xy")[2]) for t in (0.3, 3.0, 3.01)]
    wanted = {"line": [1 / 3, 1 / 3, 0.0], "circle": [np.pi / 3] * 3}.get(name, speeds)
    close(speeds, wanted, atol=1e-14)


def test_line_turns_the_shorter_way_at_constant_angular_velocity():
    reference = ck.line(
        [0.0] * 3, [0.0] * 3, duration=2.0, rotation=R0.as_matrix(), rotation_end=R1.as_quat(scalar_first=True)
    )
    whole = rotvec(R0.as_matrix(), R1.as_matrix())
    close(at(reference, 9.0, "pose")[1], R1.as_matrix(), atol=1e-14)
    for t in (0.0, 0.7, 2.0):
        close(at(reference, t, "pose")[2][3:], whole / 2, atol=1e-14)
        half = Rotation.from_rotvec(whole * t / 2) * R0
        close(at(reference, t, "pose")[1], half.as_matrix(), atol=1e-14)


def test_circle_in_space():
    for normal in ([1.0, 2, -1], [0, 1, 0], [0, 0, -3]):
        unit = np.array(normal) / np.linalg.norm(normal)
        for t in (0.0, 0.4, 2.0):
            position, _, xdot = at(ck.circle([1.0, 2, 3], 0.5, period=3.0, normal=normal), t, "xyz")
            radius = position - np.array([1, 2, 3])
            assert np.linalg.norm(radius) == pytest.approx(0.5, rel=1e-14)
            close(xdot, 2 * np.pi / 3 * np.cross(unit, radius), atol=1e-14)  # right-handed about the normal
    # The default normal is +z, with the sense of the circle in the plane.
    flat, space = ck.circle([1.0, 2], 0.5, period=3.0), ck.circle([1.0, 2, 3], 0.5, period=3.0)
    close(at(space, 0.8, "xyz")[0][:2], at(flat, 0.8, "xy")[0], atol=1e-15)


def test_waypoints_are_the_cubic_spline():
    oracle, reference = CubicSpline(TIMES, POINTS, bc_type="clamped"), ck.waypoints(TIMES, POINTS)
    for t in np.linspace(0.0, 6.0, 25):  # held before and after
        position, _, xdot = at(reference, t, "xyz")
        close(position, oracle(np.clip(t, 0.5, 4.0)), atol=1e-13)
        close(xdot, oracle(np.clip(t, 0.5, 4.0), 1), atol=1e-12)


def test_orientations_are_the_spline_of_quaternions_in_any_frame():
    """Of quaternions of either sign; seen from another frame it is the same motion. Traced ones are the known ones."""
    turns = Rotation.random(5, rng=9)
    q = turns.as_quat(scalar_first=True)
    for k in range(1, 5):
        q[k] *= np.sign(q[k] @ q[k - 1])
    made = [ck.waypoints(TIMES, None, form) for form in (turns.as_matrix(), -q, (R3 * turns).as_matrix())]
    t = np.linspace(0.5, 4.0, 15)
    wanted = Rotation.from_quat(CubicSpline(TIMES, q, bc_type="clamped")(t), scalar_first=True)
    turned = jax.jit(lambda r: jax.vmap(lambda t: r.curve(t)[1])(t))
    found = [turned(r) for r in made]
    traced = jax.jit(lambda r: jax.vmap(lambda t: ck.waypoints(TIMES, None, r).curve(t)[1])(t))
    for rotation in (*found[:2], traced(turns.as_matrix())):
        close(rotation, wanted.as_matrix(), atol=1e-12)
    close(found[2], (R3 * wanted).as_matrix(), atol=1e-12)


def asked(fn):
    law = ck.Law(ck.planar_arm([1.0, 1.0]), ck.pose("x", "z"), alpha=1.0)
    return ck.step(law, ck.path(fn), np.ones(2), 0.0, 0.1)


test_bad_input = refusals(
    (lambda: ck.hold_at(ck.panda(), "pose", np.zeros(7)), "`task` must be a Task, but is str"),
    (lambda: ck.problem.start_from(ck.panda(), "pose"), "`task` must be a Task, but is str"),
    (lambda: ck.check_log(None, np.ones(9), Ts=0.1, limits=np.ones(2)), "`limits` must be a dict"),
    (lambda: ck.hold(None), "`target` must be a position or come with a `rotation`"),
    (lambda: ck.hold([1, 2, 3, 1, 0, 0, 0], TURN), "`rotation` must be left out where `target` is a whole pose"),
    (lambda: ck.hold([0.3] * 7), r"has one of norm 0.6 \(joint values are given by hold\(values=...\)\)\."),
    (lambda: ck.hold([1, 2, 3, 4]), r"1 to 3 coordinates \(joint values are given by hold\(values=...\)\), but has 4"),
    (lambda: ck.hold([np.nan, 0]), r"`target` must be finite, but is nan at index \(0,\)\."),
    (lambda: ck.hold([0.0, 0, 0], np.diag([1, 1, -1])), "`rotation` must hold a rotation, .* mirrored"),
    (lambda: ck.hold([0.0, 0, 0], [1, 1, 0, 0]), "`rotation` must hold a unit quaternion .* norm 1.41421"),
    (lambda: ck.line([0, 0], [1, 1], duration=0), "`duration` must be positive, but is 0"),
    (lambda: ck.line([0, 0], [1, 1, 1], duration=1), r"`end` must have the shape of `start`, but has shape \(3,\)"),
    (lambda: ck.line([0], [1], duration=1, rotation_end=TURN), "`rotation` must be given with `rotation_end`"),
    (lambda: ck.circle([0, 0], 1, period=0), "`period` must not be 0"),
    (lambda: ck.circle([0, 0], 1, period=1, normal=[0, 0, 1]), "`normal` must be left out for a circle in a plane"),
    (lambda: ck.circle([0, 0, 0], 1, period=1, normal=[0, 0, 0]), "`normal` must not be the zero vector"),
    (lambda: ck.waypoints([0], [[1, 1]]), "`times` must be two or more that increase"),
    (lambda: ck.waypoints([0, 0], [[1, 1]] * 2), r"`times` must be two or more that increase, but is \[0.0, 0.0\]"),
    (lambda: ck.waypoints([0, 1]), "`positions` must be given, or `rotations`"),
    (lambda: ck.causal(5), "`reference` must be a Reference such as"),
    (lambda: jax.jit(lambda t: ck.waypoints(t, POINTS).curve(0.0))(TIMES), "`times` must be known numbers"),
    (lambda: ck.path(3), "`fn` must be a function of time, but is 3"),
    (lambda: ck.path(lambda t: (jnp.ones(2), jnp.eye(3))).curve(0.0), "`fn` must give a position, or a pose"),
    (lambda: asked(lambda t: (np.sin(t), 1.0)), "`reference` must be of functions that JAX traces.* raises Tracer"),
    (lambda: asked(lambda t: (1.0, 1.0) if t < 1 else (2.0, 2.0)), "`reference` must be of functions that JAX traces"),
    (lambda: asked(lambda t: None), "`reference` must be of functions that JAX traces.* and give numbers"),
    (lambda: asked(lambda t: ck.Pose(position=t * np.ones(3), rotation=np.eye(4))), r"gives one of shape \(4, 4\)"),
)


@pytest.mark.parametrize("count", [2, 3, 17, 1000])
def test_an_instant_is_in_the_interval_that_numpy_says(count):
    times = np.cumsum(np.random.default_rng(count).uniform(0.1, 1.0, count))
    t = np.concatenate([times, (times[1:] + times[:-1]) / 2, [times[0] - 1, times[-1] + 1]])
    wanted = np.clip(np.searchsorted(times, t, side="right") - 1, 0, count - 2)
    assert (jax.jit(jax.vmap(functools.partial(interval, times)))(t) == wanted).all()
    names = {eqn.primitive.name for eqn in jax.make_jaxpr(functools.partial(interval, times))(0.0).eqns}
    assert not names & {"while", "scan"}  # XLA for GPUs can't compile tables that a loop reads at its result
