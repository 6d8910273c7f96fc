"""The paper's experiments: against plain NumPy, and against numbers computed by others beforehand."""

import itertools

import numpy as np
import pytest

import cnclik as ck
from cnclik.paper import claims
from cnclik.paper import readings as paper
from cnclik.paper.readings import READINGS
from tests.oracles import planar_law, planar_position
from tests.refusals import refusals

MEANS = [  # arm, case, reading, EE, IE, CN: mean of ‖e‖ over k = 0 … 30, as printed
    ("2dof", "reach", "on-path/once", "0.0677", "0.0953", "0.0785"),
    ("5dof", "reach", "on-path/once", "0.0638", "0.1033", "0.0775"),
    ("2dof", "reach", "printed/once", "0.188", "0.247", None),  # CN: decided by rounding
    ("5dof", "reach", "printed/once", "0.707", "0.730", "0.616"),
    ("2dof", "track", "on-path/once/consistent", "1.08e-3", "1.13e-3", "1.81e-4"),
    ("5dof", "track", "on-path/once/consistent", "8.11e-4", "8.65e-4", "1.38e-4"),
    ("2dof", "track", "on-path/once/printed", "0.1245", "0.1205", "0.1229"),
    ("2dof", "track", "on-path/twice/consistent", "1.08e-3", "2.78e-2", "1.35e-2"),
]

RMS = {  # over k = 1 … 30, Case II, on-path/once/consistent, as printed: 2-dof, 5-dof
    "EE": ("1.123e-3", "8.49e-4"),
    "IE": ("1.188e-3", "9.07e-4"),
    "HEUN": ("3.66e-4", "2.78e-4"),
    "CN": ("1.89e-4", "1.45e-4"),
    "MIDPOINT": ("1.83e-4", "1.45e-4"),
    "TRAPEZOID": ("6.12e-6", "4.80e-6"),
    "RK4": ("3.62e-6", "2.89e-6"),
}


def same_digits(value, printed):
    """Whether a number rounds to the digits that are printed."""
    mantissa, _, exponent = printed.partition("e")
    unit = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
    return abs(value - float(printed)) <= 0.5 * unit * (1 + 1e-9)


@pytest.mark.parametrize("arm, case, reading, means", [(*row[:3], row[3:]) for row in MEANS])
def test_mean_errors_to_printed_digits(results, arm, case, reading, means):
    readings = [reading] if case == "track" else [f"{reading}/consistent", f"{reading}/printed"]
    for name in readings:
        at = results.trajectories.mean_error.sel(arm=arm, case=case, reading=name)
        for method, printed in zip(paper.PAPER, means, strict=True):
            if printed is not None:
                assert same_digits(float(at.sel({"method": method})), printed), (name, method)


@pytest.mark.parametrize("method", RMS)
def test_rms_errors_to_printed_digits(results, method):
    for arm, printed in zip(paper.ARMS, RMS[method], strict=True):
        rms = results.methods.rms_error.sel({"arm": arm, "case": "track", "method": method, "Ts": 0.1})
        assert same_digits(float(rms), printed), arm


def test_printed_feedforward_settles_where_feedback_balances_it(results):
    final = results.trajectories.final_error.sel(case="track", reading="on-path/once/printed")
    np.testing.assert_allclose(final, (1 - 1 / 3) / paper.ALPHA, rtol=0.01)


def test_observed_orders(results):
    """At the finest halving; CN is of order 2 although it is not the textbook method."""
    for method, order in {"EE": 1, "IE": 1, "CN": 2, "TRAPEZOID": 2, "MIDPOINT": 2, "RK4": 4}.items():
        np.testing.assert_allclose(results.methods.order.sel({"method": method}).isel(Ts=-1), order, atol=0.05)
        assert ck.METHODS[method].order == order


# --- against the oracle -------------------------------------------------------------------------------


def by_numpy(n, case, method, rotation="on-path", Ts_reading="once", feedforward="consistent"):
    """Errors ‖e[k]‖ (31,) and joint paths (31, n), straight from the paper's equations."""
    Ts, N, sense, velocity = 0.1, 30, -1.0 if rotation == "on-path" else 1.0, np.zeros(2)
    begin, moved = np.array({2: (1.0, 0.0), 5: (3.0, 1.0)}[n]), np.zeros(2)
    if case == "track":
        begin, moved = np.array({2: (1.0, 1.0), 5: (4.0, 1.0)}[n]), np.array([-1 / N, 0.0])
        velocity = np.array([-1 / 3 if feedforward == "consistent" else -1.0, 0.0])
    slope = planar_law(np.ones(n), lambda k: begin + k * moved, lambda k: velocity, 5.0, sense)
    path = [np.eye(n)[1] * np.pi / 2]
    for k in range(N):
        q = path[-1]
        first = implicit = slope(q, k)
        for _ in range(5):
            implicit = slope(q + (Ts if Ts_reading == "once" else Ts * Ts) * implicit, k + 1)
        path.append(q + Ts * {"EE": first, "IE": implicit, "CN": (first + implicit) / 2}[method])
    tips = [planar_position(np.ones(n), q, sense) for q in path]
    return np.linalg.norm(begin + np.arange(N + 1)[:, None] * moved - tips, axis=1), np.array(path)


@pytest.mark.parametrize("reading", READINGS)
@pytest.mark.parametrize("arm, case", list(itertools.product(paper.ARMS, paper.CASES)))
def test_trajectories_against_numpy(results, arm, case, reading):
    for method in paper.PAPER:
        at = results.trajectories.sel({"arm": arm, "case": case, "reading": reading, "method": method})
        norm, q = by_numpy(paper.ARMS[arm].n, case, method, *READINGS[reading])
        if float(at.spread) < 1e-11:
            np.testing.assert_allclose(at.q.values[:, : q.shape[1]], q, atol=1e-9)
        if float(at.spread) < 1e-6:  # elsewhere rounding decides, and there is nothing to compare
            np.testing.assert_allclose(at.error_norm, norm, atol=1e-7, rtol=1e-6)


def test_what_rounding_decides_is_marked(results):
    """The 2-dof arm at its folded singularity, and nothing else."""
    found = set(claims.undetermined(results.trajectories))
    assert {(arm, case, method) for arm, _, case, method in found} == {("2dof", "reach", "IE"), ("2dof", "reach", "CN")}
    assert {reading for _, reading, _, _ in found} == {"printed/once/consistent", "printed/once/printed"}


# --- one run by itself --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arm, case, method, reading",
    [("2dof", "reach", "CN", "on-path/twice/printed"), ("5dof", "track", "CN", "printed/once/consistent")],
)
def test_an_experiment_is_the_committed_run(results, arm, case, method, reading):
    run = paper.experiment(arm, case, method, reading)
    committed = results.trajectories.sel({"arm": arm, "case": case, "reading": reading, "method": method})
    np.testing.assert_allclose(run.q, committed.q[:, : run.q.shape[1]], rtol=1e-7, atol=1e-9)
    for name in ("e", "status"):
        np.testing.assert_allclose(getattr(run, name), committed[name], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(run.residual, committed.residual, atol=1e-12)
    assert int(run.evaluations) == int(committed.evaluations) == paper.N * (6 if method == "CN" else 1)


test_wrong_names_are_refused = refusals(
    (lambda: paper.experiment("2dof", "reach", reading="on-path/once/consistant"), "did you mean 'on-path/once/cons"),
    (lambda: paper.experiment("3dof", "reach"), "Argument `arm` must be one of 2dof, 5dof"),
    (lambda: paper.experiment("2dof", "hold"), "Argument `case` must be one of reach, track"),
    (lambda: paper.experiment("2dof", "reach", "CM"), "Argument `method` must be one of"),
)
