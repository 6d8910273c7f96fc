"""Figures of a sweep: heat maps, who is best, slices.

Every kind works from the dataset alone. Dimensions that a figure doesn't name become lines, panels and rows; samples of
starts are summed up by their median, and what is left is shown at its middle.
"""

import functools
import itertools
import math
import pathlib
import textwrap
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import xarray
from matplotlib import colors, patches
from matplotlib.figure import Figure

from cnclik import errors
from cnclik.show import style
from cnclik.sweeps import summary
from cnclik.sweeps.axes import known_keys
from cnclik.sweeps.summary import main_value, scalars, text, unit_of

LONGEST = 8  # a longer dimension gets no panels
MOST_IN_A_ROW = 5  # panels
LETTER = 0.06  # [in] mean width
RAN_AWAY = 1e2  # [m, rad, rad/s]: what is beyond is no loop at work
AXES = {"heat": ("x", "y"), "best": ("x", "y"), "slices": ("x", "over", "lines")}
ROLES = ("x", "y", "over", "lines", "panels", "rows", "across")  # keys that name a dimension
TEXT, TABLE = (str, "be a text"), (dict, "be a table of a dimension and its value")
KEYS = ("kind", "value", "panels", "rows", "across", "reduce", "log", "limits", "name", "title", "select")


def check(spec) -> None:
    """Raise ArgumentError unless all figures of a spec can be laid out, before anything runs."""
    of = spec.grid()
    dims = tuple(a.name for a in of.axes)
    values = {name: (dims, np.broadcast_to(0.0, of.shape)) for name in spec.metrics}
    data = xarray.Dataset(values, of.coordinates(spec.all_units()))
    for i, table in enumerate(spec.figures):
        with errors.called("", f"figure[{i}]"):
            arrange(data, table)


def drawings(data, tables=()) -> dict:
    """Return {name: function of no arguments that draws it}. A table that can't be laid out raises there, alone.

    Args: data: dataset of a sweep. tables: as [[figure]] in a spec; without any, good ones.
    """
    out: dict = {}
    for i, table in enumerate(tables or defaults(data)):
        name = table.get("name") or "_".join((table.get("kind", "figure"), table.get("value", main_value(data))))
        out[f"{name}_{i + 1}" if name in out else name] = functools.partial(_drawn, data, table, i)
    return out


def _drawn(data, table, i):
    with errors.called("", f"figure[{i}]"):
        layout = arrange(data, table)
    return KINDS[layout.kind](view(data, layout), layout)


# --- layout: which dimension of the data goes where -----------------------------------------------------


class Layout(NamedTuple):
    """One figure: what it shows, the dimension in each role (None: nothing), and how it is drawn."""

    kind: str
    value: str  # name of the variable shown
    x: str | None  # a dimension, or of slices a variable
    y: str | None
    over: str | None  # dimension along which a line or a sample runs that has no axis
    lines: str | None
    panels: str | None
    rows: str | None
    across: str | None  # a dimension summed up by `reduce`, as samples are
    reduced: tuple  # dimensions summed up
    middle: tuple  # dimensions without a role: shown at their middle
    table: dict  # as [[figure]] in a spec, checked


def numeric(data) -> list:
    """Return the dimensions with numbers along them, those of a question of stability first."""
    dims = [d for d in data.dims if d in data.coords and data[d].dtype.kind in "if" and d != "seed"]
    dims = [d for d in dims if f"{d}_value" not in data.coords]  # nor such that count vectors
    dims = [d for d in dims if data.sizes[d] > 1] or dims[:1]  # an axis of one value is none
    return sorted(dims, key=lambda d: (d != "alpha", d != "Ts"))


def samples(data) -> list:
    """Return the dimensions that count vectors, such as random starts, or draws of noise."""
    return [d for d in data.dims if (f"{d}_value" in data.coords and d not in summary.CHOSEN) or d == "seed"]


def defaults(data) -> list:
    """Return figures worth having, from the shape of the grid alone: tables as [[figure]] in a spec."""
    axes, value, methods = numeric(data), main_value(data), data.sizes.get("method", 1)
    if value is None:
        return []
    tables: list = []
    if len(axes) > 1:
        kinds = ("heat", "best") if methods > 1 else ("heat",)
        tables += [{"kind": kind, "value": value, "x": axes[0], "y": axes[1]} for kind in kinds]
    elif axes:
        tables.append({"kind": "slices", "value": value, "x": axes[0]})
    if "Ts" in data.dims and "evaluations" in scalars(data) and len(np.unique(data.evaluations)) > methods:
        tables.append({"kind": "slices", "value": value, "x": "evaluations", "over": "Ts", "name": f"work_{value}"})
    return tables


def arrange(data, table: dict) -> Layout:
    """Give every dimension of the data its place in a figure.

    Args: table: as [[figure]] in a spec; what it doesn't say is chosen here.
    Raises: ArgumentError for a key or a value that is none, or a figure without its axes.
    """
    kind = errors.one_of("kind", table.get("kind"), AXES)
    known_keys("table", table, (*KEYS, *AXES[kind]))
    for key, (of, must) in {"name": TEXT, "title": TEXT, "select": TABLE}.items():
        errors.kind(key, table.get(key, of()), of, must)
    if pathlib.PurePath(name := table.get("name", "")).name != name or "\\" in name:
        raise errors.fail("name", "be a file's name without a folder", f"is {name!r}")
    errors.one_of("reduce", table.get("reduce", "median"), ("median", "mean", "min"))
    errors.truth("log", table.get("log", True))
    errors.array("limits", table.get("limits", (0, 1)), (2,))
    value, select = errors.one_of("value", table.get("value", main_value(data)), scalars(data)), table.get("select", {})
    for dim, wanted in select.items():
        along, where = data[errors.one_of("select", dim, list(data[value].dims))], f"select.{dim}"
        if along.dtype.kind == "f":  # the nearest counts
            errors.number(where, wanted)
        else:
            errors.one_of(where, str(wanted), list(map(str, along.values)))
    dims = [d for d in data[value].dims if d not in select]
    axes, drawn = ([d for d in some if d in dims] for some in (numeric(data), samples(data)))
    known = {"x": [*dims, *scalars(data)]} if kind == "slices" else {}
    roles: dict[str, Any] = dict.fromkeys(ROLES)
    roles |= {role: errors.one_of(role, table[role], known.get(role, dims)) for role in ROLES if role in table}
    for role, other in (("x", "y"), ("y", "x")):
        if role in AXES[kind] and roles[role] is None:
            roles[role] = next((d for d in axes if d != roles[other]), None)
            if roles[role] is None:
                must = f"have {'two numeric axes' if 'y' in AXES[kind] else 'a numeric axis'}"
                raise errors.fail("kind", must, f"is {kind!r}, and the axes are {axes}")
    if kind == "best" and ("method" not in dims or "method" in roles.values()):
        raise errors.fail("kind", "be 'heat' for a single method", "is 'best'")
    if kind == "slices" and roles["x"] not in dims:
        roles["over"] = errors.one_of("over", roles["over"] or "Ts", dims)
    free = [d for d in dims if d not in (*roles.values(), *["method"] * (kind == "best"))]
    reduced = tuple(d for d in dims if d == roles["across"] or (d in free and d in drawn))
    # The rest: methods and stages first, then M.
    free = sorted((d for d in free if d not in reduced), key=lambda d: (d not in ("method", "stage"), d != "M"))
    places = [("lines", len(style.COLORS))] if "lines" in AXES[kind] else []
    for role, most in (*places, ("panels", LONGEST), ("rows", LONGEST)):
        if roles[role] is None:
            roles[role] = next((d for d in free if data.sizes[d] <= most), None)
            free = [d for d in free if d != roles[role]]
    return Layout(kind, value, **roles, reduced=reduced, middle=tuple(free), table=table)


def view(data, layout: Layout):
    """Return the part of the data that the figure shows."""
    shown = data[[layout.value, *[layout.x] * (layout.x in data.data_vars and layout.x != layout.value)]]
    for dim, wanted in layout.table.get("select", {}).items():
        shown = shown.sel({dim: wanted}, method="nearest" if shown[dim].dtype.kind == "f" else None)
    for dim in (d for d in summary.CHOSEN if f"{d}_value" in data.coords and d in shown.coords):
        vectors = [text(data[f"{dim}_value"].values[i]) for i in shown[dim].values.ravel()]
        labels = shown[dim].copy(data=np.reshape(np.array(vectors, object), shown[dim].shape))
        shown = shown.assign_coords({dim: labels.assign_attrs(units=data[f"{dim}_value"].attrs.get("units", ""))})
    if layout.reduced:
        reduce = layout.table.get("reduce", "median")
        shown = getattr(shown, reduce)(layout.reduced, keep_attrs=True)
        words = shown[layout.value].attrs.get("long_name", "")
        if reduce == "mean" and words.startswith("1 if "):  # a verdict
            shown[layout.value].attrs["long_name"] = words.replace("1 if", "share with", 1)
    shown = shown.isel({d: shown.sizes[d] // 2 for d in layout.middle})
    return shown.sortby([d for d in (layout.x, layout.y) if d in shown.dims and shown[d].dtype.kind in "if"])


# --- kinds ----------------------------------------------------------------------------------------------


def heat(view, layout):
    """Draw a value's colours over a plane, and the linear theory's limit where the data carry one."""
    value = view[layout.value].astype(float)  # counts and verdicts too
    panels, scale, limited = Panels(view, layout), norm(value.values, layout), False
    for ax, part in panels.each(value):
        shown = np.ma.masked_invalid(part.transpose(layout.y, layout.x).values)
        if isinstance(scale, colors.LogNorm):
            shown = np.ma.clip(shown, scale.vmin, None)  # an error of exactly 0 is the smallest, not missing
        mesh = panels.cells(ax, part, shown, norm=scale)
        share = share_of_limit(part, layout)
        if share is not None and share.min() < 1 < share.max():
            look = {"colors": style.BLACK, "linewidths": style.OUTLINED["linewidth"], "zorder": 4}
            line = ax.contour(part[layout.x].values, part[layout.y].values, share, levels=[1.0], **look)
            line.set_path_effects(style.OUTLINED["path_effects"])
            limited = True
    if limited:
        panels.legend([plt.Line2D([], [], **style.OUTLINED)], [value.coords["limit"].attrs.get("long_name", "limit")])
    beyond = bool(np.any(np.isfinite(value.values) & (value.values > scale.vmax)))
    extend = "both" if "limits" in layout.table else "max" if beyond else "neither"
    panels.figure.colorbar(mesh, ax=panels.axes.ravel().tolist(), extend=extend, pad=0.02, label=axis_label(value))
    return panels.finish(view[layout.y])


def best(view, layout):
    """Draw which method has the least value over a plane; grey where no loop ends well, or none is stable by linear
    theory: there it is chance."""
    value = view[layout.value]
    panels, names = Panels(view, layout), value["method"].values.tolist()
    looks = [look["color"] for look in style.looks(names)]
    for ax, part in panels.each(value):
        z = part.transpose("method", layout.y, layout.x).values
        finite = np.where(np.isfinite(z), z, np.inf)
        share = share_of_limit(part, layout)
        chance = ~np.isfinite(finite.min(axis=0)) | (False if share is None else share > 1)
        winner = np.ma.masked_where(chance, finite.argmin(axis=0))
        panels.cells(ax, part, winner, cmap=colors.ListedColormap(looks), vmin=-0.5, vmax=len(names) - 0.5)
    handles = [patches.Patch(color=c, label=n) for c, n in zip(looks, names, strict=True)]
    panels.legend(handles, names, title=f"least {axis_label(value)}")
    return panels.finish(view[layout.y])


def share_of_limit(part, layout):
    """Return z over the largest limit in the cells (y, x) of a plane of alpha and Ts, or one of z; None without one."""
    plane, share = (layout.y, layout.x), summary.share_of_limit(part)
    if share is None or not ("z" in plane or set(plane) == {"alpha", "Ts"}):
        return None
    share = share.min([dim for dim in share.dims if dim not in plane])
    return (share + 0 * (part[layout.x] + part[layout.y])).transpose(*plane).values


def slices(view, layout):
    """Draw a value along one axis, or against another value."""
    value = view[layout.value]
    _, x = xarray.broadcast(value, view[layout.x])
    panels = Panels(view, layout)
    for ax, part, along in panels.each(value, x):
        for i, look in enumerate(panels.looks()):
            here = {layout.lines: i} if layout.lines else {}
            at, shown = along.isel(here).values.ravel(), part.isel(here).values.ravel()
            order = np.argsort(at, kind="stable")
            shown = np.where(np.isfinite(shown), shown, np.nan)[order]  # gaps where a value is not finite
            ax.plot(at[order], shown, **look)
        if layout.x not in view.dims or style.geometric(view[layout.x].values):
            style.log_scale(ax.xaxis, x.values)
        _value_scale(ax, value.values, layout)
    handles, labels = panels.axes[0, 0].get_legend_handles_labels()
    if len(labels) > 1:
        panels.legend(handles, labels, title=axis_label(view[layout.lines]))
    return panels.finish(value)


def _value_scale(ax, values, layout):
    """Set the y axis of a value: logarithmic where the values say so."""
    limits = layout.table.get("limits")
    if is_logarithmic(values, layout):
        positive = values[np.isfinite(values) & (values > 0)]
        bottom = limits[0] if limits and limits[0] > 0 else 0.7 * max(positive.min(), positive.max() * 1e-16)
        style.log_scale(ax.yaxis, limits or np.maximum(positive, bottom))
        ax.set_ylim(bottom, positive.max() / 0.7)  # of all panels, which share it
        for line in ax.lines:  # an error of exactly 0 lies on the axis: it is not missing
            line.set_ydata(np.where(line.get_ydata() <= 0, bottom, line.get_ydata()))
    if limits:
        ax.set_ylim(*limits)


KINDS = {"heat": heat, "best": best, "slices": slices}


# --- panels ---------------------------------------------------------------------------------------------


class Panels:
    """A grid of equal panels over `layout.panels` and `layout.rows`, either of which may be None."""

    def __init__(self, view, layout):
        self.view, self.layout = view, layout
        many, down = (view.sizes[dim] if dim else 1 for dim in (layout.panels, layout.rows))
        if not layout.rows and many > MOST_IN_A_ROW:
            many, down = math.ceil(many / 2), 2
        width = style.COLUMN if many == 1 else style.PAGE
        self.room = (width - 1.0) / many  # width of a panel, or nearly so [in]
        self.high = min(2.4, max(1.25, self.room * 0.95))  # of a panel [in]
        self.figure = Figure(figsize=(width, 1.2 + down * self.high))
        self.axes = self.figure.subplots(down, many, squeeze=False, sharex=True, sharey=True)

    def each(self, *values):
        """Yield (axes, that panel's part of each of the values)."""
        dims = [d for d in (self.layout.rows, self.layout.panels) if d]
        places = list(itertools.product(*(range(self.view.sizes[d]) for d in dims)))
        for ax in self.axes.ravel()[len(places) :]:
            ax.set_axis_off()
        for ax, place in zip(self.axes.ravel(), places, strict=False):
            where = dict(zip(dims, place, strict=True))
            words = ", ".join(described(self.view[d][i]) for d, i in where.items())
            ax.set_title(textwrap.fill(words, max(12, int(self.room / LETTER))))
            yield ax, *(v.isel({d: i for d, i in where.items() if d in v.dims}) for v in values)

    def cells(self, ax, part, z, **how):
        """Draw values (y, x) as cells of a plane; its axes are logarithmic for values in geometric progression."""
        x, y = part[self.layout.x].values, part[self.layout.y].values
        ax.set_facecolor("0.85")  # where nothing is drawn
        ax.grid(False)
        mesh = ax.pcolormesh(x, y, z, shading="nearest", rasterized=True, **how)
        for values, axis, decades in ((x, ax.xaxis, 2 if self.room > 1.75 else 1), (y, ax.yaxis, 2)):
            if style.geometric(values):
                style.log_scale(axis, values, decades)
            elif len(values) < LONGEST:
                axis.set_ticks(values)  # between them nothing was run
        return mesh

    def looks(self) -> list:
        """Return the look of each line; of one where there are no several."""
        if not self.layout.lines:
            return [{"color": style.COLORS[0], "marker": ".", "linewidth": 1.2}]
        bare = {} if self.view.sizes.get(self.layout.x, 0) < 40 else {"marker": ""}
        looks = style.looks([text(value) for value in self.view[self.layout.lines].values])
        return [look | {"linewidth": 1.2} | bare for look in looks]

    def legend(self, handles, labels, **title):
        """Draw a legend below all panels."""
        columns = style.legend_columns(labels, self.figure.get_figwidth())
        self.figure.legend(handles, labels, loc="outside lower center", ncols=columns, **title)

    def finish(self, y):
        """Return the figure with labels of its axes and a title."""
        plt.setp(self.axes[-1], xlabel=axis_label(self.view[self.layout.x]))
        plt.setp(self.axes[:, 0], ylabel=textwrap.fill(axis_label(y), max(16, int(self.high / LETTER))))
        fixed = [c for name, c in self.view.coords.items() if c.ndim == 0 and name not in ("limit", "alpha_Ts")]
        self.figure.suptitle(self.layout.table.get("title") or ", ".join(map(described, fixed)))
        return self.figure


def norm(values, layout):
    """Return the colours of a heat map: of a logarithmic one nine decades of the values that stay at most."""
    known = values[np.isfinite(values)]
    if not known.size:
        return colors.Normalize(0, 1)
    logarithmic, limits = is_logarithmic(values, layout), layout.table.get("limits")
    if limits or not logarithmic:
        of = colors.LogNorm if logarithmic else colors.Normalize
        low, high = limits or (known.min(), known.max())
        return of(known[known > 0].min() if logarithmic and low <= 0 else low, high)  # no logarithm begins at 0
    # Loops that ran away, or values at rounding, would waste the colours on decades that nobody looks at.
    positive = known[known > 0]
    high = positive[positive <= RAN_AWAY].max(initial=0.0) or positive.max()
    return colors.LogNorm(max(positive.min(), high * 1e-9), high)


def is_logarithmic(values, layout) -> bool:
    """Return whether a value is drawn on a logarithmic scale: as the table asks, or where values spread."""
    known = values[np.isfinite(values)].astype(float)  # counts and verdicts too
    positive = known[known > 0]
    if "log" in layout.table or not positive.size or known.min() < 0:
        return bool(layout.table.get("log") and positive.size)
    low, high = np.quantile(positive, [0.02, 0.98])
    return high > 50 * low


def described(coordinate) -> str:
    """Return a single coordinate in words: "CN", "α = 5 1/s"; of a label that is a number, too."""
    value = coordinate.values.item()
    if isinstance(value, str) and not set(value) <= set("0123456789.-e[], "):
        return value
    return f"{_name(coordinate).partition(' = ')[0]} = {text(value)} {unit_of(coordinate)}".strip()


def axis_label(variable) -> str:
    """Return the variable's name and unit: "α [1/s]"."""
    return f"{_name(variable)} [{unit}]" if (unit := unit_of(variable)) else _name(variable)


def _name(variable):
    return variable.attrs.get("long_name") or str(variable.name).replace("_", " ")
