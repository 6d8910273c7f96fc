"""How whole nonlinear loops ended; maps of it against the linear boundary."""

import shlex

import jax
import numpy as np
import pytest

import cnclik as ck
from cnclik.engine.compiler import can_build, command
from cnclik.measure.outcome import Ending, outcome, stable
from cnclik.stability import stability_map

TWO = ck.planar_arm([1.0, 1.0], clockwise=True)
START = np.array([0.2, 1.4])
LAW = ck.Law(TWO, ck.position("xy"), alpha=1.0)
HERE = np.asarray(ck.forward(TWO, START).position[:2])
TARGET = ck.hold(HERE + np.array([0.05, -0.08]))
SMALL = ck.hold(HERE + np.array([3e-7, -5e-7]))


def endings(reference, z, M=None, **options):
    made = stability_map(LAW, reference, START, alpha=z, Ts=1.0, M=M, N=120, **({"method": "EE"} | options))
    return made.ending.values, made


@pytest.mark.skipif(not can_build(), reason="no C compiler")
def test_few_loops_run_as_c_too(monkeypatch, tmp_path):
    """By XLA with few passes 1,600 loops of a Panda took two minutes in place of four seconds."""
    own = tmp_path / "cc"
    own.write_text(f'#!/bin/sh\necho >>{tmp_path / "calls"}\nexec {shlex.join(command())} "$@"\n')
    own.chmod(0o755)
    monkeypatch.setenv("CC", str(own))
    assert list(endings(TARGET, [0.5])[0]) == [Ending.CONVERGED]
    assert (tmp_path / "calls").exists()


def test_endings_are_told_apart():
    kind, made = endings(TARGET, [0.01, 0.5, 1.0, 2.6])
    assert list(kind) == [Ending.SLOW, Ending.CONVERGED, Ending.CONVERGED, Ending.DIVERGED]
    assert np.isnan(made.rate[0]) and made.rate[1] == pytest.approx(0.5, abs=0.04)
    assert made.steps[2] <= 3 < made.steps[1] <= 11


def test_a_bounded_wrong_loop_is_not_converged():
    """Just beyond the boundary EE wanders within its reach. Where it ends is chaotic, and so differs between
    processors; that it does not arrive is not."""
    starts = START + np.random.default_rng(3).uniform(-0.3, 0.3, (64, 2))
    law = ck.replace(LAW, alpha=2.1)
    made = ck.lanes(lambda q0: outcome(law, TARGET, q0, 1.0, 120, "EE"))(starts)
    made = jax.tree.map(np.asarray, made)
    assert not stable(made.ending).any() and np.median(made.final) > 1.0 and made.final.max() < 10.0


def test_measured_boundary_is_the_linear_one():
    """Whole nonlinear loops from a small error, outside a band of 3 %; tests/stability has methods and drives."""
    z = 12.0 * np.linspace(0.1, 1.6, 41)
    found, _ = endings(SMALL, z, M=[5], method="IE", stage=ck.chord(5))
    assert np.mean(stable(found[0])) >= 0.99
