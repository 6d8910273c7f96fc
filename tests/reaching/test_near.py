"""Whatever `near`, `jump` and the arm's size: what forward kinematics leads to within the limits is found."""

import functools

import numpy as np
import pytest

import cnclik as ck
from cnclik import ReachStatus
from cnclik.reaching import search
from cnclik.reaching.starts import spans, turned
from tests import bank
from tests.oracles import ARMS, robots
from tests.reaching.test_reach import assert_ordered, drawn, tips
from tests.robot.test_urdf import Pinocchio, oracle


def ends(chain):
    """The limits (n,), and where a joint has none, those of a turn."""
    low, high = spans(chain)
    lower, upper = np.array(chain.lower), np.array(chain.upper)
    return np.where(np.isfinite(lower), lower, low), np.where(np.isfinite(upper), upper, high)


def cases(chain, count):
    """Postures within the limits, and by name what is asked of where they lead, with the statuses that are right."""
    rng, (low, high) = np.random.default_rng(7), ends(chain)
    q, other = rng.uniform(low, high, (2, count, chain.n))
    turns = 2 * np.pi * np.array(chain.periodic)
    some = {
        "nothing": {},
        "lower limits": {"near": low},
        "upper limits": {"near": high},
        "far beyond them": {"near": np.where(rng.random(q.shape) < 0.5, -100.0, 100.0)},
        "whole turns away": {"near": q + turns * rng.integers(-3, 4, q.shape)},
        "degrees": {"near": np.degrees(other)},
        "elsewhere": {"near": other},
    }
    for jump in (0.05, 0.5, 2.0):
        shift = 0.999 * rng.uniform(-jump, jump, q.shape)
        some[f"jump {jump}"] = {"near": np.clip(q + shift, chain.lower, chain.upper), "jump": jump}
    far = {"jump elsewhere": {"near": other, "jump": 0.05}, "jump degrees": {"near": np.degrees(other), "jump": 0.05}}
    right = {ReachStatus.SOLVED}
    return q, {k: (v, right) for k, v in some.items()} | {k: (v, {*right, ReachStatus.JUMP}) for k, v in far.items()}


def wrong(chain, count):
    """How many are wrong, by case, of those with any."""
    q, asked = cases(chain, count)
    targets, found = tips(chain, q), {}
    for name, (given, right) in asked.items():
        made = ck.reach(chain, targets, **given)
        bad = ~np.isin(made.status, list(right))
        if bad.any():
            found[name] = str(made)
        solved = made.solved
        low, high = np.array(chain.lower), np.array(chain.upper)
        assert ((made.q >= low) & (made.q <= high))[solved].all(), name
        if "jump" in given:
            assert (made.distance[solved] <= given["jump"] * (1 + 1e-9)).all(), name
    return found


@functools.cache
def arm_of(name):
    file, tip, base = ARMS[name]
    return ck.load_urdf(robots() / file, tip, base)


@pytest.mark.parametrize("name", ["Panda", "UR5"])
def test_every_answer_is_one_and_near_is_not_where_the_search_ends(name):
    """By Pinocchio's forward kinematics, and within the limits."""
    (file, tip, base), chain = ARMS[name], arm_of(name)
    assert wrong(chain, 100) == {}
    model, _ = oracle(robots() / file)
    other, base = Pinocchio(robots() / file, model), base or model.frames[1].name
    targets = tips(chain, drawn(chain, 60))
    made = ck.reach(chain, targets)
    assert made.solved.all()
    assert (made.q >= np.array(chain.lower)).all() and (made.q <= np.array(chain.upper)).all()
    for q, target, error, turn in zip(made.q, targets, made.position_error, made.orientation_error, strict=True):
        position, rotation, _ = other.at(chain.joint_names, q, tip, base)
        away = np.linalg.norm(position - target[:3, 3])
        angle = np.arccos(np.clip((np.trace(rotation.T @ target[:3, :3]) - 1) / 2, -1, 1))
        assert away <= 1.0001e-6 and angle <= 2e-6  # arccos is good for 1e-8 there
        assert abs(away - error) < 1e-12 and abs(angle - turn) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("name", ARMS)
def test_near_of_eight_robots(name):
    assert wrong(arm_of(name), 10_000) == {}


def test_a_minimum_at_a_limit_next_to_near_hides_no_answer():
    """There the error is 5 µm: in float32 that is an answer, and the one nearest to `near`."""
    arm = ck.replace(ck.planar_arm([1.0, 0.8]), lower=(-3.0, -3.0), upper=(3.0, 1.2))
    q = np.stack([np.linspace(-0.5, 0.5, 20), np.full(20, 1.2 + 7e-6)], axis=1)
    made = ck.reach(arm, tips(arm, q), task=ck.position("xy"), near=q)
    assert made.solved.all()
    np.testing.assert_allclose(made.q[:, 1], -q[:, 1], atol=1e-5)


def sized(size):
    """A six-joint arm of about a metre, times `size`."""
    lengths = np.array([[0.1, 0.4, 0.05, 0.0, 0.0, 0.0], [0.3, 0.0, 0.0, 0.4, 0.0, 0.1]]) * size
    twist = [np.pi / 2, 0.0, np.pi / 2, -np.pi / 2, np.pi / 2, 0.0]
    return ck.from_dh(lengths[0].tolist(), twist, lengths[1].tolist(), lower=[-3.0] * 6, upper=[3.0] * 6)


@pytest.mark.parametrize("size", [1e-4, 1e4])
def test_arms_of_any_size(size):
    assert wrong(sized(size), 60) == {}


@functools.cache
def cornered(kind):
    """An arm whose limits allow for little else: a chain of right angles, or of offsets and twists at random."""
    if kind == "twisted":
        return ck.from_dh([1.0] * 6, [1.57, -1.57] * 3, [0.0] * 6, lower=[-3.0] * 6, upper=[3.0] * 6)
    n, rng = 6 + kind % 3, np.random.default_rng(kind)
    a, d = rng.uniform(0, 1, (2, n)) * (rng.random((2, n)) < 0.7)
    twist = rng.choice([np.pi / 2, -np.pi / 2, 0.0, 1.57, 0.4], n)
    lower, upper = -rng.uniform(0.3, 3.1, n), rng.uniform(0.3, 3.1, n)
    return ck.from_dh(*(v.tolist() for v in (a, twist, d)), lower=lower.tolist(), upper=upper.tolist())


def at_limits(chain, count):
    """Postures (count, n) with two joints to all of them exactly at a limit."""
    rng, low, high = np.random.default_rng(1), np.array(chain.lower), np.array(chain.upper)
    q, side = rng.uniform(low, high, (count, chain.n)), rng.random((count, chain.n)) < 0.5
    held = rng.random(q.shape).argsort(axis=1) < rng.integers(2, chain.n + 1, count)[:, None]
    return np.where(held, np.where(side, low, high), q)


@pytest.mark.parametrize("kind", ["twisted", 14])
def test_an_answer_with_several_joints_at_their_limits_is_found(kind, monkeypatch):
    """It has hardly any posture about it from which a search within the limits arrives."""
    chain = cornered(kind)
    q = at_limits(chain, 300)

    def right(made):
        known = np.isin(made.status, [ReachStatus.SOLVED, ReachStatus.OUT_OF_BUDGET])
        return known.all() and np.sum(~made.solved) <= 1

    rng, low, high = np.random.default_rng(2), np.array(chain.lower), np.array(chain.upper)
    asked = [{}, {"near": rng.uniform(low, high, q.shape)}, {"near": high}]
    asked += [{"near": np.clip(q + 0.999 * rng.uniform(-j, j, q.shape), low, high), "jump": j} for j in (0.05, 2.0)]
    for given in asked:
        for task in ("pose", "position") if kind == 14 else ("pose",):
            made = ck.reach(chain, tips(chain, q), task=task, **given)
            assert right(made), (given.keys(), task, str(made))
    several = ck.reach(chain, tips(chain, q[:100]), solutions=2)
    assert right(ck.replace(several, status=several.status[:, 0]))
    alone = [ck.reach(chain, target).status for target in tips(chain, q[:4])]
    assert np.isin(alone, [ReachStatus.SOLVED, ReachStatus.OUT_OF_BUDGET]).all()
    monkeypatch.setattr(search, "TRIES", search.TRIES // 8)  # most tries begin where that is likely
    assert np.sum(~ck.reach(chain, tips(chain, q), tolerance=(9e-7, 1e-6)).solved) <= 6  # by a search of its own


def test_an_answer_with_all_joints_at_limits_is_found_from_beyond_them():
    """AT_LIMIT falsely: of a freedom that is left only one end is within the limits, where all joints are.

    Or 512 tries were not enough, though the nearest pose was 0.25 (952) of a unit off.
    """
    chain = cornered(16)
    some = at_limits(chain, 5000)[[846, 917, 952, 1361, 4442]]
    assert ck.reach(chain, tips(chain, some)).solved.all()


ELBOW = 2.0  # [rad] its limit


def bordering(size, count):
    """A planar arm, and targets that its tip takes where it is stretched or at the elbow's limit, or that lie by.

    Returns: the arm, positions (count, 3), by how much each is farther than the arm is long, and which are nearer to
    the base than the elbow's limit lets the tip be [m].
    """
    lengths = np.array([1.0, 0.8]) * size
    arm = ck.replace(ck.planar_arm(lengths.tolist()), lower=(-3.0, -ELBOW), upper=(3.0, ELBOW))
    rng, outer = np.random.default_rng(11), lengths.sum()
    inner = np.sqrt((lengths**2).sum() + 2 * lengths.prod() * np.cos(ELBOW))
    shift = outer * 10.0 ** rng.uniform(-13, -9, count) * rng.choice([-1.0, 0.0, 1.0], count)
    radius = np.where(np.arange(count) % 2, outer, inner) + shift
    angle = rng.uniform(0.0, 1.5, count)  # whichever way the elbow bends, the shoulder keeps its limits
    where = np.stack([-np.sin(angle), np.cos(angle), 0.0 * angle], axis=1) * radius[:, None]
    away = np.hypot(*where[:, :2].T)
    return arm, where, away - outer, inner - away


@pytest.mark.parametrize("size", [1e-4, 1e4])
def test_on_the_border_only_what_is_known_is_said(size):
    """By the law of cosines. Searches end there at errors of a billionth of the arm's length: those are near misses."""
    arm, where, beyond, inside = bordering(size, 20)
    options = {"task": ck.position("xy")}
    for tolerance in (1e-6, 1e-11 * size, 1e-13 * size):
        for jump in ({}, {"near": [-2.5, -1.0], "jump": 0.05}):
            given = options | jump | {"tolerance": (tolerance, 1e-6)}
            some, alone = ck.reach(arm, where, **given), ck.reach(arm, where[:3], **given)
            status = np.append(some.status, alone.status)
            far, held = (np.append(v, v[:3]) > tolerance for v in (beyond, inside))
            ok = ReachStatus.JUMP if jump else ReachStatus.SOLVED
            for which, right in ((~far & ~held, ok), (far, ReachStatus.OUT_OF_REACH), (held, ReachStatus.AT_LIMIT)):
                assert np.isin(status[which], [right, ReachStatus.OUT_OF_BUDGET]).all(), (tolerance, jump)
            assert (status[~far & ~held] == ok).all() or tolerance < 1e-12 * size
            assert (status[far] == ReachStatus.OUT_OF_REACH).all()
    made = ck.reach(arm, where, tolerance=(1e-17 * size, 1e-6), **options)  # what a rounding may put beyond the arm
    assert (beyond[made.status == ReachStatus.OUT_OF_REACH] > 1e-14 * size).all()


def test_next_to_a_singularity_a_near_miss_is_no_lack_of_reach():
    """Postures with joints at 0, whose poses are reached: what `jump` forbids is never called out of reach."""
    arm, rng = cornered("twisted"), np.random.default_rng(3)
    q = np.where(rng.random((24, 6)) < 0.4, 0.0, rng.uniform(-3, 3, (24, 6)))
    given = {"near": rng.uniform(-3, 3, q.shape), "jump": 0.05}
    for tolerance in (1e-11, 1e-13):
        made = ck.reach(arm, tips(arm, q), **given, tolerance=(tolerance, 1e-6))
        assert np.isin(made.status, [ReachStatus.JUMP, ReachStatus.OUT_OF_BUDGET]).all()


def test_starts_cover_the_limits_and_one_turn_of_a_wide_joint():
    """Of a joint that may turn further: the turn about 0 where the limits have it, else the nearest one.

    Limits so large that they mean none are none: of starts spread so far few would arrive.
    """
    limits = [(-1, 2), (-20, 20), (1, 9), (-12, -2), (-np.inf, 1), (5, np.inf), (-np.inf, np.inf)]
    limits = np.array([*limits, (-9e3, 9e3), (-1e6, 1e4), (-1.7e308, 1.7e308)])  # those of sliding joints last
    kinds, pi = "RRRRRRRPPP", np.pi
    low, high = spans(ck.from_dh(*np.zeros((3, 10)), kinds=kinds, lower=limits[:, 0], upper=limits[:, 1]))
    np.testing.assert_allclose(low, [-1, -pi, 1, -2 - 2 * pi, 1 - 2 * pi, 5, -pi, -9e3, -pi, -pi])
    np.testing.assert_allclose(high, [2, pi, 1 + 2 * pi, -2, 1, 5 + 2 * pi, pi, 9e3, pi, pi])


def test_whole_turns_lead_to_the_nearest_place_within_the_range():
    """A turn and back again is none, to the last bit: rounding put answers beyond a limit, and then at the other."""
    rng = np.random.default_rng(0)
    q, about, low, high = rng.uniform([-20, -20, -9, 1], [20, 20, 0, 8], (500, 4)).T
    every = q + 2 * np.pi * np.arange(-9, 10)[:, None]
    away = np.where((every >= low) & (every <= high), abs(every - about), np.inf)
    found, some = turned(q, about, True, low, high), np.isfinite(away).any(0)
    np.testing.assert_allclose(found[some], every[away.argmin(0), np.arange(500)][some])
    np.testing.assert_array_equal(turned(q, about, False, low, high), q)
    alone = high - low < 2 * np.pi
    for end in (low, high):
        np.testing.assert_array_equal(turned(end, about, True, low, high)[alone], end[alone])


AXES = [[0, 0, 1], [1, 0, 0], [0, 1, 0], [1, 0, 0]]
SLIDING = bank.screws(np.outer(np.arange(4), [1.0, 0.2, 0.0]), AXES, [4.0, 0.0, 1.0], kinds="RPRR")


def test_starts_in_one_bin_lead_to_the_same_place():
    assert_ordered(SLIDING)
    assert_ordered(bank.robot("two arms"), "two_tip", "one_tip")
