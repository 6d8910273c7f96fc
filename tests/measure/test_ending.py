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
    home = np.asarray(ck.forward(ARM, REST).position)[:2]
    z, far = (v.ravel() for v in np.meshgrid(np.linspace(0.01, 2.6, 14), [0.01, 0.3, 1.5]))
    x = np.full(len(z), home[0])
    x[-2:] = np.nan, np.inf  # loops that begin with no number

    def both(z, far, x):
        law, q0, target = ck.replace(LAW, alpha=z), REST + far * np.array([1.0, -0.7]), ck.hold((x, home[1], 0.0))
        run = ck.solve(law, target, q0, 1.0, 40, "EE")
        found = metrics.measure_run(run, law, target, ["ending", "stable"])
        return found["ending"], found["stable"], outcome(law, target, q0, 1.0, 40, "EE")

    with ck.use_engine("plain"):  # one rounding for both: some of these loops are chaotic
        stored, stable, running = jax.tree.map(np.asarray, jax.jit(jax.vmap(both))(z, far, x))
    np.testing.assert_array_equal(stored, running.ending)
    np.testing.assert_array_equal(stable, running.ending <= Ending.SLOW)
    assert {Ending.CONVERGED, Ending.SLOW, Ending.DIVERGED} <= set(stored)
    assert running.ending[-2:].tolist() == [Ending.DIVERGED] * 2 and running.steps[-2:].tolist() == [41, 41]
    assert np.isnan(running.rate[-2:]).all()


K = np.arange(41)
SWING = 0.97**K * (1.1 + np.cos(2 * np.pi * K / 5))


@pytest.mark.parametrize(
    "sizes, singular, swings, code",
    [
        (0.5**K, [], False, Ending.CONVERGED),
        (0.97**K, [], False, Ending.SLOW),
        (np.r_[1.0, np.full(40, 0.5)], [], False, Ending.STALLED),
        (np.r_[1.0, np.full(40, 0.5)], [3], False, Ending.NEAR_SINGULAR),
        (1.1**K, [], False, Ending.DIVERGED),
        (1.1**K, [20], False, Ending.DIVERGED),  # it had grown before
        (np.r_[np.ones(30), np.full(11, np.nan)], [], False, Ending.DIVERGED),
        (np.full(41, np.nan), [], False, Ending.DIVERGED),  # none of it was ever a number
        (np.full(41, np.inf), [0], False, Ending.DIVERGED),
        (SWING, [], False, Ending.STALLED),
        (SWING, [], True, Ending.SLOW),  # through a drive an error swings: the least before says nothing
    ],
)
def test_every_ending(sizes, singular, swings, code):
    status = np.zeros(40, np.int32)
    status[singular] = int(ck.Status.NEAR_SINGULAR)
    assert jax.jit(judge, static_argnames="swings")(sizes, status, swings=swings).ending == code


def test_a_run_without_an_error_has_no_ending():
    run = ck.solve(LAW, ck.hold([1.0, 1.0]), REST, 1.0, 40, "EE")
    found = metrics.measure_run(ck.replace(run, e=0 * run.e), LAW, ck.hold([1.0, 1.0]), ["ending"])
    assert np.isnan(found["ending"])
