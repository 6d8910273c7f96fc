"""`cnclik reproduce`, the committed results, which are what the code produces, and its verdicts on claims."""

import json

import numpy as np
import pytest
import xarray as xr
from PIL import Image

from cnclik.cli import main
from cnclik.paper import claims, readings
from cnclik.paper import figures as pictures
from cnclik.writing import LIST
from tests.paper.conftest import COMMITTED, load

FIGURES = [*(f"fig{i:02d}.png" for i in range(1, 16)), "overview.png"]
DATA = {"claims.json", "claims.md", "trajectories.nc", "methods.nc", "passes.nc"}
READING = "on-path/once/consistent"
TELLS = 1e-13  # [rad] last change of an iteration from which its ratio to the one before is more than rounding


@pytest.fixture(scope="module")
def fresh(tmp_path_factory):
    """A folder that the command has just written: the one time that everything is run."""
    folder = tmp_path_factory.mktemp("paper")
    main(["reproduce", "--out", str(folder)])
    return folder


@pytest.fixture(scope="module")
def ours(fresh):
    return load(fresh)


def decided(trajectories):
    """Runs that rounding does not decide, as a mask."""
    return trajectories.spread < readings.UNDETERMINED


@pytest.mark.slow
def test_committed_data_are_what_the_code_gives(ours, results):
    mask = decided(ours.trajectories)
    xr.testing.assert_equal(mask, decided(results.trajectories))
    for name, data in ours._asdict().items():
        other = getattr(results, name)
        assert set(data.variables) == set(other.variables) and data.attrs["config"] == other.attrs["config"]
        for variable in set(data.data_vars) - {"spread"}:
            a, b = data[variable], other[variable]
            if {"reading", "case"} <= set(a.dims):  # a residual at a state that rounding decides is no number either
                keep = mask.sel({"method": data.method}) if name == "passes" else mask
                a, b = a.where(keep), b.where(keep)
            if name == "passes":  # an iteration that has once gone half a turn wanders on as rounding decides
                far = np.maximum.accumulate(other[variable].fillna(0.0).values, axis=b.dims.index("pass")) > np.pi
                a, b = a.where(~far), b.where(~far)
            if variable == "contraction":  # a ratio of two changes, each with a rounding: a number above it only
                a, b = (x.where(other.residual > TELLS) for x in (a, b))
            # Far from convergence (5-dof arm, printed rotation) a pass multiplies rounding, pass after pass.
            loose = name == "passes" or variable in ("residual", "contraction", "status")
            # An order is the logarithm of a ratio of errors, of which RK4's smallest are a few roundings large.
            rtol = 1e-2 if loose else 1e-5 if variable == "order" else 1e-7
            np.testing.assert_allclose(a, b, rtol=rtol, atol=1e-9, err_msg=f"{name}.{variable}")


@pytest.mark.slow
def test_committed_files_and_verdicts_are_what_the_code_gives(fresh):
    assert {p.name for p in fresh.iterdir()} - {LIST} == {*FIGURES, *DATA} == {p.name for p in COMMITTED.iterdir()}
    ours, theirs = (json.loads((folder / "claims.json").read_text()) for folder in (fresh, COMMITTED))
    for name in ("rows", "picard"):
        keys = ("arm", "case", "reading", "holds")
        assert [[r[k] for k in keys] for r in ours[name]] == [[r[k] for k in keys] for r in theirs[name]]


def test_committed_claims_follow_from_committed_data(results):
    judged = json.loads((COMMITTED / "claims.json").read_text())
    assert claims.judge(results.trajectories, results.passes) == judged
    text = claims.page(judged, results)
    assert text == (COMMITTED / "claims.md").read_text(encoding="utf-8")
    for name, (_, about) in pictures.figures(*results).items():
        assert f"- `{name}`: {about['Title']}\n" in text


def test_numbers_of_the_page_are_those_of_the_data(results):
    text = " ".join((COMMITTED / "claims.md").read_text(encoding="utf-8").split())
    runs, first = results.trajectories.sel(reading=READING), results.methods.isel(Ts=0)
    mean, final = runs.mean_error, results.trajectories.final_error
    for arm, name in (("2dof", "2-dof"), ("5dof", "5-dof")):
        reach, track = (mean.sel(arm=arm, case=case).to_series().to_dict() for case in ("reach", "track"))
        assert f"{name}: {', '.join(f'{m} {v:.4f}' for m, v in reach.items())}" in text
        assert f"{min(track['EE'], track['IE']) / track['CN']:.1f} times ({name})" in text
    at = dict(case="track", method="CN")
    others = "TRAPEZOID", "HEUN", "MIDPOINT", "RK4", "EXP-MIDPOINT"
    assert f"| method | {' | '.join(others)} |" in text
    for arm, name in (("2dof", "2-dof"), ("5dof", "5-dof")):
        rms = first.rms_error.sel(case="track", arm=arm).to_series().to_dict()
        each = " | ".join(f"{rms['CN'] / rms[m]:.2g}" for m in others)
        assert f"| {name} arm | {each} |" in text
    twice = final.sel(arm="2dof", case="track", reading="on-path/twice/consistent").to_series().to_dict()
    assert f"They end at {twice['IE']:.3f} m and {twice['CN']:.3f} m" in text
    off = final.sel(case="track", reading="on-path/once/printed").values
    assert f"the runs end at {off.min():.3f} to {off.max():.3f} m" in text
    judged = claims.picard(results.passes)
    for reading, contraction in ((READING, "measured 0.51"), ("on-path/twice/consistent", "measured 0.052")):
        one = next(r for r in judged if (r["arm"], r["reading"]) == ("5dof", reading) and r.items() >= at.items())
        assert contraction == f"measured {one['contraction']:.2g}" and contraction in text
        assert f"{one['residual_max'][readings.M]:.0e} rad, and {one['needed']['1e-06']} passes are needed" in text


@pytest.mark.slow
def test_committed_figures_are_what_the_code_draws(fresh, ours):
    """They have fewer colours."""
    for name, (_, about) in pictures.figures(*ours).items():
        drawn, committed = (Image.open(folder / name) for folder in (fresh, COMMITTED))
        assert drawn.text == {"Software": "cnclik"} | about == {key: committed.text[key] for key in drawn.text}
        away = np.asarray(drawn.convert("RGB"), int) - np.asarray(committed.convert("RGB"), int)
        assert np.mean(np.abs(away).max(axis=2) > 60) < 1e-3, name


def test_an_error_that_is_no_number_holds_no_claim():
    assert claims.holds("track", {"EE": 2.0, "IE": 3.0, "CN": 1.0}) and claims.SIGNIFICANT == 0.5
    assert not any(claims.holds(case, {"EE": 2.0, "IE": 3.0, "CN": float("nan")}) for case in ("reach", "track"))


def test_picard_records(results):
    """Linear theory: a pass shrinks its error by a·alpha·Ts, a = 1 if Ts enters once, Ts if it enters twice."""
    for record in (r for r in claims.picard(results.passes) if r["reading"].startswith("on-path")):
        z = 0.5 if "/once/" in record["reading"] else 0.05
        assert record["contraction"] == pytest.approx(z, rel=0.05)
    # After M passes the followed residual is the one the run itself reported.
    where = {"arm": "5dof", "case": "track", "reading": "on-path/once/consistent", "method": "CN"}
    followed = results.passes.residual.sel({**where, "pass": readings.M})
    np.testing.assert_allclose(followed, results.trajectories.residual.sel(where), rtol=1e-6, atol=1e-13)
