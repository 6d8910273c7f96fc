"""What does not fit is said in one line: nothing is run with it, and no other error comes of it."""

import numpy as np
import pytest

import cnclik as ck
from cnclik import stability as st

ARM = ck.planar_arm([1.0, 1.0])
LAW = ck.Law(ARM, ck.position("xy"), alpha=5.0)
Q = np.array([0.3, 1.2])
GOAL = ck.hold([1.0, 1.0])


def outcomes(**changes):
    return st.outcomes(LAW, GOAL, **({"q0": Q, "alpha": 5.0, "Ts": 0.1} | changes))


def verdict(law=LAW, reference=GOAL, run=None, Ts=0.1):
    return st.verdict(law, reference, ck.solve(LAW, GOAL, Q, 0.1, 3) if run is None else run, Ts=Ts)


@pytest.mark.parametrize(
    "call, told",
    [
        (lambda: st.recommend(3, None, Q, Ts=0.1), "`law` must be a Law"),
        (lambda: st.recommend(LAW, 3, Q, Ts=0.1), "`reference` must be a Reference"),
        (lambda: st.recommend(LAW, None, Q, Ts=0.1, reach=-1), "`reach` must be positive"),
        (lambda: st.margin(LAW, None, Q, Ts=None), "`Ts` must be a number"),
        (lambda: st.settle(3, GOAL, Q), "`law` must be a Law"),
        (lambda: st.stability_region("EE", points=0), "`points` must be at least 2"),
        (lambda: outcomes(alpha=[]), "one loop at least"),
        (lambda: outcomes(alpha=[1.0, 2.0], Ts=[0.1, 0.1, 0.1]), "go with each other"),
        (lambda: outcomes(q0=[0.0, 0.0, 0.0]), r"`q0` must have shape \(..., 2\)"),
        (lambda: outcomes(Ts=-0.1), "`Ts` must be positive"),
        (lambda: outcomes(M=-1, method="IE"), "`M` must be at least 0"),
        (lambda: outcomes(tolerance=-1), "`tolerance` must be positive"),
        (lambda: st.passes_map(LAW, GOAL, Q, z=[0.5], M=["a"], method="IE"), "`M` must be an integer"),
        (lambda: st.passes_map(LAW, GOAL, Q, z=[0.5], M=[1], method="EE"), "`method` must be implicit"),
        (lambda: st.certified_radius(LAW, Q, Ts="a"), "`Ts` must be a number"),
        (lambda: st.sampled_attraction(LAW, Q, radii=[0.1], Ts=0.1, directions=0), "`directions` must be at least 1"),
        (lambda: verdict(run=3), "`run` must be a Trajectory"),
        (lambda: st.amplification("EE", None, "x"), "`z` must be a finite number, or an array of them, but is 'x'"),
        (lambda: st.amplification("EE", None, [1.0, np.nan]), "`z` must be a finite number"),
        (lambda: st.delayed_radius("EE", None, {}, 1), "`z` must be a finite number"),
        (lambda: st.delay_limit(100_000), "`delay` must be at most 101, but is 100000"),
        (lambda: st.stability_region("EE", real=3.0), r"`real` must have shape \(2,\)"),
        (lambda: st.stability_map(5, GOAL, Q, alpha=[1.0], Ts=[0.1]), "`law` must be a Law, but is int"),
        (lambda: st.responses(5, None, Q, Ts=0.1), "`law` must be a Law, but is int"),
        (lambda: st.sampled_attraction(5, Q, radii=[0.1], Ts=0.1), "`law` must be a Law, but is int"),
        (lambda: st.sampled_attraction(LAW, Q, radii=[-1.0], Ts=0.1), "`radii` must hold positive numbers"),
        (lambda: st.sampled_attraction(LAW, Q, radii=[0.1], Ts=0.1, seed="x"), "`seed` must be a number"),
        (lambda: st.curvature_bound("arm"), "`chain` must be a Chain, but is str"),
        (lambda: outcomes(M=1.5, method="IE"), "`M` must be whole"),
        (lambda: st.passes_map(LAW, GOAL, Q, z=[0.5], M=5, method="IE"), "`M` must be numbers of passes, but is 5"),
        (lambda: st.passes_map(LAW, GOAL, Q, z=[0.5], M=[1], method="IE", Ts=None), "`Ts` must be a number"),
        (lambda: ck.maximize_manipulability("arm", ck.position("xy")), "`chain` must be a Chain, but is str"),
        (lambda: ck.maximize_manipulability(ck.panda(), "xy"), "`task` must be a Task, but is str"),
        (lambda: ck.lanes(3), "`fn` must be a function of one lane, but is 3"),
        (lambda: ck.lanes(len, quick=np.zeros(2)), "`quick` must be True or False"),
        (lambda: ck.reach(ck.panda(), [0.4, 0, 0.4], task="position", explain=[1]), "`explain` must be True or False"),
        (lambda: ck.sweeps.run_spec(3), "`spec` must be a path, but is int"),
        (lambda: ck.sweeps.run_spec("a.toml", set="alpha=3"), "`set` must be strings NAME=VALUE, but is 'alpha=3'"),
        (lambda: ck.sweeps.run_spec("a.toml", progress=3), "`progress` must be a function or None, but is 3"),
        (lambda: ck.require_ok(5), "`run` must be a Trajectory, but is int"),
        (lambda: st.certified_radius(5, Q, Ts=0.1), "`law` must be a Law, but is int"),
        (lambda: verdict(reference=None), "`reference` must be a Reference"),
        (lambda: verdict(ck.Law(ck.planar_arm([1.0] * 3), ck.position("xy"), alpha=1.0)), "Trajectory of this law"),
        (lambda: verdict(Ts=0.01), r"`Ts` must be the run's, 0\.1 s, but is 0\.01"),
    ],
)
def test_what_does_not_fit_is_named(call, told):
    with pytest.raises(ck.ArgumentError, match=told) as error:
        call()
    assert "\n" not in str(error.value)


def test_nothing_is_certain_at_a_singularity():
    assert st.certified_radius(LAW, [0.0, 0.0], Ts=0.1) == 0.0


def test_a_method_that_swings_through_dead_time_is_named():
    law = ck.Law(ck.planar_arm([1.0, 0.8]), ck.position("xy"), alpha=5.0)
    for method, what in (("ZNN4", "without overshoot"), ("IFD5", "stable")):
        drive = ck.Drive(delay=2 * (method == "IFD5"))
        with pytest.raises(ck.ArgumentError, match=f"leave some gain {what}.*EXP-AB2.* is {method}, which"):
            ck.advise(law, None, [0.3, 1.1], Ts=0.01, method=method, drive=drive)
