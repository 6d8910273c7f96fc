"""Figures of one run, from trajectories made by hand, and their style; one that fails costs only itself."""

import contextlib
import itertools
import sys

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

import cnclik as ck
from cnclik.cli import main
from cnclik.integrate.method import METHODS
from cnclik.integrate.status import level
from cnclik.integrate.trajectory import Trajectory
from cnclik.show import run as pictures
from cnclik.show import style
from cnclik.show.output import FigureError, draw
from cnclik.writing import LIST

N = 20
LAW = ck.Law(
    ck.from_dh([1.0, 0.8], [0.0, 0.0], [0.0, 0.0], lower=[-1.0, -9.0], upper=[1.0, 9.0], velocity_limit=[0.5, 2.0]),
    ck.pose("x", "z"),
    alpha=1.0,
)
BITS = [bit for bit in ck.Status if bit]


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def run(qdot=None, status=None):
    """A run whose first joint moves at qdot (N,) and whose second rests."""
    qdot = np.c_[np.full(N, 0.1) if qdot is None else qdot, np.zeros(N)]
    q = np.concatenate([np.zeros((1, 2)), np.cumsum(0.1 * qdot, axis=0)])
    return Trajectory(
        t=0.1 * np.arange(N + 1),
        q=q,
        x=q,
        e=np.geomspace(1, 1e-6, N + 1)[:, None] * [1.0, 0.5],
        qdot=qdot,
        residual=np.zeros(N),
        contraction=np.zeros(N),
        status=np.zeros(N, int) if status is None else status,
        evaluations=np.asarray(N),
    )


@pytest.mark.parametrize("kind, panels", [("overview", 4), ("tip", 1)])
def test_every_kind_is_a_figure_around_numbers_that_are_not_finite(kind, panels, tmp_path):
    figure = pictures.plot(run(np.where(np.arange(N) < 10, 0.3, np.nan)), LAW, kind)
    assert isinstance(figure, plt.Figure) and len(figure.axes) == panels
    with style.style():
        style.save(figure, tmp_path / "one.png", {"Title": kind})
    assert (tmp_path / "one.png").stat().st_size > 5000


@pytest.mark.parametrize("swing, drawn", [((0.1, -0.1), []), ((0.1, -0.7), [-1.0]), ((1.0, -1.05), [-1.0, 1.0])])
def test_velocity_limits_on_each_side_that_comes_near(swing, drawn):
    speed = pictures.plot(run(np.resize(swing, N)), LAW).axes[2]
    lines = [line for line in speed.lines if to_rgb(line.get_color()) == to_rgb(style.LIMIT["color"])]
    assert sorted(line.get_ydata()[0] for line in lines) == drawn and "over its limit" in speed.get_ylabel()


def test_the_tips_path_is_that_of_the_joints_and_ends_at_its_target():
    space = ck.from_dh([0.0, 1.0], [np.pi / 2, 0.0], [0.5, 0.0])  # turns about z, then lifts
    law = ck.Law(space, ck.position("xz"), alpha=1.0)
    made = run()
    way = np.array([ck.forward(space, q).position for q in made.q])
    made = ck.replace(made, x=way[:, [0, 2]], e=[0.1, -0.2] - 0 * way[:, :2])
    tip, target, start = pictures.plot(made, law, "tip").axes[0].lines
    np.testing.assert_allclose(np.transpose(tip.get_data_3d()), way, atol=1e-12)
    np.testing.assert_allclose(np.transpose(target.get_data_3d()), np.add(way, [0.1, 0.0, -0.2]), atol=1e-12)
    np.testing.assert_allclose(np.transpose(start.get_data_3d()), way[:1], atol=1e-12)
    flat = ck.Law(ck.planar_arm([1.0, 0.8]), ck.position("xy"), alpha=1.0)
    assert pictures.plot(run(), flat, "tip").axes[0].name != "3d"


def test_status_has_a_row_for_every_bit():
    status = np.zeros(N, int)
    status[3:6] = BITS[0].value
    status[5:] |= BITS[-1].value
    panel = pictures.plot(run(status=status), LAW).axes[3]
    assert [t.get_text() for t in panel.get_yticklabels()] == [b.name.replace("_", " ").lower() for b in BITS]
    bars = [[box.get_extents() for box in row.get_paths()] for row in panel.collections]
    assert [len(row) for row in bars] == [1, *[0] * (len(BITS) - 2), 1]  # neighbouring steps are one bar
    np.testing.assert_allclose([bars[0][0].x0, bars[0][0].x1], [0.3, 0.6])
    assert to_rgb(panel.collections[-1].get_facecolor()[0][:3]) == to_rgb(style.LEVELS[level(BITS[-1])])
    assert not panel.texts
    assert "every step OK" in pictures.plot(run(), LAW).axes[3].texts[0].get_text()


def test_what_cannot_be_drawn_is_one_line():
    with pytest.raises(ck.ArgumentError, match="did you mean 'tip'"):
        pictures.plot(run(), LAW, "tips")
    batch = ck.replace(run(), residual=np.zeros((3, N)))
    with pytest.raises(ck.ArgumentError, match="Argument `run` must be one lane, but has 1 leading axes"):
        pictures.plot(batch, LAW)


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


def test_every_method_has_a_line_of_its_own():
    plain = {name for name, m in METHODS.items() if not m.exponential}
    assert plain | {name for name in METHODS if name.startswith("EXP-")} <= set(style.METHODS) <= set(METHODS)
    for one, other in itertools.combinations(plain, 2):
        one, other = style.METHODS[one], style.METHODS[other]
        assert one.color != other.color and one.marker != other.marker
    looks = {(m.color, str(m.linestyle), m.marker) for m in style.METHODS.values()}
    assert len(looks) == len(style.METHODS)
    assert style.line("EXP-EE")["markerfacecolor"] != style.line("EE")["markerfacecolor"]


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
    panel = plt.figure().add_subplot()
    panel.plot(values, values)
    style.log_scale(panel.xaxis, values)
    low, high = panel.get_xlim()
    shown = [
        t.get_text() for t, at in zip(panel.get_xticklabels(), panel.get_xticks(), strict=True) if low <= at <= high
    ]
    assert panel.get_xscale() == ("log" if labels else "linear")
    assert labels is None or set(labels) <= set(shown), shown


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
