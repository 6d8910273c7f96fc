"""Summaries: statistics against NumPy, and which loops are best."""

import csv
import json

import numpy as np
import pytest
import xarray

from cnclik.sweeps import summarize, summary
from cnclik.writing import output_folder

CASES = ["plain", "with, comma", 'with "quotes"', "two\nlines"]


def test_statistics_are_numpys_and_read_back_whatever_the_names(tmp_path):
    rng = np.random.default_rng(3)
    error = rng.random((4, 2, 10, 5))
    error[0, 0, 0, :2] = np.inf
    error[0, 0, 1, 0] = np.nan
    dims = ("case", "M", "alpha", "q0")
    coords = {"case": CASES, "M": [1, 5], "alpha": np.linspace(1, 2, 10), "q0": np.arange(5)}
    coords["q0_value"] = (("q0", "q0_0"), rng.random((5, 2)))
    about = {"spec": "{}", "config": json.dumps({"lanes": 8}), "question": "?", "expectation": "!"}
    histories = {"error": ((*dims, "time"), np.zeros((4, 2, 10, 5, 3)))}  # have no statistics
    data = xarray.Dataset({"final_error": (dims, error, {"units": "m"})} | histories, coords, attrs=about)
    rows = summarize(data)
    assert len(rows) == 4 * 2
    first, whole, values = rows[0], rows[-1], error[0, 0].ravel()
    finite, ranked = values[np.isfinite(values)], np.sort(values[~np.isnan(values)])
    assert (first["case"], first["M"], first["metric"], first["units"]) == ("plain", 1, "final_error", "m")
    assert first["finite"] == pytest.approx(47 / 50) and first["mean"] == pytest.approx(finite.mean())
    assert (first["min"], first["median"], first["max"]) == (finite.min(), ranked[24], np.inf)
    assert whole["median"] == np.quantile(error[3, 1], 0.5, method="lower") and whole["finite"] == 1
    assert len(summarize(data.isel(case=0, M=0, drop=True))) == 1
    with output_folder(tmp_path) as folder:
        summary.write(data, folder)
    with (tmp_path / "summary.csv").open(newline="") as file:
        read = list(csv.DictReader(file))
    assert list(read[0]) == ["case", "M", "metric", "units", "min", "q10", "median", "q90", "max", "mean", "finite"]
    assert [row["case"] for row in read[::2]] == CASES
    np.testing.assert_allclose([float(row["median"]) for row in read], [row["median"] for row in rows], rtol=1e-5)
    assert json.loads((tmp_path / "config.json").read_text()) == {"spec": {}, "config": {"lanes": 8}}


SHAPE = (2, 2, 2, 2)
ERROR = np.arange(16.0).reshape(SHAPE)


def judged(**changes):
    """Errors of two cases over two starts, two gains and two sampling times; the first start is the easier one."""
    dims = ("case", "q0", "alpha", "Ts")
    fields = {"final_error": ERROR + 1, "over_velocity": np.zeros(SHAPE, int), "stable": np.ones(SHAPE)} | changes
    coords = {"case": ["a", "b"], "q0": [0, 1], "alpha": [2.0, 5.0], "Ts": [0.01, 0.1]}
    data = xarray.Dataset({name: (dims, value) for name, value in fields.items()}, coords)
    data = data.assign_coords(q0_value=(("q0", "q0_0"), np.zeros((2, 3))))
    data.final_error.attrs["units"], data.alpha.attrs["units"], data.Ts.attrs["units"] = "m", "1/s", "s"
    return data


def test_the_best_loop_is_safe_and_judged_by_its_worst_start():
    fast = np.zeros(SHAPE, int)
    fast[0, 1, 0, 0] = fast[1] = 3  # of case a one start of one loop; of case b every loop
    assert summary.best(judged(over_velocity=fast)) == [
        "Case a: 3 of 4 loops are safe, the best by final_error (6 m): alpha 2 1/s, Ts 0.1 s.",
        "Case b: none of 4 loops is safe.",
    ]
    lost = judged(final_error=np.full(SHAPE, np.nan), stable=np.zeros(SHAPE))
    assert summary.best(lost)[0] == "Case a: none of 4 loops is safe."
    ties = "(1 m; 4 loops tie): alpha 2 or 5 1/s, Ts 0.01 or 0.1 s."
    same = summary.best(judged(final_error=np.ones(SHAPE)).isel(case=0, drop=True))
    assert same == [f"4 of 4 loops are safe, the best by final_error {ties}"]
    assert summary.best(judged().drop_vars("final_error")) == []


def test_a_loop_beyond_the_linear_limit_is_not_safe():
    """Of a sweep that measures an error alone, a short run may end before it shows that it diverges."""
    data = judged(final_error=16.0 - ERROR).drop_vars(["over_velocity", "stable"])
    data = data.isel(case=0, drop=True).assign_coords(limit=0.3)
    (line,) = summary.best(data)
    assert line.startswith("3 of 4 loops are safe, ") and "alpha 5 1/s, Ts 0.01 s" in line
    of_one = data.isel(Ts=1, drop=True).assign_attrs(spec=json.dumps({"fixed": {"Ts": 0.1}}))
    assert summary.best(of_one)[0].startswith("1 of 2 loops is safe, ")
    (unlimited,) = summary.best(data.assign_coords(limit=np.inf))
    assert unlimited.startswith("4 of 4 loops are safe") and unlimited.endswith("alpha 5 1/s, Ts 0.1 s.")
