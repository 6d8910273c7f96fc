"""A stack as C: targets by the names of tasks and tips; it computes what the loop does."""

import subprocess

import numpy as np
import pytest

import cnclik as ck
from cnclik.export.example import BUILD
from cnclik.export.fields import parameters
from cnclik.export.trace import Request
from cnclik.export.write import configuration
from tests.engine.compare import NEEDS_C
from tests.oracles import close
from tests.robot.test_trees import BAXTER, GRIPPERS
from tests.task.test_stack_loops import ROBOT, TIPS, Q

LEFT, RIGHT = TIPS
TASK = ck.stack(
    hands=ck.pose("xy", "z", tip=LEFT) & ck.position("xy", tip=RIGHT),
    apart=ck.position("xy", tip=LEFT, relative_to=RIGHT),
    rest=ck.joints(),
)
INVERSE = ck.levels(["hands"], ["apart", "rest"], damping=(0.01, 0.1))
LAW = ck.Law(ROBOT, TASK, alpha={"hands": 10.0, "apart": 3.0, "rest": 1.0}, inverse=INVERSE)


def given(held):
    """The arguments of a held reference."""
    left, right = (held["hands"][tip].curve for tip in TIPS)
    of_hands = {f"hands_{LEFT}_position": left.position, f"hands_{LEFT}_rotation": left.rotation}
    of_hands |= {f"hands_{RIGHT}_position": right.position}
    return of_hands | {"apart_position": held["apart"].curve.position, "rest_values": held["rest"].curve.position}


@NEEDS_C
@pytest.mark.parametrize("method", ["EE", pytest.param("AB2", marks=pytest.mark.slow)])
def test_a_step_is_the_loops(method):
    step, past, made, q = ck.export.compiled(LAW, method=method), None, None, Q + 0.1
    held = ck.hold_at(ROBOT, TASK, Q)
    for _ in range(3):
        native = step(q, Ts=0.01, history=past, **given(held))
        made = ck.step(LAW, held, q, 0.0, 0.01, method, history=None if made is None else made.history)
        close(native.qdot, made.qdot, atol=1e-9)
        close(native.e, made.e, atol=1e-12)
        assert native.status == made.status
        past, q = (native.history if method == "AB2" else None), np.asarray(made.q)


@NEEDS_C
def test_a_whole_run_has_its_tasks_and_the_vectors_agree(tmp_path):
    paths = ck.hold_at(ROBOT, TASK, Q, apart=ck.circle([0.2, 0.4], 0.05, period=1.0))
    folder = ck.export.c(LAW, paths, out=tmp_path / "made", what="solve", method="EE")
    made, wanted = ck.export.load(folder)(Q, Ts=0.01, N=20), ck.solve(LAW, paths, Q, 0.01, 20, "EE")
    close(made.q, wanted.q, atol=1e-9)
    close(made["apart"].e, wanted["apart"].e, atol=1e-9)
    done = subprocess.run(BUILD.format(sources="clik_step.c example.c") + " && ./example", shell=True, cwd=folder)
    assert done.returncode == 0


def test_the_header_says_in_whose_frame_a_relative_target_is(tmp_path):
    tasks = ck.stack(apart=ck.position("xy", tip=LEFT, relative_to=RIGHT), hand=ck.position("xy", tip=RIGHT))
    law = ck.Law(ROBOT, tasks, alpha=5.0, inverse=ck.damped(0.1))
    header = (ck.export.c(law, out=tmp_path / "made", method="EE") / "clik_step.h").read_text()
    assert f"/* desired position of apart in the frame of {RIGHT} [m] */" in header
    assert "/* desired position of hand [m] */" in header


@NEEDS_C
def test_many_loops_side_by_side():
    step = ck.export.compiled(LAW, method="EE", batch=True)
    q, held = Q + 0.05 * np.random.default_rng(0).normal(size=(5, ROBOT.n)), ck.hold_at(ROBOT, TASK, Q)
    made = step.batch(q, Ts=0.01, N=4, t=0.0, **given(held))
    close(made["q"], [ck.solve(LAW, held, one, 0.01, 4, "EE").q[-1] for one in q], atol=1e-9)


@NEEDS_C
def test_names_are_words_of_c():
    task = ck.stack(**{"left-hand": ck.position(tip=LEFT), "left_hand": ck.position(tip=RIGHT), "2": ck.joints(["a"])})
    step = ck.export.compiled(ck.Law(ROBOT, task, alpha=1.0, inverse=ck.damped(0.1)), method="EE")
    names = [row["name"] for row in step.manifest["inputs"]["input"]]
    assert names[1:7:2] == ["left_hand_position", "left_hand_1_position", "task_2_values"]


def test_walls_and_balance_are_described():
    """Each parameter has a meaning, and the configuration is whole: a mark that is no ASCII became a "?"."""
    robot, (left, right) = ck.load_urdf(BAXTER, tips=GRIPPERS), GRIPPERS
    pair = ck.distance(ck.sphere(left, 0.05), ck.capsule(right, 0.05, (0, 0, 0), (0, 0, 0.1)))
    walls = [ck.wall(pair, above=0.02, rate=5.0), ck.wall(ck.position("z", tip=left), above=0.1)]
    tasks = ck.stack(hands=ck.pose(tip=left) & ck.pose(tip=right), stand=ck.center_of_mass("xy"))
    levels = ck.levels(["hands"], ["stand"], damping=(0.01, 0.1))
    law = ck.Law(robot, tasks, alpha=5.0, inverse=levels, limits=ck.bounded(walls=walls))
    found = parameters(law, None)[0]
    assert [field.name for field in found if not field.about] == []
    shapes = [f"wall_1_{which}_{what}" for which in ("one", "other") for what in ("ends", "radius")]
    own = {field.name for field in found if field.name.startswith("wall_")}
    assert own == {*shapes, "wall_1_normal", "wall_1_offset", "wall_1_rate", "wall_2_normal", "wall_2_offset"}
    named = ck.bounded(walls=[ck.wall(pair, above=0.02, name="left arm")])
    found = parameters(ck.replace(law, limits=named), None)[0]
    assert {"wall_left_arm_one_ends", "wall_left_arm_other_radius", "wall_left_arm_offset"} <= {f.name for f in found}
    request = Request(law, None, ck.EE, ck.picard(5), np.dtype(float), "step", None)
    assert "?" not in "".join(configuration(request)) and "..." in "".join(configuration(request))
