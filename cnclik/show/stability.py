"""Figures of stability: regions in the z-plane, maps of simulated loops with the linear limit, gains."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import ListedColormap, LogNorm
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
_OPERATING = {"marker": "o", "color": "white", "markeredgecolor": "black", "markersize": 6, "zorder": 6}
_OPERATING |= {"clip_on": False}


def plane(data):
    """Stability regions |R(z)| ≤ 1, a panel for the explicit methods and one for each implicit one.

    Args:
      data: from `cnclik.stability.plane`.
    """
    groups = {}
    for method, stage, region in zip(data.method.values, data.stage.values, data.region, strict=True):
        groups.setdefault(str(method) if stage else "explicit", {})[str(stage) or str(method)] = region
    columns = min(len(groups), 4)
    rows = -(-len(groups) // columns)
    size = (style.PAGE, 2.2 * rows + 0.45)
    figure, axes = plt.subplots(rows, columns, figsize=size, sharex=True, sharey=True, squeeze=False)
    handles = {}
    for axis, (title, group) in zip(axes.flat, groups.items(), strict=False):
        shades = plt.get_cmap("viridis")(np.linspace(0.0, 0.9, max(len(group), 2)))
        for i, (shade, (name, region)) in enumerate(zip(shades, group.items(), strict=False)):
            color, dashes = style.METHODS[name][:2] if name in style.METHODS else (shade, style.DASHES[i % 6])
            if name == "exact":
                color, dashes = style.BLACK, (0, (4, 1.5))
                axis.contourf(data.re, data.im, region, levels=[0, 1], colors=["0.93"], zorder=0)
                handles["area"] = Patch(facecolor="0.93", label="stable if exact")
            axis.contour(data.re, data.im, region, levels=[1.0], colors=[color], linewidths=1.0, linestyles=[dashes])
            handles[name] = plt.Line2D([], [], color=color, linestyle=dashes, linewidth=1.0, label=name)
        axis.axhline(0, color="0.6", linewidth=0.5, zorder=1)
        axis.axvline(0, color="0.6", linewidth=0.5, zorder=1)
        axis.set(title=title, aspect="equal", xlim=(-2, 4), ylim=(-3.1, 3.1))
    figure.legend(handles=handles.values(), loc="outside lower center", ncols=7, fontsize=6)
    for axis in axes.flat[len(groups) :]:
        axis.axis("off")
    plt.setp(axes[-1], xlabel="Re z,  z = α·Ts")
    plt.setp(axes[:, 0], ylabel="Im z")
    return figure


def stability_map(data, *, title="", operating=None):
    """How simulated loops end over (alpha, Ts), with the linear stability limit, and an operating point.

    Args:
      data: from `cnclik.stability.stability_map`. operating: (alpha, Ts), or None.
    """
    figure, axis = plt.subplots(figsize=(style.PAGE * 0.62, 3.1))
    x, y, limit = data.alpha.values, data.Ts.values, data.limit.values
    axis.set(title=title, xlabel="gain α [1/s]", ylabel="sampling time Ts [s]")
    axis.grid(False)
    rate = np.ma.masked_where(data.ending.values != Ending.CONVERGED, data.rate.values)
    mesh = axis.pcolormesh(x, y, rate, cmap=RATES, vmin=0, vmax=1, shading="nearest", rasterized=True)
    handles = []
    for ending, (color, hatch, words) in FLAT.items():
        where = data.ending.values == ending
        if where.any():
            flat = np.ma.masked_where(~where, np.ones(where.shape))
            axis.pcolormesh(x, y, flat, cmap=ListedColormap([color]), shading="nearest", rasterized=True)
            handles.append(Patch(facecolor=color, hatch=hatch, label=words))
            if hatch:
                axis.contourf(x, y, where, levels=[0.5, 1.5], colors="none", hatches=[hatch])
    figure.colorbar(mesh, ax=axis, label="error factor per step (simulated)", fraction=0.05)
    for values, ticks in ((x, axis.xaxis), (y, axis.yaxis)):
        if style.geometric(values):
            style.log_scale(ticks, values)
    if (known := np.isfinite(limit)).any():
        handles.append(plt.Line2D([], [], label="linear stability limit", **style.OUTLINED))
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=6, columnspacing=1.0)
    axis.plot(limit[known], y[known], **style.OUTLINED)
    if operating is not None:
        alpha, Ts = operating
        axis.plot(alpha, Ts, **_OPERATING)
        place = {"xytext": (-7, -7), "textcoords": "offset points", "ha": "right", "va": "top", "zorder": 6}
        box = {"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
        axis.annotate(f"z = {alpha * Ts:.3g}", (alpha, Ts), fontsize=6.5, bbox=box, **place)
    axis.set(xlim=x[[0, -1]], ylim=y[[0, -1]])
    return figure


def gains(data, *, title="", operating=None):
    """The recommended gain over sampling time and dead time, as lines of equal gain.

    Args: data: from `cnclik.stability.gain_table`. operating: (Ts, dead time) now, or None.
    """
    figure, axis = plt.subplots(figsize=(style.PAGE * 0.62, 3.1))
    x, y, values = 1e3 * data.Ts.values, 1e3 * data.dead_time.values, data.recommended.values.T
    values = np.ma.masked_equal(values, 0.0)  # no gain is recommended there
    low, high = (values.min(), values.max()) if values.count() else (1.0, 1.0)
    levels = sorted({v for gain in np.geomspace(low, high, 8) if low < (v := float(f"{gain:.2g}")) < high})
    shown = axis.pcolormesh(x, y, values, norm=LogNorm(), cmap=RATES, shading="nearest", rasterized=True)
    bar = figure.colorbar(shown, ax=axis, label="recommended gain α [1/s]", fraction=0.05)
    bar.set_ticks(levels, labels=[f"{v:g}" for v in levels])
    bar.minorticks_off()
    if levels:
        lines = axis.contour(x, y, values, levels=levels, colors="black", linewidths=0.8)
        axis.clabel(lines, fmt=lambda v: f"{v:g}", fontsize=6.5)
    if operating is not None:
        axis.plot(1e3 * operating[0], 1e3 * operating[1], **_OPERATING)
    style.log_scale(axis.xaxis, x)
    axis.set(xlabel="sampling time Ts [ms]", ylabel="dead time [ms]", title=title)
    return figure
