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


@pytest.mark.parametrize(
    ("words", "kept"),
    [
        (["stability", "--draw", "plane", "--method", "EE"], {"plane.nc"}),
        (
            ["stability", "planar:1,1", "--draw", "map", "--N", "4", "--method", "EE", "--Ts", "0.1"],
            {"map.nc"},
        ),
    ],
    ids=["plane", "map"],
)
def test_what_draws_may_be_missing(words, kept, tmp_path, monkeypatch, capsys):
    for name in ("matplotlib.pyplot", *(m for m in sys.modules if m.startswith("cnclik.show."))):
        if name != "cnclik.show.output":
            monkeypatch.setitem(sys.modules, name, None)  # so that importing it fails
    with pytest.raises(SystemExit) as left:
        main([*words, "--out", str(tmp_path)])
    said = capsys.readouterr().err.strip()
    assert left.value.code == 1 and said.startswith("cnclik: Not drawn: ") and "\n" not in said
    assert kept <= {p.name for p in tmp_path.iterdir()}
