"""reach against Pinocchio's kinematics: every answer is one, and what is none is said to be none."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

import cnclik as ck
from cnclik import ReachStatus
from cnclik.reaching.starts import spans, starts_of
from cnclik.reaching.traced import refined
from cnclik.robot.model import modelled
from cnclik.robot.poses import quaternions
from cnclik.task.parts import At
from tests.refusals import refusals

TWIST = [np.pi / 2, 0.0, np.pi / 2, -np.pi / 2, np.pi / 2, 0.0]
WRIST = ck.from_dh([0, 0.4, 0, 0, 0, 0], TWIST, [0.3, 0, 0, 0.35, 0, 0.1], lower=[-2.5] * 6, upper=[2.5] * 6)
SHORT = ck.from_dh([0, 0.4, 0, 0, 0], [*TWIST[:4], 0.3], [0.3, 0, 0, 0.35, 0.1])
ARM = ck.planar_arm([1.0, 1.0])
HELD = ck.replace(ARM, lower=(-0.5, 0.2), upper=(0.5, 1.0))
PLANE = ck.position("xy")


def tips(chain, q):
    """4×4 transforms of the tip, by NumPy, which does not compile."""
    at, made = At(modelled(chain), np.asarray(q, float)), np.tile(np.eye(4), (len(q), 1, 1))
    made[:, :3, 3], made[:, :3, :3] = at.position(None), at.rotation(None)
    return made


def assert_ordered(chain, tip=None, to=None):
    """Starts one after the other lead to about the same place, those farther apart do not."""
    postures = starts_of(chain, ck.position(tip=tip, relative_to=to).on(chain)).postures.astype(float)
    some = postures[1 << 16 :][: 1 << 12], postures[:: 1 << 12]
    near, far = (np.diff(At(modelled(chain), q).position(tip, to), axis=0) for q in some)
    assert np.median(np.linalg.norm(near, axis=1)) < 0.1 * np.median(np.linalg.norm(far, axis=1))


def drawn(chain, count, seed=0):
    low, high = spans(chain)
    return np.random.default_rng(seed).uniform(low, high, (count, chain.n))


def test_the_same_numbers_give_the_same_answers_whatever_the_setting():
    targets = tips(WRIST, drawn(WRIST, 20))
    first, again = ck.reach(WRIST, targets), ck.reach(WRIST, targets)
    assert (first.q == again.q).all() and first.q.dtype == np.float64 and isinstance(first.q, np.ndarray)
    with jax.enable_x64(False):
        single, alone = ck.reach(WRIST, targets), ck.reach(WRIST, targets[0])
        arrays = ck.reach(WRIST, jnp.asarray(targets[0]), near=jnp.asarray(first.q[0]))  # in float32
        assert arrays.solved and arrays.q.dtype == np.float64
    assert (single.q == first.q).all() and single.position_error.max() <= 1e-6 and alone.q.dtype == np.float64


# --- why there is no answer ---------------------------------------------------------------------------


def test_in_a_hole_of_the_limits():
    """A place that the arm reaches with its elbow the other way or bent further than it may."""
    q = np.random.default_rng(2).uniform([-0.5, 1.3], [0.5, 2.5], (60, 2))
    targets = tips(ARM, q)[:, :3, 3]
    made = ck.reach(HELD, targets, task=PLANE)
    assert (made.status == ReachStatus.AT_LIMIT).all() and made.at_limit.any(axis=1).all()
    assert (ck.reach(HELD, targets[:3], task=PLANE).status == ReachStatus.AT_LIMIT).all()
    assert ck.reach(HELD, targets, task=PLANE, limits=False).solved.all()
    for target, error in list(zip(targets, made.position_error, strict=True))[:6]:  # the nearest there is

        def away(q, target=target):
            place = np.array([-np.sin(q[0]) - np.sin(q.sum()), np.cos(q[0]) + np.cos(q.sum())])
            return np.sum((place - target[:2]) ** 2)

        starts = ([-0.4, 0.3], [0.4, 0.3], [-0.4, 0.9], [0.4, 0.9])
        found = min(minimize(away, s, bounds=[(-0.5, 0.5), (0.2, 1.0)]).fun for s in starts)
        assert error <= 1.01 * np.sqrt(found) + 1e-6


def test_a_small_error_is_called_out_of_reach_only_where_that_is_known():
    held = ck.replace(ARM, lower=(-np.inf, 1e-2), upper=(np.inf, 2 * np.pi - 1e-2))  # the arm can't be stretched
    for target, status in (([2.00005, 0, 0], ReachStatus.OUT_OF_REACH), ([1.999985, 0, 0], ReachStatus.AT_LIMIT)):
        for some in (target, [target] * 2):
            assert np.all(ck.reach(held, some, task=PLANE).status == status)
    assert ck.reach(held, [1e-5, 0, 0], task=PLANE).solved  # its base is nearly met, from either side


def test_targets_that_are_not_finite():
    targets = tips(WRIST, drawn(WRIST, 10))
    targets[3, 0, 3], targets[4] = np.nan, np.inf
    made = ck.reach(WRIST, targets)
    assert made.status[[3, 4]].tolist() == [ReachStatus.NON_FINITE] * 2 and np.isnan(made.q[[3, 4]]).all()
    assert made.solved.sum() == 8
    turn = np.full((3, 3), np.nan)
    for target in (targets[3], (np.ones(3), turn)):
        assert ck.reach(WRIST, target).status == ReachStatus.NON_FINITE
    target = tips(ARM, np.array([[0.95, 0.5]]))[0, :3, 3]
    for some in (target, np.stack([target] * 12)):
        assert np.all(ck.reach(ARM, some, task=PLANE, near=[np.nan, 0.5]).status == ReachStatus.NON_FINITE)


MIMIC = """<robot name="m"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
<joint name="j1" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint>
<joint name="j2" type="revolute"><parent link="b"/><child link="c"/><origin xyz="1 0 0"/><axis xyz="0 0 1"/>
<limit lower="-9" upper="9" velocity="1" effort="1"/><mimic joint="j1" multiplier="0.5"/></joint>
<joint name="j3" type="revolute"><parent link="c"/><child link="d"/><origin xyz="1 0 0"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" velocity="1" effort="1"/></joint></robot>"""


def test_a_joint_that_a_slower_one_follows_is_not_turned_back(tmp_path):
    (tmp_path / "m.urdf").write_text(MIMIC)
    arm = ck.with_tool(ck.load_urdf(tmp_path / "m.urdf"), [1.0, 0.0, 0.0])
    assert arm.periodic == (False, True)
    assert_ordered(arm)
    targets = tips(arm, np.random.default_rng(0).uniform(-6, 6, (40, 2)))
    for some in (targets, targets[:5]):
        made = ck.reach(arm, some[:, :3, 3], task=PLANE)
        assert made.solved.mean() > 0.9
        np.testing.assert_allclose(tips(arm, made.q[made.solved])[:, :2, 3], some[made.solved][:, :2, 3], atol=2e-6)


# --- near, jump, several ------------------------------------------------------------------------------


def test_near_beyond_the_limits_is_no_way_around_a_jump():
    """And where all answers are beyond the limits `jump` does not hide that."""
    for q, near, name in (([0.45, 0.5], [0.9, 0.5], "JUMP"), ([0.2, 2.5], [0.1, 0.3], "AT_LIMIT")):
        target = tips(ARM, np.array([q]))[0, :3, 3]
        for some in (target, np.stack([target] * 12)):
            made = ck.reach(HELD, some, task=PLANE, near=near, jump=0.1)
            assert np.all(made.status == ReachStatus[name]) and np.isnan(made.q).all() == (name == "JUMP")
            assert np.isnan(made.distance).all() == (name == "JUMP")  # of joint values that are given


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("far", [1e30, -1e70, 1e200, -1e308])
def test_targets_beyond_all_squares_cost_their_own_lane_alone(far):
    status = ReachStatus.OUT_OF_REACH if abs(far) < 1e77 else ReachStatus.NON_FINITE
    made = ck.reach(ARM, [[far, 0.1, 0.0], [0.9, 0.4, 0.0]], task=PLANE)
    assert made.status.tolist() == [status, ReachStatus.SOLVED]
    alone = ck.reach(ARM, [far, 0.1, 0.0], task=PLANE, near=[0.1, 0.2])
    assert alone.status == status and np.isfinite(alone.q).all() == (abs(far) < 1e77)
    np.testing.assert_allclose(alone.position_error, abs(far) if abs(far) < 1e77 else np.nan)


def test_a_path_gives_what_its_waypoints_give_one_by_one():
    """Through several programs of the path, and a waypoint that is out of reach."""
    t = np.linspace(0, 2 * np.pi, 70)
    path = np.stack([1.2 + 0.5 * np.cos(t), 0.5 * np.sin(t), 0 * t], axis=1)
    path[40] = 5.0, 0.0, 0.0
    made = ck.reach(ARM, path, task=PLANE, near="previous", jump=0.3)
    at = made.q[0]
    for k in range(1, len(path)):
        alone = ck.reach(ARM, path[k], task=PLANE, near=at, jump=0.3)
        assert made.status[k] == alone.status
        np.testing.assert_allclose(made.q[k], alone.q, atol=1e-9)
        np.testing.assert_allclose(made.distance[k], alone.distance, atol=1e-9)
        at = alone.q if alone.solved else at
    assert np.flatnonzero(~made.solved).tolist() == [40]


def test_a_path_says_how_far_its_tip_strays():
    """Half-way between two rows, by kinematics; of two tips the one that strays more, and NaN beside a gap."""
    line = np.linspace([0.9, -0.7, 0.0], [0.9, 0.7, 0.0], 8)
    made = ck.reach(ARM, line, task=PLANE, near="previous")
    half = tips(ARM, (made.q[1:] + made.q[:-1]) / 2)[:, :3, 3]
    wanted = np.linalg.norm(half - (line[1:] + line[:-1]) / 2, axis=1)
    np.testing.assert_allclose(made.strays, wanted, atol=2e-6)
    assert 1e-3 < made.strays.min() < made.strays.max() < 2e-2
    with pytest.raises(ck.ArgumentError, match="`targets` must be rows of a path"):
        ck.replace(made, q=made.q[0]).strays
    line[2] = 5.0
    gap = ck.reach(ARM, line, task=PLANE, near="previous").strays
    assert np.isnan(gap).tolist() == [False, True, True, *[False] * 4]


# --- as part of other programs ------------------------------------------------------------------------


def test_derivative_of_a_task_that_leaves_part_of_the_turn_free():
    """After a step along it an answer is wrong by second order alone, also where the free part of the turn is large."""
    task, q, h = ck.pose("xyz", "z").on(SHORT), np.array([0.2, 0.3, 0.4, 0.5, 0.6]), 1e-5
    at = ck.forward(SHORT, q)
    rotation = Rotation.from_euler("x", 1.2).as_matrix() @ np.asarray(at.rotation)
    near = ck.reach(SHORT, (at.position, rotation), task=task, near=q, tolerance=(1e-12, 1e-12)).q

    @ck.native
    def moved(shift):
        target = jnp.concatenate([at.position + shift, rotation.ravel()])
        return refined(SHORT, task, target, near, np.zeros(5, bool), True)

    along = ck.native(lambda at, way: jax.jvp(moved, (at,), (way,)))
    np.testing.assert_allclose(along(np.full(3, 0.01), np.eye(3)[0])[0], near, atol=1e-15)  # it stays where it is
    _, slope = along(np.zeros(3), np.eye(3)[0])
    aim = at.position + np.array([h, 0, 0]), rotation
    again = ck.reach(SHORT, aim, task=task, near=near + h * slope, tolerance=(1e-13, 1e-13))
    assert again.distance < 1e-8


# --- what targets look like ---------------------------------------------------------------------------


def test_the_forms_of_targets():
    made = tips(WRIST, drawn(WRIST, 9))
    position, rotation = made[:, :3, 3], made[:, :3, :3]
    quaternion = quaternions(rotation)
    first = ck.reach(WRIST, made)
    assert (quaternion[:, 0] >= 0).all()
    seven = np.concatenate([position, quaternion], 1)
    poses = ck.Pose(position=position, rotation=rotation)
    several = [ck.Pose(position=p, rotation=r) for p, r in zip(position, rotation, strict=True)]
    for same in ((position, rotation), (position, quaternion), seven, made.tolist(), poses, several):
        np.testing.assert_allclose(ck.reach(WRIST, same).q, first.q, atol=1e-5)
    one = ck.reach(WRIST, ck.forward(WRIST, jnp.array(first.q[0])))
    assert one.solved and one.q.shape == (6,)
    made = tips(SHORT, drawn(SHORT, 9))
    position, rotation, quaternion = made[:, :3, 3], made[:, :3, :3], quaternions(made[:, :3, :3])
    places = ck.reach(SHORT, position, task="position")
    assert places.solved.all() and (places.orientation_error == 0).all()
    turns = ck.reach(SHORT, rotation, task="orientation")
    assert turns.solved.all() and (turns.position_error == 0).all()
    for count in (3, 4, 5):  # four of them are no transform
        assert ck.reach(SHORT, quaternion[:count], task="orientation").solved.all()
    assert ck.reach(SHORT, made, task=ck.pose("xyz", "z")).solved.all()
    flat = position[:, [2, 0]]  # the coordinates of a task alone
    same = ck.reach(ARM, flat, task=PLANE), ck.reach(ARM, flat @ np.eye(2, 3), task=PLANE)
    np.testing.assert_array_equal(same[0].q, same[1].q)


test_what_cannot_be_asked = refusals(
    ({"targets": np.zeros((2, 5))}, r"must hold 7 numbers, x y z \[m\] and a quaternion w x y z, but holds 5"),
    ({"targets": [0.3, 0.1], "task": "position"}, r"`targets` must hold 3 numbers, x y z \[m\], but holds 2"),
    ({"targets": 2 * np.eye(4)}, "`targets` must hold a rotation, .* but is off by 3"),
    ({"targets": (np.zeros((2, 3)), np.eye(3)[None])}, "must be as many of each, or one, but are 1 and 2"),
    ({"targets": np.zeros((0, 4, 4))}, "at least one target"),
    ({"task": "xy"}, r"`task` must be a Task, such as ck.position\('xy'\), or one of pose, position, orientation"),
    ({"tolerance": 1e-6}, "`tolerance` must have 2 numbers"),
    ({"tolerance": (1e-6, -1)}, "`tolerance` must hold positive"),
    ({"jump": 0.1}, "`near` must be given with `jump`"),
    ({"near": [0.0, 1.0]}, "`near` must have 6 numbers or shape"),
    ({"near": "last"}, "`near` must be one of previous"),
    ({"solutions": 0}, "`solutions` must be at least 1"),
    ({"solutions": 1001}, "`solutions` must be at most 1,000, but is 1001"),
    ({"chain": 3}, "`chain` must be a Chain"),
    ({"targets": np.array(np.eye(4) + np.eye(4, k=-3))}, "`targets` must have the last row 0 0 0 1"),
    ({"near": "previous", "solutions": 2}, "`solutions` must be 1 along a path"),
    of=lambda **change: ck.reach(**({"chain": WRIST, "targets": np.eye(4)} | change)),
)


def test_what_cannot_be_asked_while_tracing():
    for name, value in (("solutions", 2), ("near", "previous")):
        with pytest.raises(ck.ArgumentError, match=f"`{name}` must be left out under jit"):
            jax.jit(lambda t, n=name, v=value: ck.reach(WRIST, t, **{n: v}).q)(np.eye(4))
    with pytest.raises(ck.ArgumentError, match="`chain` must have limits that are numbers"):
        jax.jit(lambda v: ck.reach(ck.replace(WRIST, lower=(v,) * 6), np.eye(4)).q)(-1.0)
