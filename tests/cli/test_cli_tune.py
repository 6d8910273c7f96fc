"""`cnclik tune` and `cnclik rivals` as a user meets them."""

import json
import re

import numpy as np
import pytest

from cnclik.cli import main
from tests.bench.rivals import Row, as_csv, grid_of, page

ARM = ["tune", "planar-clockwise:1,1", "--reference", "line", "--from", "1", "1", "--to", "0", "1", "--q0", "0"]
ARM += [str(np.pi / 2), "--method", "EE", "--Ts", "0.1", "--N", "30", "--steps", "40"]
KEYS = {"alpha", "Ts", "z", "values", "bounds", "spectral_radius", "spectral_radius_before", "margin", "satisfied"}
KEYS |= {"violation", "loss", "loss_before", "loss_after", "status", "why", "gradient", "lines", "history", "config"}


def tuned(tmp_path, *options):
    main([*ARM, *map(str, options), "--out", str(tmp_path)])
    return json.loads((tmp_path / "tuned.json").read_text())


def test_everything_a_controller_needs(tmp_path, capsys):
    made = tuned(tmp_path, "--margin", 0.5, "--damping", 0.01)
    assert set(made) >= KEYS
    assert made["config"]["margin"] == 0.5 and made["config"]["damping"] == 0.01 and made["config"]["steps"] == 40
    assert made["satisfied"] and 0.49 < made["spectral_radius"] <= 0.5 * (1 + 1e-9)
    np.testing.assert_allclose(made["z"], made["alpha"] * 0.1, rtol=1e-12)
    assert made["loss_after"] < made["loss_before"]
    # A rate: the line itself, run as a controller would, is the step of the loop that was tuned.
    import cnclik as ck

    arm, q = ck.planar_arm([1.0, 1.0], clockwise=True), np.array([0.1, 1.4])
    J, e, xdot_d = np.asarray(ck.jacobian(arm, q))[:2], np.array([0.03, -0.02]), np.array([-1 / 3, 0.0])
    J_damped = J.T @ np.linalg.inv(J @ J.T + 1e-4 * np.eye(2))
    line = made["lines"]["rate"].split("#")[0].removeprefix("qdot = ")
    qdot = eval(line, {"J_damped": J_damped, "e": e, "xdot_d": xdot_d})
    np.testing.assert_allclose(qdot, J_damped @ (xdot_d + made["alpha"] * e), rtol=1e-5)
    # pink and mink: a gain per step, at most 1.
    gain, dt, damping = (
        float(re.search(rf"{k}=([^,)]+)", made["lines"]["pink_mink"])[1]) for k in ("gain", "dt", "damping")
    )
    assert (gain, dt) == (1.0, 0.1) and "beyond the 1" in made["lines"]["pink_mink"] and made["z"] > 1
    np.testing.assert_allclose(damping, 1e-4)
    summary = (tmp_path / "summary.md").read_text()
    for name in ("history", "error", "operating", "responses"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000 and f"({name}.png)" in summary
    assert made["lines"]["rate"] in summary and "all kept" in summary
    assert "Wrote" in capsys.readouterr().out


def test_infeasible_margin_is_in_the_summary(tmp_path, capsys):
    made = tuned(tmp_path, "--margin", 0.5, "--damping", 0.01, "--alpha-bounds", 0.1, 1, "--no-figures")
    assert not made["satisfied"] and made["status"] == "infeasible" and 0.7 < made["violation"] < 0.9
    assert "NOT kept" in capsys.readouterr().out


@pytest.mark.parametrize(
    "options, told",
    [
        ("--loss trakcing", "did you mean 'tracking'"),
        ("--loss jerk=x", "weights as numbers"),
        ("--loss tracking=0", "weight above 0"),
        ("--margin 1.5", "`margin` must be at most 1"),
        ("--alpha-bounds 5 1", "must increase"),
        ("--over gian", "must be one of alpha"),
        ("--over damping", "damped"),
        ("--over", "name something to tune"),
        ("--shape square", "shape"),
        ("--steps 0", "steps"),
        ("--delay 1.5", "an integer"),
    ],
)
def test_one_line_and_exit_code_2(options, told, tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([*ARM, *options.split(), "--out", str(tmp_path / "out")])
    err = capsys.readouterr().err
    assert stopped.value.code == 2 and err.count("\n") == 1 and told in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("options, told", [("--cases 3-dof", "cases"), ("--gains vector", "gains")])
def test_rivals_refuse_what_is_unknown(options, told, tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["rivals", *options.split(), "--out", str(tmp_path / "out")])
    err = capsys.readouterr().err
    assert stopped.value.code == 2 and err.count("\n") == 1 and told in err


def test_rivals_page_and_csv():
    row = Row("2-dof line", "scalar", "grid", np.inf, False, 1.2, 0.0, 100, 1.5, 0.5, [5.0])
    assert "| not finite | NO | 1.200 | 100 | 1.5 | 0.50 |" in page([row], 0.9, 100)
    assert as_csv([row]).splitlines()[1] == "2-dof line,scalar,grid,inf,False,1.2,0.0,100,1.5,0.5,[5.0]"


@pytest.mark.parametrize("axes", [0, 1, 2, 3, 6])
def test_grid_uses_no_more_than_it_may(axes):
    from cnclik.tuning import parameters as pm

    start = np.full((axes,), 5.0) if axes else 5.0
    p = pm.parameter("alpha", start, 0.01, 100.0, None)
    grid = grid_of(p, 100)
    each = max(2, int(100 ** (1 / max(axes, 1)) + 1e-9))
    assert grid.shape == (each ** max(axes, 1), *np.shape(start)) and len(grid) <= 100
    assert np.all(grid > 0.01) and np.all(grid < 100) and grid.min() < 1 < 20 < grid.max()


@pytest.mark.slow
def test_gradient_is_no_worse_than_its_rivals(tmp_path, capsys):
    from tests.bench.rivals import rivals

    rows = {r.way: r for r in rivals("2-dof line", "per-axis", steps=60)}
    assert len(rows) == 4 and all(r.satisfied and r.evaluations <= 60 for r in rows.values())
    assert rows["gradient"].loss <= min(r.loss for r in rows.values()) * (1 + 1e-6)
    assert rows["gradient"].loss < 0.5 * rows["hand-picked α = 5"].loss
