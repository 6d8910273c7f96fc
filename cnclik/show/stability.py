"""Figures of stability: regions in the z-plane, maps of simulated loops with the linear limit, maps over M."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from cnclik.measure.outcome import Ending
from cnclik.show import style

RATES = ListedColormap(plt.get_cmap("viridis")(np.linspace(0.25, 1.0, 256)), "rates")
# Lighter or darker than every rate, or hatched, so that greyscale separates them.
FLAT = {
    Ending.SLOW: ("#fbf5c8", "", "converging, not done in N steps"),
    Ending.STALLED: ("#bdbdbd", "//////", "bounded and wrong"),
    Ending.DIVERGED: ("#5e1a03", "", "diverged"),
    Ending.NEAR_SINGULAR: ("#f4a582", "......", "failed near a singularity"),
}


def plane(data):
    """Stability regions |R(z)| ≤ 1, a panel for the explicit methods and one for each implicit one.

    Args:
      data: from `cnclik.stability.plane`.
    """
    groups = {}
    for row in data.region_row.values:
        method, _, stage = str(row).partition(" ")
        groups.setdefault(method if stage else "explicit", {})[stage or method] = data.region.sel(region_row=row)
    columns = min(len(groups), 4)
    rows = -(-len(groups) // columns)
    size = (style.PAGE, 2.2 * rows + 0.45)
    figure, axes = plt.subplots(rows, columns, figsize=size, sharex=True, sharey=True, squeeze=False)
    named = {}
    for axis, (title, group) in zip(axes.flat, groups.items(), strict=False):
        shades = plt.get_cmap("viridis")(np.linspace(0.0, 0.9, max(len(group), 2)))
        for i, (shade, (name, region)) in enumerate(zip(shades, group.items(), strict=False)):
            color, dashes = style.METHODS[name][:2] if name in style.METHODS else (shade, style.DASHES[i % 6])
            if name == "exact":
                color, dashes = style.BLACK, (0, (4, 1.5))
                axis.contourf(data.re, data.im, region, levels=[0, 1], colors=["0.93"], zorder=0)
            axis.contour(data.re, data.im, region, levels=[1.0], colors=[color], linewidths=1.0, linestyles=[dashes])
            named[name] = plt.Line2D([], [], color=color, linestyle=dashes, linewidth=1.0, label=name)
        for line in (axis.axhline, axis.axvline):
            line(0, color="0.6", linewidth=0.5, zorder=1)
        axis.set(title=title, aspect="equal", xlim=(-2, 4), ylim=(-3.1, 3.1))
    if "exact" in named:
        named["area"] = Patch(facecolor="0.93", label="stable if exact")
    figure.legend(handles=named.values(), loc="outside lower center", ncols=7, fontsize=6)
    for axis in axes.flat[len(groups) :]:
        axis.axis("off")
    plt.setp(axes[-1], xlabel="Re z,  z = α·Ts")
    plt.setp(axes[:, 0], ylabel="Im z")
    return figure


def stability_map(data, *, title="", operating=None):
    """How simulated loops end over (alpha, Ts), the linear stability limit, and an operating point with its margin.

    Args:
      data: from `cnclik.stability.stability_map`.
      operating: (alpha, Ts, margin), or None.
    """
    figure, axis = plt.subplots(figsize=(style.PAGE * 0.62, 3.1))
    mesh = _cells(axis, data.alpha, data.Ts, data)
    figure.colorbar(mesh, ax=axis, label="error factor per step (simulated)", fraction=0.05)
    _legend(figure, [data], columns=3)
    axis.set(xlabel="gain α [1/s]", ylabel="sampling time Ts [s]", title=title)
    for values, ticks in ((data.alpha, axis.xaxis), (data.Ts, axis.yaxis)):
        if style.geometric(values.values):
            style.log_scale(ticks, values)
    finite = np.isfinite(data.limit.values)
    axis.plot(data.limit.values[finite], data.Ts.values[finite], **style.OUTLINED)
    if operating is not None:
        alpha, Ts, margin = operating
        axis.plot(alpha, Ts, "o", color="white", markeredgecolor="black", markersize=6, zorder=6)
        place = {"xytext": (-7, -7), "textcoords": "offset points", "ha": "right", "va": "top", "zorder": 6}
        box = {"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
        words = f"z = {alpha * Ts:.3g}\ngain margin {margin:.3g}"
        axis.annotate(words, (alpha, Ts), fontsize=6.5, bbox=box, **place)
    axis.set(xlim=data.alpha.values[[0, -1]], ylim=data.Ts.values[[0, -1]])
    return figure


def radii(axis, x, y, radius, limit=None):
    """Spectral radii as shades over two gains, or a gain and a sampling time; hatched where a loop is unstable.

    Args: limit: (k, 2) where it becomes unstable, from the top of the plane to its right; None: interpolated.
    """
    levels = [0, 0.2, 0.4, 0.6, 0.8, 1.0, 1e9]
    shades = ["#eaf3fa", "#cfe3f2", "#a9cde6", "#7fb2d6", "#4f93c1", "0.95"]
    hatches = [None] * 5 + ["////"]
    most = 10 if limit is None else 1
    shown = axis.contourf(x, y, np.minimum(radius, most), levels=levels, colors=shades, hatches=hatches)
    bar = axis.figure.colorbar(shown, ax=axis, label="spectral radius", fraction=0.05, drawedges=True)
    bar.set_ticks(levels, labels=[*(f"{level:g}" for level in levels[:-1]), "∞"])
    style.log_scale(axis.xaxis, x, decades=3)
    style.log_scale(axis.yaxis, y, decades=3)
    if limit is None:
        axis.contour(x, y, radius, levels=[1.0], colors="black", linewidths=1.4)
    elif len(limit):
        (left, _), (_, low), right, top = limit[0], limit[-1], float(x[-1]), float(y[-1])
        beyond = np.vstack([limit, [(right, low), (right, top), (left, top)]])
        axis.fill(*beyond.T, facecolor=shades[-1], edgecolor="black", hatch=hatches[-1], linewidth=0)
        axis.plot(*limit.T, color="black", linewidth=1.4)
    axis.grid(False)


def gains(data, *, title="", operating=None):
    """Spectral radius over the gains of two tasks, the limits for any posture, and an operating point.

    Args: data: from `cnclik.stability.gains_map`. operating: the two gains now, or None.
    """
    figure, axis = plt.subplots(figsize=(style.PAGE * 0.62, 3.4))
    y, x = (data[name] for name in data.radius.dims)
    limit = np.stack([data[f"limit of {one.name}"].dropna("ray of limit") for one in (x, y)], -1)
    radii(axis, x, y, np.maximum(data.radius.values, 1e-12), limit)
    line = plt.Line2D([], [], color="black", linewidth=1.4, label="stability limit at this posture")
    drawn = [line] if len(limit) else []
    bounds = (("stable", style.LOST, "stability limit at any"), ("recommended", style.FINE, "recommended at any"))
    for name, color, label in bounds:
        most = data.attrs[name]
        if np.isfinite(most):
            look = {"color": color, "linewidth": 1.2, "linestyle": style.DASH, "label": f"{label} posture"}
            drawn += axis.plot([float(x[0]), most, most], [most, most, float(y[0])], **look)
    if operating is not None:
        look = {"linestyle": "none", "markeredgecolor": "white", "color": "0.35", "markersize": 8, "label": "now"}
        drawn += axis.plot(*operating, "o", zorder=5, **look)
    labels = [f"{one.attrs['long_name']} [1/s]" for one in (x, y)]
    axis.set(xlim=x.values[[0, -1]], ylim=y.values[[0, -1]], title=title, xlabel=labels[0], ylabel=labels[1])
    figure.legend(handles=drawn, loc="outside lower center", ncols=2, fontsize=6, columnspacing=1.0)
    return figure


def passes(panels):
    """How simulated loops end over z and M, with the linear stability limit of each M; odd and even M differ.

    Args:
      panels: {title: Dataset from `cnclik.stability.passes_map`}.
    """
    figure, axes = plt.subplots(1, len(panels), figsize=(style.PAGE, 2.6), sharey=True, squeeze=False)
    for axis, (title, data) in zip(axes[0], panels.items(), strict=True):
        rows = np.arange(data.sizes["M"])
        mesh = _cells(axis, data.z, rows, data)
        for row, limit in zip(rows, data.limit.values, strict=True):
            if np.isfinite(limit):
                axis.plot([limit, limit], [row - 0.5, row + 0.5], **style.OUTLINED)
        axis.set(xlabel="z = α·Ts", title=title, yticks=rows, yticklabels=data.M.values, xlim=data.z.values[[0, -1]])
    axes[0, 0].set_ylabel("iterations M")
    figure.colorbar(mesh, ax=axes[0, -1], label="error factor per step", fraction=0.05)
    _legend(figure, panels.values())
    return figure


def _cells(axis, x, y, data):
    """Outcomes as cells: the rate where converged, a flat colour elsewhere."""
    axis.grid(False)
    rate = np.ma.masked_where(data.ending.values != Ending.CONVERGED, data.rate.values)
    mesh = axis.pcolormesh(x, y, rate, cmap=RATES, vmin=0, vmax=1, shading="nearest", rasterized=True)
    for ending, (color, hatch, _) in FLAT.items():
        where = data.ending.values == ending
        if where.any():
            flat = np.ma.masked_where(~where, np.ones(where.shape))
            axis.pcolormesh(x, y, flat, cmap=ListedColormap([color]), shading="nearest", rasterized=True)
            if hatch:
                axis.contourf(x, y, where, levels=[0.5, 1.5], colors="none", hatches=[hatch])
    return mesh


def _legend(figure, several, *, columns=4):
    seen = set(np.concatenate([np.unique(data.ending.values) for data in several]))
    shown = (look for ending, look in FLAT.items() if ending in seen)
    handles = [Patch(facecolor=color, hatch=hatch, label=label) for color, hatch, label in shown]
    if any(np.isfinite(data.limit.values).any() for data in several):
        handles.append(plt.Line2D([], [], label="linear stability limit", **style.OUTLINED))
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, fontsize=6, columnspacing=1.0)
