"""The comparison's table and figure, on errors of known order."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr

from cnclik.show import run as pictures
from cnclik.show import style
from cnclik.study import compare


@pytest.fixture
def data():
    orders = {"EE": 1, "CN": 1, "TRAPEZOID": 2, "RK4": 4}
    Ts = np.array(compare.TS)
    error = np.array([[2.0 * Ts**p for p in orders.values()], [3.0 * Ts**p for p in orders.values()]])
    dims = ("robot", "method", "Ts")
    return xr.Dataset(
        {
            "position_error": (dims, error, {"units": "m"}),
            "orientation_error": (dims, 0.5 * error, {"units": "rad"}),
            "evaluations": ("method", [1.0, 6.0, 6.0, 4.0]),
        },
        {"robot": ["Panda", "UR5"], "method": list(orders), "Ts": Ts},
    )


def test_the_table_has_errors_work_and_orders(data):
    page = compare.table(data)
    assert "| TRAPEZOID | 6 | 1.25e-05 | 5.00e-05 |" in page and "| 2.00 |" in page  # 2 · 0.0025² and its order
    assert "| RK4 | 4 |" in page and page.count("| EE | 1 |") == page.count("## ")
    slopes = compare.order(data)
    np.testing.assert_allclose(slopes.sel({"method": "RK4"}), 4, atol=1e-9)


def test_the_figure_has_a_line_per_method(data):
    with style.style():
        figure = pictures.work(data)
    assert [len(panel.lines) for panel in figure.axes] == [4] * 4
    np.testing.assert_allclose(figure.axes[0].lines[0].get_xdata(), 1 / data.Ts)  # EE: one evaluation per Ts
    plt.close(figure)
