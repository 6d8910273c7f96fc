"""A run that the described loop has not made is refused, and none that it may have made."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.integrate.solve import in_pieces, joined, simulate
from cnclik.record import replace
from cnclik.stability import verdict

ARM = ck.planar_arm([1.0, 0.8, 0.6])
Q0 = np.array([0.3, 1.2, 0.9])
X0 = np.asarray(ck.forward(ARM, Q0).position[:2])
TS = 0.01
LAW = ck.Law(ARM, ck.position("xy"), alpha=5.0)
CIRCLE = ck.circle(X0 - [0.2, 0.0], 0.2, period=2.0)
PACE = ck.Pace(velocity=2.0, acceleration=10.0, jerk=300.0)
LATE = ck.Drive(delay=3)
ERRORS = np.random.default_rng(0).normal(size=(300, 2)) * 1e-3


def run_of(N=300, method="EE", law=LAW, q0=Q0, **how):
    return simulate(law, CIRCLE, q0, TS, N, method, ck.picard(5), **how)


def judge(run, law=LAW, Ts=TS, method="EE", **how):
    return verdict(law, CIRCLE, run, Ts=Ts, method=method, **how)


@pytest.mark.parametrize(
    ("made", "said"),
    [
        pytest.param(dict(drive=LATE), {}, id="a drive left out"),
        pytest.param({}, dict(drive=LATE), id="a drive that was not there"),
        pytest.param(dict(drive=LATE), dict(drive=ck.Drive(delay=2.9)), id="another dead time"),
        pytest.param(dict(drive=ck.Drive(lag=0.02)), {}, id="a lag left out"),
        pytest.param(dict(noise=ERRORS), {}, id="noise left out"),
        pytest.param(dict(method="RK4"), {}, id="another method"),
        pytest.param(dict(method="AB2"), {}, id="a multistep method"),
        pytest.param(dict(law=replace(LAW, alpha=4.9)), {}, id="another gain"),
        pytest.param(dict(pace=PACE), dict(pace=ck.Pace(velocity=2.0, acceleration=5.0)), id="another pace"),
        pytest.param({}, dict(pace=replace(PACE, wait=False)), id="a pace whose path does not wait"),
    ],
)
def test_a_run_of_another_loop_is_refused(made, said):
    """A drive that was left out was not noticed: a verdict was given on a loop that nobody had run."""
    run = run_of(**made)
    with pytest.raises(ck.ArgumentError, match="`run` must be made by the loop that is described, with its drive"):
        judge(run, **said)


def test_a_pace_that_the_record_contradicts_is_refused():
    """It was accepted without a word, and the remedies were tried at it."""
    with pytest.raises(ck.ArgumentError, match="`pace` must be left out, or have wait=False"):
        judge(run_of(), pace=PACE)
    with pytest.raises(ck.ArgumentError, match="`pace` must be the run's, in which the path waited"):
        judge(run_of(pace=PACE), pace=replace(PACE, wait=False))


LOST = replace(LAW, alpha=1000.0, inverse=ck.transpose())
SINGULAR = np.zeros(3)


@pytest.mark.parametrize(
    "how",
    [
        dict(),
        dict(drive=LATE),
        dict(drive=ck.Drive(lag=0.05, joint_noise=1e-4)),
        dict(pace=PACE),
        dict(pace=replace(PACE, wait=False), drive=LATE),
        dict(method="AB2"),
        dict(law=LOST),
        dict(q0=SINGULAR),
        dict(q0=SINGULAR, method="RK4", law=replace(LAW, alpha=300.0)),
    ],
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_run_of_the_loop_is_judged(how, dtype):
    how = dict(method="EE", law=LAW, q0=Q0) | how
    run = run_of(**how | {"q0": dtype(how["q0"])})
    assert run.q.dtype == dtype
    del how["q0"]
    assert judge(run, **how).sentence


def part(run, begin, every=1):
    """Every so many instants of a run, from one on."""
    names = ("t", "q", "x", "e"), ("qdot", "residual", "contraction", "status")
    points = {name: np.asarray(getattr(run, name))[begin::every] for name in names[0]}
    steps = {name: np.asarray(getattr(run, name))[begin::every][: len(points["t"]) - 1] for name in names[1]}
    return replace(run, **points, **steps)


def test_what_cannot_be_judged_passes():
    assert judge(run_of(noise=ERRORS), noise=1e-3).sentence
    assert judge(part(run_of(), 0, 4), Ts=4 * TS).sentence  # sampled more rarely than it was run
    assert judge(part(run_of(drive=LATE), 100), drive=LATE).sentence  # what was under way is not known
    assert judge(part(run_of(), 100)).sentence
    assert judge(run_of(), Ts=1.001 * TS).sentence
    assert judge(run_of(t0=0.5, drive=LATE), drive=LATE).sentence


def test_runs_by_other_programs_are_of_the_same_loop():
    lanes = jax.vmap(lambda q: ck.solve(LAW, CIRCLE, q, TS, 50, "EE"))(jnp.stack([Q0, Q0 + 0.1]))
    assert judge(jax.tree.map(lambda v: v[1], lanes)).sentence
    pieces = joined(in_pieces(LAW, CIRCLE, Q0, TS, 60, "EE", ck.picard(5), size=20), 60)
    assert judge(pieces).sentence
    single = run_of(q0=np.float32(Q0))
    kept = {name: np.asarray(getattr(single, name), np.float64) for name in ("t", "q", "x", "e", "qdot")}
    assert judge(replace(single, **kept)).sentence  # in another precision
