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


def check_boundary(kind, z, limit, within=0.03):
    """Loops are stable below the limit and not beyond it, outside a band of 3 %."""
    beyond = np.asarray(z) / limit
    looked = np.abs(beyond - 1) > within
    assert np.mean((stable(kind) == (beyond < 1))[looked]) >= 0.99


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


@pytest.mark.parametrize(
    ("method", "kind", "limits"),
    [
        ("CN", "picard", {1: 2.0, 2: 1.4780, 5: 1.2149}),
        ("IE", "chord", {5: np.inf}),
    ],
)
def test_measured_boundary_is_the_linear_one(method, kind, limits):
    """Whole nonlinear loops from a small error, outside a band of 3 %; the limits are those of docs/gains.md."""
    for M, limit in limits.items():
        z = min(limit, 12.0) * np.linspace(0.1, 1.6, 41)
        found, _ = endings(SMALL, z, M=[M], method=method, stage=getattr(ck, kind)(5))
        check_boundary(found[0], z, limit)


def test_map_is_labelled_and_carries_the_boundary():
    alpha, Ts = np.geomspace(2, 60, 6), np.geomspace(0.02, 0.2, 5)
    data = stability_map(LAW, TARGET, START, alpha=alpha, Ts=Ts, method="EE", N=80)
    assert data.ending.dims == ("Ts", "alpha") and data.alpha.units == "1/s" and data.Ts.units == "s"
    np.testing.assert_allclose(data.limit, 2 / Ts, rtol=1e-6)
    check_boundary(data.ending.values, data.alpha.values, data.limit.values[:, None])


def test_strip_over_M_shows_odd_and_even_passes():
    strip = stability_map(LAW, SMALL, START, alpha=[1.1], Ts=1.0, M=np.arange(5), method="IE", N=150)
    assert list(stable(strip.ending.values[:, 0])) == [True, False, True, False, True]
