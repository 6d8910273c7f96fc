"""cnclik stability: numbers on the terminal, one line for what can't be used, figures and data in the folder."""

import numpy as np
import pytest

from cnclik.cli import main


def test_advice_on_the_terminal(capsys):
    main(["stability", "planar:1,1", "--alpha", "5", "--Ts", "0.1", "--method", "EE"])
    out = capsys.readouterr().out
    assert "largest stable alpha [1/s]" in out and "20." in out  # 2/Ts
    assert "stable: gain margin 4" in out


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--method", "EULER"], "Argument `method` must be one of"),
        (["--cells", "1"], "Argument `cells` must be at least 2, but is 1."),
        (["--N", "3"], "Argument `N` must be at least 4, but is 3."),
        (["panda", "--map", "--Ts-range", "0.1", "0.01"], "Argument `Ts-range` must increase, but is 0.1 to 0.01."),
        (["planar:1,1", "--target", "9", "0"], "Argument `target` must be one the loop comes to rest on"),
    ],
)
def test_user_errors_are_one_line(arguments, line, capsys):
    with pytest.raises(SystemExit) as left:
        main(["stability", *arguments])
    assert left.value.code == 2
    said = capsys.readouterr().err.strip()
    assert line in said and "\n" not in said


def test_map_writes_labelled_data_and_figures(tmp_path, capsys):
    import xarray as xr

    small = ["--cells", "8", "--passes", "2", "--Ts", "0.1"]
    main(["stability", "planar:1,1", "--method", "IE", "--map", *small, "--out", str(tmp_path)])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["map.nc", "map.png", "passes.nc", "passes.png"]
    with xr.open_dataset(tmp_path / "map.nc", engine="h5netcdf") as data:
        assert data.ending.dims == ("Ts", "alpha") and data.sizes == {"Ts": 8, "alpha": 8}
        np.testing.assert_allclose(data.limit, 1 / data.Ts, rtol=1e-6)  # picard(5)
        assert '"robot": "planar:1,1"' in data.attrs["config"]
    assert "64 loops" in capsys.readouterr().out


def test_plane_writes_the_limits_of_every_M_and_of_late_errors(tmp_path, capsys):
    main(["stability", "--plane", "--methods", "EE", "IE", "--passes", "2", "--out", str(tmp_path)])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["plane.md", "plane.nc", "plane.png"]
    text = (tmp_path / "plane.md").read_text(encoding="utf-8")
    assert "| IE | picard(1) | 1.0000 |" in text and "| IE | picard(2) | 1.3532 |" in text
    assert "| EE | 2.0000 | 1.0000 | 0.6180 | 0.4450 | 0.3473 |" in text
