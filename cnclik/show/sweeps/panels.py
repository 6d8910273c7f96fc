"""Panels: equal axes over two dimensions of a view, with labels and scales that follow from the data."""

import itertools
import math
import textwrap

import numpy as np
from matplotlib import colors, figure
from matplotlib.artist import setp

from cnclik.show import style

MOST_IN_A_ROW = 5
LETTER = 0.06  # [in] mean width
LEGEND = 1.3  # [in] what a legend beside the panels takes


class Panels:
    """A grid of equal panels over `layout.panels` and `layout.rows`, either of which may be None."""

    def __init__(self, view, layout):
        self.view, self.layout = view, layout
        many = view.sizes[layout.panels] if layout.panels else 1
        down = view.sizes[layout.rows] if layout.rows else 1
        if not layout.rows and many > MOST_IN_A_ROW:
            many, down = math.ceil(many / 2), 2
        width = min(style.PAGE, 1.0 + 2.6 * many)
        height = 0.8 + down * min(2.4, max(1.25, (width - 1.0) / many * 0.95))
        self.figure = figure.Figure(figsize=(width, height))
        self.axes = self.figure.subplots(down, many, squeeze=False, sharex=True, sharey=True)

    def each(self, *values):
        """(axes, that panel's part of each of the values)."""
        dims = [d for d in (self.layout.rows, self.layout.panels) if d]
        places = list(itertools.product(*(range(self.view.sizes[d]) for d in dims)))
        flat = self.axes.ravel()
        for ax in flat[len(places) :]:
            ax.set_axis_off()
        chosen = [dict(zip(dims, place, strict=True)) for place in places]
        words = [[described(self.view[d][i]) for d, i in one.items()] for one in chosen]
        room = (self.figure.get_figwidth() - 1.0 - LEGEND * bool(self.layout.lines)) / self.axes.shape[1]
        between = ", " if all(len(", ".join(w)) * LETTER < room for w in words) else ",\n"
        for ax, title, one in zip(flat, words, chosen, strict=False):
            ax.set_title(between.join(title))
            yield ax, *(v.isel({d: i for d, i in one.items() if d in v.dims}) for v in values)

    def finish(self, x: str, y: str):
        """Axis labels, a legend where there are lines, and the title. Returns: the figure."""
        setp(self.axes[-1], xlabel=x)
        room = (self.figure.get_figheight() - 0.8) / len(self.axes)
        setp(self.axes[:, 0], ylabel=textwrap.fill(y, max(16, int(room / LETTER))))
        lines = self.layout.lines
        handles, labels = self.axes[0, 0].get_legend_handles_labels()
        if lines and len(labels) > 1:
            self.figure.legend(handles, labels, loc="outside right upper", title=axis_label(self.view[lines]))
        fixed = [c for name, c in self.view.coords.items() if c.ndim == 0 and name != "limit"]
        title = self.layout.title or ", ".join(map(described, fixed))
        if title:
            self.figure.suptitle(title, fontsize=8)
        return self.figure


def lines(part, dim):
    """(look, data) of each line along a dimension; one line where there is none."""
    if not dim or dim not in part.dims:
        yield {"color": style.COLORS[0], "label": "", "linewidth": 1.2}, part
        return
    for i, value in enumerate(part[dim].values):
        known = dim == "method" and str(value) in style.METHODS
        look = style.line(str(value)) if known else {"color": style.COLORS[i % 8], "label": text(value)}
        yield {"linewidth": 1.2} | look, part.isel({dim: i})


# --- words --------------------------------------------------------------------------------------------


def text(value) -> str:
    """A label's value, four digits."""
    return f"{value:.4g}" if isinstance(value, (float, np.floating)) else str(value)


def described(coordinate) -> str:
    """A single coordinate in words: "CN", "α = 5 1/s"."""
    value = coordinate.values.item()
    if isinstance(value, str):
        return value
    name, unit = _name(coordinate).partition(" = ")[0], coordinate.attrs.get("units", "")
    return f"{name} = {text(value)}" + (f" {unit}" if unit not in ("", "1") else "")


def axis_label(variable) -> str:
    """The variable's name and unit: "α [1/s]"."""
    unit = variable.attrs.get("units", "")
    return f"{_name(variable)} [{unit}]" if unit not in ("", "1") else _name(variable)


def _name(variable):
    return variable.attrs.get("long_name") or str(variable.name).replace("_", " ")


# --- scales -------------------------------------------------------------------------------------------


def norm(values, layout):
    """Colours of a heat map: logarithmic where the values say so, the smallest nine decades at most."""
    known = values[np.isfinite(values)]
    if not known.size:
        return colors.Normalize(0, 1)
    positive = known[known > 0]
    log = layout.log
    if log is None and positive.size and known.min() >= 0:
        low, high = np.quantile(positive, [0.02, 0.98])
        log = high > 50 * low
    if log and positive.size:
        # Values at rounding would waste the colours on twelve empty decades.
        low, high = layout.limits or (max(positive.min(), positive.max() * 1e-9), positive.max())
        return colors.LogNorm(low, high)
    return colors.Normalize(*(layout.limits or (known.min(), known.max())))


def axis_scales(ax, x, y=()):
    """Logarithmic axes for values in geometric progression, or spread over decades by hand."""
    for values, scale in ((x, ax.set_xscale), (y, ax.set_yscale)):
        if geometric(values):
            scale("log")


def geometric(values) -> bool:
    """Whether three or more positive numbers grow by the same factor, or most of them lie in a tenth of their range."""
    values = np.asarray(values)
    if values.dtype.kind not in "if" or len(values) < 3 or values.min() <= 0:
        return False
    if values.max() > max(50 * values.min(), 10 * np.median(values)):
        return True
    ratios = values[1:] / values[:-1]
    return bool(np.ptp(ratios) < 1e-6 * ratios[0] and abs(ratios[0] - 1) > 1e-9)


def value_scale(ax, values, layout):
    """The y axis of a value: logarithmic where the values say so."""
    known = values[np.isfinite(values)]
    positive = known[known > 0]
    log = layout.log
    if log is None and positive.size:
        log = known.min() >= 0 and positive.max() > 50 * positive.min()
    if log and positive.size:
        ax.set_yscale("log")
        ax.set_ylim(bottom=0.7 * max(positive.min(), positive.max() * 1e-16))
    if layout.limits:
        ax.set_ylim(*layout.limits)
