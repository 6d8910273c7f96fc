"""How loops ended: a run, a stored one, a loop of a map; and maps against the linear boundary."""

import shlex

import jax
import numpy as np
import pytest

import cnclik as ck
from cnclik.engine.compiler import can_build, command
from cnclik.measure import metrics
from cnclik.measure.outcome import Ending, judge, outcome
from cnclik.stability import stability_map

TWO = ck.planar_arm([1.0, 1.0], clockwise=True)
START = np.array([0.2, 1.4])
LAW = ck.Law(TWO, ck.position("xy"), alpha=1.0)
HERE = np.asarray(ck.forward(TWO, START).position[:2])
TARGET = ck.hold(HERE + np.array([0.05, -0.08]))


def ended(z):
    return stability_map(LAW, TARGET, START, alpha=z, Ts=1.0, method="EE", N=120)


@pytest.mark.skipif(not can_build(), reason="no C compiler")
def test_few_loops_run_as_c_too(monkeypatch, tmp_path):
    """By XLA with few passes 1,600 loops of a Panda took two minutes in place of four seconds."""
    own = tmp_path / "cc"
    own.write_text(f'#!/bin/sh\necho >>{tmp_path / "calls"}\nexec {shlex.join(command())} "$@"\n')
    own.chmod(0o755)
    monkeypatch.setenv("CC", str(own))
    assert list(ended([0.5]).ending.values) == [Ending.CONVERGED]
    assert (tmp_path / "calls").exists()


def test_endings_are_told_apart():
    made = ended([0.01, 0.5, 1.0, 2.6])
    assert list(made.ending.values) == [Ending.SLOW, Ending.CONVERGED, Ending.CONVERGED, Ending.DIVERGED]
    assert np.isnan(made.rate[0]) and made.rate[1] == pytest.approx(0.5, abs=0.04)
    assert made.steps[2] <= 3 < made.steps[1] <= 11


ARM = ck.planar_arm([1.0, 1.0])
ARM_LAW = ck.Law(ARM, ck.position("xy"), alpha=1.0)
REST = np.array([0.3, 1.2])


def test_it_agrees_with_outcome_over_z_and_starts():
    home = np.asarray(ck.forward(ARM, REST).position)[:2]
    z, far = (v.ravel() for v in np.meshgrid(np.linspace(0.01, 2.6, 14), [0.01, 0.3, 1.5]))
    x = np.full(len(z), home[0])
    x[-2:] = np.nan, np.inf  # loops that begin with no number

    def both(z, far, x):
        law, q0, target = ck.replace(ARM_LAW, alpha=z), REST + far * np.array([1.0, -0.7]), ck.hold((x, home[1], 0.0))
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
    run = ck.solve(ARM_LAW, ck.hold([1.0, 1.0]), REST, 1.0, 40, "EE")
    names, circle = ["ending", "stable"], ck.circle([1.0, 1.0], 0.1, period=9.0)
    for path, e in ((ck.hold([1.0, 1.0]), 0 * run.e), (circle, run.e)):  # nor one after a moving target
        assert np.isnan([*metrics.measure_run(ck.replace(run, e=e), ARM_LAW, path, names).values()]).all()


def test_through_a_drive_a_run_that_swings_less_and_less_is_stable():
    drive, target = ck.Drive(natural_frequency=20.0, damping_ratio=0.05), ck.hold([1.0, 1.0])
    law = ck.replace(ARM_LAW, alpha=1.7)  # the least stable gain is 2 1/s
    run = ck.solve(law, target, REST, 0.01, 400, "EE", drive=drive)
    assert metrics.measure_run(run, law, target, ["stable"], drive=drive)["stable"] == 1
    assert metrics.measure_run(run, law, target, ["stable"])["stable"] == 0
