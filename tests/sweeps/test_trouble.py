"""Trouble: paths that are what they are called, and measures with a known value."""

import numpy as np
import pytest

import cnclik as ck
from cnclik.measure.metrics import chatter
from cnclik.robot.posture import arm_length as length
from cnclik.sweeps import trouble


def test_chatter_counts_what_is_taken_back():
    steps = np.arange(40)
    back_and_forth = np.stack([0.3 * (-1.0) ** steps, 0.4 * (-1.0) ** steps, np.ones(40)], axis=1)
    assert chatter(back_and_forth) == pytest.approx(0.5, rel=1e-12)
    assert chatter(np.exp(-0.5 * steps)[:, None]) == 0  # slowing down, however hard
    assert chatter(np.where(steps < 20, (-1.0) ** steps, 1.0)[:, None]) == 0  # over in the first half


def test_paths_are_trouble():
    chain = ck.ur5()
    _, threshold, paths = trouble._paths(chain)
    assert set(paths) == set(trouble.PATHS) and threshold > 0
    half, end = trouble.N * trouble.TS / 2, trouble.N * trouble.TS
    start, reference = paths["unreachable"]
    assert np.linalg.norm(reference.curve(end)[0]) > 1.2 * length(chain)
    start, reference = paths["singularity"]
    np.testing.assert_allclose(reference.curve(0.0)[0], ck.pose(chain, start).position, atol=1e-12)
    np.testing.assert_allclose(reference.curve(end)[0], ck.pose(chain, start).position, atol=1e-9)
    least = trouble._least(chain)
    assert least(trouble._singular(chain, start, least)[None])[0] < 1e-3 < 0.05 < least(start[None])[0]
    # In the middle of the path, the joint with the least room is 0.2 rad past its limit.
    start, reference = paths["limit"]
    there = start + trouble._beyond(chain, start)
    past = np.maximum(there - chain.upper, np.array(chain.lower) - there)
    assert past.max() == pytest.approx(0.2, abs=1e-12) and np.sum(past > 0) == 1
    np.testing.assert_allclose(reference.curve(half)[0], ck.pose(chain, there).position, atol=1e-9)


def test_the_page_has_every_row_and_their_summary():
    rows = [
        {"path": path, "robot": robot, "method": method, "position_rms": size, "orientation_rms": 2 * size}
        | {"fastest": 1.0, "fastest_share": 0.5 * size, "past_limit": 0.0, "chatter": 0.0}
        | {"NEAR_SINGULAR": 1, "AT_LIMIT": 2, "NON_FINITE": 0, "NOT_CONVERGED": 0}
        for path in trouble.PATHS
        for robot, size in (("a", 1.0), ("b", 3.0), ("c", 4.0))
        for method in trouble.METHODS
    ]
    lines = trouble.page(rows).splitlines()
    count = len(trouble.PATHS) * len(trouble.METHODS)
    assert sum(line.startswith("|") for line in lines) == (3 + 1) * count + 2 * (len(trouble.PATHS) + 1)
    # Medians 3 and 6; of the speeds the largest, 2.
    assert "| limit | pseudoinverse | 3.00e+00 | 6.00e+00 | 2 | 0 | 0 | 0 |" in lines
