"""Curves: a value along one axis, its history, its distribution, and what it costs."""

import numpy as np
import xarray

from cnclik.show import style
from cnclik.show.sweeps.panels import Panels, axis_label, lines, value_scale
from cnclik.sweeps.summary import HISTORY

BAND = 8  # histories of more loops than this show their spread


def slices(view, layout):
    """A value along one axis."""
    value = view[layout.value]
    grid = Panels(view, layout)
    for ax, part in grid.each(value):
        x = part[layout.x].values
        for i, (look, line) in enumerate(lines(part, layout.lines)):
            ax.plot(x, _drawn(line.values), **{"marker": "."} | look, markevery=style.sparse(i, len(x)))
        grid.scales(ax, x)
        value_scale(ax, value.values, layout)
    return grid.finish(axis_label(view[layout.x]), axis_label(value))


def convergence(view, layout):
    """A history: the median over all loops of a line, and the band between their deciles."""
    value = view[layout.value]
    grid = Panels(view, layout)
    history = next(d for d in value.dims if d in HISTORY)
    for ax, part in grid.each(value):
        for i, (look, line) in enumerate(lines(part, layout.lines)):
            rows = _drawn(line.transpose(..., history).values.reshape(-1, line.sizes[history]))
            ax.plot(_quantiles(rows, 0.5), **look, markevery=style.sparse(i, rows.shape[1]))
            if len(rows) > BAND:
                low, high = _quantiles(rows, [0.1, 0.9])
                ax.fill_between(np.arange(rows.shape[1]), low, high, color=look["color"], alpha=0.15, linewidth=0)
        value_scale(ax, value.values, layout)
    return grid.finish("step k", axis_label(value))


def distribution(view, layout):
    """The share of loops at or below a value; one that is not finite is never reached."""
    value = view[layout.value]
    grid = Panels(view, layout)
    known = value.values[np.isfinite(value.values)]
    log = bool(known.size and known.min() > 0 and known.max() > 100 * np.median(known))
    for ax, part in grid.each(value):
        for i, (look, line) in enumerate(lines(part, layout.lines)):
            sample = np.sort(line.values.ravel())
            sample = sample[~np.isnan(sample)]
            share = np.arange(1, len(sample) + 1) / max(len(sample), 1)
            shown = np.isfinite(sample)
            ax.step(sample[shown], share[shown], where="post", **look, markevery=style.sparse(i, 40))
        if log if layout.log is None else layout.log:
            style.log_scale(ax.xaxis, known)
        ax.set(ylim=(0, 1), xlim=layout.limits)
    return grid.finish(axis_label(value), "share of loops at or below")


def work(view, layout):
    """A value against the evaluations of f(q, t) that it cost."""
    value, cost = xarray.broadcast(view[layout.value], view["evaluations"])
    grid = Panels(view, layout)
    for ax, part, price in grid.each(value, cost):
        for (look, line), (_, paid) in zip(lines(part, layout.lines), lines(price, layout.lines), strict=True):
            x, y = paid.values.ravel(), line.values.ravel()
            order = np.argsort(x, kind="stable")
            ax.plot(x[order], _drawn(y[order]), **{"marker": "o"} | look)
        ax.set_xscale("log")
        value_scale(ax, value.values, layout)
    return grid.finish("evaluations of f(q, t)", axis_label(value))


def _drawn(values):
    """A line has a gap where a value is not finite."""
    return np.where(np.isfinite(values), values, np.nan)


def _quantiles(rows, q):
    """Of each column over what is finite in it; NaN, and no warning, where nothing is."""
    none = np.all(np.isnan(rows), axis=0)
    return np.where(none, np.nan, np.nanquantile(np.where(none, 0.0, rows), q, axis=0))
