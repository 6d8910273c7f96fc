"""One line per method, everywhere."""

import itertools

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from cnclik.integrate.method import METHODS
from cnclik.show import style


def test_every_method_has_a_line_of_its_own():
    plain = {name for name, m in METHODS.items() if m.steps == 1 and not m.exponential}
    assert plain | {name for name in METHODS if name.startswith("EXP-")} <= set(style.METHODS) <= set(METHODS)
    for one, other in itertools.combinations(plain, 2):
        one, other = style.METHODS[one], style.METHODS[other]
        assert one.color != other.color and one.marker != other.marker
    looks = {(m.color, str(m.linestyle), m.marker) for m in style.METHODS.values()}
    assert len(looks) == len(style.METHODS)
    assert style.line("EXP-EE")["markerfacecolor"] != style.line("EE")["markerfacecolor"]


@pytest.mark.parametrize(
    "projection",
    [  # Viénot, Brettel & Mollon (1999), linear RGB as a person without L, or without M cones sees it
        [[0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]],
        [[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]],
    ],
)
def test_the_papers_methods_differ_for_the_colour_blind(projection):
    seen = {m: np.array(projection) @ (np.array(to_rgb(style.METHODS[m].color)) ** 2.2) for m in ("EE", "IE", "CN")}
    for one, other in itertools.combinations(seen.values(), 2):
        assert np.linalg.norm(one - other) > 0.15


def test_style_does_not_leak():
    before = plt.rcParams["font.size"]
    with style.style():
        assert plt.rcParams["font.size"] != before
    assert plt.rcParams["font.size"] == before


def test_saved_figures_are_reproducible_and_carry_metadata(tmp_path):
    for name in ("a.png", "b.png"):
        with style.style():
            figure, panel = plt.subplots()
            panel.plot([0, 1], [0, 1], **style.line("CN"))
            style.save(figure, tmp_path / name, {"Data": "abc"})
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    with Image.open(tmp_path / "a.png") as image:
        assert image.text["Data"] == "abc" and image.text["Software"] == "cnclik"


@pytest.mark.parametrize("form", ["pdf", "svg"])
def test_other_forms_are_reproducible_too(tmp_path, form):
    for name in ("a", "b"):
        style.save(plt.figure(), tmp_path / f"{name}.{form}", {"Title": "t", "Data": "abc"})
    if form == "pdf":
        assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()
    assert b"<dc:date>" not in (tmp_path / f"a.{form}").read_bytes()


def test_a_figure_is_drawn_once_and_is_that_of_savefig(tmp_path):
    def figure():
        made, panels = plt.subplots(2, 1, sharex=True, figsize=(style.COLUMN, 3.0))
        for panel in panels:
            panel.plot(np.linspace(0, 7, 50), np.sin(np.linspace(0, 7, 50)), label="$e_x$")
        style.legend(made, panels[0])
        return made

    with style.style():
        first, second = figure(), figure()
        drawn = []
        first.axes[0].draw = lambda renderer, draw=first.axes[0].draw: (drawn.append(1), draw(renderer))
        style.save(first, tmp_path / "once.png", {"Title": "x"})
        second.savefig(tmp_path / "twice.png", metadata={"Software": "cnclik", "Title": "x"}, dpi=style.DPI)
        plt.close(second)
    assert len(drawn) == 1
    assert (tmp_path / "once.png").read_bytes() == (tmp_path / "twice.png").read_bytes()
