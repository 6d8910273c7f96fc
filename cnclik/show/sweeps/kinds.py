"""Kinds: a value over a plane or along an axis, which of several is best, distributions, and what a value costs."""

import itertools

import numpy as np
import xarray
from matplotlib import colors, patches

from cnclik.show import style
from cnclik.show.sweeps.panels import Panels, axis_label, is_logarithmic
from cnclik.sweeps.summary import text

RAN_AWAY = 1e2  # [m, rad, rad/s]: what is beyond is no loop at work, if others are a thousand times beyond


# --- planes -------------------------------------------------------------------------------------------


def heat(view, layout):
    """Draw a value's colours over a plane, and the linear theory's limit where the data carry one."""
    value = view[layout.value].astype(float)  # counts and verdicts too
    grid, scale, limits = Panels(view, layout), norm(value.values, layout), []
    for ax, part in grid.each(value):
        x, y, z = _plane(part, layout)
        shown = np.ma.masked_invalid(z)
        if isinstance(scale, colors.LogNorm):
            shown = np.ma.clip(shown, scale.vmin, None)  # an error of exactly 0 is the smallest, not missing
        mesh = _mesh(grid, ax, x, y, shown, norm=scale)
        limits = (_boundary(ax, part, layout) if layout.boundary else []) or limits
    if limits:
        words = value.coords["limit"].attrs.get("long_name", "limit")
        grid.figure.legend(limits, [words], loc="outside lower center")
    beyond = np.any(np.isfinite(value.values) & (value.values > scale.vmax))
    extend = "both" if layout.limits else "max" if beyond else "neither"
    bar = grid.figure.colorbar(mesh, ax=grid.axes.ravel().tolist(), extend=extend, pad=0.02)
    bar.set_label(axis_label(value))
    return grid.finish(axis_label(view[layout.x]), axis_label(view[layout.y]))


def best(view, layout):
    """Draw which of several has the least value over a plane; grey where no loop ends well: there it is chance."""
    value, among = view[layout.value], layout.among
    grid, names = Panels(view, layout), [text(v) for v in value[among].values]
    looks = [look["color"] for look, _ in _lines(value, among)]
    for ax, part in grid.each(value):
        x, y, z = _plane(part, layout, among)
        finite = np.where(np.isfinite(z), z, np.inf)
        chance = ~np.isfinite(finite.min(axis=0)) | beyond_every_limit(part, layout)
        winner = np.ma.masked_where(chance, finite.argmin(axis=0))
        _mesh(grid, ax, x, y, winner, cmap=colors.ListedColormap(looks), vmin=-0.5, vmax=len(names) - 0.5)
    handles = [patches.Patch(color=c, label=n) for c, n in zip(looks, names, strict=True)]
    columns = style.legend_columns(names, grid.figure.get_figwidth())
    title = f"least {axis_label(value)}"
    grid.figure.legend(handles=handles, loc="outside lower center", ncols=columns, title=title)
    return grid.finish(axis_label(view[layout.x]), axis_label(view[layout.y]))


def _plane(part, layout, *before):
    """Return x, y, and the values with dimensions (*before, y, x)."""
    part = part.transpose(*before, layout.y, layout.x)
    return part[layout.x].values, part[layout.y].values, part.values


def _mesh(grid, ax, x, y, z, **how):
    ax.set_facecolor("0.85")  # where nothing is drawn
    ax.grid(False)
    mesh = ax.pcolormesh(x, y, z, shading="nearest", rasterized=True, **how)
    grid.scales(ax, x, y)
    grid.name_few(ax, x, y)
    return mesh


def norm(values, layout):
    """Return the colours of a heat map: of a logarithmic one nine decades of the values that stay at most."""
    known = values[np.isfinite(values)]
    if not known.size:
        return colors.Normalize(0, 1)
    if not is_logarithmic(values, layout):
        return colors.Normalize(*(layout.limits or (known.min(), known.max())))
    if layout.limits:
        return colors.LogNorm(*layout.limits)
    # One loop that ran away, or values at rounding, would waste the colours on decades that nobody looks at.
    positive = known[known > 0]
    staying = positive[positive <= RAN_AWAY]
    high = staying.max() if staying.size and positive.max() > RAN_AWAY * 1e3 else positive.max()
    return colors.LogNorm(max(positive.min(), high * 1e-9), high)


def _boundary(ax, part, layout) -> list:
    """Draw the largest z = alpha·Ts at which linear theory calls the panel's loops stable, from the data's `limit`.

    Returns: the line drawn, in a list; an empty one where the data have no limit for this plane.
    """
    names, limit = {layout.x, layout.y}, part.coords.get("limit")
    if limit is None or not np.isfinite(limit).any():
        return []
    if limit.ndim == 0 and names == {"alpha", "Ts"}:
        (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
        x = np.geomspace(max(left, right * 1e-6), right, 400)
        drawn = ax.plot(x, float(limit) / x, **style.OUTLINED)
        ax.set(xlim=(left, right), ylim=(bottom, top))
        return drawn
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
    """Return the (y, x) cells of an alpha-Ts plane, or one of z, with z above every limit that the data carry."""
    names, limit = {layout.x, layout.y}, part.coords.get("limit")
    none = np.zeros((part.sizes[layout.y], part.sizes[layout.x]), bool)
    known = names == {"alpha", "Ts"} or "z" in names
    if limit is None or not known or not set(limit.dims) <= {layout.among} or np.isnan(limit).any():
        return none
    z = part["z"] if "z" in names else part["alpha"] * part["Ts"]
    z = z.broadcast_like(part.isel({layout.among: 0})).transpose(layout.y, layout.x)
    return z.values > float(limit.max())


# --- lines --------------------------------------------------------------------------------------------


def slices(view, layout):
    """Draw a value along one axis."""
    value = view[layout.value]
    grid = Panels(view, layout)
    for ax, part in grid.each(value):
        x = part[layout.x].values
        for i, (look, line) in enumerate(_lines(part, layout.lines)):
            ax.plot(x, _gaps(line.values), **{"marker": "."} | look, markevery=style.sparse(i, len(x)))
        grid.scales(ax, x)
        _value_scale(ax, value.values, layout)
    return grid.finish(axis_label(view[layout.x]), axis_label(value))


def work(view, layout):
    """Draw a value against the evaluations of f(q, t) that it cost."""
    value, cost = xarray.broadcast(view[layout.value], view["evaluations"])
    grid = Panels(view, layout)
    for ax, part, price in grid.each(value, cost):
        for (look, line), (_, paid) in zip(_lines(part, layout.lines), _lines(price, layout.lines), strict=True):
            x, y = paid.values.ravel(), line.values.ravel()
            order = np.argsort(x, kind="stable")
            ax.plot(x[order], _gaps(y[order]), **{"marker": "o"} | look)
        ax.set_xscale("log")
        _value_scale(ax, value.values, layout)
    return grid.finish("evaluations of f(q, t)", axis_label(value))


def distribution(view, layout):
    """Draw the share of loops at or below a value; one that is not finite is never reached."""
    value = view[layout.value].astype(float)
    grid = Panels(view, layout)
    for ax, part in grid.each(value):
        for i, (look, line) in enumerate(_lines(part, layout.lines)):
            sample = np.sort(line.values[~np.isnan(line.values)])
            share = np.arange(1, len(sample) + 1) / max(len(sample), 1)
            shown = np.isfinite(sample)
            ax.step(sample[shown], share[shown], where="post", **look, markevery=style.sparse(i, 40))
        if is_logarithmic(value.values, layout):
            style.log_scale(ax.xaxis, value.values)
        ax.set(ylim=(0, 1), xlim=layout.limits)
    return grid.finish(axis_label(value), "share of loops at or below")


def _gaps(values):
    """Return the values of a line, with gaps where they are not finite."""
    return np.where(np.isfinite(values), values, np.nan)


def _lines(part, dim):
    """Yield (look, data) of each line along a dimension; one line where there is none."""
    if not dim or dim not in part.dims:
        yield {"color": style.COLORS[0], "label": "", "linewidth": 1.2}, part
        return
    names = [text(value) for value in part[dim].values]
    methods = [style.METHODS[name] for name in names if name in style.METHODS]
    free_colors = [c for c in style.COLORS if c not in {method.color for method in methods}] or style.COLORS
    free_marks = [m for m in style.MARKERS if m not in {method.marker for method in methods}] or style.MARKERS
    others = itertools.count()
    for i, name in enumerate(names):
        if name in style.METHODS:
            look = style.line(name)
        else:
            k = next(others)
            own = {"color": free_colors[k % len(free_colors)], "marker": free_marks[k % len(free_marks)]}
            look = style.series(k, label=name, **own)
        yield {"linewidth": 1.2} | look, part.isel({dim: i})


def _value_scale(ax, values, layout):
    """Set the y axis of a value: logarithmic where the values say so."""
    limits = layout.limits
    if is_logarithmic(values, layout):
        positive = values[np.isfinite(values) & (values > 0)]
        bottom = limits[0] if limits and limits[0] > 0 else 0.7 * max(positive.min(), positive.max() * 1e-16)
        style.log_scale(ax.yaxis, limits or np.maximum(positive, bottom))
        ax.set_ylim(bottom=bottom)
        for line in ax.lines:  # an error of exactly 0 lies on the axis: it is not missing
            line.set_ydata(np.where(line.get_ydata() <= 0, bottom, line.get_ydata()))
    if limits:
        ax.set_ylim(*limits)
