"""The search: an answer is its target's own, by C, by XLA and in a program of one's own; what few tries may claim."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik import ReachStatus
from cnclik.reaching import public, search
from tests.oracles import robots
from tests.reaching.test_reach import WRIST, drawn, tips

FIELDS = "q", "status", "position_error", "orientation_error", "at_limit"


def hard_and_easy(count=80):
    """Targets of a wrist with narrow limits, of which some are beyond the limits, some beyond the arm, one is NaN."""
    held = ck.replace(WRIST, lower=(-1.5,) * 6, upper=(1.5,) * 6)
    targets = tips(WRIST, drawn(WRIST, count, seed=4))
    targets[::3] = tips(held, drawn(held, count, seed=5))[::3]
    targets[5, 2, 3], targets[6, 0, 0] = 7.0, np.nan
    return held, targets


def assert_alike(one, other, ids=slice(None)):
    """The same numbers, bit by bit."""
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name)[ids], err_msg=name)


def test_an_answer_is_the_targets_own(monkeypatch):
    """Whatever is asked beside it, in whatever order, in pools, on threads."""
    monkeypatch.setattr(search, "TRIES", 64)  # some run out of them
    held, targets = hard_and_easy()
    whole = ck.reach(held, targets)
    assert len(set(whole.status.tolist())) == 5
    order = np.random.default_rng(0).permutation(len(targets))
    assert_alike(ck.reach(held, targets[order]), whole, order)
    for k in (0, 1, 5, 6, 7):
        assert_alike(ck.reach(held, targets[k : k + 1]), whole, [k])
    monkeypatch.setattr(public, "POOL", 50)
    monkeypatch.setattr(search, "MANY", 8)
    monkeypatch.setattr(search, "AT_ONCE", 64)
    assert_alike(ck.reach(held, targets), whole)


@pytest.mark.slow
@pytest.mark.parametrize("near", [False, True])
def test_the_statuses_of_xla_and_of_a_trace_are_those_of_c(near):
    held, targets = hard_and_easy(60)
    given = {"near": drawn(held, 60, seed=6)} if near else {}
    whole, other = ck.reach(held, targets, **given), ck.replace(held)
    with ck.use_engine("xla"):
        by_xla = ck.reach(other, targets, **given)
    traced = jax.jit(lambda t: ck.reach(held, t, **given))(targets)
    for made in (by_xla, traced):
        assert (made.status == whole.status).mean() >= 0.97
        gone = (whole.status != 0) & (made.status == whole.status) & np.isfinite(whole.position_error)
        np.testing.assert_allclose(whole.position_error[gone], made.position_error[gone], rtol=0.02, atol=2e-3)


def test_limits_may_be_an_array_within_a_program_of_float32():
    """What is missed is by the law of cosines. That weights are tiny changes no status."""
    arm, task = ck.planar_arm([1.0, 0.4]), ck.replace(ck.position("xy"), weights=[1e-8] * 2)
    arrays = ck.replace(arm, lower=jnp.array([-1.9, -2.0]), upper=np.array([2.0, 2.0]))
    radius, nearest = np.array([1.1, 1.6, 0.75, 0.2]), np.sqrt(1 + 0.4**2 + 2 * 0.4 * np.cos(2.0))
    targets = radius[:, None] * [np.sin(0.3), np.cos(0.3)]
    with jax.enable_x64(False):
        made = jax.jit(jax.vmap(lambda t: ck.reach(arrays, t, task=task)))(targets)
    assert made.q.dtype == np.float32 and np.all(np.asarray(made.position_error)[0] < 1e-5)
    assert made.status.tolist() == [0, ReachStatus.OUT_OF_REACH, ReachStatus.AT_LIMIT, ReachStatus.OUT_OF_REACH]
    np.testing.assert_allclose(made.position_error, [0, 0.2, nearest - 0.75, nearest - 0.2], atol=1e-6)


def test_the_nearest_pose_is_where_a_descent_rests():
    """Of a Z1 with its tip at the gripper: 802 mm and 261 mrad were called nearest once."""
    arm = ck.load_urdf(robots() / "z1_description/urdf/z1.urdf", "gripperStator")
    made = ck.reach(arm, [-0.6076486, 0.6904791, -0.3924306, 0.6281435, 0.0735664, -0.4141221, -0.6546195])
    assert made.status == ReachStatus.OUT_OF_REACH
    assert made.position_error < 0.7705 and made.orientation_error < 0.236
