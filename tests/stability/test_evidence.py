"""The committed studies, small: lanes of one program against loops run one by one."""

import numpy as np
import pytest

import cnclik as ck
from cnclik.problem.build import problem_from, reference_from
from cnclik.stability import evidence

ROBOT = {"robots": ["planar:1,1"], "tasks": ["xy"]}


def test_agreement_is_full_for_small_errors_and_the_limits_are_those_of_each_M():
    found = evidence.agreement_study(
        **ROBOT, methods=["EE", "IE"], picard=[1, 2], chord=[], sizes=[1e-5], z=[0.1, 1.5, 8], directions=2, N=120,
        band=0.03,
    )  # fmt: skip
    assert list(found.case.values) == ["EE", "IE picard(1)", "IE picard(2)"]
    np.testing.assert_allclose(found.limit, [2, 1, 1.3532], atol=1e-4)
    assert (found.agreement == 1).all() and (found.unstable_inside == 0).all() and (found.stable_outside == 0).all()


def test_reaching_and_tracking_are_those_of_loops_run_one_by_one():
    reported = []
    found = evidence.implicit_study(
        **ROBOT, methods=["IE"], picard=[2], chord=[1], sizes=[0.1], z=[0.5, 1.0, 2], directions=1, N=80,
        tolerance=1e-6, track={"radius": 0.1, "evaluations": 48, "z": [0.5]},
        progress=lambda done, total: reported.append((done, total)),
    )  # fmt: skip
    assert reported[-1] == (6, 6)  # two cases, two z and one circle each
    one = problem_from("planar:1,1", task="xy", alpha=1.0)
    move = evidence._moves(one.law, 0.2, 1, 0)
    start = evidence.maps.starts(one.law, one.q0, move)[0]
    here = ck.hold(np.asarray(ck.pose(one.law.chain, one.q0).position[:2]))
    circle = reference_from("circle", one.law.chain, one.law.task, one.q0, radius=0.2, period=1.0)
    for case, stage, cost in (("IE picard(2)", ck.picard(2), 3), ("IE chord(1)", ck.chord(1), 2)):
        for z in (0.5, 1.0):
            e = np.linalg.norm(ck.solve(ck.replace(one.law, alpha=z), here, start, 1.0, 80, "IE", stage).e, axis=-1)
            assert found.steps.sel(case=case, z=z).item() == np.flatnonzero(e > 1e-6)[-1] + 1
        N = 48 // cost
        run = ck.solve(ck.replace(one.law, alpha=0.5 * N), circle, one.q0, 1 / N, 2 * N, "IE", stage)
        rms = np.sqrt(np.mean(np.sum(np.asarray(run.e[N : 2 * N]) ** 2, -1)))
        assert found.rms.sel(case=case).item() == pytest.approx(rms, rel=1e-6)
