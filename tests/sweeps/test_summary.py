"""Summaries: statistics against NumPy, and tables that any reader of CSV understands."""

import csv
import json

import numpy as np
import pytest
import xarray

from cnclik.sweeps import summarize, summary
from cnclik.writing import output_folder

CASES = ["plain", "with, comma", 'with "quotes"', "two\nlines"]


@pytest.fixture
def data():
    rng = np.random.default_rng(3)
    error = rng.random((4, 2, 10, 5))
    error[0, 0, 0, :2] = np.inf
    error[0, 0, 1, 0] = np.nan
    dims = ("case", "M", "alpha", "q0")
    return xarray.Dataset(
        {
            "final_error": (dims, error, {"units": "m"}),
            "error": ((*dims, "time"), np.zeros((4, 2, 10, 5, 3)), {"units": "m"}),
        },
        {
            "case": CASES,
            "M": [1, 5],
            "alpha": np.linspace(1, 2, 10),
            "q0": np.arange(5),
            "q0_value": (("q0", "q0_0"), rng.random((5, 2))),
        },
        attrs={"spec": "{}", "config": json.dumps({"lanes": 8}), "question": "?", "expectation": "!"},
    )


def test_statistics_are_numpys_for_each_combination_of_names(data):
    rows = summarize(data)
    assert len(rows) == 4 * 2  # of histories none
    first = rows[0]
    values = data.final_error.values[0, 0].ravel()
    known = values[np.isfinite(values)]
    assert (first["case"], first["M"], first["metric"], first["units"]) == ("plain", 1, "final_error", "m")
    assert first["finite"] == pytest.approx(47 / 50) and first["mean"] == pytest.approx(known.mean())
    assert first["min"] == known.min() and first["max"] == np.inf
    ranked = np.sort(values[~np.isnan(values)])  # 49 of them
    assert first["median"] == ranked[24]
    whole = rows[-1]
    assert whole["median"] == np.quantile(data.final_error.values[3, 1], 0.5, method="lower") and whole["finite"] == 1


def test_the_table_reads_back_whatever_the_names(data, tmp_path):
    with output_folder(tmp_path) as folder:
        summary.write(data, folder)
    assert folder.made == ["summary.csv", "config.json"]
    with (tmp_path / "summary.csv").open(newline="") as file:
        read = list(csv.DictReader(file))
    assert list(read[0]) == ["case", "M", "metric", "units", "min", "q10", "median", "q90", "max", "mean", "finite"]
    assert [row["case"] for row in read[::2]] == CASES
    for row, wanted in zip(read, summarize(data), strict=True):
        assert float(row["median"]) == pytest.approx(wanted["median"], rel=1e-5)
    assert json.loads((tmp_path / "config.json").read_text()) == {"spec": {}, "config": {"lanes": 8}}


SAFE = "finite, within velocity limits, ending stable"


def judged(**changes):
    """Errors of two cases over two starts, two gains and two sampling times; the first start is the easier one."""
    dims, shape = ("case", "q0", "alpha", "Ts"), (2, 2, 2, 2)
    error = np.arange(16.0).reshape(shape) + 1
    fields = {"final_error": error, "over_velocity": np.zeros(shape, int), "stable": np.ones(shape)} | changes
    coords = {"case": ["a", "b"], "q0": [0, 1], "alpha": [2.0, 5.0], "Ts": [0.01, 0.1]}
    data = xarray.Dataset({name: (dims, value) for name, value in fields.items()}, coords)
    data = data.assign_coords(q0_value=(("q0", "q0_0"), np.zeros((2, 3))))
    data.final_error.attrs["units"], data.alpha.attrs["units"], data.Ts.attrs["units"] = "m", "1/s", "s"
    return data


def test_the_best_loop_is_safe_and_judged_by_its_worst_start():
    fast = np.zeros((2, 2, 2, 2), int)
    fast[0, 1, 0, 0] = fast[1] = 3  # of case a one start of one loop; of case b every loop
    assert summary.best(judged(over_velocity=fast)) == [
        f"Case a: 3 of 4 loops are safe ({SAFE}), the best by final_error (6 m): alpha 2 1/s, Ts 0.1 s, z = 0.2.",
        f"Case b: none of 4 loops is safe ({SAFE}).",
    ]
    lost = judged(final_error=np.full((2, 2, 2, 2), np.nan), stable=np.zeros((2, 2, 2, 2)))
    assert summary.best(lost)[0] == f"Case a: none of 4 loops is safe ({SAFE})."
    same = summary.best(judged(final_error=np.ones((2, 2, 2, 2))).isel(case=0, drop=True))
    assert same == [
        f"4 of 4 loops are safe ({SAFE}), the best by final_error (1 m; 4 loops tie): alpha 2 or 5 1/s, Ts 0.01 or "
        "0.1 s."
    ]
    assert summary.best(judged().drop_vars("final_error")) == []


def test_a_loop_beyond_the_linear_limit_is_not_safe():
    """Of a sweep that measures an error alone, a short run may end before it shows that it diverges."""
    data = judged(final_error=16.0 - np.arange(16.0).reshape(2, 2, 2, 2)).drop_vars(["over_velocity", "stable"])
    data = data.isel(case=0, drop=True).assign_coords(limit=0.3)
    (said,) = summary.best(data)
    assert said.startswith("3 of 4 loops are safe (finite, below the linear stability limit), ") and "z = 0.05" in said
    one = data.isel(Ts=1, drop=True).assign_attrs(spec=json.dumps({"fixed": {"Ts": 0.1}}))
    assert summary.best(one)[0].startswith("1 of 2 loops is safe (finite, below the linear stability limit), ")
    only = summary.best(one.isel(alpha=[0]))
    assert only == ["The loop is safe (finite, below the linear stability limit), final_error 15 m: alpha 2 1/s."]
    (unlimited,) = summary.best(data.assign_coords(limit=np.inf))
    assert unlimited.startswith("4 of 4 loops are safe (finite, below") and unlimited.endswith("z = 0.5.")
