"""Planes: a value over two numeric axes, and which of several is best there."""

import math

import numpy as np
from matplotlib import colors, patches, ticker
from matplotlib.patheffects import withStroke

from cnclik.show import style
from cnclik.show.sweeps.panels import LETTER, Panels, axis_label, lines, norm
from cnclik.sweeps.summary import text

ISOLINES = (0.1, 0.5, 1.0, 2.0)  # of z = alpha·Ts
ISOLINE = {
    "color": "black",
    "linewidth": 0.5,
    "zorder": 2,
    "path_effects": [withStroke(linewidth=1.1, foreground="0.8")],
}
ROUGH = 0.15  # decades by which log10 of a value may bend from cell to cell before it counts as chance
_LABEL = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8}


def heat(view, layout):
    """A value's colours over a plane, contours, and the linear theory's limit where the data carry one."""
    value = view[layout.value].astype(float)  # counts and verdicts too
    grid = Panels(view, layout)
    scale = norm(value.values, layout)
    counts = any(view[d].dtype.kind == "i" for d in (layout.x, layout.y))
    levels = layout.contours if layout.contours is not None else not counts
    bounded = []
    for ax, part in grid.each(value):
        x, y, z = _plane(part, layout)
        shown = np.ma.masked_invalid(z)
        if isinstance(scale, colors.LogNorm):
            shown = np.ma.clip(shown, scale.vmin, None)  # an error of exactly 0 is the smallest, not missing
        mesh = _mesh(ax, x, y, shown, norm=scale)
        grid.scales(ax, x, y)
        grid.name_few(ax, x, y)
        drawn = boundary(ax, part, layout) if layout.boundary else []
        bounded = bounded or drawn
        if levels is not False:
            _contours(ax, x, y, shown, scale, levels)
    if bounded:
        words = value.coords["limit"].attrs.get("long_name", "limit")
        grid.figure.legend(bounded, [words], loc="outside lower center")
    beyond = np.any(np.isfinite(value.values) & (value.values > scale.vmax))
    extend = "both" if layout.limits else "max" if beyond else "neither"
    bar = grid.figure.colorbar(mesh, ax=grid.axes.ravel().tolist(), extend=extend, pad=0.02)
    bar.set_label(axis_label(value))
    return grid.finish(axis_label(view[layout.x]), axis_label(view[layout.y]))


def best(view, layout):
    """Which of several has the least value over a plane; grey where no loop ends well: there it is chance."""
    value, among = view[layout.value], layout.among
    names = [text(v) for v in value[among].values]
    grid = Panels(view, layout)
    looks = [look["color"] for look, _ in lines(value, among)]
    for ax, part in grid.each(value):
        x, y, z = _plane(part, layout, among)
        finite = np.where(np.isfinite(z), z, np.inf)
        chance = ~np.isfinite(finite.min(axis=0)) | beyond_every_limit(part, layout)
        winner = np.ma.masked_where(chance, finite.argmin(axis=0))
        _mesh(ax, x, y, winner, cmap=colors.ListedColormap(looks), vmin=-0.5, vmax=len(names) - 0.5)
        grid.scales(ax, x, y)
        grid.name_few(ax, x, y)
        isolines = {layout.x, layout.y} == {"alpha", "Ts"} and layout.boundary
        _named(ax, x, y, winner, names, _isolines(ax) if isolines else [], grid.room())
    handles = [patches.Patch(color=c, label=n) for c, n in zip(looks, names, strict=True)]
    title = f"least {axis_label(value)}"
    columns = style.legend_columns(names, grid.figure.get_figwidth())
    grid.figure.legend(handles=handles, loc="outside lower center", ncols=columns, title=title)
    return grid.finish(axis_label(view[layout.x]), axis_label(view[layout.y]))


def _plane(part, layout, *before):
    """x, y, and the values with dimensions (*before, y, x)."""
    part = part.transpose(*before, layout.y, layout.x)
    return part[layout.x].values, part[layout.y].values, part.values


def _mesh(ax, x, y, z, **how):
    ax.set_facecolor("0.85")  # where nothing is drawn
    ax.grid(False)
    return ax.pcolormesh(x, y, z, shading="nearest", rasterized=True, **how)


# --- contours -----------------------------------------------------------------------------------------


def _contours(ax, x, y, z, scale, levels):
    log = isinstance(scale, colors.LogNorm)
    if levels is True:
        levels = _decades(scale) if log else ticker.MaxNLocator(5).tick_values(scale.vmin, scale.vmax)
    levels = [v for v in levels if scale.vmin < v < scale.vmax]
    z = np.ma.masked_where(rough(z), z)
    if levels and min(z.shape) > 1 and z.count() > 4:
        shades = ["white" if scale(v) < 0.65 else "black" for v in levels]
        drawn = ax.contour(x, y, z, levels=levels, colors=shades, linewidths=0.6, alpha=0.8)
        style.label_contours(ax, drawn, lambda v: style.plain(v, decimal=not log))


def _decades(scale):
    found = np.arange(math.ceil(math.log10(scale.vmin)), math.floor(math.log10(scale.vmax)) + 1)
    return 10.0 ** found[:: max(1, len(found) // 5)]


def rough(z):
    """Where a plane's large values have little to do with their neighbours, as in diverged, chaotic loops.

    Contours there would be noise. A flank may be as steep as it likes: what counts is how much log10 z bends from cell
    to cell, |a − 2b + c| along both axes, the median of each 3×3 neighbourhood; large are the upper 1.5 decades.
    """
    known = np.ma.filled(np.ma.masked_invalid(z), np.inf)
    top = np.log10(max(known[np.isfinite(known)].max(initial=0), 1e-300))
    size = np.clip(np.log10(np.maximum(known, 1e-300)), top - 3, top + 1)
    bend = np.zeros_like(size)
    bend[1:-1] += np.abs(np.diff(size, 2, axis=0))
    bend[:, 1:-1] += np.abs(np.diff(size, 2, axis=1))
    near = np.lib.stride_tricks.sliding_window_view(np.pad(bend, 1, mode="reflect"), (3, 3))
    return (np.median(near, axis=(-2, -1)) > ROUGH) & (size > top - 1.5)


# --- theory -------------------------------------------------------------------------------------------


def boundary(ax, part, layout) -> list:
    """The largest z = alpha·Ts at which linear theory calls the panel's loops stable, from the data's `limit`.

    Returns: the line drawn, in a list; an empty one where the data have no limit for this plane.
    """
    names, limit = {layout.x, layout.y}, part.coords.get("limit")
    if limit is None or not np.isfinite(limit).any():
        return []
    if limit.ndim == 0 and names == {"alpha", "Ts"}:
        return _hyperbola(ax, float(limit), **style.OUTLINED)
    if limit.ndim == 0 and "z" in names:
        return [(ax.axvline if layout.x == "z" else ax.axhline)(float(limit), **style.OUTLINED)]
    if limit.dims == ("M",) and names == {"z", "M"}:
        counts, steps = part["M"].values, np.where(np.isfinite(limit), limit, np.nan)
        edges = np.concatenate([[counts[0] - 0.5], (counts[1:] + counts[:-1]) / 2, [counts[-1] + 0.5]])
        steps = np.append(steps, steps[-1])
        if layout.x == "M":
            return ax.step(edges, steps, where="post", **style.OUTLINED)
        return ax.step(steps, edges, where="pre", **style.OUTLINED)
    return []


def beyond_every_limit(part, layout):
    """The (y, x) cells of an alpha-Ts plane, or one of z, with z above every limit that the data carry."""
    names, limit = {layout.x, layout.y}, part.coords.get("limit")
    none = np.zeros((part.sizes[layout.y], part.sizes[layout.x]), bool)
    known = names == {"alpha", "Ts"} or "z" in names
    if limit is None or not known or not set(limit.dims) <= {layout.among} or np.isnan(limit).any():
        return none
    z = part["z"] if "z" in names else part["alpha"] * part["Ts"]
    z = z.broadcast_like(part.isel({layout.among: 0})).transpose(layout.y, layout.x)
    return z.values > float(limit.max())


def _hyperbola(ax, z, **look):
    """The line alpha·Ts = z, the axes left as they are."""
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    x = np.geomspace(max(left, right * 1e-6), right, 400)
    drawn = ax.plot(x, z / x, **look)
    ax.set_xlim(left, right)
    ax.set_ylim(bottom, top)
    return drawn


def _named(ax, x, y, winner, names, taken, wide):
    """Names in the middle of their largest areas, where they fit: these tell the areas apart in greyscale.

    Args: taken: places of other words. wide: the panel [in].
    """
    from scipy.ndimage import distance_transform_edt

    free = np.ones(winner.shape, bool)
    for across, up in taken:
        free[np.abs(np.log(y / up)).argmin(), np.abs(np.log(x / across)).argmin()] = False
    for i, name in enumerate(names):
        own = np.pad((np.ma.filled(winner, -1) == i) & free, 1)  # beyond the edges there is nothing
        inside = distance_transform_edt(own, sampling=(1 / len(y), 1 / len(x)))[1:-1, 1:-1]
        row, column = np.unravel_index(inside.argmax(), inside.shape)
        if inside.max() * wide > 0.5 * LETTER * len(name):
            ax.text(x[column], y[row], name, fontsize=6, ha="center", va="center", bbox=_LABEL)


def _isolines(ax) -> list:
    """Lines of constant z = alpha·Ts, labelled where there is room. Returns: the places of the labels."""
    taken = []
    for z in ISOLINES:
        (line,) = _hyperbola(ax, z, **ISOLINE)
        (bottom, top), points = ax.get_ylim(), line.get_xydata()
        inside = points[(points[:, 1] > bottom) & (points[:, 1] < top)]
        if len(inside) > 20:
            place = inside[int(len(inside) * 0.7)]
            ax.text(*place, f"z = {z:g}", fontsize=6, ha="center", va="center", bbox=_LABEL)
            taken.append(place)
    return taken
