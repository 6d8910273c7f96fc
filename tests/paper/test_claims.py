"""Verdicts on the paper's claims, and the form of claims.json."""

import json

import numpy as np
import pytest

from cnclik.paper import claims, readings
from cnclik.paper.readings import READINGS


@pytest.fixture(scope="module")
def judged(results):
    return claims.judge(results.trajectories, results.passes)


def test_schema(judged):
    assert set(judged) == {"rows", "picard"} and len(READINGS) == 8
    where = [(r["arm"], r["case"], r["reading"]) for r in judged["rows"]]
    assert sorted(where) == sorted((a, c, r) for a in ("2dof", "5dof") for c in ("reach", "track") for r in READINGS)
    for row in judged["rows"]:
        assert set(row) == {"arm", "case", "reading", "mean_error", "final_error", "claim", "holds"}
        assert list(row["mean_error"]) == list(row["final_error"]) == ["EE", "IE", "CN"]
    json.dumps(judged, allow_nan=False)


def test_verdicts(judged):
    """(b) needs on-path/once/consistent; (a) in full holds only for the 5-dof arm under printed/once."""
    held = {(r["arm"], r["case"], r["reading"]) for r in judged["rows"] if r["holds"]}
    assert held == {
        ("2dof", "track", "on-path/once/consistent"),
        ("5dof", "track", "on-path/once/consistent"),
        ("5dof", "reach", "printed/once/consistent"),
        ("5dof", "reach", "printed/once/printed"),
    }


def test_an_error_that_is_no_number_holds_no_claim():
    assert claims.holds("track", {"EE": 2.0, "IE": 3.0, "CN": 1.0}) and claims.SIGNIFICANT == 0.5
    assert not any(claims.holds(case, {"EE": 2.0, "IE": 3.0, "CN": float("nan")}) for case in ("reach", "track"))


def test_picard_records(judged, results):
    """Linear theory: a pass shrinks its error by a·alpha·Ts, a = 1 if Ts enters once, Ts if it enters twice."""
    assert len(judged["picard"]) == 64
    for record in (r for r in judged["picard"] if r["reading"].startswith("on-path")):
        z = 0.5 if "/once/" in record["reading"] else 0.05
        assert record["contraction"] == pytest.approx(z, rel=0.05)
    at = {(r["arm"], r["case"], r["reading"], r["method"]): r for r in judged["picard"]}
    track = at["2dof", "track", "on-path/once/consistent", "CN"]
    assert track["holds"] and track["needed"] == {"1e-02": 1, "1e-03": 2, "1e-04": 5, "1e-06": 12, "1e-08": 18}
    reach = at["5dof", "reach", "on-path/once/consistent", "IE"]
    assert not reach["holds"] and reach["needed"]["1e-03"] == 13
    assert at["2dof", "reach", "printed/once/consistent", "CN"]["needed"]["1e-03"] is None
    assert at["5dof", "track", "on-path/twice/consistent", "CN"]["needed"]["1e-06"] == 5
    # After M passes the followed residual is the one the run itself reported.
    where = {"arm": "5dof", "case": "track", "reading": "on-path/once/consistent", "method": "CN"}
    followed = results.passes.residual.sel({**where, "pass": readings.M})
    np.testing.assert_allclose(followed, results.trajectories.residual.sel(where), rtol=1e-6, atol=1e-13)
