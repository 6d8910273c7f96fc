"""The search for one target as C: every answer is looked at by the library's own kinematics."""

import json
import shutil

import jax
import numpy as np
import pytest

import cnclik as ck
from cnclik.cli import main
from cnclik.reaching import strategy
from cnclik.reaching.native import SEARCH
from tests.export.combinations import arm
from tests.robot.test_trees import BAXTER, GRIPPERS

pytestmark = pytest.mark.skipif(not shutil.which("gcc"), reason="no gcc")
ROBOTS = {"panda": ck.panda, "ur5": ck.ur5}


@pytest.fixture(scope="module", params=ROBOTS)
def robot(request):
    chain = ROBOTS[request.param]()
    return chain, ck.export.compiled(chain, what="reach")


def drawn(chain, count, seed=0):
    """Joint values within the limits, and where they lead."""
    low, high = np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi)
    q = np.random.default_rng(seed).uniform(low, high, (count, chain.n))
    return q, *places(chain, q)


def places(chain, q):
    at = jax.vmap(lambda q: ck.forward(chain, q))(np.asarray(q, float))
    return np.asarray(at.position), np.asarray(at.rotation)


def off(a, b):
    """Angles [rad] between rotations (..., 3, 3)."""
    return 2 * np.arcsin(np.minimum(np.linalg.norm(a - b, axis=(-2, -1)) / 2**1.5, 1))


def test_it_solves_what_can_be_reached_within_the_limits(robot):
    chain, reach = robot
    position, rotation = drawn(chain, 500)[1:]
    start = np.zeros(chain.n)
    made = [reach(start, p, r) for p, r in zip(position, rotation, strict=True)]
    solved = np.array([m.status == ck.ReachStatus.SOLVED for m in made])
    assert solved.mean() >= 0.998
    q = np.stack([m.q for m in made])[solved]
    there = places(chain, q)
    assert np.linalg.norm(there[0] - position[solved], axis=1).max() <= 1e-6
    assert off(there[1], rotation[solved]).max() <= 1e-6
    assert (q >= np.array(chain.lower)).all() and (q <= np.array(chain.upper)).all()
    assert np.median([m.evaluations for m in made]) < 40


def test_from_next_to_the_target_it_takes_a_few_looks_and_stays_there(robot):
    chain, reach = robot
    q, position, rotation = drawn(chain, 100, seed=1)
    near = np.clip(q + np.random.default_rng(2).uniform(-0.01, 0.01, q.shape), chain.lower, chain.upper)
    made = [reach(*row) for row in zip(near, position, rotation, strict=True)]
    assert all(m.status == ck.ReachStatus.SOLVED for m in made)
    assert np.median([m.evaluations for m in made]) <= 4
    assert np.median([np.abs(m.q - n).max() for m, n in zip(made, near, strict=True)]) < 0.03


def test_too_far_is_said_with_the_nearest_pose(robot):
    chain, reach = robot
    target = np.array([2.0, 1.0, 0.5]), np.eye(3)
    made = reach(np.zeros(chain.n), *target)
    wanted = ck.reach(chain, np.block([[np.eye(3), target[0][:, None]], [np.zeros((1, 3)), np.ones((1, 1))]]))
    assert made.status == wanted.status == ck.ReachStatus.OUT_OF_REACH
    assert made.position_error <= 1.01 * wanted.position_error + 0.1 * wanted.orientation_error
    at = places(chain, made.q[None])
    assert np.isclose(np.linalg.norm(at[0][0] - target[0]), made.position_error)
    assert np.isclose(off(at[1][0], target[1]), made.orientation_error)
    many = reach.parameters["tries"]
    reach.set(tries=1)
    few = reach(np.zeros(chain.n), *target)
    reach.set(tries=0)  # the first is tried in any case
    assert (reach(np.zeros(chain.n), *target).q == few.q).all()
    reach.set(tries=many)
    assert few.evaluations < made.evaluations and few.position_error >= made.position_error - 1e-3


def test_several_tips(tmp_path):
    """Both hands at once, one of them as it sees its target itself; the stack's posture has no part in it."""
    robot, (left, right) = ck.load_urdf(BAXTER, tips=GRIPPERS), GRIPPERS
    hands = ck.pose(tip=left) & ck.position("xy", tip=right, frame="tip")
    law = ck.Law(robot, ck.stack(hands=hands, rest=ck.joints()), alpha=1.0, inverse=ck.damped(0.1))
    reach = ck.export.compiled(law, what="reach")
    low, high = np.array(robot.lower), np.array(robot.upper)
    for q in np.random.default_rng(6).uniform(low, high, (40, robot.n)):
        at, other = (ck.forward(robot, q, tip=tip) for tip in GRIPPERS)
        given = {"position": at.position, "rotation": at.rotation}
        given = {f"hands_{left}_{name}": np.asarray(v) for name, v in given.items()}
        made = reach(np.zeros(robot.n), **given, **{f"hands_{right}_position": np.asarray(other.position)})
        assert made.status == ck.ReachStatus.SOLVED and (made.q >= low).all() and (made.q <= high).all()
        there, see = (ck.forward(robot, made.q, tip=tip) for tip in GRIPPERS)
        away = (np.asarray(other.position) - np.asarray(see.position)) @ np.asarray(see.rotation)
        assert np.linalg.norm(there.position - at.position) < 2e-6 and np.linalg.norm(away[:2]) < 2e-6
    given[f"hands_{left}_position"] = np.array([9.0, 0.0, 0.0])
    assert reach(q, **given, **{f"hands_{right}_position": np.zeros(3)}).status == ck.ReachStatus.OUT_OF_REACH


def test_what_is_not_known_is_not_claimed():
    """A target within the arm's length that the limits forbid: the C tries too little to tell."""
    chain = ck.replace(ck.ur5(), lower=(-0.3,) * 6, upper=(0.3,) * 6)
    made = ck.export.compiled(chain, what="reach", seeds=4)(np.zeros(6), [0.1, 0.1, 0.4], np.eye(3))
    assert made.status == ck.ReachStatus.OUT_OF_BUDGET and np.isfinite(made.q).all() and made.position_error > 0.01


@pytest.mark.parametrize("size", [1e-4, 1e6])
def test_arms_of_any_size(size):
    """With a joint that slides: lengths come and go in metres."""
    a, d = np.array([[0.0, 0.4, 0.3, 0.0], [0.0, 0.1, 0.0, 0.2]]) * size
    bounds = {"lower": [-0.5 * size, -3.0, -3.0, -3.0], "upper": [0.5 * size, 3.0, 3.0, 3.0]}
    chain = ck.from_dh(a.tolist(), [0.3, np.pi / 2, -np.pi / 2, 0.0], d.tolist(), kinds="PRRR", **bounds)
    reach = ck.export.compiled(ck.Law(chain, ck.position(), alpha=1.0), what="reach")
    q = np.random.default_rng(5).uniform(chain.lower, chain.upper, (100, 4))
    wanted = places(chain, q)[0]
    made = [reach(near, p) for near, p in zip(q[::-1], wanted, strict=True)]
    assert np.mean([m.status == ck.ReachStatus.SOLVED for m in made]) >= 0.98
    away = np.linalg.norm(places(chain, np.stack([m.q for m in made]))[0] - wanted, axis=1)
    np.testing.assert_allclose(away, [m.position_error for m in made], rtol=1e-3, atol=1e-13 * size)
    assert np.median(away) <= 1e-6


def test_what_is_not_finite_is_told(robot):
    chain, reach = robot
    q, (position,), (rotation,) = drawn(chain, 1)
    right = q[0], position, rotation
    for place, bad in enumerate((np.nan, np.inf, np.nan)):
        made = reach(*(v * bad if i == place else v for i, v in enumerate(right)))
        assert made.status == ck.ReachStatus.NON_FINITE and np.isnan(made.q).all() and made.evaluations == 0
    assert reach(*right).status == ck.ReachStatus.SOLVED


def test_a_joint_without_limits_answers_within_half_a_turn_of_where_it_is():
    chain = ck.planar_arm([1.0, 0.7])
    reach = ck.export.compiled(ck.Law(chain, ck.position("xy"), alpha=1.0), what="reach")
    for start in ([14.0, 1.0], [-8.0, 20.0]):
        made = reach(start, [0.9, 0.8])
        assert made.status == ck.ReachStatus.SOLVED and np.abs(made.q - start).max() <= np.pi
        assert np.allclose(np.asarray(ck.forward(chain, made.q).position)[:2], [0.9, 0.8], atol=1e-6)
        assert made.orientation_error == 0


@pytest.mark.parametrize("task", ["xyz", "orientation", "pose"])
def test_tasks_in_single_precision(task):
    chain = ck.panda()
    law = ck.Law(chain, {"xyz": ck.position(), "orientation": ck.orientation(), "pose": ck.pose()}[task], alpha=1.0)
    reach = ck.export.compiled(law, what="reach", dtype="float32")
    made = []
    for p, r in zip(*drawn(chain, 100, seed=3)[1:], strict=True):
        made.append(reach(np.zeros(7), *([p] if task != "orientation" else []), *([r] if task != "xyz" else [])))
    assert np.mean([m.status == ck.ReachStatus.SOLVED for m in made]) >= 0.97
    there = places(chain, np.stack([m.q for m in made]))
    position, rotation = drawn(chain, 100, seed=3)[1:]
    solved = np.array([m.status == ck.ReachStatus.SOLVED for m in made])
    if task != "orientation":
        assert np.linalg.norm(there[0] - position, axis=1)[solved].max() < 2e-5
    if task != "xyz":
        assert off(there[1], rotation)[solved].max() < 2e-5


def test_what_is_shipped_is_the_search_of_the_library(tmp_path):
    """Line by line, with its numbers."""
    text = (ck.export.c(ck.panda(), out=tmp_path / "made", what="reach", name="arm") / "clik_arm.c").read_text()
    assert SEARCH in text and all(f"#define {n} {getattr(strategy, n)}\n" in text for n in strategy.NUMBERS)


def test_seeds_are_counted_and_options_checked(tmp_path):
    chain = arm(3)
    law = ck.Law(chain, ck.position("xy"), alpha=1.0)
    assert ck.export.compiled(law, what="reach", seeds=3).parameters["tries"] == 4
    for wrong in (dict(seeds=0), dict(seeds=5000), dict(seeds=2.5), dict(runtime=()), dict(batch=True)):
        with pytest.raises(ck.ArgumentError, match=next(iter(wrong))):
            ck.export.c(law, out=tmp_path / "never", what="reach", **wrong)
    assert not (tmp_path / "never").exists()


def test_from_the_command_line(tmp_path, capsys):
    main(["export", "ur5", "--what", "reach", "--seeds", "8", "--out", str(tmp_path / "made")])
    assert "ur5, tip tool flange, task x y z rx ry rz: reach in double" in capsys.readouterr().out
    assert json.loads((tmp_path / "made" / "export.json").read_text())["what"] == "reach"
    chain = ck.ur5()
    q, (position,), (rotation,) = drawn(chain, 1)
    made = ck.export.load(tmp_path / "made", tolerance=[1e-9, 1e-9])(q[0] + 0.1, position, rotation)
    assert made.status == ck.ReachStatus.SOLVED and made.position_error <= 1e-9
