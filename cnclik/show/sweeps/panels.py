"""Panels: equal axes over two dimensions of a view, with labels and scales that follow from the data."""

import itertools
import math
import textwrap

import numpy as np
from matplotlib import colors, figure
from matplotlib.artist import setp

from cnclik.show import style
from cnclik.sweeps.summary import text

MOST_IN_A_ROW = 5
LETTER = 0.06  # [in] mean width
LEGEND, BAR = 1.3, 0.7  # [in] what a legend, or a bar of colours, beside the panels takes


class Panels:
    """A grid of equal panels over `layout.panels` and `layout.rows`, either of which may be None."""

    def __init__(self, view, layout):
        self.view, self.layout = view, layout
        many = view.sizes[layout.panels] if layout.panels else 1
        down = view.sizes[layout.rows] if layout.rows else 1
        if not layout.rows and many > MOST_IN_A_ROW:
            many, down = math.ceil(many / 2), 2
        width = style.COLUMN if many == 1 else style.PAGE
        self.high = min(2.4, max(1.25, (width - 1.0) / many * 0.95))  # of a panel [in]
        height = 0.8 + down * self.high
        self.below = many == 1  # where the legend of lines goes: beside a single panel it would take its width
        if self.below and layout.lines:
            labels = [text(v) for v in view[layout.lines].values]
            height += 0.15 * (1 + math.ceil(len(labels) / style.legend_columns(labels, width)))
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
        between = ", " if all(len(", ".join(w)) * LETTER < self.room() for w in words) else ",\n"
        for ax, title, one in zip(flat, words, chosen, strict=False):
            ax.set_title(between.join(title))
            yield ax, *(v.isel({d: i for d, i in one.items() if d in v.dims}) for v in values)

    def room(self) -> float:
        """Width of a panel [in], or nearly so."""
        beside = LEGEND * bool(self.layout.lines and not self.below) + BAR * (self.layout.kind == "heat")
        return (self.figure.get_figwidth() - 1.0 - beside) / self.axes.shape[1]

    def scales(self, ax, x, y=()):
        """Logarithmic axes for values in geometric progression, or spread over decades by hand."""
        for values, axis, few in ((x, ax.xaxis, 2 if self.room() > 1.75 else 1), (y, ax.yaxis, 2)):
            if geometric(values):
                style.log_scale(axis, values, few)

    def name_few(self, ax, x, y):
        """Ticks at the values of the axes of a plane, where they have room: between them nothing was run."""
        for values, axis, used in (
            (x, ax.xaxis, sum(len(text(v)) + 2 for v in x) * LETTER / self.room()),
            (y, ax.yaxis, 2.5 * LETTER * len(y) / self.high),
        ):
            if used < 1:
                axis.set_ticks(values, [text(v) for v in values])
                axis.set_ticks([], minor=True)

    def finish(self, x: str, y: str):
        """Axis labels, a legend where there are lines, and the title. Returns: the figure."""
        setp(self.axes[-1], xlabel=x)
        setp(self.axes[:, 0], ylabel=textwrap.fill(y, max(16, int(self.high / LETTER))))
        lines = self.layout.lines
        handles, labels = self.axes[0, 0].get_legend_handles_labels()
        if lines and len(labels) > 1:
            place = {"loc": "outside right upper"}
            if self.below:
                place = {
                    "loc": "outside lower center",
                    "ncols": style.legend_columns(labels, self.figure.get_figwidth()),
                }
            self.figure.legend(handles, labels, title=axis_label(self.view[lines]), **place)
        fixed = [c for name, c in self.view.coords.items() if c.ndim == 0 and name != "limit"]
        title = self.layout.title or ", ".join(map(described, fixed))
        if title:
            self.figure.suptitle(title)
        return self.figure


def lines(part, dim):
    """(look, data) of each line along a dimension; one line where there is none."""
    if not dim or dim not in part.dims:
        yield {"color": style.COLORS[0], "label": "", "linewidth": 1.2}, part
        return
    names = [text(value) for value in part[dim].values]
    known = [style.METHODS[name] for name in names if name in style.METHODS]
    colors_left = [c for c in style.COLORS if c not in {method.color for method in known}] or style.COLORS
    marks_left = [m for m in style.MARKERS if m not in {method.marker for method in known}] or style.MARKERS
    free = itertools.count()
    for i, name in enumerate(names):
        if name in style.METHODS:
            look = style.line(name)
        else:
            k = next(free)
            own = {"color": colors_left[k % len(colors_left)], "marker": marks_left[k % len(marks_left)]}
            look = style.series(k, label=name, **own)
        yield {"linewidth": 1.2} | look, part.isel({dim: i})


# --- words --------------------------------------------------------------------------------------------


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


RAN_AWAY = 1e2  # [m, rad, rad/s]: what is beyond is no loop at work, if others are a thousand times beyond


def norm(values, layout):
    """Colours of a heat map: logarithmic where the values say so, nine decades of those that stay at most."""
    known = values[np.isfinite(values)]
    if not known.size:
        return colors.Normalize(0, 1)
    positive = known[known > 0]
    log = layout.log
    if log is None and positive.size and known.min() >= 0:
        low, high = np.quantile(positive, [0.02, 0.98])
        log = high > 50 * low
    if log and positive.size:
        if layout.limits:
            return colors.LogNorm(*layout.limits)
        # One loop that ran away, or values at rounding, would waste the colours on decades that nobody looks at.
        staying = positive[positive <= RAN_AWAY]
        high = staying.max() if staying.size and positive.max() > RAN_AWAY * 1e3 else positive.max()
        return colors.LogNorm(max(positive.min(), high * 1e-9), high)
    return colors.Normalize(*(layout.limits or (known.min(), known.max())))


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
    limits = layout.limits
    if log and positive.size:
        bottom = limits[0] if limits and limits[0] > 0 else 0.7 * max(positive.min(), positive.max() * 1e-16)
        style.log_scale(ax.yaxis, limits or np.maximum(positive, bottom))
        ax.set_ylim(bottom=bottom)
        for line in ax.lines:  # an error of exactly 0 lies on the axis: it is not missing
            line.set_ydata(np.where(line.get_ydata() <= 0, bottom, line.get_ydata()))
    if limits:
        ax.set_ylim(*limits)
