"""Panels: equal axes over two dimensions of a view, with labels and scales that follow from the data."""

import itertools
import math
import textwrap

import numpy as np
from matplotlib import figure
from matplotlib.artist import setp

from cnclik.show import style
from cnclik.sweeps.summary import text

MOST_IN_A_ROW = 5
LETTER = 0.06  # [in] mean width
BESIDE = 1.3  # [in] what a legend or a bar of colours beside the panels takes


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
        self.room = (width - 1.0 - BESIDE * (many > 1)) / many  # its width, or nearly so [in]
        height = 0.8 + down * self.high
        self.below = many == 1  # where the legend of lines goes: beside a single panel it would take its width
        if self.below and layout.lines:
            labels = [text(v) for v in view[layout.lines].values]
            height += 0.15 * (1 + math.ceil(len(labels) / style.legend_columns(labels, width)))
        self.figure = figure.Figure(figsize=(width, height))
        self.axes = self.figure.subplots(down, many, squeeze=False, sharex=True, sharey=True)

    def each(self, *values):
        """Yield (axes, that panel's part of each of the values)."""
        dims = [d for d in (self.layout.rows, self.layout.panels) if d]
        places = list(itertools.product(*(range(self.view.sizes[d]) for d in dims)))
        for ax in self.axes.ravel()[len(places) :]:
            ax.set_axis_off()
        chosen = [dict(zip(dims, place, strict=True)) for place in places]
        words = [[described(self.view[d][i]) for d, i in one.items()] for one in chosen]
        between = ", " if all(len(", ".join(w)) * LETTER < self.room for w in words) else ",\n"
        for ax, title, one in zip(self.axes.ravel(), words, chosen, strict=False):
            ax.set_title(between.join(title))
            yield ax, *(v.isel({d: i for d, i in one.items() if d in v.dims}) for v in values)

    def scales(self, ax, x, y=()):
        """Set logarithmic axes for values in geometric progression, or spread over decades by hand."""
        for values, axis, few in ((x, ax.xaxis, 2 if self.room > 1.75 else 1), (y, ax.yaxis, 2)):
            if style.geometric(values):
                style.log_scale(axis, values, few)

    def name_few(self, ax, x, y):
        """Set ticks at the values of the axes of a plane, where they have room: between them nothing was run."""
        for values, axis, used in (
            (x, ax.xaxis, sum(len(text(v)) + 2 for v in x) * LETTER / self.room),
            (y, ax.yaxis, 2.5 * LETTER * len(y) / self.high),
        ):
            if used < 1:
                axis.set_ticks(values, [text(v) for v in values])
                axis.set_ticks([], minor=True)

    def finish(self, x: str, y: str):
        """Return the figure with labels of its axes, a legend where there are lines, and a title."""
        setp(self.axes[-1], xlabel=x)
        setp(self.axes[:, 0], ylabel=textwrap.fill(y, max(16, int(self.high / LETTER))))
        handles, labels = self.axes[0, 0].get_legend_handles_labels()
        if self.layout.lines and len(labels) > 1:
            columns = style.legend_columns(labels, self.figure.get_figwidth()) if self.below else 1
            place = "outside lower center" if self.below else "outside right upper"
            title = axis_label(self.view[self.layout.lines])
            self.figure.legend(handles, labels, title=title, loc=place, ncols=columns)
        fixed = [c for name, c in self.view.coords.items() if c.ndim == 0 and name != "limit"]
        self.figure.suptitle(self.layout.title or ", ".join(map(described, fixed)))
        return self.figure


def described(coordinate) -> str:
    """Return a single coordinate in words: "CN", "α = 5 1/s"."""
    value = coordinate.values.item()
    if isinstance(value, str):
        return value
    name, unit = _name(coordinate).partition(" = ")[0], coordinate.attrs.get("units", "")
    return f"{name} = {text(value)}" + (f" {unit}" if unit not in ("", "1") else "")


def axis_label(variable) -> str:
    """Return the variable's name and unit: "α [1/s]"."""
    unit = variable.attrs.get("units", "")
    return f"{_name(variable)} [{unit}]" if unit not in ("", "1") else _name(variable)


def _name(variable):
    return variable.attrs.get("long_name") or str(variable.name).replace("_", " ")


def is_logarithmic(values, layout) -> bool:
    """Return whether a value is drawn on a logarithmic scale: as the table asks, or where values spread."""
    known = values[np.isfinite(values)].astype(float)  # counts and verdicts too
    positive = known[known > 0]
    if layout.log is not None or not positive.size or known.min() < 0:
        return bool(layout.log and positive.size)
    low, high = np.quantile(positive, [0.02, 0.98])
    return high > 50 * low
