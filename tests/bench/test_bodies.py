"""Retargeting of the bench: mink's answers."""

import jax
import numpy as np
import pytest

from tests.bench import bodies

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def clip():
    made = bodies.clip(3)
    call = jax.jit(bodies.retarget(bodies.law()))
    return made, call


def test_the_answers_are_minks(clip):
    """Both follow the same clip; what is left is that mink's errors are of whole poses, ours of places and turns."""
    pytest.importorskip("mink")
    made, call = clip
    truth, seen = made
    ours, theirs = np.asarray(call(bodies.begun(truth[0], seen[None])[0], seen)), bodies.mink_run(truth, seen)()
    for found in (ours, theirs):
        seen_of = bodies.quality(found, made)
        assert seen_of.links < 6 and seen_of.feet < 9 and seen_of.beyond == seen_of.faster == 0
    assert np.sqrt(np.mean((ours - theirs)[:, bodies.BASE :] ** 2)) < 2e-3
