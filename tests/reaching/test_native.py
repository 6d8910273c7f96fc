"""The native search: of what C is built from it, whose answers those are, and what happens without a compiler."""

import copy
import gc
import pickle
import shutil
import warnings
import weakref

import numpy as np
import pytest

import cnclik as ck
from cnclik.reaching import many, native
from cnclik.reaching.native import Native
from tests.reaching.test_reach import ARM, PLANE, WRIST, drawn, tips


def hard_and_easy(count=120):
    """Targets of a wrist with narrow limits, of which some are beyond the limits, some beyond the arm, one is NaN."""
    held = ck.replace(WRIST, lower=(-1.5,) * 6, upper=(1.5,) * 6)
    targets = tips(WRIST, drawn(WRIST, count, seed=4))
    targets[::3] = tips(held, drawn(held, count, seed=5))[::3]
    targets[5, 2, 3], targets[6, 0, 0] = 7.0, np.nan
    return held, targets


def alike(one, other):
    """Whether two records are the same, bit by bit."""
    fields = ("q", "status", "position_error", "orientation_error", "evaluations", "at_limit", "distance")
    return all(np.array_equal(getattr(one, f), getattr(other, f), equal_nan=f != "status") for f in fields)


def some(made, ids):
    """The record of some targets."""
    names = ("q", "status", "position_error", "orientation_error", "evaluations", "at_limit", "distance")
    return ck.replace(made, **{name: getattr(made, name)[ids] for name in names})


def test_an_answer_is_the_targets_own(monkeypatch):
    """Whatever is asked beside it, in whatever order, on however many cores: the same numbers."""
    held, targets = hard_and_easy()
    whole = ck.reach(held, targets)
    assert len(set(whole.status.tolist())) == 4
    order = np.random.default_rng(0).permutation(len(targets))
    monkeypatch.setattr(native, "SMALLEST", 8)
    monkeypatch.setattr(native, "cores", lambda: 3)
    assert alike(ck.reach(held, targets[order]), some(whole, order))
    for k in (0, 1, 5, 6, 7):
        assert alike(ck.reach(held, targets[k : k + 1]), some(whole, [k]))


def test_with_and_without_a_compiler_the_statuses_agree(monkeypatch):
    held, targets = hard_and_easy(60)
    near = drawn(held, 60, seed=6)
    found = [(ck.reach(held, targets), ck.reach(held, targets, near=near, accept=(0.5, 4.0)))]
    monkeypatch.setattr(native, "can_build", lambda: False)
    held = ck.replace(held)
    with warnings.catch_warnings(action="error"):
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
    with pytest.warns(UserWarning, match="reach runs without native code: .* says"):
        assert ck.reach(arm, targets, task=PLANE).solved.all()
    with warnings.catch_warnings(action="error"):
        assert ck.reach(arm, targets, task=PLANE).solved.all()
    with ck.use_hints(False), warnings.catch_warnings(action="error"):
        assert ck.reach(ck.replace(ARM), targets, task=PLANE).solved.all()


def test_a_chain_takes_its_code_with_it():
    chain = ck.replace(WRIST)
    assert ck.reach(chain, tips(WRIST, drawn(WRIST, 3))).solved.all()
    (library,) = (weakref.ref(v) for name, v in chain.__dict__.items() if name.startswith("_native"))
    for other in (pickle.loads(pickle.dumps(chain)), copy.deepcopy(chain)):
        assert ck.reach(other, tips(WRIST, drawn(WRIST, 3))).solved.all()
    del chain, other
    gc.collect()
    assert library() is None


def test_a_loop_over_many_chains_builds_few(monkeypatch):
    """Programs that serve all chains are sooner ready; a chain that is asked of often gets its own."""
    monkeypatch.setattr(native, "AT_ONCE", Native.libraries + 1)
    begun = Native.libraries
    for length in (0.5, 0.6, 0.7):
        arm = ck.planar_arm([1.0, length])
        assert ck.reach(arm, [0.9, 0.8, 0.0], task=PLANE).solved
    assert Native.libraries == begun + 1
    for _ in range(many.ALONE):
        assert ck.reach(arm, [0.9, 0.8, 0.0], task=PLANE).solved
    ck.reach(ck.planar_arm([1.0, 0.8]), [[0.9, 0.8, 0.0]] * (native.FEW + 1), task=PLANE)
    assert Native.libraries == begun + 2
