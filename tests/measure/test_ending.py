"""Ending: how a run ended, the same from a stored one and from a loop of a map."""

import jax
import numpy as np
import pytest

import cnclik as ck
from cnclik.measure import metrics
from cnclik.measure.outcome import Ending, judge, outcome

ARM = ck.planar_arm([1.0, 1.0])
LAW = ck.Law(ARM, ck.position("xy"), alpha=1.0)
REST = np.array([0.3, 1.2])


def test_it_agrees_with_outcome_over_z_and_starts():
    target = ck.hold(ck.forward(ARM, REST).position)
    z, far = (v.ravel() for v in np.meshgrid(np.linspace(0.01, 2.6, 14), [0.01, 0.3, 1.5]))

    def both(z, far):
        law, q0 = ck.replace(LAW, alpha=z), REST + far * np.array([1.0, -0.7])
        run = ck.solve(law, target, q0, 1.0, 40, "EE")
        found = metrics.measure_run(run, law, target, ["ending", "stable"])
        return found.ending, found.stable, jax.tree.leaves(outcome(law, target, q0, 1.0, 40, "EE"))[0]

    with ck.use_engine("plain"):  # one rounding for both: some of these loops are chaotic
        stored, stable, running = map(np.asarray, jax.jit(jax.vmap(both))(z, far))
    np.testing.assert_array_equal(stored, running)
    np.testing.assert_array_equal(stable, running <= Ending.SLOW)
    assert {Ending.CONVERGED, Ending.SLOW, Ending.DIVERGED} <= set(stored)


@pytest.mark.parametrize(
    "sizes, singular, code",
    [
        (0.5 ** np.arange(41), [], Ending.CONVERGED),
        (0.97 ** np.arange(41), [], Ending.SLOW),
        (np.r_[1.0, np.full(40, 0.5)], [], Ending.STALLED),
        (np.r_[1.0, np.full(40, 0.5)], [3], Ending.NEAR_SINGULAR),
        (1.1 ** np.arange(41), [], Ending.DIVERGED),
        (1.1 ** np.arange(41), [20], Ending.DIVERGED),  # it had grown before
        (np.r_[np.ones(30), np.full(11, np.nan)], [], Ending.DIVERGED),
        (np.zeros(41), [], np.nan),
        (np.full(41, np.nan), [], Ending.DIVERGED),  # none of it was ever a number
        (np.full(41, np.inf), [0], Ending.DIVERGED),
    ],
)
def test_every_ending(sizes, singular, code):
    status = np.zeros(40, np.int32)
    status[singular] = int(ck.Status.NEAR_SINGULAR)
    run, law = ck.solve(LAW, ck.hold([1.0, 1.0]), REST, 1.0, 40, "EE"), LAW
    run = ck.replace(run, e=np.asarray(sizes)[:, None] * np.array([0.6, 0.8]), status=status)
    found = metrics.measure_run(run, law, ck.hold([1.0, 1.0]), ["ending"])
    np.testing.assert_equal(float(found.ending), float(code))


def test_swings_that_become_smaller_are_slow():
    """Through a drive an error swings: the least of the quarter before says nothing."""
    k = np.arange(41)
    size, status = 0.97**k * (1.1 + np.cos(2 * np.pi * k / 5)), np.zeros(40, np.int32)
    assert [judge(size, status, swings=swings).ending for swings in (False, True)] == [Ending.STALLED, Ending.SLOW]


def test_a_loop_that_begins_with_no_number_has_diverged():
    bad = np.array([np.nan, np.inf])
    found = jax.jit(jax.vmap(lambda x: outcome(LAW, ck.hold((x, 1.0, 0.0)), REST, 1.0, 8, "EE")))(bad)
    assert found.ending.tolist() == [Ending.DIVERGED] * 2 and found.steps.tolist() == [9, 9]
    assert np.isnan(found.rate).all()
