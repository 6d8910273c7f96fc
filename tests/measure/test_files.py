"""Files of results: tables that stay tables, and datasets that come back."""

import numpy as np
import xarray as xr

from cnclik.measure import markdown, save_netcdf


def test_markdown_escapes_what_would_end_a_cell():
    text = markdown(["|e|", "n"], [["a|b", 1], ["c", 2.5]])
    assert text == "| \\|e\\| | n |\n| --- | ---: |\n| a\\|b | 1 |\n| c | 2.5 |\n"
    assert markdown(["a", "b"], [], left=2) == "| a | b |\n| --- | --- |\n"


def test_netcdf_is_packed_and_comes_back(tmp_path):
    data = xr.Dataset(
        {"x": ("k", np.zeros(10_000)), "ok": ("k", np.ones(10_000, bool)), "once": 3.0},
        {"k": np.arange(10_000), "name": ("c", ["a", "b"])},
        attrs={"config": "{}"},
    )
    save_netcdf(data, tmp_path / "data.nc")
    assert (tmp_path / "data.nc").stat().st_size < 60_000  # 170 kB as they are
    with xr.open_dataset(tmp_path / "data.nc") as back:
        xr.testing.assert_identical(back.load(), data)
