"""Several tips at once: every answer by Pinocchio; targets by name; what is out of reach, and what is refused."""

import jax
import numpy as np

import cnclik as ck
from cnclik.robot.chain import Tip
from cnclik.robot.fixed import Offset
from cnclik.robot.model import modelled
from cnclik.task.parts import At
from tests.oracles import close
from tests.reaching.test_reach import drawn
from tests.refusals import refusals
from tests.robot.test_trees import BAXTER, GRIPPERS
from tests.robot.test_urdf import Pinocchio, oracle

LEFT, RIGHT = GRIPPERS
TWO = ck.load_urdf(BAXTER, tips=GRIPPERS)
TASK = ck.stack(left=ck.pose(tip=LEFT), right=ck.pose(tip=RIGHT))
HANDS = ck.pose(tip=LEFT) & ck.position(tip=RIGHT)
TRUNK, SIDES = ck.planar_arm([1.0, 0.8]), [ck.planar_arm([0.6, length]) for length in (0.9, 0.5)]
PLANAR = ck.join(ck.join(TRUNK, SIDES[0], prefix="one_", keep=True), SIDES[1], at="tip", prefix="two_")
PAIR = ck.position("xy", tip="one_tip") & ck.position("xy", tip="two_tip")
Q = np.linspace(0.4, 0.9, 6)


def where(robot, q, tip, to=None):
    """Positions (B, 3) and rotations (B, 3, 3) of a tip."""
    at = At(modelled(robot), q)
    return at.position(tip, to), at.rotation(tip, to)


def angle(one, other):
    return 2 * np.arcsin(np.minimum(np.linalg.norm(one - other) / 8**0.5, 1))


def test_every_answer_is_one():
    """By Pinocchio's forward kinematics, and within the limits; errors are those of the tip that misses most."""
    q, other = drawn(TWO, 60), Pinocchio(BAXTER, oracle(BAXTER)[0])
    due = {side: where(TWO, q, tip) for side, tip in zip(("left", "right"), GRIPPERS, strict=True)}
    made, sides = ck.reach(TWO, dict(reversed(due.items())), task=TASK), []  # names count, and no order
    assert made.solved.all()
    assert (made.q >= np.array(TWO.lower)).all() and (made.q <= np.array(TWO.upper)).all()
    for side, tip in zip(due, GRIPPERS, strict=True):
        there = [other.at(TWO.joint_names, v, tip, "base")[:2] for v in made.q]
        away = [np.linalg.norm(at[0] - p) for at, p in zip(there, due[side][0], strict=True)]
        turn = [angle(at[1], r) for at, r in zip(there, due[side][1], strict=True)]
        sides.append((away, turn))
    close(np.stack([made.position_error, made.orientation_error]), np.max(sides, axis=0), atol=1e-12)
    assert made.position_error.max() <= 1e-6 and made.orientation_error.max() <= 1e-6


def test_tasks_joined_and_tasks_of_several_tips():
    """By the names of tips; of a position alone the rest is free; one arm of a robot with two."""
    robot, q = ck.replace(PLANAR, lower=(-2.0,) * 6, upper=(2.0,) * 6), Q + np.linspace(-2.0, 1.0, 12)[:, None]
    one, two = where(robot, q, "one_tip"), where(robot, q, "two_tip")
    hands = ck.pose("xy", "z", tip="one_tip") & ck.position("xy", tip="two_tip")
    due = {"one_tip": one, "two_tip": two[0]}
    made, stacked = ck.reach(robot, due, task=hands), {f"hands.{tip}": target for tip, target in due.items()}
    assert made.solved.all()
    close(ck.reach(robot, stacked, task=ck.stack(hands=hands)).q, made.q, atol=0)
    close(where(robot, made.q, "two_tip")[0], two[0], atol=1e-6)
    close(where(robot, made.q, "one_tip")[1], one[1], atol=3e-6)
    near = q + 0.05
    alone = ck.reach(robot, one[0], task=ck.position("xy", tip="one_tip"), near=near)
    assert alone.solved.all()
    close(alone.q[:, 4:], np.clip(near, -2.0, 2.0)[:, 4:], atol=1e-12)
    close(where(robot, alone.q, "one_tip")[0], one[0], atol=1e-6)


def test_one_tip_seen_from_the_other():
    """As Pinocchio has it, while the other goes somewhere; and alone."""
    q, other = drawn(TWO, 12, seed=3), Pinocchio(BAXTER, oracle(BAXTER)[0])
    seen = [other.at(TWO.joint_names, v, RIGHT, LEFT)[:2] for v in q]
    apart, turned = (np.array(v) for v in zip(*seen, strict=True))
    there = where(TWO, q, LEFT)[0]
    task = ck.stack(place=ck.position(tip=LEFT), grip=ck.pose(tip=RIGHT, relative_to=LEFT))
    made = ck.reach(TWO, {"place": there, "grip": (apart, turned)}, task=task)
    assert made.solved.all()
    for v, p, r in zip(made.q, apart, turned, strict=True):
        position, rotation = other.at(TWO.joint_names, v, RIGHT, LEFT)[:2]
        assert np.linalg.norm(position - p) <= 1.0001e-6 and angle(rotation, r) <= 1.0001e-6
    close(where(TWO, made.q, LEFT)[0], there, atol=1e-6)
    seen = where(PLANAR, Q + q[:, :1], "two_tip", "one_tip")
    made = ck.reach(PLANAR, seen, task=ck.pose("xy", "z", tip="two_tip", relative_to="one_tip"))
    assert made.solved.all()
    close(where(PLANAR, made.q, "two_tip", "one_tip")[1], seen[1], atol=2e-6)


# --- no answer ----------------------------------------------------------------------------------------


def test_farther_than_one_arm_is_long_is_out_of_reach():
    """Of the arm that the target is for: the short one does not get to where the long one does."""
    q = drawn(TWO, 1, seed=6)
    left, right = (tuple(v[0] for v in where(TWO, q, tip)) for tip in GRIPPERS)
    far = (right[0] + [0.0, -4.0, 0.0], right[1])
    made = ck.reach(TWO, {"left": left, "right": far}, task=TASK)
    assert made.status == ck.ReachStatus.OUT_OF_REACH and made.position_error > 2 and made.q.shape == (TWO.n,)
    close(made.position_error, np.linalg.norm(where(TWO, made.q, RIGHT)[0] - far[0]), rtol=1e-9)
    bent = np.array([[0.0, 0.0, 0.5, 0.5, 0.0, 0.0]])  # the short arm is stretched
    one, two = (where(PLANAR, bent, tip)[0][0] for tip in ("one_tip", "two_tip"))
    for away, right in ((-1e-3, "SOLVED"), (2e-5, "OUT_OF_REACH"), (0.3, "OUT_OF_REACH")):
        due = {"one_tip": one, "two_tip": two + away * np.eye(3)[1]}
        assert ck.reach(PLANAR, due, task=PAIR).status == ck.ReachStatus[right], away


def test_a_pair_that_is_rigid_and_is_asked_to_part():
    """Two points of one link, asked to be farther apart than they are: each misses by half of it."""
    ends = {"one": Offset(position=(0.0, 0.5, 0.0)), "other": Offset(position=(0.0, 0.7, 0.0))}
    tips = tuple(Tip(name=name, joint=2, offset=offset) for name, offset in ends.items())
    robot = ck.replace(ck.planar_arm([1.0, 0.8, 0.5]), tips=tips)
    task = ck.stack(a=ck.position("xy", tip="one"), b=ck.position("xy", tip="other"))
    at = where(robot, np.array([[0.4, 0.8, -1.3]]), "one")
    along = at[1][0, :, 1]
    middle = at[0][0] + 0.1 * along
    for gap in (0.1, 0.3):
        due = {"a": middle - gap / 2 * along, "b": middle + gap / 2 * along}
        made = ck.reach(robot, due, task=task)
        assert made.status == ck.ReachStatus.OUT_OF_REACH
        close(made.position_error, 0.05, atol=1e-4)
    made = ck.reach(robot, due, task=ck.replace(task, weights=np.repeat([9.0, 1.0], 2)))
    missed = [np.linalg.norm(where(robot, made.q, tip)[0] - due[name]) for tip, name in (("one", "a"), ("other", "b"))]
    close(missed, [0.01, 0.09], atol=1e-3)
    due["b"] = due["a"] + 0.2 * along
    assert ck.reach(robot, due, task=task).solved


# --- in one's own JAX code ----------------------------------------------------------------------------


def test_jit_vmap_and_the_implicit_derivative():
    """dq = J# de of targets that a reach has, with the joints that are free; a joint at its limit has none."""
    robot = ck.replace(PLANAR, lower=(0.4, *[-3.0] * 5), upper=(3.0,) * 6)
    near = np.stack([Q, Q + 0.2])  # at a limit, and not
    places = np.concatenate([where(robot, near, tip)[0][:, :2] for tip in ("one_tip", "two_tip")], axis=1)

    def q_at(place, near):
        due = {"one_tip": place[:2], "two_tip": place[2:]}
        made = ck.reach(robot, due, task=PAIR, near=near, tolerance=(1e-10, 1e-10))
        return made.q, made

    slopes, made = jax.jit(jax.vmap(jax.jacrev(q_at, has_aux=True)))(places, near)
    assert np.all(made.solved) and isinstance(made.q, jax.Array)
    close(made.q, near, atol=1e-9)
    j = np.concatenate([At(modelled(robot), near).jacobian(tip)[:, :2] for tip in ("one_tip", "two_tip")], axis=1)
    j[0, :, 0] = 0.0
    close(slopes, np.linalg.pinv(j), rtol=1e-6, atol=1e-8)
    assert (slopes[0, 0] == 0).all()


# --- what is refused ----------------------------------------------------------------------------------

EYE = np.eye(4)


def ask(targets, task=TASK, **options):
    return lambda: ck.reach(TWO, targets, task=task, **options)


test_what_is_refused = refusals(
    (ask(EYE), "`targets` must be a dict with left and right, but is ndarray"),
    (ask({"left": EYE, "rigth": EYE}), "`targets` must be a dict with left and right, but is left, rigth"),
    (ask({"left": EYE, "right": np.zeros(3)}), r"`targets\['right'\]` must hold 7 numbers, .* but holds 3"),
    (ask({LEFT: EYE}, HANDS), f"`targets` must be a dict with {LEFT} and {RIGHT}, but is {LEFT}"),
    (ask(EYE, "pose"), "`tip` must be given for a robot with several"),
    (ask(EYE, ck.pose(tip="nose")), "`tip` must be one of left_gripper, right_gripper"),
    (ask(EYE, ck.pose(tip=LEFT) & ck.joints()), "`task` must be of positions and orientations of tips, but has"),
)
