"""A figure that can't be drawn costs only itself."""

import matplotlib.pyplot as plt
import pytest

from cnclik.show.output import FigureError, draw


def test_a_figure_that_fails_costs_only_itself(tmp_path):
    def fail():
        raise ValueError("no\nink")

    reports = []
    figures = {"a.png": (fail, {}), "b.png": (plt.figure, {"Title": "b"}), "c.pdf": (plt.figure, {"Title": "c"})}
    with pytest.raises(FigureError, match=r"Not drawn: a.png \(ValueError: no ink\)"):
        draw(figures, tmp_path, progress=lambda *report: reports.append(report))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["b.png", "c.pdf"]
    assert reports == [(k, 3, f"drawing {name}") for k, name in enumerate(figures)]
