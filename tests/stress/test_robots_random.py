"""Random chains and tasks: no NaN without a status, and limits that hold."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import cnclik as ck
from cnclik.integrate.status import Status
from cnclik.problem.names import task_from

pytestmark = pytest.mark.slow
SETTINGS = settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))


LAWS = {
    "pseudoinverse": {},
    "bounded": {"inverse": ck.damped(0.05), "limits": ck.bounded()},
    "scaled": {"inverse": ck.singular_damped(0.05, 0.1), "limits": ck.velocity_scaling()},
}


def dh(values):
    """A 4-joint chain, last joint prismatic, all geometry in arrays: one compilation serves every example."""
    a, alpha, d = np.asarray(values, float).reshape(3, 4)
    bounds = {"lower": [-2.0] * 4, "upper": [2.0] * 4, "velocity_limit": [3.0] * 4}
    return ck.from_dh(a, alpha, d, kinds="RRRP", **bounds)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("task", ["xy", "pose", "rz"])
def test_no_nan_without_a_status(name, task):
    made = task_from(task)
    if name == "pseudoinverse" and made.m > 4:  # more rows than joints only with damping
        made = ck.pose("xyz", "x")
    size = st.floats(-2, 2) | st.sampled_from([0.0, np.pi / 2])

    @settings(SETTINGS, max_examples=15)
    @given(
        geometry=st.lists(size, min_size=12, max_size=12),
        q0=st.lists(st.floats(-3, 3), min_size=4, max_size=4),
        target=st.lists(st.floats(-5, 5) | st.just(1e150), min_size=3, max_size=3),
        z=st.floats(1e-3, 50),
    )
    def check(geometry, q0, target, z):
        law = ck.Law(dh(geometry), made, alpha=z / 0.1, **LAWS[name])
        turn = np.eye(3) if made.orientation else None
        run = ck.solve(law, ck.hold(np.array(target), turn), np.array(q0), 0.1, 12, "EE")
        finite = np.isfinite(np.asarray(run.q[1:])).all(1) & np.isfinite(np.asarray(run.e[:-1])).all(1)
        flagged = (np.asarray(run.status) & int(Status.NON_FINITE)) != 0
        np.testing.assert_array_equal(flagged, ~finite)
        if name == "bounded":  # within limits from wherever it starts, whatever is asked
            speed = np.abs(np.asarray(run.qdot)[finite])
            assert (speed <= 3.0 + 1e-6).all()
            if finite.all():
                inside = np.abs(np.asarray(run.q)) <= np.maximum(2.0, np.abs(q0)) + 1e-6
                assert inside.all()

    check()
