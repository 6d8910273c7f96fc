"""A stack as C: targets by the names of tasks and tips; it computes what the loop does."""

import subprocess

import numpy as np

import cnclik as ck
from cnclik.export.example import BUILD
from cnclik.export.fields import parameters
from cnclik.export.trace import Request
from cnclik.export.write import configuration
from tests import bank
from tests.engine.compare import NEEDS_C
from tests.export.native import native
from tests.oracles import close
from tests.robot.test_trees import BAXTER, GRIPPERS

ROBOT, Q = bank.robot("two arms"), np.array([0.2, -0.4, 0.7, 0.5, -0.6, -0.8])
LEFT, RIGHT = TIPS = [tip.name for tip in ROBOT.tips]
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
def test_a_step_is_the_loops():
    step, q = native(LAW, method="EE"), Q + 0.1
    held = ck.hold_at(ROBOT, TASK, Q)
    for _ in range(3):
        found = step(q, Ts=0.01, **given(held))
        made = ck.step(LAW, held, q, 0.0, 0.01, "EE")
        close(found.qdot, made.qdot, atol=1e-9)
        close(found.e, made.e, atol=1e-12)
        assert found.status == made.status
        q = np.asarray(made.q)


@NEEDS_C
def test_along_paths_the_vectors_agree(tmp_path):
    """And the header says in whose frame a relative target is."""
    header = (ck.export.c(LAW, out=tmp_path / "held", method="EE") / "clik_step.h").read_text()
    assert f"/* desired position of apart in the frame of {RIGHT} [m] */" in header
    paths = ck.hold_at(ROBOT, TASK, Q, apart=ck.circle([0.2, 0.4], 0.05, period=1.0))
    folder = ck.export.c(LAW, paths, out=tmp_path / "made", method="EE")
    done = subprocess.run(BUILD.format(name="clik_step") + " && ./example", shell=True, cwd=folder)
    assert done.returncode == 0


@NEEDS_C
def test_names_are_words_of_c():
    task = ck.stack(**{"left-hand": ck.position(tip=LEFT), "left_hand": ck.position(tip=RIGHT), "2": ck.joints(["q1"])})
    step = native(ck.Law(ROBOT, task, alpha=1.0, inverse=ck.damped(0.1)), method="EE")
    assert step.names[1:7:2] == ("left_hand_position", "left_hand_1_position", "task_2_values")


def test_walls_and_balance_are_described():
    """Each parameter has a meaning, and the configuration is whole: a mark that is no ASCII became a "?"."""
    robot, (left, right) = ck.load_urdf(BAXTER, tips=GRIPPERS), GRIPPERS
    pair = ck.distance(ck.sphere(left, 0.05), ck.capsule(right, 0.05, (0, 0, 0), (0, 0, 0.1)))
    walls = [ck.wall(pair, above=0.02, rate=5.0), ck.wall(ck.position("z", tip=left), above=0.1, name="low one")]
    tasks = ck.stack(hands=ck.pose(tip=left) & ck.pose(tip=right), stand=ck.center_of_mass("xy"))
    levels = ck.levels(["hands"], ["stand"], damping=(0.01, 0.1))
    law = ck.Law(robot, tasks, alpha=5.0, inverse=levels, limits=ck.bounded(walls=walls))
    found = parameters(law)[0]
    assert [field.name for field in found if not field.about] == []
    shapes = [f"wall_1_{which}_{what}" for which in ("one", "other") for what in ("ends", "radius")]
    own = {field.name for field in found if field.name.startswith("wall_")}
    each = {f"wall_{i}_{what}" for i in ("1", "low_one") for what in ("normal", "offset", "rate")}
    assert own == {*shapes, *each}
    request = Request(law, None, ck.METHODS["EE"], ck.picard(5), np.dtype(float))
    assert "?" not in "".join(configuration(request)) and "..." in "".join(configuration(request))


@NEEDS_C
def test_kinematics_of_each_tip():
    found = native(ROBOT)(Q)
    for tip in TIPS:
        close(getattr(found, f"{tip}_position"), ck.forward(ROBOT, Q, tip=tip).position, atol=1e-15)
        close(getattr(found, f"{tip}_jacobian"), ck.jacobian(ROBOT, Q, tip=tip), atol=1e-15)
