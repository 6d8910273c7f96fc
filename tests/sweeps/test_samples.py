"""Axes of samples, vectors beside their numbers, keep both all the way from the store to tables and exports."""

import csv

import numpy as np
import pytest

from cnclik.sweeps import files, store, summary
from tests.specs import reaching


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    folder = tmp_path_factory.mktemp("samples")
    axes = dict(q0='{ samples = 6, low = "-pi", high = "pi", seed = 3 }')
    text = reaching(metrics=["final_error"], **axes).replace('q0 = [0, "-pi/2"]\n', "")
    (folder / "samples.toml").write_text(text)
    assert store.run(files.read(folder / "samples.toml"), folder / "out")
    return store.read(folder / "out")


def test_the_samples_are_kept_with_the_data(stored):
    assert stored.q0_value.shape == (6, 2)
    assert np.abs(stored.q0_value.values).max() <= np.pi
    assert len(np.unique(stored.q0_value.values)) == 12


def test_a_summary_is_over_the_samples(stored):
    (row,) = summary.table(stored)
    assert row["max"] == stored.final_error.values.max()
    assert "q0" not in row


def test_an_export_holds_them(stored, tmp_path):
    with summary.export(stored, tmp_path, "csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 6
    assert float(rows[4]["q0[1]"]) == stored.q0_value.values[4, 1]
