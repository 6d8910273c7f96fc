"""Retargeting of the bench: mink's answers, in one go, in pieces, and from a file."""

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
    truth, seen, _ = made
    ours, theirs = np.asarray(call(bodies.begun(truth[0], seen[None])[0], seen)), bodies.mink_run(truth, seen)()
    for found in (ours, theirs):
        seen_of = bodies.quality(found, made)
        assert seen_of.links < 6 and seen_of.feet < 9 and seen_of.beyond == seen_of.faster == 0
    assert np.sqrt(np.mean((ours - theirs)[:, bodies.BASE :] ** 2)) < 2e-3


def test_a_clip_in_pieces_is_the_clip(clip):
    """After 15 frames of run-in nothing is left of where a piece began."""
    (truth, seen, _), call = clip
    whole = np.asarray(call(bodies.begun(truth[0], seen[None])[0], seen))
    cut = bodies.pieces(seen)
    each = [
        np.asarray(call(q, piece))[bodies.RUN_IN :] for q, piece in zip(bodies.begun(truth[0], cut), cut, strict=True)
    ]
    off = np.abs(np.concatenate(each) - whole)[bodies.RUN_IN :, bodies.BASE :]
    assert np.max(off) < 0.02 and np.sqrt(np.mean(off**2)) < 1e-3


def test_a_standing_foot_slides_less_where_it_is_held(clip):
    """The truth stands; what is seen of it follows the noise; where a foot is held, only the rest pulls at it."""
    made, call = clip
    q0, sliding = bodies.begun(made.truth[0], made.seen[None])[0], lambda q: bodies.quality(q, made).sliding
    seen, held = (np.asarray(call(q0, each)) for each in (made.seen, bodies.held(made)))
    assert sliding(made.truth) < 0.01 and sliding(held) < 60 < 250 < sliding(seen)
