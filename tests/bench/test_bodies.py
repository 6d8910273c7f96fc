"""Retargeting of the bench: mink's answers, in one go, in pieces, and from a file."""

import jax
import numpy as np
import pytest

from tests.bench import bodies

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def clip():
    truth, seen = bodies.clip(3)
    call = jax.jit(bodies.retarget(bodies.law()))
    return truth, seen, call


def test_the_answers_are_minks(clip):
    """Both follow the same clip; what is left is that mink's errors are of whole poses, ours of places and turns."""
    pytest.importorskip("mink")
    truth, seen, call = clip
    ours, theirs = np.asarray(call(bodies.begun(truth[0], seen[None])[0], seen)), bodies.mink_run(truth, seen)()
    for found in (ours, theirs):
        (links, feet), beyond = bodies.quality(found, truth)
        assert links < 6 and feet < 9 and beyond == 0
    assert np.sqrt(np.mean((ours - theirs)[:, bodies.BASE :] ** 2)) < 2e-3


def test_a_clip_in_pieces_is_the_clip(clip):
    """After 15 frames of run-in nothing is left of where a piece began."""
    truth, seen, call = clip
    whole = np.asarray(call(bodies.begun(truth[0], seen[None])[0], seen))
    cut = bodies.pieces(seen)
    each = [
        np.asarray(call(q, piece))[bodies.RUN_IN :] for q, piece in zip(bodies.begun(truth[0], cut), cut, strict=True)
    ]
    off = np.abs(np.concatenate(each) - whole)[bodies.RUN_IN :, bodies.BASE :]
    assert np.max(off) < 0.02 and np.sqrt(np.mean(off**2)) < 1e-3
