"""Stacks in plain names: what the tables of a file build, from the same words as one task, and what is refused."""

import dataclasses
import functools
import re

import jax
import numpy as np
import pytest

import cnclik as ck
from cnclik.errors import Remark
from cnclik.law.reference import aims_of
from cnclik.problem import OF_TASK
from cnclik.problem.names import near_singular_start
from cnclik.robot.posture import spread_postures
from cnclik.robot.tree import read_urdf
from tests.oracles import close, robots
from tests.robot.test_trees import ARMS, BAXTER, G1, GRIPPERS, ROBOTS

FILE = """
[tasks.hands]
task = "pose"
tip = ["left_gripper", "right_gripper"]
alpha = 10
weights = [1, 1, 1, 0.3, 0.3, 0.3]
damping = 1e-3
level = 1
reference = "circle"
radius = "50mm"
period = "4 s"

[tasks.rest]
task = "joints"
alpha = [1.0]
level = 2
damping = 0.1
"""
ROBOT = ck.load_urdf(BAXTER, tips=GRIPPERS)


def made(tables, robot=ROBOT, **options):
    return ck.problem_from(robot, tasks=tables, **({"N": 5} | options))


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    file = tmp_path_factory.mktemp("stack") / "stack.toml"
    file.write_text(FILE)
    return ck.problem_from(BAXTER, stack=file, N=400)


def test_a_file_is_the_law_by_hand(problem):
    """The same joint values, to the bit, as of records that are made one by one."""
    task = ck.stack(
        hands=ck.pose(tip=GRIPPERS[0], weights=[1, 1, 1, 0.3, 0.3, 0.3])
        & ck.pose(tip=GRIPPERS[1], weights=[1, 1, 1, 0.3, 0.3, 0.3]),
        rest=ck.joints(ROBOT.joint_names),
    )
    inverse = ck.levels(["hands"], ["rest"], damping=(1e-3, 0.1))
    law = ck.Law(ROBOT, task, alpha={"hands": 10.0, "rest": 1.0}, inverse=inverse)
    q0 = np.asarray(problem.q0)

    def circle(tip):
        at = ck.forward(ROBOT, q0, tip=tip)
        center = np.asarray(at.position, float) - [0.05, 0, 0]
        return ck.circle(center, 0.05, period=4.0, rotation=np.asarray(at.rotation, float))

    aims = ck.references(hands=ck.references(**{tip: circle(tip) for tip in GRIPPERS}), rest=ck.hold(values=q0))
    run, hand = problem.run(), ck.solve(law, aims, q0, 0.01, 400, problem.method, problem.stage)
    close(run.q, hand.q, atol=1e-6)
    assert problem.tip == "left_gripper, right_gripper" and problem.tables["hands"]["radius"] == 0.05
    assert np.abs(run["hands"].e).max() < 1e-3 < np.abs(run["rest"].e).max()


def test_q0_is_well_away_from_singularities_of_every_tip(problem):
    for tip in GRIPPERS:
        assert ck.manipulability(ROBOT, problem.q0, ck.pose(), tip=tip) > 0.01


def test_what_is_left_out():
    """A task without path stays where q0 has it, a gain is that of all, and a task is a pose where there are joints."""
    p = made({"hand": {"tip": GRIPPERS[0]}, "rest": {"joints": ["left_s0", "left_s1"]}}, alpha=3.0, damping=0.05)
    assert p.law.task.names == (
        *(f"hand.{c}" for c in ("x", "y", "z", "rx", "ry", "rz")),
        "rest.left_s0",
        "rest.left_s1",
    )
    assert float(p.law.alpha) == 3.0 and float(p.law.inverse.damping) == 0.05
    close(p.run().e, 0, atol=1e-6)
    finger = {"tip": "link_3.0_tip"}
    from tests.robot.test_trees import ROBOTS, ROOT

    assert made({"finger": finger}, robot=ROOT / ROBOTS["allegro"]).law.task.names == (
        "finger.x",
        "finger.y",
        "finger.z",
    )


def test_one_tip_needs_no_name():
    p = made({"place": {"task": "position"}, "rest": {"task": "joints", "target": "0 -45 0 -90 0 90 45 deg"}}, "panda",
             damping=0.1)  # fmt: skip
    close(aims_of(p.reference, p.law.task, 0.0)[1], np.deg2rad([0, -45, 0, -90, 0, 90, 45]), atol=1e-12)
    with pytest.raises(ck.ArgumentError, match=r"`tasks.place.tip` must be given for .*; the tips are "):
        made({"place": {"task": "position"}}, BAXTER)


def test_a_stack_that_names_no_tip_moves_all_joints():
    """A posture and a balance alone: which tips the robot has decides only which joints it has."""
    p = made({"rest": {"task": "joints"}, "stand": {"task": "center_of_mass", "axes": "xy"}}, BAXTER, damping=0.1)
    assert p.law.chain.n == ck.load_urdf(BAXTER, tips=list(read_urdf(BAXTER).tips())).n > 14


def test_the_target_of_one_joint_is_a_number():
    p = made({"bend": {"joints": ["left_s0"], "target": "30 deg"}})
    close(p.reference["bend"].curve(0.0)[0], [np.pi / 6], atol=1e-12)


@pytest.mark.slow
def test_one_tip_as_seen_from_another():
    p = made({"apart": {"task": "pose", "tip": GRIPPERS[0], "relative_to": GRIPPERS[1], "reference": "line"}}, N=20)
    left, right = (ck.forward(ROBOT, p.q0, tip=tip) for tip in GRIPPERS)
    where = np.asarray(right.rotation).T @ (np.asarray(left.position) - np.asarray(right.position))
    close(p.reference["apart"].curve(0.0)[0], where, atol=1e-6)
    assert np.abs(p.run().e[0]).max() < 1e-6


def test_a_path_in_a_file_lies_beside_the_stack(tmp_path):
    (tmp_path / "way.csv").write_text("time,x,y,z\n0,0.7,0.3,0.2\n1,0.7,0.4,0.2\n")
    (tmp_path / "stack.toml").write_text('[tasks.a]\ntask = "position"\ntip = "left_gripper"\nreference = "way.csv"\n')
    p = ck.problem_from(BAXTER, stack=tmp_path / "stack.toml", N=5)
    close(p.reference["a"].curve(1.0)[0], [0.7, 0.4, 0.2], atol=1e-6)


def test_a_level_has_one_damping_and_tasks_without_levels_have_their_own():
    one, two, three = ({"tip": GRIPPERS[0], "task": task} for task in ("position", "rx", "ry"))
    p = made({"b": two | {"level": 2}, "a": one | {"level": 1, "damping": 0.01},
              "c": three | {"level": 2, "damping": 0.1}})  # fmt: skip
    assert p.law.inverse.names == (("a",), ("b", "c"))
    singular = {"inverse": "singular-damped", "damping": 0.1, "threshold": 0.2}
    p = made({"b": two, "a": one | singular}, damping=0.05)  # no damping away from singularities is the least
    assert p.law.inverse.names == (("a",), ("b",))
    assert [type(one).__name__ for one in p.law.inverse.damping] == ["SingularDamped", "Damped"]
    p = made({"b": two | {"damping": 0.2}, "a": one}, damping=0.05)
    assert p.law.inverse.names == (("a",), ("b",))  # by what makes one come first
    assert [float(one.damping) for one in p.law.inverse.damping] == [0.05, 0.2]


@pytest.mark.slow
def test_gradients_go_through_gains_and_dampings():
    @jax.jit
    def last(values):
        alpha, damping = values
        tables = {"a": {"task": "position", "tip": GRIPPERS[0], "alpha": alpha, "target": [0.7, 0.3, 0.2]},
                  "r": {"task": "joints", "damping": damping}}  # fmt: skip
        e = made(tables, damping=1e-2, method="EE").run()["a"].e[-1]
        return e @ e

    at = np.array([5.0, 0.3])
    with jax.enable_x64(True):
        found, h = jax.grad(last)(jax.numpy.asarray(at)), 1e-4 * np.eye(2)
        wanted = [(last(at + d) - last(at - d)) / 2e-4 for d in h]
    close(found, wanted, rtol=1e-4)


HAND, REST = {"task": "position", "tip": GRIPPERS[0]}, {"task": "joints"}


@pytest.mark.parametrize(
    ("tables", "options", "told"),
    [
        ({"hands": HAND | {"alhpa": 1}}, {}, r"`tasks.hands` must .* but holds 'alhpa' \(did you mean 'alpha'"),
        ({"hands": HAND | {"alpha": -1}}, {}, "`tasks.hands.alpha` must be at least 0, but is -1"),
        ({"hands": HAND | {"alpha": [1, 2]}}, {}, r"`tasks.hands.alpha` must have shape \(\) or \(3,\)"),
        ({"hands": HAND | {"radius": "5kg", "reference": "circle"}}, {}, "`tasks.hands.radius` must be a number"),
        ({"hands": HAND | {"radius": 0.1}}, {}, "`tasks.hands.radius` must be left out for the reference 'hold'"),
        ({"hands": HAND | {"reference": "cirle"}}, {}, r"`tasks.hands.reference` .*you mean 'circle'"),
        ({"hands": HAND | {"task": "poses"}}, {}, "`tasks.hands.task` must be pose, position, orientation, joints, c"),
        ({"hands": HAND | {"tip": "left_griper"}}, {}, r"`tasks.hands.tip` .*did you mean 'left_gripper'"),
        ({"hands": HAND | {"tip": [GRIPPERS[0]] * 2}}, {}, "`tasks.hands.tip` must hold different names"),
        ({"hands": HAND | {"tip": 1}}, {}, "`tasks.hands.tip` must be a name or a list of names, but is 1"),
        ({"hands": HAND | {"relative_to": "nose"}}, {}, "`tasks.hands.relative_to` must be one of the"),
        ({"hands": HAND | {"weights": [1, 2]}}, {}, r"`tasks.hands.weights` must have shape \(\) or \(3,\)"),
        ({"hands": HAND | {"weights": [1, 2, -1]}}, {}, "`tasks.hands.weights` must be positive"),
        ({"hands": HAND | {"damping": "5"}}, {}, "`tasks.hands.damping` must be a number, or a text"),
        ({"hands": HAND, "rest": REST | {"tip": "a"}}, {}, "`tasks.rest.tip` must be left out for the task 'joints'"),
        ({"hands": HAND | {"joints": ["left_s0"]}}, {}, "`tasks.hands.joints` must be left out for the task 'posi"),
        ({"rest": REST | {"joints": ["left_s"]}}, {}, r"`tasks.rest.joints` must be one of .* but is 'left_s' "),
        ({"rest": REST | {"target": [1.0]}}, {}, r"`tasks.rest.target` must have shape"),
        ({"rest": REST | {"target": "1 m", "joints": ["left_s0"]}}, {}, "`tasks.rest.target` .*is in rad, and m is"),
        ({"rest": REST | {"reference": "circle"}}, {}, "`tasks.rest.reference` must be one of hold, but is 'circle'"),
        ({"hands": HAND, "rest": REST}, {}, "`damping` must be given for 17 coordinates of tasks and 14 joints"),
        ({"hands": HAND | {"level": 1}, "rest": REST}, {}, "`tasks.rest.level` must be given where others"),
        ({"hands": HAND | {"level": 1}}, {}, "`tasks.hands.damping` must be given, for its level or for all tasks"),
        (
            {"hands": HAND | {"level": 1}},
            {"inverse": "pseudoinverse", "damping": 0.1},
            "`inverse` must be one of damped, .* for a stack whose tasks have levels or dampings, but is 'pseudoinv",
        ),
        ({"hands": HAND | {"damping": 0.1}}, {"inverse": "pseudoinverse"}, "`inverse` must be one of damped"),
        ({"hands": HAND | {"level": 0, "damping": 1}}, {}, "`tasks.hands.level` must be at least 1"),
        (
            {"hands": HAND | {"level": 1, "damping": 0.1}, "rest": REST | {"level": 2, "damping": 0.05}},
            {},
            "`tasks.rest.damping` must be larger than that of the level before, 0.1",
        ),
        (
            {
                "hands": HAND | {"level": 1, "damping": 0.01},
                "rest": REST | {"level": 2, "damping": 0.1, "inverse": "singular-damped", "threshold": 0.2},
            },
            {},
            "`tasks.rest.damping` must be larger than that of the level before, 0.01, .* is 0 away from singularities",
        ),
        (
            {"hands": HAND | {"level": 1, "damping": 0.1}, "rest": REST | {"level": 1, "damping": 0.05}},
            {},
            "`tasks.rest.damping` must be that of its level, 0.1, but is 0.05",
        ),
        ({"hands": HAND | {"inverse": "pseudoinverse"}}, {"damping": 0.1}, "`tasks.hands.inverse` must be one of damp"),
        ({"hands": HAND | {"relative_to": "base"}}, {}, r"`tasks.hands.relative_to` must be moved by .*\(leave it out"),
        ({"a b": HAND}, {}, "`tasks` must have names of letters, digits and _, but has 'a b'"),
        ({"hands": 1}, {}, "`tasks.hands` must be a table of options, but is 1"),
        ({}, {}, r"`tasks` must be tables of tasks, \[tasks.NAME\], but are none"),
        ({"hands": HAND}, {"task": "pose"}, "`task` must be left out with a stack: its tasks have their own"),
        ({"hands": HAND}, {"reference": "circle"}, "`reference` must be left out with a stack"),
        ({"hands": HAND}, {"end": [1, 2, 3]}, "`to` must be left out with a stack"),
        ({"hands": HAND}, {"target": np.ones(3)}, "`target` must be left out with a stack"),
        ({"hands": HAND | {"damping": {"a": 1.0}}}, {}, "`tasks.hands.damping` must be a number"),
        ({"hands": HAND}, {"posture": [0] * 14}, "`posture` must be left out .*: a posture is one of its"),
        ({"hands": HAND | {"alpha": 1}}, {"alpha": (3.0,)}, "`alpha` must be left out where every task has its own"),
        ({"hands": HAND | {"damping": 1}}, {"damping": 0.1}, "`damping` must be left out where every task has its own"),
        ({"hands": HAND | {"frame": "tip"}}, {}, "`tasks.hands` must hold known options, but holds 'frame'"),
        ({"hands": HAND}, {"stack": "a.toml"}, "`tasks` must be left out where `stack` is given"),
    ],
)  # fmt: skip
def test_what_is_refused(tables, options, told):
    with pytest.raises(ck.ArgumentError, match=told):
        made(tables, BAXTER if "`tasks.hands.tip`" in told or "relative_to" in told else ROBOT, **options)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[task.hands]", r"`stack` must hold known keys, but holds 'task' \(did you mean 'tasks'"),
        ("Ts = 1", r"holds 'Ts': a stack has \[tasks.NAME\] and \[walls.NAME\] tables alone"),
        ("[tasks", "`stack` must be a TOML file"),
        ("", r"`tasks` must be tables of tasks, \[tasks.NAME\], but are none"),
    ],
)
def test_a_file_that_is_none(tmp_path, text, told):
    (tmp_path / "stack.toml").write_text(text)
    with pytest.raises(ck.ArgumentError, match=told):
        ck.problem_from(BAXTER, stack=tmp_path / "stack.toml")


def test_millimetres_are_remarked_on():
    with pytest.warns(Remark, match=r'`tasks.a.radius` has 80 m, .*with their unit: radius = "80 mm"'):
        made({"a": HAND | {"tip": GRIPPERS, "reference": "circle", "radius": 80.0, "damping": 0.1}})


# --- what became of it --------------------------------------------------------------------------------


def judged(p):
    return ck.verdict(p.law, p.reference, p.run(), Ts=p.Ts, method=p.method, stage=p.stage)


def test_a_verdict_has_a_line_for_each_task(problem):
    told = judged(problem)
    assert told.kind == "following" and set(told.tasks) == {"hands", "rest"}
    assert re.search(r"; hands .* .rad .following.; rest .* .rad .following.", told.sentence), told


@pytest.mark.slow
def test_a_verdict_of_a_stack_that_settles_and_of_one_that_swings():
    tables = {
        "hands": HAND | {"target": "700 300 200 mm", "alpha": 20.0, "damping": 0.01},
        "rest": REST | {"damping": 0.5},
    }
    q0 = 0.3 + np.zeros(14)
    fine = judged(made(tables, N=600, q0=q0, alpha=1e-3))
    assert re.search(r"hands [\w. ]+ \(settled\)", fine.sentence), fine
    tables["hands"]["alpha"] = 250.0
    swinging = judged(made(tables, N=600, q0=q0, method="EE"))
    assert swinging.kind in ("swinging", "growing") and "Give hands an alpha of at most 25 1/s" in swinging.sentence


@pytest.mark.slow
def test_a_target_that_no_posture_has_is_out_of_reach():
    tables = {"hands": HAND | {"target": [5.0, 0, 0], "damping": 0.3}, "rest": REST | {"damping": 0.6}}
    told = judged(made(tables, N=300))
    assert told.kind == "held back" and np.isfinite(told.error)
    assert re.search(r"out of reach: the nearest posture found is 3\.\d+ m away", told.sentence), told


def fork(targets, q0, **options):
    """A torso of one link with an arm of one link on each side, and what becomes of a loop to these places."""
    robot = ck.planar_arm([1.0])
    for side in ("left", "right"):
        robot = ck.join(robot, ck.planar_arm([1.0]), at="tip", prefix=f"{side}_", keep=True)
    task = ck.stack(**{side: ck.position("xy", tip=f"{side}_tip") for side in targets}, rest=ck.joints())
    law = ck.Law(robot, task, alpha=5.0, inverse=ck.levels(list(targets), ["rest"], damping=(0.05, 0.5)), **options)
    paths = ck.hold_at(robot, task, q0, **{side: ck.hold(place) for side, place in targets.items()})
    return ck.verdict(law, paths, ck.solve(law, paths, np.array(q0), 0.02, 400), Ts=0.02)


@pytest.mark.slow
def test_targets_that_only_each_alone_has_are_out_of_reach_together():
    told = fork({"left": [-1.8, 0.0], "right": [1.8, 0.0]}, [0.1, 0.3, -0.3])
    assert told.kind == "held back" and "out of reach: the nearest posture found is 1.06 m away" in told.sentence, told


@pytest.mark.slow
def test_targets_that_a_posture_has_are_not_called_out_of_reach():
    """Straight arms that point away from their targets: no first step leads there."""
    told = fork({"left": [0.0, 1.2]}, [0.0, 0.0, 0.3])
    assert told.kind == "held back" and "out of reach" not in told.sentence, told


@pytest.mark.slow
def test_a_humanoid_in_c(monkeypatch):
    """47 coordinates on 29 joints: so long that its program is written in pieces."""
    feet = [f"{side}_ankle_roll_link" for side in ("left", "right")]
    tables = {"feet": {"tip": feet, "damping": 1e-3}, "hands": {"tip": ARMS, "task": "position", "damping": 0.05},
              "rest": REST | {"damping": 0.5}}  # fmt: skip
    p = made(tables, G1, N=3, method="EE")
    assert (p.law.task.m, p.law.chain.n) == (47, 29)
    with ck.use_engine("plain"):
        plain = dataclasses.replace(p).run()
    close(p.run().q, plain.q, atol=1e-6)


def test_every_option_of_a_task_says_what_it_is():
    assert all(one.help.endswith(".") for one in OF_TASK.values())


def test_the_default_start_is_far_from_singularities_of_all_tips_together(monkeypatch):
    """Each arm alone is well there in the middle of the limits: its task is the torso's, which both share."""
    tips = {"l": "arm1_8", "r": "arm2_8"}
    arms = ck.load_urdf(robots() / ROBOTS["centauro"], tips=list(tips.values()))
    tables = {name: {"tip": tip, "task": "position"} for name, tip in tips.items()}
    p = made(tables, arms)
    task, middle = p.law.task, spread_postures(arms)[0]
    at = functools.partial(near_singular_start, arms, task, below=0.1)
    assert "of l and r together (least singular value 0.0062)" in at(middle) and "--q0" in at(middle)
    np.testing.assert_array_equal(p.q0, made(tables, arms).q0)
    monkeypatch.setattr("cnclik.problem.names.spread_postures", None)  # other postures are looked at where one is near
    assert not at(p.q0)


def test_walls_beside_a_file_are_refused_whatever_they_are(tmp_path):
    (tmp_path / "stack.toml").write_text('[tasks.tip]\ntip = "flange"\n')
    for walls in (True, {"floor": {"above": 0.1}}):
        with pytest.raises(ck.ArgumentError, match="`walls` must come with `tasks`, or stand in the file of `stack`"):
            ck.problem_from("panda", stack=str(tmp_path / "stack.toml"), walls=walls)
