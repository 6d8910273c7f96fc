"""Verdicts on the paper's claims, and the form of claims.json."""

import json

import pytest

from cnclik.paper import READINGS, claims, readings


@pytest.fixture(scope="module")
def judged(results):
    return claims.judge(results.trajectories, results.passes)


def test_schema(judged):
    assert set(judged) == {"rows", "picard"}
    where = {(r["arm"], r["case"], r["reading"]) for r in judged["rows"]}
    assert where == {(a, c, r) for a in ("2dof", "5dof") for c in ("reach", "track") for r in READINGS}
    assert len(judged["rows"]) == 32 and len(READINGS) == 8
    for row in judged["rows"]:
        assert set(row) == {"arm", "case", "reading", "mean_error", "final_error", "claim", "holds"}
        assert list(row["mean_error"]) == list(row["final_error"]) == ["EE", "IE", "CN"]
        assert type(row["holds"]) is bool and type(row["claim"]) is str
        assert all(type(v) is float for v in (*row["mean_error"].values(), *row["final_error"].values()))
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


@pytest.mark.parametrize(
    "case, errors, held",
    [
        ("reach", {"EE": 2.0, "IE": 3.0, "CN": 1.0}, True),
        ("reach", {"EE": 3.0, "IE": 2.0, "CN": 1.0}, False),
        ("track", {"EE": 2.0, "IE": 3.0, "CN": 1.0}, True),
        ("track", {"EE": 2.0, "IE": 3.0, "CN": 1.1}, False),
        ("track", {"EE": 2.0, "IE": 3.0, "CN": float("nan")}, False),
    ],
)
def test_what_holding_means(case, errors, held):
    assert claims.holds(case, errors) is held


def test_picard_contracts_by_z_or_by_z_times_Ts(judged):
    """Linear theory: a pass shrinks its error by a·alpha·Ts, a = 1 if Ts enters once, Ts if it enters twice."""
    for record in judged["picard"]:
        if record["reading"].startswith("on-path"):
            z = 0.5 if "/once/" in record["reading"] else 0.05
            assert record["contraction"] == pytest.approx(z, rel=0.05)


def test_picard_records(judged):
    assert len(judged["picard"]) == 64
    at = {(r["arm"], r["case"], r["reading"], r["method"]): r for r in judged["picard"]}
    track = at["2dof", "track", "on-path/once/consistent", "CN"]
    assert track["holds"] and track["needed"] == {"1e-02": 1, "1e-03": 2, "1e-04": 5, "1e-06": 12, "1e-08": 18}
    reach = at["5dof", "reach", "on-path/once/consistent", "IE"]
    assert not reach["holds"] and reach["needed"]["1e-03"] == 13
    assert at["2dof", "reach", "printed/once/consistent", "CN"]["needed"]["1e-03"] is None
    assert at["5dof", "track", "on-path/twice/consistent", "CN"]["needed"]["1e-06"] == 5


def test_followed_passes_are_those_of_the_run(results):
    """After M passes the followed residual is the one the run itself reported."""
    import numpy as np

    where = {"arm": "5dof", "case": "track", "reading": "on-path/once/consistent", "method": "CN"}
    followed = results.passes.residual.sel({**where, "pass": readings.M})
    np.testing.assert_allclose(followed, results.trajectories.residual.sel(where), rtol=1e-6, atol=1e-13)
