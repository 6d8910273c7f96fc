"""One line per method, everywhere."""

import contextlib
import itertools

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from cnclik.integrate.method import METHODS
from cnclik.show import style


def test_every_method_has_a_line_of_its_own():
    plain = {name for name, m in METHODS.items() if not m.exponential}
    assert plain | {name for name in METHODS if name.startswith("EXP-")} <= set(style.METHODS) <= set(METHODS)
    for one, other in itertools.combinations(plain, 2):
        one, other = style.METHODS[one], style.METHODS[other]
        assert one.color != other.color and one.marker != other.marker
    looks = {(m.color, str(m.linestyle), m.marker) for m in style.METHODS.values()}
    assert len(looks) == len(style.METHODS)
    assert style.line("EXP-EE")["markerfacecolor"] != style.line("EE")["markerfacecolor"]


def test_the_papers_methods_differ_for_the_colour_blind():
    """Viénot, Brettel & Mollon (1999): linear RGB as a person without L, or without M cones sees it."""
    without_L = [[0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]]
    without_M = [[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]]
    for seen in (without_L, without_M):
        colors = [np.array(seen) @ (np.array(to_rgb(style.METHODS[m].color)) ** 2.2) for m in ("EE", "IE", "CN")]
        for one, other in itertools.combinations(colors, 2):
            assert np.linalg.norm(one - other) > 0.15


@pytest.mark.parametrize("form", ["png", "pdf", "svg"])
def test_saved_figures_are_reproducible_and_those_of_savefig(tmp_path, form):
    files = [tmp_path / f"{name}.{form}" for name in ("a", "b")]
    for file in files:
        with style.style():
            figure, panel = plt.subplots(figsize=(style.COLUMN, 2.0))
            panel.plot(np.linspace(0, 7, 50), np.sin(np.linspace(0, 7, 50)), **style.line("CN"))
            style.legend(figure, panel)
            if file == files[1] and form == "png":
                figure.savefig(file, metadata={"Software": "cnclik", "Title": "t"}, dpi=style.DPI)
            else:
                style.save(figure, file, {"Title": "t"})
    assert b"<dc:date>" not in files[0].read_bytes()
    assert form == "svg" or files[0].read_bytes() == files[1].read_bytes()
    if form == "png":
        with Image.open(files[0]) as image:
            assert image.text == {"Title": "t", "Software": "cnclik"}
    plt.close("all")


@pytest.mark.parametrize(
    ("values", "labels"),
    [
        ([0, 0.9, np.nan, 60], ["1", "2", "5", "10", "20", "50"]),
        ([4e-5, 7e-4], ["$5\\times10^{-5}$", "0.0001", "0.0002", "0.0005"]),
        ([1e-4, 1], ["$\\mathdefault{10^{-4}}$", "$\\mathdefault{10^{-2}}$", "$\\mathdefault{10^{0}}$"]),
        ([1.0602e-3, 1.0609e-3], None),
    ],
)
def test_a_logarithmic_axis_of_few_decades_has_plain_numbers(values, labels):
    figure, panel = plt.subplots()
    panel.plot(values, values)
    style.log_scale(panel.xaxis, values)
    low, high = panel.get_xlim()
    shown = [
        t.get_text() for t, at in zip(panel.get_xticklabels(), panel.get_xticks(), strict=True) if low <= at <= high
    ]
    assert panel.get_xscale() == ("log" if labels else "linear")
    assert labels is None or set(labels) <= set(shown), shown
    plt.close(figure)


def test_geometric_axes():
    for values in (np.geomspace(1e-3, 2, 9), [0.1, 0.2, 0.5, 1, 2, 5, 50], [1, 2, 4]):
        assert style.geometric(values)
    for values in (np.linspace(1, 2, 9), [1, 2], ["a", "b", "c"], [2, 2, 2], [0.0, 1.0, 2.0], range(1, 101)):
        assert not style.geometric(values)


def test_errors_at_rounding_stretch_no_axis_and_the_largest_is_below_its_top():
    figure, panel = plt.subplots()
    norm = np.append(np.full(5, 1e-17), np.linspace(1e-5, 1e-3, 95))  # five steps of dead time on the path
    panel.plot(norm)
    style.log_errors(panel, [norm])
    low, high = panel.get_ylim()
    assert 1e-6 < low < 1e-5 and 1.1e-3 < high < 2e-3
    style.log_errors(panel, [np.zeros(3), np.full(3, np.nan)])  # nothing that a logarithm could show
    plt.close(figure)


NOTEBOOK = """
import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg as FigureCanvas
matplotlib.interactive(True)  # as matplotlib_inline does when it is loaded, with the first figure
"""


def test_a_notebooks_first_figure_leaves_its_interactive_mode_on(tmp_path, monkeypatch):
    (tmp_path / "first_figure.py").write_text(NOTEBOOK)
    monkeypatch.syspath_prepend(tmp_path)
    before, backend, sizes = matplotlib.is_interactive(), matplotlib.get_backend(), plt.rcParams["font.size"]
    try:
        with contextlib.suppress(ValueError), style.style():
            plt.switch_backend("module://first_figure")
            assert plt.rcParams["font.size"] != sizes
            raise ValueError
        assert matplotlib.is_interactive() and plt.rcParams["font.size"] == sizes
    finally:
        plt.switch_backend(backend)
        matplotlib.interactive(before)
