"""Kinds: a value over a plane or along an axis, which method is best, and distributions, in equal panels."""

import itertools
import math
import textwrap

import numpy as np
import xarray
from matplotlib import colors, patches
from matplotlib.artist import setp
from matplotlib.figure import Figure

from cnclik.show import style
from cnclik.sweeps.summary import text

MOST_IN_A_ROW = 5
LETTER = 0.06  # [in] mean width
BESIDE = 1.3  # [in] what a legend or a bar of colours beside the panels takes
RAN_AWAY = 1e2  # [m, rad, rad/s]: what is beyond is no loop at work, if others are a thousand times beyond


def heat(view, layout):
    """Draw a value's colours over a plane, and the linear theory's limit where the data carry one."""
    value = view[layout.value].astype(float)  # counts and verdicts too
    grid, scale, limits = Panels(view, layout), norm(value.values, layout), []
    for ax, part in grid.each(value):
        shown = np.ma.masked_invalid(part.transpose(layout.y, layout.x).values)
        if isinstance(scale, colors.LogNorm):
            shown = np.ma.clip(shown, scale.vmin, None)  # an error of exactly 0 is the smallest, not missing
        mesh = _mesh(grid, ax, part, layout, shown, norm=scale)
        limits = _boundary(ax, part, layout) or limits
    if limits:
        words = value.coords["limit"].attrs.get("long_name", "limit")
        grid.figure.legend(limits, [words], loc="outside lower center")
    beyond = np.any(np.isfinite(value.values) & (value.values > scale.vmax))
    extend = "both" if layout.limits else "max" if beyond else "neither"
    axes = grid.axes.ravel().tolist()
    grid.figure.colorbar(mesh, ax=axes, extend=extend, pad=0.02, label=axis_label(value))
    return grid.finish(axis_label(view[layout.x]), axis_label(view[layout.y]))


def best(view, layout):
    """Draw which method has the least value over a plane; grey where no loop ends well: there it is chance."""
    value = view[layout.value]
    grid, names = Panels(view, layout), value["method"].values.tolist()
    looks = [look["color"] for look in style.looks(names)]
    for ax, part in grid.each(value):
        z = part.transpose("method", layout.y, layout.x).values
        finite = np.where(np.isfinite(z), z, np.inf)
        chance = ~np.isfinite(finite.min(axis=0)) | beyond_every_limit(part, layout)
        winner = np.ma.masked_where(chance, finite.argmin(axis=0))
        _mesh(grid, ax, part, layout, winner, cmap=colors.ListedColormap(looks), vmin=-0.5, vmax=len(names) - 0.5)
    handles = [patches.Patch(color=c, label=n) for c, n in zip(looks, names, strict=True)]
    columns = style.legend_columns(names, grid.figure.get_figwidth())
    title = f"least {axis_label(value)}"
    grid.figure.legend(handles=handles, loc="outside lower center", ncols=columns, title=title)
    return grid.finish(axis_label(view[layout.x]), axis_label(view[layout.y]))


def _mesh(grid, ax, part, layout, z, **how):
    x, y = part[layout.x].values, part[layout.y].values
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
    logarithmic = is_logarithmic(values, layout)
    if layout.limits or not logarithmic:
        of = colors.LogNorm if logarithmic else colors.Normalize
        return of(*(layout.limits or (known.min(), known.max())))
    # One loop that ran away, or values at rounding, would waste the colours on decades that nobody looks at.
    positive = known[known > 0]
    staying = positive[positive <= RAN_AWAY]
    high = staying.max() if staying.size and positive.max() > RAN_AWAY * 1e3 else positive.max()
    return colors.LogNorm(max(positive.min(), high * 1e-9), high)


def _boundary(ax, part, layout) -> list:
    """Draw the largest stable z = alpha·Ts over a plane of alpha and Ts, or of z and what the limit depends on.

    Returns: the line drawn, in a list; an empty one where the data have no limit for this plane.
    """
    limit, own = part.coords.get("limit"), "z" if "z" in (layout.x, layout.y) else "alpha"
    other = layout.y if layout.x == own else layout.x
    known = limit is not None and own in (layout.x, layout.y) and set(limit.dims) <= {other}
    if not known or not np.isfinite(limit).any() or (own == "alpha" and other != "Ts"):
        return []
    at = part[other]
    if not limit.ndim and at.dtype.kind == "f":  # a smooth line
        at = xarray.DataArray(np.linspace(at.values[0], at.values[-1], 400), dims=other)
    edge = (limit / at if own == "alpha" else limit + 0 * at).values
    edge, at = np.where(np.isfinite(edge), edge, np.nan), at.values
    if limit.ndim:  # a step for each value
        middles = (at[1:] + at[:-1]) / 2
        at = np.repeat([1.5 * at[0] - 0.5 * at[1], *middles, 1.5 * at[-1] - 0.5 * at[-2]], 2)[1:-1]
        edge = np.repeat(edge, 2)
    box = {"xlim": ax.get_xlim(), "ylim": ax.get_ylim()}
    drawn = ax.plot(*((edge, at) if layout.x == own else (at, edge)), **style.OUTLINED)
    ax.set(**box)
    return drawn


def beyond_every_limit(part, layout):
    """Return the (y, x) cells of an alpha-Ts plane, or one of z, with z above every limit that the data carry."""
    plane, limit = (layout.y, layout.x), part.coords.get("limit")
    if limit is None or not ("z" in plane or set(plane) == {"alpha", "Ts"}):
        return np.zeros([part.sizes[dim] for dim in plane], bool)
    z = part["z"] if "z" in plane else part["alpha"] * part["Ts"]
    beyond = z > limit.max([dim for dim in limit.dims if dim not in plane])
    return beyond.broadcast_like(part.isel({"method": 0})).transpose(*plane).values


def slices(view, layout):
    """Draw a value along one axis, or against another value."""
    value = view[layout.value]
    _, x = xarray.broadcast(value, view[layout.x])
    grid = Panels(view, layout)
    for ax, part, along in grid.each(value, x):
        for i, look in enumerate(_looks(view, layout)):
            here = {layout.lines: i} if layout.lines else {}
            at, shown = along.isel(here).values.ravel(), part.isel(here).values.ravel()
            order = np.argsort(at, kind="stable")
            shown = np.where(np.isfinite(shown), shown, np.nan)[order]  # gaps where a value is not finite
            ax.plot(at[order], shown, **{"marker": "."} | look, markevery=_every(i, shown))
        if layout.x in view.dims:
            grid.scales(ax, view[layout.x].values)
        else:
            ax.set_xscale("log")
        _value_scale(ax, value.values, layout)
    return grid.finish(axis_label(view[layout.x]), axis_label(value))


def distribution(view, layout):
    """Draw the share of loops at or below a value; one that is not finite is never reached."""
    value = view[layout.value].astype(float)
    grid = Panels(view, layout)
    for ax, part in grid.each(value):
        for i, look in enumerate(_looks(view, layout)):
            sample = part.isel({layout.lines: i} if layout.lines else {}).values
            sample = np.sort(sample[~np.isnan(sample)])
            share = np.arange(1, len(sample) + 1) / max(len(sample), 1)
            shown = np.isfinite(sample)
            ax.step(sample[shown], share[shown], where="post", **look, markevery=_every(i, np.resize(sample, 40)))
        if is_logarithmic(value.values, layout):
            style.log_scale(ax.xaxis, value.values)
        ax.set(ylim=(0, 1), xlim=layout.limits)
    return grid.finish(axis_label(value), "share of loops at or below")


def _every(i, values):
    """Return which points of the i-th line have markers; matplotlib can't stagger them where nothing is drawn."""
    return style.sparse(i, len(values)) if np.isfinite(values).any() else None


def _looks(view, layout) -> list:
    """Return the look of each line; of one where there are no several."""
    if not layout.lines:
        return [{"color": style.COLORS[0], "label": "", "linewidth": 1.2}]
    return [{"linewidth": 1.2} | look for look in style.looks([text(value) for value in view[layout.lines].values])]


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


KINDS = {"heat": heat, "best": best, "slices": slices, "distribution": distribution}


# --- panels -------------------------------------------------------------------------------------------


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
        self.figure = Figure(figsize=(width, height))
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
