"""`cnclik sweep`, end to end on a tiny spec."""

import csv
import json

import numpy as np
import pytest
from PIL import Image

from cnclik.cli import main
from cnclik.sweeps import open_sweep, run_spec, store
from cnclik.writing import LIST
from tests.specs import reaching

TEXT = reaching(
    metrics=["final_error", "max_qdot", "evaluations"],
    N=6,
    method=["EE", "HEUN"],
    alpha="{ geomspace = [1, 30, 9] }",
    Ts="{ geomspace = [0.01, 0.2, 7] }",
)
FIGURE = """
[[figure]]
kind = "slices"
name = "at5"
x = "Ts"
select = { alpha = 5.0 }
"""


@pytest.fixture
def path(tmp_path):
    (tmp_path / "tiny.toml").write_text(TEXT)
    return tmp_path / "tiny.toml"


def test_a_sweep_leaves_data_summary_and_figures(path, tmp_path, capsys):
    """Again, with a figure of its own and a block that is lost, it mends the data and draws that figure."""
    out = tmp_path / "out"
    main(["sweep", str(path), "--out", str(out)])
    figures = ["heat_final_error.png", "best_final_error.png"]
    assert {p.name for p in out.iterdir()} == {LIST, "data.zarr", "summary.csv", "config.json", *figures}
    found, wanted = open_sweep(out).load(), run_spec(path)
    for name in wanted.data_vars:
        np.testing.assert_array_equal(found[name], wanted[name])
    with (out / "summary.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(r["method"], r["metric"]) for r in rows[:3]] == [
        *(("EE", "final_error"), ("HEUN", "final_error"), ("EE", "max_qdot")),
    ]
    assert list(found.data_vars) == list(wanted.data_vars)
    np.testing.assert_allclose(float(rows[1]["max"]), wanted.final_error.sel({"method": "HEUN"}).max(), rtol=1e-5)
    assert json.loads((out / "config.json").read_text())["spec"]["fixed"]["N"] == 6
    with Image.open(out / figures[0]) as image:
        assert image.text["Title"] == "heat_final_error" and "Does it end well?" in image.text["Description"]
    path.write_text(TEXT + FIGURE)  # other figures are no other data
    next(p for p in (out / "data.zarr/final_error/c").rglob("*") if p.is_file()).unlink()
    main(["sweep", str(path), "--out", str(out), "--format", "svg"])
    assert f"Wrote {out}/at5.svg\n" in capsys.readouterr().out and not store.Store(out).missing()
    assert "<svg" in (out / "at5.svg").read_text() and not (out / "heat_final_error.svg").exists()


def test_check_says_what_would_run_and_writes_nothing(path, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    main(["sweep", str(path), "--check", "--set", "method=EE", "--set", "delay=2"])
    question, size = capsys.readouterr().out.splitlines()
    assert question == "Does it end well?" and size == ("tiny: 63 loops, alpha 9 × Ts 7, in 1 program")
    assert list(tmp_path.iterdir()) == [path]
