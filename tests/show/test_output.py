"""A figure that can't be drawn costs only itself."""

import sys

import matplotlib.pyplot as plt
import pytest

from cnclik.cli import main
from cnclik.show.output import FigureError, draw
from cnclik.writing import LIST


def test_a_figure_that_fails_costs_only_itself(tmp_path):
    def fail():
        raise ValueError("no\nink")

    reports = []
    figures = {"a.png": (fail, {}), "b.png": (plt.figure, {"Title": "b"}), "c.pdf": (plt.figure, {"Title": "c"})}
    with pytest.raises(FigureError, match=r"Not drawn: a.png \(ValueError: no ink\)"):
        draw(figures, tmp_path, progress=lambda *report: reports.append(report))
    assert sorted(p.name for p in tmp_path.iterdir()) == [LIST, "b.png", "c.pdf"]
    assert reports == [(k, 3, f"drawing {name}") for k, name in enumerate(figures)]


def test_what_draws_may_be_missing(tmp_path, monkeypatch, capsys):
    for name in ("matplotlib.pyplot", *(m for m in sys.modules if m.startswith("cnclik.show."))):
        if name != "cnclik.show.output":
            monkeypatch.setitem(sys.modules, name, None)  # so that importing it fails
    with pytest.raises(SystemExit) as left:
        main(["stability", "--draw", "plane", "--method", "EE", "--out", str(tmp_path)])
    error = capsys.readouterr().err.strip()
    assert left.value.code == 1 and error.startswith("cnclik: Not drawn: ") and "\n" not in error
    assert (tmp_path / "plane.nc").exists()
