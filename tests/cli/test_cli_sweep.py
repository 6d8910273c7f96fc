"""`cnclik sweep`, end to end on a tiny spec."""

import csv
import json
import shutil

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
FIGURES = """
[[figure]]
kind = "heat"
value = "final_error"
panels = "method"
[[figure]]
kind = "slices"
name = "at5"
x = "Ts"
select = { alpha = 5.0 }
"""
EVERY = ["heat_final_error.png", "best_final_error.png"]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    file = tmp_path_factory.mktemp("spec") / "tiny.toml"
    file.write_text(TEXT)
    return file


@pytest.fixture(scope="module")
def folder(path, tmp_path_factory):
    """A finished sweep, with the figures that are drawn unasked."""
    out = tmp_path_factory.mktemp("out")
    main(["sweep", str(path), "--out", str(out)])
    return out


@pytest.fixture
def copy(folder, tmp_path):
    """The finished sweep's store alone."""
    shutil.copytree(folder / "data.zarr", tmp_path / "copy/data.zarr")
    return tmp_path / "copy"


def test_a_sweep_leaves_data_summary_and_figures(path, folder):
    assert sorted(p.name for p in folder.iterdir()) == sorted([LIST, "data.zarr", "summary.csv", "config.json", *EVERY])
    found, wanted = open_sweep(folder).load(), run_spec(path)
    for name in wanted.data_vars:
        np.testing.assert_array_equal(found[name], wanted[name])
    with (folder / "summary.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(r["method"], r["metric"]) for r in rows[:3]] == [
        *(("EE", "final_error"), ("HEUN", "final_error"), ("EE", "max_qdot")),
    ]
    assert list(found.data_vars) == list(wanted.data_vars)
    np.testing.assert_allclose(float(rows[1]["max"]), wanted.final_error.sel({"method": "HEUN"}).max(), rtol=1e-5)
    assert json.loads((folder / "config.json").read_text())["spec"]["fixed"]["N"] == 6
    with Image.open(folder / EVERY[0]) as image:
        assert image.text["Title"] == "heat_final_error" and "Does it end well?" in image.text["Description"]


def test_check_says_what_would_run_and_writes_nothing(path, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    main(["sweep", str(path), "--check", "--set", "method=EE", "--set", "delay=2"])
    question, size = capsys.readouterr().out.splitlines()
    assert question == "Does it end well?" and size == ("tiny: 63 loops, alpha 9 × Ts 7, in 1 program")
    assert not list(tmp_path.iterdir())


@pytest.fixture
def other(tmp_path):
    """The same spec with two figures of its own: other figures are no other data."""
    file = tmp_path / "other.toml"
    file.write_text(TEXT + FIGURES)
    return file


def test_a_damaged_block_is_computed_again_and_figures_drawn_in_another_format(other, copy, capsys):
    next(p for p in (copy / "data.zarr/final_error/c").rglob("*") if p.is_file()).unlink()
    main(["sweep", str(other), "--out", str(copy), "--format", "svg"])
    assert f"Wrote {copy}/heat_final_error.svg\n" in capsys.readouterr().out and not store.Store(copy).missing()
    assert "<svg" in (copy / "heat_final_error.svg").read_text()
