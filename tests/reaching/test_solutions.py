"""Several solutions: all that closed forms know, what different means, and what a summary counts."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cnclik as ck
from cnclik import ReachStatus
from tests.reaching.test_reach import drawn, tips

# Modified Denavit-Hartenberg parameters of an arm whose wrist is spherical.
A, ALPHA = (0.0, 0.16, 0.78, 0.15, 0.0, 0.0), (0.0, -np.pi / 2, 0.0, -np.pi / 2, np.pi / 2, -np.pi / 2)
THETA, D = (0.0, -np.pi / 2, 0.0, 0.0, 0.0, np.pi), (0.49, 0.0, 0.0, 0.66, 0.0, 0.11)


def arm(limit=np.pi):
    dh = map(list, (A, ALPHA, D, THETA))
    return ck.from_dh(*dh, convention="modified", lower=[-limit] * 6, upper=[limit] * 6)


def turn(axis, angle):
    return Rotation.from_euler(axis, angle).as_matrix()


def in_closed_form(target):
    """All joint values (K, 6) of a target (4, 4): shoulder, elbow and wrist each one way or the other (Pieper 1968)."""
    wrist, found = target[:3, 3] - D[5] * target[:3, 2], []
    for shoulder, elbow, flip in itertools.product((0, 1), (1, -1), (1, -1)):
        first = np.arctan2(wrist[1], wrist[0]) + shoulder * np.pi
        x, y, _ = turn("x", ALPHA[1]).T @ (turn("z", first).T @ (wrist - [0, 0, D[0]])) - [A[1], 0, 0]
        upper, fore = A[2], np.hypot(A[3], D[3])
        cosine = (x * x + y * y - upper**2 - fore**2) / (2 * upper * fore)
        if abs(cosine) > 1:
            continue
        bend = elbow * np.arccos(cosine)
        second = np.arctan2(y, x) - np.arctan2(fore * np.sin(bend), upper + fore * np.cos(bend))
        third = bend - np.arctan2(D[3], A[3])
        to_wrist = turn("z", first) @ turn("x", ALPHA[1]) @ turn("z", second) @ turn("z", third)
        left = turn("x", -ALPHA[3]) @ to_wrist.T @ target[:3, :3]  # Rz(θ4) Ry(−θ5) Rz(θ6)
        nod = flip * np.arccos(np.clip(left[2, 2], -1, 1))
        fourth = np.arctan2(flip * left[1, 2], flip * left[0, 2])
        sixth = np.arctan2(flip * left[2, 1], -flip * left[2, 0])
        q = np.array([first, second, third, fourth, -nod, sixth]) - THETA
        found.append(q - 2 * np.pi * np.round(q / (2 * np.pi)))
    return np.array(found).reshape(-1, 6)


def apart(q, others):
    """The largest joint's difference (K,), without whole turns."""
    gap = np.abs(others - q)
    return np.abs(gap - 2 * np.pi * np.round(gap / (2 * np.pi))).max(axis=1)


def complete(chain, targets, made):
    """Of which targets every solution in closed form, within the limits, was found, or one that is not different."""
    limit, done = chain.upper[0], []
    for target, q, status in zip(targets, made.q, made.status, strict=True):
        known = in_closed_form(target)
        np.testing.assert_allclose(tips(chain, known), np.tile(target, (len(known), 1, 1)), atol=1e-9)
        known = known[(np.abs(known) <= limit - 1e-6).all(axis=1)]
        done.append(all((apart(k, q[status == 0]) < 0.1).any() for k in known))
    return np.array(done)


@pytest.mark.parametrize("limit", [np.pi, 2.5])
def test_all_that_the_closed_form_knows(limit, count=75):
    chain = arm(limit)
    targets = tips(chain, np.random.default_rng(3).uniform(-limit, limit, (count, 6)))
    made = ck.reach(chain, targets, solutions=12)
    assert complete(chain, targets, made).sum() >= count - 1
    there = tips(chain, made.q.reshape(-1, 6)).reshape(count, 12, 4, 4)
    right = np.abs(there - targets[:, None]).max(axis=(2, 3))
    assert (right[made.status == 0] < 3e-6).all()
    for q, status in zip(made.q, made.status, strict=True):
        own = q[status == 0]
        assert all((apart(v, np.delete(own, k, axis=0)) >= 0.1).all() for k, v in enumerate(own))


def test_a_solution_at_a_limit_is_one():
    chain = ck.replace(ck.planar_arm([1.0, 1.0]), lower=(-2.0, 0.0), upper=(2.0, 2.5))
    for bend in (0.0, 2.5):
        made = ck.reach(chain, tips(chain, np.array([[0.4, bend]]))[0, :3, 3], task=ck.position("xy"), solutions=3)
        assert made.status.tolist() == [0, 6, 6]  # NO_OTHER, as files hold it


def test_solutions_of_two_links():
    """Elbow up and elbow down, the nearer first; a summary counts them; out of reach there is one nearest pose."""
    two, task = ck.planar_arm([1.0, 1.0]), ck.position("xy")
    targets = tips(two, np.array([[0.3, 1.0], [-0.4, -0.7], [np.pi, np.pi / 2]]))[:, :3, 3]  # a joint at ±π is at one
    made = ck.reach(two, targets, task=task, solutions=3)
    assert made.q.shape == (3, 3, 2) and str(made) == "6 SOLVED, 3 NO_OTHER"
    assert (made.status[:, 2] == ReachStatus.NO_OTHER).all() and np.isnan(made.q[:, 2]).all()
    for k in range(2):
        np.testing.assert_allclose(tips(two, made.q[:, k])[:, :2, 3], targets[:, :2], atol=2e-6)
    assert (np.sign(made.q[:, 0, 1]) == -np.sign(made.q[:, 1, 1])).all()
    near = ck.reach(two, targets, task=task, solutions=2, near=[0.3, 1.0])
    assert near.distance[0, 0] < 1e-5 and (near.distance[:, 0] <= near.distance[:, 1]).all()
    far = ck.reach(two, [5.0, 0, 0], task=task, solutions=2)
    assert far.status.tolist() == [ReachStatus.OUT_OF_REACH, ReachStatus.NO_OTHER] and np.isfinite(far.q[0]).all()
    assert str(far) == "1 OUT_OF_REACH, 1 NO_OTHER"
    sliding = ck.from_dh([1.0, 1.0, 0.0], [0.0] * 3, [0.0] * 3, kinds="RRP", lower=[-3, -3, 0], upper=[3, 3, 9])
    assert ck.reach(sliding, [1.2, 0.9, 7.0], task=ck.position(), solutions=4).status.tolist() == [0, 0, 6, 6]


def test_solved_is_within_each_tolerance():
    """Also after a posture with a smaller sum of both errors, of which one is beyond its tolerance."""
    six = arm()
    made = ck.reach(six, tips(six, drawn(six, 200)), tolerance=(1e-2, 1e-1), solutions=3)
    assert made.solved.mean() > 0.8
    assert made.position_error[made.solved].max() <= 1e-2 and made.orientation_error[made.solved].max() <= 0.1 + 1e-12
