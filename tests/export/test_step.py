"""The exported step against JAX: inverses, limits, methods, stages and precisions in turn; and a stack."""

import subprocess

import numpy as np
import pytest

import cnclik as ck
from cnclik.export.example import BUILD
from cnclik.export.fields import identifiers, parameters
from cnclik.export.trace import Request
from cnclik.export.write import configuration
from tests import bank
from tests.bank import told
from tests.engine.compare import NEEDS_C, plain
from tests.export.native import arm, native
from tests.oracles import close
from tests.robot.test_trees import BAXTER, GRIPPERS

pytestmark = NEEDS_C
TS, REST, SINGULAR = 0.01, [0.3, 0.3, 0.3], ck.singular_damped(0.1, 0.2)
RESULTS = ("q", "qdot", "e", "x", "residual")
SPREAD = [  # inverse, limits, posture, method, stage, dtype
    (ck.pseudoinverse(), None, None, "EE", ck.picard(1), "float64"),
    (ck.damped(0.1), ck.velocity_scaling(), None, "IE", ck.newton(2), "float64"),
    (SINGULAR, ck.bounded(), ck.posture(REST), "EXP-MIDPOINT", ck.picard(1), "float64"),
    (ck.damped(0.1), None, None, "CN", ck.picard(3), "float32"),
]


def a_law(inverse, limits=None, null=None):
    return ck.Law(arm(3), ck.position("xy"), alpha=5.0, inverse=inverse, limits=limits, null_velocity=null)


def lanes(inverse, dtype, count=60):
    """q, position and velocity: some q beyond their limits, some singular if that is damped, the last a NaN."""
    random = np.random.default_rng(0)
    q = random.uniform(0.3, 2.1, (count, 3))
    if not isinstance(inverse, type(ck.pseudoinverse())):
        q[:6] = random.normal(0, 1e-2, (6, 3)) * np.arange(6)[:, None]
    q[-1, 0] = np.nan
    return [v.astype(dtype) for v in (q, random.uniform(0.3, 1.5, (count, 2)), random.normal(0, 0.1, (count, 2)))]


def by_jax(law, method, stage, given):
    def one(q, position, velocity):
        moving = ck.causal(told(ck.hold(position), velocity))
        return ck.step(law, moving, q, 0.0, TS, method, stage)

    return plain(one, *given)


def off(law, method, stage, dtype, wanted, given):
    """The largest difference of the exported step, relative to 1 + the number; statuses are the same."""
    step = native(law, method=method, stage=stage, dtype=dtype)
    rows = [step(q, position, velocity=velocity, Ts=TS) for q, position, velocity in zip(*given, strict=True)]
    worst = 0.0
    for name in RESULTS:
        found, real = np.array([getattr(row, name) for row in rows]), np.asarray(getattr(wanted, name))
        np.testing.assert_array_equal(np.isfinite(found), np.isfinite(real))
        worst = max(worst, np.nanmax(np.abs(found - real) / (1 + np.abs(real))))
    edges = np.abs(np.abs(wanted.q) - 2.0).min(axis=1) < 1e-5  # there a rounding decides about AT_LIMIT
    np.testing.assert_array_equal(np.where(edges, 0, [row.status for row in rows]), np.where(edges, 0, wanted.status))
    return worst


@pytest.mark.parametrize(("inverse", "limits", "null", "method", "stage", "dtype"), SPREAD, ids=str)
def test_the_exported_step_is_jaxs(inverse, limits, null, method, stage, dtype):
    law, given = a_law(inverse, limits, null), lanes(inverse, dtype)
    wanted, near = by_jax(law, method, stage, given), {"float64": 1e-11, "float32": 1e-4}[dtype]
    assert off(law, method, stage, dtype, wanted, given) < near
    if law.inverse == ck.pseudoinverse():  # a gain that is off in its ninth digit is found
        wrong = ck.replace(law, alpha=5.0 * (1 + 1e-9))
        assert off(wrong, method, stage, dtype, wanted, given) > 10 * near


ROBOT, Q = bank.robot("two arms"), np.array([0.2, -0.4, 0.7, 0.5, -0.6, -0.8])
LEFT, RIGHT = TIPS = [tip.name for tip in ROBOT.tips]
TASK = ck.stack(
    hands=ck.pose("xy", tip=LEFT) & ck.position("xy", tip=RIGHT),
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


def test_a_step_is_the_loops():
    """And the header says in whose frame a relative target is."""
    step, q = native(LAW, method="EE"), Q + 0.1
    assert f"/* desired position of apart in the frame of {RIGHT} [m] */" in step.header
    held = ck.hold_at(ROBOT, TASK, Q)
    for _ in range(3):
        found = step(q, Ts=0.01, **given(held))
        made = ck.step(LAW, held, q, 0.0, 0.01, "EE")
        close(found.qdot, made.qdot, atol=1e-9)
        close(found.e, made.e, atol=1e-12)
        assert found.status == made.status
        q = np.asarray(made.q)


def test_along_paths_the_vectors_agree(tmp_path):
    paths = ck.hold_at(ROBOT, TASK, Q, apart=ck.circle([0.2, 0.4], 0.05, period=1.0))
    folder = ck.export.c(LAW, paths, out=tmp_path / "made", method="EE")
    done = subprocess.run(BUILD.format(name="clik_step") + " && ./example", shell=True, cwd=folder)
    assert done.returncode == 0


def test_names_are_words_of_c():
    task = ck.stack(**{"left-hand": ck.position(tip=LEFT), "left_hand": ck.position(tip=RIGHT), "2": ck.joints(["q1"])})
    step = native(ck.Law(ROBOT, task, alpha=1.0, inverse=ck.damped(0.1)), method="EE")
    assert step.names[1:7:2] == ("left_hand_position", "left_hand_1_position", "task_2_values")
    odd = ["task_2", "2", "x__4", "x-", "x_", ""]  # equal only once they are words
    assert identifiers(odd) == ["task_2", "task_2_1", "x__4", "x_", "x__4_4", "task_"]


def test_no_name_ends_a_comment():
    two = ck.join(ck.planar_arm([1.0]), ck.planar_arm([0.5]), prefix="a*/", keep=True)
    assert "/* of a* /tip in the base frame [m] */" in native(two).header


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


@pytest.mark.parametrize(("robot", "dtype", "near"), [("panda", "float32", 1e-6), ("two arms", "float64", 1e-15)])
def test_kinematics_are_the_librarys(robot, dtype, near):
    """Of each tip; that of an arm with one has no name."""
    chain, q = (ck.panda(), np.linspace(-1, 1, 7)) if robot == "panda" else (ROBOT, Q)
    made = native(chain, dtype=dtype)(q)
    for tip in chain.tips:
        before, wanted = f"{tip.name}_" * (chain is ROBOT), ck.forward(chain, q, tip=tip.name)
        close(getattr(made, f"{before}position"), wanted.position, atol=near)
        close(getattr(made, f"{before}rotation"), wanted.rotation, atol=near)
        close(getattr(made, f"{before}jacobian"), ck.jacobian(chain, q, tip=tip.name), atol=near)
