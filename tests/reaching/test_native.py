"""The native search: of what C is built from it, whose answers those are, and what happens without a compiler."""

import copy
import gc
import pathlib
import pickle
import shutil
import time
import warnings
import weakref

import numpy as np
import pytest

import cnclik as ck
from cnclik.engine.compiler import can_build
from cnclik.reaching import many, native
from cnclik.reaching.native import Native
from cnclik.reaching.result import PER_TARGET, fields
from tests.reaching.test_reach import ARM, PLANE, WRIST, both_ways, drawn, tips

pytestmark = pytest.mark.skipif(not can_build(), reason="there is no C compiler")


def hard_and_easy(count=120):
    """Targets of a wrist with narrow limits, of which some are beyond the limits, some beyond the arm, one is NaN."""
    held = ck.replace(WRIST, lower=(-1.5,) * 6, upper=(1.5,) * 6)
    targets = tips(WRIST, drawn(WRIST, count, seed=4))
    targets[::3] = tips(held, drawn(held, count, seed=5))[::3]
    targets[5, 2, 3], targets[6, 0, 0] = 7.0, np.nan
    return held, targets


def alike(one, other):
    """Whether two records are the same, bit by bit."""
    return all(np.array_equal(getattr(one, f), getattr(other, f), equal_nan=f != "status") for f in PER_TARGET)


def some(made, ids):
    """The record of some targets."""
    return ck.replace(made, **{name: v[ids] for name, v in fields(made).items()})


def test_an_answer_is_the_targets_own(monkeypatch):
    """Whatever is asked beside it, in whatever order, on however many cores: the same numbers."""
    held, targets = hard_and_easy()
    whole = ck.reach(held, targets)
    assert len(set(whole.status.tolist())) == 5
    order = np.random.default_rng(0).permutation(len(targets))
    monkeypatch.setattr(native, "SMALLEST", 8)
    monkeypatch.setattr(native, "cores", lambda: 3)
    assert alike(ck.reach(held, targets[order]), some(whole, order))
    for k in (0, 1, 5, 6, 7):
        assert alike(ck.reach(held, targets[k : k + 1]), some(whole, [k]))


@pytest.mark.slow
def test_with_and_without_a_compiler_the_statuses_agree():
    held, targets = hard_and_easy(60)
    near = drawn(held, 60, seed=6)
    found = [(ck.reach(held, targets), ck.reach(held, targets, near=near, accept=(0.5, 4.0)))]
    held = ck.replace(held)
    with warnings.catch_warnings(action="error"), ck.use_engine("xla"):
        found.append((ck.reach(held, targets), ck.reach(held, targets, near=near, accept=(0.5, 4.0))))
    assert not any("native" in name and value for name, value in held.__dict__.items())
    for one, other in zip(*found, strict=True):
        assert (one.status == other.status).mean() >= 0.97
        gone = (one.status != 0) & (other.status == one.status) & np.isfinite(one.position_error)
        np.testing.assert_allclose(one.position_error[gone], other.position_error[gone], rtol=0.02, atol=2e-3)


@pytest.mark.parametrize(
    ("compiler", "flags"),
    [
        ("gcc", "-Wall -Wextra -Werror -fsanitize=undefined -fno-sanitize-recover=all"),
        ("clang", "-Wall -Wextra -Werror -Wno-psabi"),
        ("gcc", "-mno-avx"),
        ("gcc", "-Ofast -ffast-math"),  # by which NaN and infinity would mean nothing: left out
    ],
)
def test_what_compilers_make_of_it(compiler, flags, monkeypatch):
    """No warning, nothing undefined, narrower vectors: the same statuses, and answers to rounding."""
    if not shutil.which(compiler):
        pytest.skip(f"{compiler} is not installed")
    held, targets = hard_and_easy()
    first, path = ck.reach(held, targets), ck.reach(held, targets[::3], near="previous", jump=3.0)
    monkeypatch.setenv("CC", compiler)
    monkeypatch.setenv("CFLAGS", flags)
    held = ck.replace(held)
    with warnings.catch_warnings(action="error"):
        made, along = ck.reach(held, targets), ck.reach(held, targets[::3], near="previous", jump=3.0)
    assert (made.status == first.status).all() and (along.status == path.status).all()
    near = np.abs(made.q - first.q).max(axis=1) < 1e-6
    assert near[made.solved].mean() > 0.95  # which try arrives may turn on a rounding


def test_a_compiler_that_fails_is_told_once(monkeypatch):
    monkeypatch.setenv("CC", "false")
    arm = ck.replace(ARM)
    targets = tips(ARM, drawn(ARM, 40))[:, :3, 3]
    with pytest.warns(UserWarning, match="reach runs without native code, .* reports: nothing"):
        assert ck.reach(arm, targets, task=PLANE).solved.all()
    with warnings.catch_warnings(action="error"):
        assert ck.reach(arm, targets, task=PLANE).solved.all()
    with ck.use_engine("xla"), warnings.catch_warnings(action="error"):
        assert ck.reach(ck.replace(ARM), targets, task=PLANE).solved.all()


def test_a_compiler_that_hangs_is_ended(monkeypatch, tmp_path):
    """With what it has started; the search goes on without it."""
    hanging, started = tmp_path / "cc", tmp_path / "started"
    hanging.write_text(f"#!/bin/sh\nsleep 600 &\necho $! >{started}\nwait\n")
    hanging.chmod(0o755)
    monkeypatch.setenv("CC", str(hanging))
    monkeypatch.setattr(native, "LONGEST", 1.0)
    begun = time.monotonic()
    with pytest.warns(UserWarning, match="`compiler` must be done within 1 s"):
        assert ck.reach(ck.replace(ARM), [0.9, 0.8, 0.0], task=PLANE).solved
    assert time.monotonic() - begun < 60
    state = pathlib.Path("/proc", started.read_text().strip(), "stat")
    assert not state.exists() or state.read_text().split()[2] in "ZX"


def test_a_chain_takes_its_code_with_it():
    chain = ck.replace(WRIST)
    assert ck.reach(chain, tips(WRIST, drawn(WRIST, 3))).solved.all()
    (library,) = (weakref.ref(v) for name, v in chain.__dict__.items() if name.startswith("_native"))
    for other in (pickle.loads(pickle.dumps(chain)), copy.deepcopy(chain)):
        assert ck.reach(other, tips(WRIST, drawn(WRIST, 3))).solved.all()
    del chain, other
    gc.collect()
    assert library() is None


@pytest.mark.slow
def test_a_loop_over_many_chains_builds_few(monkeypatch):
    """Programs that serve all chains are sooner ready; a chain that is asked of often gets its own."""
    monkeypatch.setattr(native, "AT_ONCE", Native.libraries + 1)
    begun, lots = Native.libraries, [[0.9, 0.8, 0.0]] * 40
    for length in (0.5, 0.6, 0.7):
        arm = ck.planar_arm([1.0, length])
        assert ck.reach(arm, [0.9, 0.8, 0.0], task=PLANE).solved
        assert ck.reach(arm, lots, task=PLANE).solved.all()
    assert Native.libraries == begun + 1
    for _ in range(many.ALONE):
        assert ck.reach(arm, [0.9, 0.8, 0.0], task=PLANE).solved
    assert Native.libraries == begun + 2


def test_columns_are_rows_of_targets():
    """Arrays whose numbers lie column by column."""
    targets = tips(WRIST, drawn(WRIST, 50))
    where = np.asfortranarray(targets[:, :3, 3])
    for some in (where, (where, np.asfortranarray(targets[:, :3, :3]))):
        made = ck.reach(WRIST, some, task="position", near=np.asfortranarray(drawn(WRIST, 50, seed=2)))
        assert made.solved.all()
        np.testing.assert_allclose(tips(WRIST, made.q)[:, :3, 3], where, atol=2e-6)


def test_what_is_left_alone_still_has_its_arrays(monkeypatch):
    """Threads go on for a while after an exception: what they write to is nobody else's."""
    monkeypatch.setattr(native, "SMALLEST", 64)
    monkeypatch.setattr(native, "cores", lambda: 4)
    held, targets = hard_and_easy(3000)

    def stop(*_):
        raise KeyError("enough")

    for _ in range(3):
        with pytest.raises(KeyError, match="enough"):
            ck.reach(held, targets, progress=stop)
        mine = [np.zeros((3000, width)) for width in (7, 13, 17, 60)]
        time.sleep(0.1)
        assert not any(v.any() for v in mine)


def test_progress_goes_on_and_only_up():
    held, targets = hard_and_easy(1500)
    told = []
    for _ in range(2):
        told.clear()
        ck.reach(held, targets, progress=lambda *done: told.append(done))
        counts = [done for done, _ in told]
        assert counts == sorted(counts) and told[-1] == (1500, 1500) and len(told) > 8
        assert {total for _, total in told} == {1500}


def test_weights_are_for_the_nearest_pose_alone():
    """Different answers are searched for without them."""
    arm = ck.replace(WRIST, lower=(-3.0,) * 6, upper=(3.0,) * 6)
    targets = tips(arm, drawn(arm, 10, seed=8))
    for weights in (None, np.array([1.0, 1.0, 1.0, 1e-8, 1e-8, 1e-8])):
        made = ck.reach(arm, targets, task=ck.pose(weights=weights), solutions=2)
        assert made.solved.all()


def test_what_can_not_be_looked_at_has_no_solutions():
    """Targets whose squares overflow: nothing of what was in memory before."""
    places = np.array([[1.2, 0.3, 0.0], [1e200, 0.0, 0.0], [0.3, 1.2, 0.0]])
    for _ in range(3):
        with np.errstate(over="ignore", invalid="ignore"):
            made = ck.reach(ARM, places, task=PLANE, solutions=2, accept=(0.1, 0.1))
        assert made.status[[0, 2]].max() == 0 and (made.status[1] > ck.ReachStatus.ACCEPTED).all()


@both_ways
def test_a_wound_up_joint_has_its_seeds_where_it_is():
    free = ck.replace(WRIST, lower=(-np.inf,) * 6, upper=(np.inf,) * 6)
    near = drawn(free, 60, seed=1)
    targets = tips(free, near + np.random.default_rng(2).uniform(-2.0, 2.0, near.shape))
    for turn in (0.0, 4 * np.pi):
        made = ck.reach(free, targets, near=near + turn, jump=2.1)
        assert made.solved.mean() > 0.97 and np.abs(made.q - near - turn)[made.solved].max() <= 2.1 + 1e-9


@both_ways
def test_few_seeds_and_a_small_budget_claim_nothing():
    """That limits forbid a target is said where enough was tried, and no sooner."""
    held = ck.replace(WRIST, lower=(-0.5,) * 6, upper=(0.5,) * 6)
    targets = tips(WRIST, drawn(WRIST, 20, seed=9))
    assert (ck.reach(held, targets).status == ck.ReachStatus.AT_LIMIT).mean() > 0.9
    for few in ({"seeds": 1}, {"budget": 10}, {"seeds": 64, "near": np.zeros(6), "jump": 0.2}):
        made = ck.reach(held, targets, **few)
        assert set(made.status.tolist()) <= {ck.ReachStatus.SOLVED, ck.ReachStatus.OUT_OF_BUDGET}


def test_beyond_the_stretched_arm_nothing_is_tried_without_need():
    far = np.tile([5.0, 0.0, 0.0], (300, 1))
    made = ck.reach(ARM, far, task=PLANE, explain=False)
    assert (made.status == ck.ReachStatus.OUT_OF_REACH).all() and made.evaluations.max() == 0
