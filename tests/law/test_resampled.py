"""resampled: a smooth path of a stream of targets, which are never known before they come."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from tests.oracles import close

ARM = ck.planar_arm([1.0, 0.8, 0.6])
LAW = ck.Law(ARM, ck.position("xy"), alpha=10.0)
Q0 = np.array([0.3, 1.2, 0.9])
X0 = np.asarray(ck.forward(ARM, Q0).position[:2])
TS = 0.002
TIMES = np.arange(0, 1.0, 1 / 30)
TARGETS = np.stack([np.cos(2 * TIMES), TIMES**2], axis=1)


def sampled(stream, t):
    return np.asarray(jax.vmap(lambda t: stream.curve(t)[0])(t))


def test_a_stream_is_smoothed_and_never_known_before_it_comes():
    gap, t = 1 / 30, np.arange(0, 1.3, 0.001) + 1e-6
    path = sampled(ck.resampled(TIMES, TARGETS), t)
    # The mean of straight lines over a period.
    fine = np.linspace(-gap / 2, gap / 2, 401)
    smooth = [np.interp(t[:, None] - 1.5 * gap + fine, TIMES, x).mean(axis=1) for x in TARGETS.T]
    close(path, np.stack(smooth, axis=1), atol=1e-4)
    changed = TARGETS.copy()
    changed[20:] += 1.0
    other, known = sampled(ck.resampled(TIMES, changed), t), t < TIMES[20]
    close(other[known], path[known], atol=0)
    assert np.abs(other - path).max() > 0.5
    assert not ck.resampled(TIMES, TARGETS).known


def test_a_stream_of_rotations_and_uneven_times():
    turns = np.linspace(0, 1.0, 8)
    rotations = np.stack([np.cos(turns / 2), 0 * turns, 0 * turns, np.sin(turns / 2)], axis=1)
    times = np.cumsum([0, 0.03, 0.05, 0.03, 0.04, 0.03, 0.05, 0.03])
    stream = ck.resampled(times, None, rotations)
    at = jax.vmap(lambda t: stream.curve(t)[1])(np.linspace(0, 0.5, 101))
    angle = np.arctan2(at[:, 1, 0], at[:, 0, 0])
    close(angle[[0, -1]], [0.0, 1.0], atol=1e-9)
    assert (np.diff(angle) >= -1e-12).all() and np.abs(np.diff(angle, 2)).max() < 0.02


def test_a_smooth_stream_shakes_a_fast_loop_less_than_held_targets():
    points = X0 + np.stack([-0.3 * (1 - np.cos(2 * TIMES)), -0.2 * np.sin(3 * TIMES)], axis=1)
    held = ck.path(lambda t: jnp.asarray(points)[jnp.clip((t * 30 + 1e-6).astype(int), 0, len(points) - 1)])
    shaken = []
    for stream in (ck.resampled(TIMES, points), held):
        run = ck.solve(LAW, stream, Q0, TS, 450, "EE")
        shaken.append(np.abs(np.diff(np.asarray(run.qdot), axis=0)[100:]).max() / TS)
    assert shaken[0] < 0.5 * shaken[1]


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: ck.resampled([0.0, 1.0]), "`positions` must be given, or `rotations`"),
        (lambda: ck.resampled([0.0, 0.0], np.zeros((2, 2))), "`times` must increase"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_line(made, words):
    with pytest.raises(ck.ArgumentError, match=words):
        made()
