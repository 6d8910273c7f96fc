"""One look for every figure: colour-blind safe, readable at column width, the same line for a method everywhere."""

import pathlib
from typing import NamedTuple

import matplotlib
import matplotlib.pyplot as plt
from matplotlib.backends.backend_agg import FigureCanvasAgg

COLUMN, PAGE = 3.5, 7.16  # widths of a column and of a page of a two-column journal [inch]
DPI = 300
LABEL_AT = -0.2  # of the width of a panel of `fixed_grid`: where the labels of its left axis stand

# Okabe & Ito (2008): distinguishable with any colour vision.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, VERMILION, PURPLE = "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
DASH, DOT, DASHDOT = (0, (5, 2)), (0, (1, 1.2)), (0, (5, 1.5, 1, 1.5))

# Lines of one panel, in this order.
COLORS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK, YELLOW)
DASHES = ("-", DASH, DOT, DASHDOT, (0, (3, 1)), (0, (8, 2)))


class Line(NamedTuple):
    """How a method is drawn; marker and dashes carry the meaning where colour can't."""

    color: str
    linestyle: object
    marker: str
    zorder: float
    linewidth: float = 1.2


METHODS = {
    "EE": Line(BLUE, DASH, "o", 3.3),
    "IE": Line(VERMILION, DASHDOT, "s", 3.2),
    "CN": Line(BLACK, "-", "D", 3.1, 1.1),
    "TRAPEZOID": Line(GREEN, "-", "^", 3.4),
    "HEUN": Line(ORANGE, DASH, "v", 3.5),
    "MIDPOINT": Line(SKY, DASHDOT, "P", 3.6),
    "RK4": Line(PURPLE, DOT, "X", 3.7, 1.6),
    "AB2": Line(ORANGE, DOT, "<", 3.2),
    "EXP-EE": Line(BLUE, "-", "o", 3.4),
    "EXP-HEUN": Line(ORANGE, "-", "v", 3.5),
    "EXP-MIDPOINT": Line(SKY, "-", "P", 3.6),
    "EXP-RK4": Line(PURPLE, "-", "X", 3.7),
    "EXP-AB2": Line(VERMILION, "-", ">", 3.8),
    "EXP-AB3": Line(GREEN, DOT, ">", 3.8),
    "EXP-AB4": Line(BLACK, DOT, ">", 3.8),
}
OTHER = Line(BLACK, DASH, "o", 3.0)  # of a method without one of its own

GUIDE = {"color": "0.55", "linewidth": 0.8, "linestyle": (0, (1, 2)), "zorder": 2}
LIMIT = {"color": VERMILION, "linewidth": 0.8, "linestyle": (0, (4, 2)), "zorder": 2}
NOTE = {"fontsize": 6.5, "color": "0.35"}

_RC = {
    "figure.dpi": 100,
    "savefig.dpi": DPI,
    "figure.constrained_layout.use": True,
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same glyphs on every machine
    "font.size": 7.5,
    "axes.labelsize": 7.5,
    "axes.titlesize": 7.5,
    "legend.fontsize": 7,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "mathtext.fontset": "dejavusans",
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.5,
    "lines.markersize": 3.2,
    "lines.markeredgewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "xtick.minor.size": 1.5,
    "ytick.minor.size": 1.5,
    "legend.frameon": False,
    "legend.handlelength": 2.6,
    "legend.columnspacing": 1.4,
    "axes.unicode_minus": True,
}


def style():
    """Context manager: every figure made inside has the project's look."""
    return matplotlib.rc_context(_RC)


def line(method: str, **changes) -> dict:
    """Keyword arguments of `plot` for a method: its colour, dashes and marker, filled for exponential ones."""
    look = METHODS.get(method, OTHER)
    face = look.color if method.startswith("EXP-") else "white"
    return {"label": method, "markerfacecolor": face} | look._asdict() | changes


def legend(figure, panel, columns=None) -> None:
    """One legend above all panels, with what one of them shows."""
    handles, labels = panel.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=columns or max(len(labels), 1))


def fixed_grid(width, height, rows, columns) -> dict:
    """Keyword arguments of `subplots` for many panels with short labels: room for these measured out beforehand.

    Laying them out automatically, every label is drawn three times, which is most of the time such a figure takes.
    """
    left, right, below, above = 0.72, 0.08, 0.38, 0.2  # [inch]
    between, beside = 0.26, 0.76
    high = (height - below - above - (rows - 1) * between) / rows
    wide = (width - left - right - (columns - 1) * beside) / columns
    edges = dict(left=left / width, right=1 - right / width, bottom=below / height, top=1 - above / height)
    return dict(layout="none", gridspec_kw=edges | dict(hspace=between / high, wspace=beside / wide))


def save(figure, path, about: dict) -> None:
    """Write a PNG, PDF or SVG that carries what it was drawn from, and close the figure.

    The same figure gives the same bytes: no date goes into the file.

    Args:
      about: what the file says of itself; a PDF and an SVG keep its "Title" only.
    """
    plain = {"Software": "cnclik"} | {key: str(value) for key, value in about.items()}
    dated = {".pdf": "CreationDate", ".svg": "Date"}.get(pathlib.Path(path).suffix)
    if dated:
        plain = {"Title": plain.get("Title", ""), dated: None}
    if pathlib.Path(path).suffix == ".png":
        # Not savefig, which draws twice: once to lay out, and once more at the resolution of the file.
        figure.set_dpi(DPI)
        FigureCanvasAgg(figure).print_png(path, metadata=plain)
    else:
        figure.savefig(path, metadata=plain, dpi=DPI)
    plt.close(figure)
