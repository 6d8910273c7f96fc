"""One look for every figure: colour-blind safe, readable at column width, the same line for a method everywhere."""

import contextlib
import pathlib
from typing import Any, NamedTuple

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib import patheffects, ticker
from matplotlib.backends.backend_agg import FigureCanvasAgg

COLUMN, PAGE = 3.5, 7.16  # widths of a column and of a page of a two-column journal [inch]
DPI = 300

LEAST_ERROR = 1e-15  # [m, rad] what is below is rounding

# Okabe & Ito (2008): distinguishable with any colour vision.
BLUE, BLACK, SKY, VERMILION, PURPLE = "#0072B2", "#000000", "#56B4E9", "#D55E00", "#CC79A7"
LEVELS = FINE, WARNING, LOST = "#009E73", "#E69F00", "#CC3311"  # the last by Tol (2021); see `status.level`
GREEN, ORANGE = FINE, WARNING  # for lines, where the colour has no meaning
GREY = "#8A8F94"
WINE = "#882255"  # Tol (2021), in place of their yellow, which is lost on white
DASH, DOT, DASHDOT = (0, (5, 2)), (0, (1, 1.2)), (0, (5, 1.5, 1, 1.5))

# Lines of one panel, in this order; dashes and markers tell them apart in greyscale.
COLORS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK, WINE)
DASHES = ("-", DASH, DOT, DASHDOT, (0, (3, 1)), (0, (8, 2)))
MARKERS = "osD^vPX<"


class Line(NamedTuple):
    """How a method is drawn; marker and dashes carry the meaning where colour can't."""

    color: str
    linestyle: str | tuple
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
    "EXP-EE": Line(BLUE, "-", "o", 3.4),
    "EXP-HEUN": Line(ORANGE, "-", "v", 3.5),
    "EXP-MIDPOINT": Line(SKY, "-", "P", 3.6),
    "EXP-RK4": Line(PURPLE, "-", "X", 3.7),
}

GUIDE: dict[str, Any] = {"color": "0.55", "linewidth": 0.8, "linestyle": (0, (1, 2)), "zorder": 2}
OUTLINED = {  # a boundary over colours: black with a white edge, seen on any of them
    "color": BLACK,
    "linewidth": 1.1,
    "zorder": 4,
    "path_effects": [patheffects.withStroke(linewidth=2.4, foreground="white")],
}
LIMIT = {"color": GREY, "linewidth": 1.6, "zorder": 2}
NOTE = {"fontsize": 6.5, "color": "0.35"}

_RC = {
    **dict.fromkeys(("font.size", "axes.labelsize", "figure.labelsize", "axes.titlesize"), 7.5),
    **dict.fromkeys(("legend.fontsize", "xtick.labelsize", "ytick.labelsize"), 7),
    **dict.fromkeys(("axes.linewidth", "lines.markeredgewidth", "xtick.major.width", "ytick.major.width"), 0.6),
    **dict.fromkeys(("axes.spines.top", "axes.spines.right", "legend.frameon"), False),
    **dict.fromkeys(("axes.grid", "axes.axisbelow", "axes.unicode_minus", "figure.constrained_layout.use"), True),
    **dict.fromkeys(("grid.linewidth", "hatch.linewidth"), 0.5),
    **dict.fromkeys(("xtick.major.size", "ytick.major.size"), 2.5),
    **dict.fromkeys(("xtick.minor.size", "ytick.minor.size"), 1.5),
    **{"figure.titlesize": 8, "grid.color": "0.9", "lines.markersize": 3.2, "figure.dpi": 100, "savefig.dpi": DPI},
    **{"font.family": "DejaVu Sans", "mathtext.fontset": "dejavusans"},  # of matplotlib: the same on every machine
    **{"legend.handlelength": 2.6, "legend.columnspacing": 1.4},
}


@contextlib.contextmanager
def style():
    """Context manager: every figure made inside has the project's look."""
    with contextlib.ExitStack() as after, matplotlib.rc_context(_RC):
        try:
            yield
        finally:  # a notebook's backend, loaded with the first figure, switches interactive mode on
            after.callback(matplotlib.interactive, matplotlib.is_interactive())


def line(method: str, **changes) -> dict:
    """Keyword arguments of `plot` for a method: its colour, dashes and marker, filled for exponential ones."""
    look = METHODS[method]
    face = look.color if method.startswith("EXP-") else "white"
    return {"label": method, "markerfacecolor": face} | look._asdict() | changes


def series(i: int, **changes) -> dict:
    """Keyword arguments of `plot` for the i-th of several lines that are not methods: as `line` gives for these."""
    color, dashes, marker = (some[i % len(some)] for some in (COLORS, DASHES, MARKERS))
    return {"color": color, "linestyle": dashes, "marker": marker, "markerfacecolor": "white"} | changes


def looks(names) -> list:
    """Return keyword arguments of `plot` for lines of one panel: those of methods, if all of them are methods."""
    if all(name in METHODS for name in names):
        return [line(name) for name in names]
    return [series(k, label=name) for k, name in enumerate(names)]


def log_scale(axis, values, decades=2.0) -> None:
    """Make `panel.xaxis` or `.yaxis` logarithmic for values, with ticks 1, 2, 5, 10 … where it has few decades.

    Values that differ by less than a factor of three, between which there may be no such tick, get a linear one.
    """
    known = np.asarray(values, float)
    known = known[np.isfinite(known) & (known > 0)]
    low, high = (known.min(), known.max()) if known.size else (1.0, 1.0)
    set_scale = getattr(axis.axes, f"set_{axis.axis_name}scale")
    if known.size and high < 3 * low:
        set_scale("linear")
        axis.axes.ticklabel_format(axis=axis.axis_name, scilimits=(-2, 4), useMathText=True)
        return
    set_scale("log")
    if high < low * 10**decades:
        axis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter(ticker.FuncFormatter(lambda value, _: plain(value)))
        axis.set_minor_formatter(ticker.NullFormatter())


def log_errors(panel, norms) -> None:
    """A logarithmic y axis for norms of errors that were drawn; a start on the path does not stretch it to rounding."""
    shown = [norm[np.isfinite(norm) & (norm > LEAST_ERROR)] for norm in map(np.asarray, norms)]
    bottom = 0.3 * min((np.quantile(norm, 0.01) for norm in shown if norm.size), default=0.0)
    shown = np.concatenate([norm[norm > bottom] for norm in shown] or [[]])
    log_scale(panel.yaxis, shown)
    if bottom and panel.get_yscale() == "log":
        panel.set_ylim(bottom, shown.max() * (shown.max() / bottom) ** 0.05)


def geometric(values) -> bool:
    """Return whether three or more positive numbers grow by one factor, or most lie in a tenth of their range."""
    values = np.asarray(values)
    if values.dtype.kind not in "if" or len(values) < 3 or values.min() <= 0:
        return False
    ratios = values[1:] / values[:-1]
    even = np.ptp(ratios) < 1e-6 * ratios[0] and abs(ratios[0] - 1) > 1e-9
    return bool(even or values.max() > 10 * np.median(values))


def plain(value) -> str:
    """A number on an axis: 0.05, or 5 × 10⁻⁵ where that would be long."""
    power = int(np.floor(np.log10(abs(value) or 1.0) + 1e-9))
    factor = f"{value / 10.0**power:.3g}"
    if -5 < power < 5:
        return f"{value:.6g}"
    return f"$10^{{{power}}}$" if factor == "1" else f"${factor}\\times10^{{{power}}}$"


def legend_columns(labels, width) -> int:
    """The most columns of a legend that fit into a width [in]."""
    for rows in range(1, len(labels)):
        columns = [labels[i : i + rows] for i in range(0, len(labels), rows)]
        if sum(0.46 + 0.05 * max(map(len, column)) for column in columns) < width:
            return len(columns)
    return 1


def legend(figure, panel) -> None:
    """One legend above all panels, with what one of them shows."""
    handles, labels = panel.get_legend_handles_labels()
    columns = legend_columns(labels, figure.get_figwidth())
    figure.legend(handles, labels, loc="outside upper center", ncols=columns)


def save(figure, path, about: dict) -> None:
    """Write a figure as PNG, PDF or SVG with a description in the file, of which the last two keep the title, and close
    it. The same figure gives the same bytes: no date goes into the file."""
    if (kind := pathlib.Path(path).suffix) == ".png":
        # Not savefig, which draws twice: once to lay out, and once more at the resolution of the file.
        figure.set_dpi(DPI)
        FigureCanvasAgg(figure).print_png(path, metadata={"Software": "cnclik"} | about)
    else:
        dated = {".pdf": "CreationDate", ".svg": "Date"}[kind]
        figure.savefig(path, metadata={"Title": about.get("Title", ""), dated: None}, dpi=DPI)
    plt.close(figure)
