"""tests.bench.timing: the loops it times are `solve`'s, and its numbers are counted right."""

import jax
import numpy as np
import pytest

import cnclik as ck
from tests.bench import cases
from tests.bench import timing as bench
from tests.bench.lines import Line


@pytest.mark.parametrize(
    "robot, method, stage",
    [("planar2", ck.TRAPEZOID, ck.chord(2)), pytest.param("ur5", ck.EE, ck.picard(5), marks=pytest.mark.slow)],
)
def test_final_is_the_end_of_solve(robot, method, stage):
    case = cases.ROBOTS[robot]()
    q0, *target = (values[1] for values in cases.inputs(case, 2, "float64").values())
    reference = ck.hold(*target)
    whole = ck.solve(case.law, reference, q0, cases.TS, 3, method, stage)
    q, error = jax.jit(cases.loop(case, 3, method, stage))(q0, *target)
    np.testing.assert_allclose(q, whole.q[-1], rtol=0, atol=1e-13)
    np.testing.assert_allclose(error, np.linalg.norm(whole.e[-1]), rtol=0, atol=1e-13)
    loss = cases.tracking_loss(case, 3, method, stage)(np.asarray(cases.ALPHA), q0, *target)
    np.testing.assert_allclose(loss, np.mean(np.linalg.norm(whole.e, axis=1) ** 2), rtol=0, atol=1e-13)


@pytest.mark.parametrize("robot", ["planar5", "ur5", pytest.param("chain30", marks=pytest.mark.slow)])
def test_targets_can_be_reached_and_starts_differ(robot):
    case = cases.ROBOTS[robot]()
    given = cases.inputs(case, 5000, "float32")
    assert {a.dtype for a in given.values()} == {np.dtype("float32")}
    assert len(np.unique(given["q0"], axis=0)) == 5000
    assert len(np.unique(given["position"], axis=0)) == 4096
    # The goals are poses within the spread of the posture: no farther from it than all joints can carry the tip.
    at = ck.forward(case.law.chain, np.array(case.posture)).position
    reach = 4.0 * case.law.chain.n * case.spread  # no arm here is longer than 5 m
    assert np.linalg.norm(given["position"] - at, axis=1).max() < reach
    assert ("rotation" in given) == bool(case.law.task.orientation)


def test_steps_shrink_with_the_batch_and_obey_N():
    line = Line(robot="panda", method="EE", stage="picard")
    assert bench.steps_for(line, 1) == 50
    assert bench.steps_for(ck.replace(line, batch=1_000_000), 1) == 25
    assert bench.steps_for(ck.replace(line, batch=1_000_000), 6) == 25
    assert bench.steps_for(ck.replace(line, N=7), 6) == 7


def test_timing_is_median_and_quartiles():
    t = bench.timing([5.0, 1.0, 2.0, 3.0, 4.0])
    assert (t.low, t.median, t.high, t.runs) == (2.0, 3.0, 4.0, 5)
    assert t.spread == 2 / 3
    assert bench.timing([2.0]).median == 2.0


@pytest.mark.parametrize(
    "change, message",
    [
        ({"robot": "pandas"}, "Argument `robot` must be one of planar2, planar5, panda, ur5, chain30"),
        ({"batch": 0}, "Argument `batch` must be at least 1, but is 0."),
        ({"cores": 4096}, "Argument `cores` must be at most"),
        ({"N": 0}, "Argument `N` must be at least 1, but is 0."),
    ],
)
def test_lines_that_cannot_be_run(change, message):
    with pytest.raises(ck.ArgumentError, match=message):
        Line(**{"robot": "panda", "method": "EE", "stage": "picard"} | change)
