"""Figures of a sweep: heat maps, slices, convergence curves, distributions, work diagrams, and who is best.

Every kind works from the dataset alone. Dimensions that a figure doesn't name become panels, then rows, then
figures of their own; samples of starts are summed up by their median.
"""

import functools
import itertools
import json
import math
import pathlib

import numpy as np
from matplotlib import colors, figure, patches, ticker

from cnclik import errors
from cnclik.integrate.method import METHODS
from cnclik.problem.build import stage_from
from cnclik.show import style
from cnclik.stability.linear import stability_limit
from cnclik.sweeps.sweep import UNITS

_SYMBOLS = {"alpha": "α", "Ts": "Ts", "z": "z = α·Ts", "damping": "λ", "case": ""}
_HISTORY = ("time", "step")
_MOST = 8  # panels along a dimension, or figures for it
COLORS = (
    *(style.BLUE, style.VERMILION, style.GREEN, style.PURPLE),
    *(style.ORANGE, style.SKY, style.BLACK, style.YELLOW),
)
_LABEL = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8}
BOUNDARY = {"color": style.VERMILION, "linewidth": 1.2, "linestyle": (0, (4, 2))}


def draw(data, folder, *, figures=None, form="png") -> list:
    """Draw the figures that the data's spec asks for, or `figures`, or good ones if none are asked for.

    Args:
      data: dataset of a sweep, as `cnclik.sweeps.store.read` gives it.
      folder: where to put them.
      figures: tables as [[figure]] in a spec.
      form: "png", "pdf" or "svg".

    Returns: the paths written.
    """
    spec = json.loads(data.attrs["spec"]) if "spec" in data.attrs else {}
    asked = spec.get("figures", ()) if figures is None else figures
    out = []
    with style.style():
        for number, one in enumerate(asked or defaults(data)):
            one = dict(one)
            stem = one.pop("name", None) or f"{one['kind']}_{one.get('value', number)}"
            for suffix, view in _views(data, one):
                path = pathlib.Path(folder) / f"{stem}{suffix}.{form}"
                made = _DRAW[one["kind"]](view, one, spec)
                if form == "png":
                    style.save(made, path, {"Title": path.stem, "Description": data.attrs.get("spec", "")})
                else:
                    made.savefig(path)
                out.append(path)
    return out


def defaults(data) -> list:
    """Figures worth having, from the shape of the grid alone."""
    inner, samples = _inner(data), _samples(data)
    scalars = [n for n in data.data_vars if not set(data[n].dims) & set(_HISTORY)]
    value = next((n for n in scalars if n.endswith("error")), scalars[0] if scalars else None)
    out = []
    if value and len(inner) >= 2:
        out.append({"kind": "heat", "value": value, "x": inner[0], "y": inner[1]})
        if "method" in data.dims and data.sizes["method"] > 1:
            out.append({"kind": "best", "value": value, "x": inner[0], "y": inner[1]})
    elif value and inner:
        out.append({"kind": "slices", "value": value, "x": inner[0]})
    if value and samples:
        out.append({"kind": "distribution", "value": value, "over": samples[0]})
    costs = data["evaluations"].values if "evaluations" in scalars else np.zeros(1)
    if value and "Ts" in data.dims and len(np.unique(costs)) > data.sizes.get("method", 1):
        out.append({"kind": "work", "value": value})
    if "error" in data.data_vars:
        out.append({"kind": "convergence", "value": "error"})
    return out


# --- which part of the data a figure shows ------------------------------------------------------------


def _inner(data):
    """Dimensions with numbers along them."""
    return [d for d in data.dims if d in data.coords and data[d].dtype.kind in "if" and f"{d}_value" not in data.coords]


def _samples(data):
    """Dimensions that count vectors, such as random starts."""
    return [d for d in data.dims if f"{d}_value" in data.coords]


def _value(data, one):
    scalars = [n for n in data.data_vars if not set(data[n].dims) & set(_HISTORY)]
    return one.get("value") or next((n for n in scalars if n.endswith("error")), scalars[0])


def _views(data, one):
    """The selections of the data that are one figure each, with a suffix for the file's name."""
    for dim, wanted in one.get("select", {}).items():
        exact = data[dim].dtype.kind in "OUTi"
        data = data.sel({dim: wanted}) if exact else data.sel({dim: wanted}, method="nearest")
    kind = one["kind"]
    if kind == "convergence":
        one.setdefault("value", "error")
    one["value"] = _value(data, one)
    found = data[one["value"]]
    inner = [d for d in _inner(data) if d in found.dims]
    if kind in ("heat", "best"):
        axes = [d for d in ("Ts", "alpha", *inner) if d in inner]
        one.setdefault("x", next((d for d in axes if d != one.get("y")), None))
        one.setdefault("y", next((d for d in axes if d != one["x"]), None))
        if one["x"] is None or one["y"] is None:
            raise errors.fail("figure", f"have two numeric axes for the kind {kind!r}", f"has {inner}")
    if kind == "best":
        one.setdefault("among", "method")
    if kind == "slices":
        one.setdefault("x", inner[0] if inner else None)
    if kind == "work":
        one.setdefault("over", "Ts")
    if kind == "distribution":
        one.setdefault("over", next(iter(_samples(data)), inner[0] if inner else None))
    taken = {one.get(k) for k in ("x", "y", "lines", "panels", "rows", "over", "among")}
    free = [d for d in found.dims if d not in taken and d not in _HISTORY]
    # Samples are summed up; the rest is given a place, what differs most in kind first.
    reduced = [d for d in free if d in _samples(data)]
    free = sorted((d for d in free if d not in reduced), key=lambda d: (d not in ("method", "stage"), d != "M"))
    if kind in ("slices", "convergence", "work", "distribution") and "lines" not in one:
        one["lines"] = next((d for d in free if data.sizes[d] <= len(COLORS)), None)
        free = [d for d in free if d != one["lines"]]
    for role in ("panels", "rows"):
        if role not in one:
            one[role] = next((d for d in free if data.sizes[d] <= _MOST), None)
            free = [d for d in free if d != one[role]]
    how = one.get("reduce", "median")
    names = [n for n in dict.fromkeys((one["value"], "evaluations")) if n in data]
    view = data[names]
    if reduced:
        view = getattr(view, how)(reduced, keep_attrs=True)
    # A long axis that has no place is shown at its middle, and the title says so.
    for dim in [d for d in free if view.sizes[d] > _MOST]:
        view = view.isel({dim: view.sizes[dim] // 2})
        free.remove(dim)
    for place in itertools.product(*(range(view.sizes[d]) for d in free)):
        labels = [f"_{_text(view[d].values[i])}" for d, i in zip(free, place, strict=True)]
        yield "".join(labels), view.isel(dict(zip(free, place, strict=True)))


# --- drawing ------------------------------------------------------------------------------------------


def _heat(view, one, spec):
    value = view[one["value"]]
    grid = _Panels(view, one)
    known = value.values[np.isfinite(value.values)]
    norm = _norm(known, one)
    mesh = None
    for ax, place, part in grid.each(value):
        x, y, z = _plane(part, one)
        shown = np.ma.masked_invalid(z)
        if isinstance(norm, colors.LogNorm):
            shown = np.ma.clip(shown, norm.vmin, None)  # an error of exactly 0 is the smallest, not missing
        ax.set_facecolor("0.85")  # not finite
        ax.grid(False)
        mesh = ax.pcolormesh(x, y, shown, norm=norm, shading="nearest", rasterized=True)
        _scales(ax, x, y)
        counts = view[one["x"]].dtype.kind == "i" or view[one["y"]].dtype.kind == "i"
        if one.get("contours", not counts) is not False and shown.count() > 4:
            _contours(ax, x, y, shown, norm, one.get("contours", True))
        if one.get("boundary", True):
            _boundary(ax, view, one, spec, place, x, y)
    bar = grid.figure.colorbar(
        mesh, ax=grid.axes.ravel().tolist(), extend="both" if "limits" in one else "neither", pad=0.02
    )
    bar.set_label(_label(value))
    return grid.finish(one, _axis_label(view[one["x"]]), _axis_label(view[one["y"]]), spec)


def _plane(part, one):
    part = part.transpose(one["y"], one["x"])
    return part[one["x"]].values, part[one["y"]].values, part.values


def _contours(ax, x, y, z, norm, levels):
    if levels is True:
        low, high = norm.vmin, norm.vmax
        if isinstance(norm, colors.LogNorm):
            decades = np.arange(math.ceil(math.log10(low)), math.floor(math.log10(high)) + 1)
            levels = 10.0 ** decades[:: max(1, len(decades) // 5)]
        else:
            levels = ticker.MaxNLocator(5).tick_values(low, high)
    levels = [v for v in levels if norm.vmin < v < norm.vmax]
    z = np.ma.masked_where(_rough(z), z)
    if levels and min(z.shape) > 1 and z.count() > 4:
        lines = ax.contour(x, y, z, levels=levels, colors="white", linewidths=0.6, alpha=0.8)
        ax.clabel(lines, fmt="%.0e" if isinstance(norm, colors.LogNorm) else "%g", fontsize=5)


def _rough(z):
    """Where large values have little to do with their neighbours, as in a diverged, chaotic loop."""
    known = np.asarray(np.ma.filled(np.ma.asarray(z, float), np.inf), float)
    finite = known[np.isfinite(known)]
    top = math.log10(max(finite.max(initial=1e-12), 1e-12))
    size = np.clip(np.log10(np.clip(known, 1e-300, None)), top - 3, top + 1)
    bent = np.zeros_like(size)  # second differences: a steep but smooth flank has none
    bent[1:-1] += np.abs(size[2:] - 2 * size[1:-1] + size[:-2])
    bent[:, 1:-1] += np.abs(size[:, 2:] - 2 * size[:, 1:-1] + size[:, :-2])
    near = np.lib.stride_tricks.sliding_window_view(np.pad(bent, 1, mode="reflect"), (3, 3))
    return (np.median(near, axis=(-2, -1)) > 0.15) & (size > top - 1.5)


def _hopeless(view, one, spec, part):
    """Cells beyond the linear limit of every method: who is best there is chance."""
    none = np.zeros((part.sizes[one["y"]], part.sizes[one["x"]]), bool)
    names = {one["x"], one["y"]}
    if not names <= {"alpha", "Ts", "z"} or one["among"] != "method":
        return none
    values = {**spec.get("fixed", {}), **_labels(view)}
    limits = [_limit(values | {"method": m}) for m in part[one["among"]].values]
    if any(v is None for v in limits):
        return none
    coordinates = {d: part[d] for d in names}
    z = coordinates["z"] if "z" in names else coordinates["alpha"] * coordinates["Ts"]
    return none | (z.broadcast_like(part.isel({one["among"]: 0})).transpose(one["y"], one["x"]).values > max(limits))


def _boundary(ax, view, one, spec, place, x, y):
    """The largest z at which the linear theory calls the panel's method stable."""
    values = {**spec.get("fixed", {}), **_labels(view), **place}
    names = {one["x"], one["y"]}
    if names == {"alpha", "Ts"} or (names == {"z", "Ts"} or names == {"z", "alpha"}):
        limit = _limit(values)
        if limit is None or not math.isfinite(limit):
            return
        if "z" in names:
            (ax.axvline if one["x"] == "z" else ax.axhline)(limit, **BOUNDARY)
            return
        left, right = ax.get_xlim()
        bottom, top = ax.get_ylim()
        line = np.geomspace(max(left, 1e-12), right, 200)
        ax.plot(line, limit / line, **BOUNDARY)
        ax.set_xlim(left, right), ax.set_ylim(bottom, top)
    elif names == {"z", "M"}:
        counts = x if one["x"] == "M" else y
        limits = np.array([_limit(values | {"M": int(m)}) or np.nan for m in counts])
        edges = np.concatenate([counts - 0.5, counts[-1:] + 0.5])
        steps = (np.append(limits, limits[-1]), edges)
        if one["x"] == "z":
            ax.step(*steps, where="pre", **BOUNDARY)
        else:
            ax.step(steps[1], steps[0], where="post", **BOUNDARY)


def _limit(values):
    """Largest stable z of the method and stage named by the values, or None where they name none."""
    method, m = METHODS.get(str(values.get("method", "EE"))), values.get("M", 5)
    if method is None or not isinstance(m, (int, np.integer)):
        return None
    return _stable(method, str(values.get("stage", "picard")) if method.implicit else None, int(m))


@functools.cache
def _stable(method, stage, m):
    # M as an array: one program for every M.
    stage = stage and stage_from(stage, np.asarray(m), maximum=max(m, 16))
    return float(stability_limit(method, stage))


def _labels(view):
    return {d: view[d].values.item() for d in view.coords if view[d].ndim == 0}


def _best(view, one, spec):
    value, among = view[one["value"]], one["among"]
    names = [_text(v) for v in value[among].values]
    grid = _Panels(view, one)
    looks = [style.METHODS[n].color if n in style.METHODS else c for n, c in zip(names, COLORS, strict=False)]
    palette = colors.ListedColormap(looks)
    for ax, _, part in grid.each(value):
        part = part.transpose(among, one["y"], one["x"])
        finite = np.where(np.isfinite(part.values), part.values, np.inf)
        least = finite.min(axis=0)
        # Grey where nobody gets there: what is left is chance.
        winner = np.ma.masked_where(~np.isfinite(least) | _hopeless(view, one, spec, part), finite.argmin(axis=0))
        x, y = part[one["x"]].values, part[one["y"]].values
        ax.set_facecolor("0.85")
        ax.grid(False)
        ax.pcolormesh(x, y, winner, cmap=palette, vmin=-0.5, vmax=len(names) - 0.5, shading="nearest", rasterized=True)
        _scales(ax, x, y)
        if {one["x"], one["y"]} == {"alpha", "Ts"} and one.get("boundary", True):
            _z_lines(ax)
    handles = [patches.Patch(color=c, label=n) for c, n in zip(looks, names, strict=True)]
    grid.figure.legend(handles=handles, loc="outside lower center", ncols=len(names), title=f"least {_label(value)}")
    return grid.finish(one, _axis_label(view[one["x"]]), _axis_label(view[one["y"]]), spec)


def _z_lines(ax, values=(0.1, 0.5, 1.0, 2.0)):
    """Lines of constant z = alpha·Ts."""
    left, right = ax.get_xlim()
    bottom, top = ax.get_ylim()
    x = np.geomspace(max(left, 1e-12), right, 200)
    for z in values:
        inside = (z / x > bottom) & (z / x < top)
        if inside.sum() > 10:
            ax.plot(x, z / x, color="black", linewidth=0.6, alpha=0.6)
            i = np.flatnonzero(inside)[int(inside.sum() * 0.7)]
            ax.text(x[i], z / x[i], f"z = {z:g}", fontsize=5, ha="center", va="center", bbox=_LABEL)
    ax.set_xlim(left, right), ax.set_ylim(bottom, top)


def _slices(view, one, spec):
    value = view[one["value"]]
    grid = _Panels(view, one)
    for ax, _, part in grid.each(value):
        x = part[one["x"]].values
        for _, look, line in _lines(part, one["lines"]):
            y = np.where(np.isfinite(line.values), line.values, np.nan)
            ax.plot(x, y, **look | {"marker": look.get("marker", ".") if len(x) < 40 else None})
        _scales(ax, x, None)
        _y_scale(ax, value, one)
    return grid.finish(one, _axis_label(view[one["x"]]), _label(value), spec, legend=one["lines"])


def _convergence(view, one, spec):
    value = view[one["value"]]
    grid = _Panels(view, one)
    history = next(d for d in value.dims if d in _HISTORY)
    for ax, _, part in grid.each(value):
        for _, look, line in _lines(part, one["lines"]):
            others = [d for d in line.dims if d != history]
            rows = line.transpose(*others, history).values.reshape(-1, line.sizes[history])
            rows = np.where(np.isfinite(rows), rows, np.nan)
            ax.plot(np.nanmedian(rows, axis=0), **look | {"marker": None})
            if len(rows) > 8:
                low, high = np.nanquantile(rows, [0.1, 0.9], axis=0)
                ax.fill_between(np.arange(rows.shape[1]), low, high, color=look["color"], alpha=0.15, linewidth=0)
        _y_scale(ax, value, one)
    return grid.finish(one, "step k", _label(value), spec, legend=one["lines"])


def _distribution(view, one, spec):
    value = view[one["value"]]
    grid = _Panels(view, one)
    known = value.values[np.isfinite(value.values)]
    log = bool(known.size and known.min() > 0 and known.max() > 100 * np.median(known))
    for ax, _, part in grid.each(value):
        for _, look, line in _lines(part, one["lines"]):
            sample = np.sort(line.values.ravel())
            sample = sample[~np.isnan(sample)]
            share = np.arange(1, len(sample) + 1) / max(len(sample), 1)
            shown = np.isfinite(sample)
            ax.step(sample[shown], share[shown], where="post", **look | {"marker": None})
        if one.get("log", log):
            ax.set_xscale("log")
        ax.set_ylim(0, 1)
        if "limits" in one:
            ax.set_xlim(*one["limits"])
    return grid.finish(one, _label(value), "share of loops at or below", spec, legend=one["lines"])


def _work(view, one, spec):
    value, cost = view[one["value"]], view["evaluations"]
    grid = _Panels(view, one)
    for ax, place, part in grid.each(value):
        costs = cost.sel({d: v for d, v in place.items() if d in cost.dims})
        for _, look, line in _lines(part, one["lines"]):
            mine = costs.sel({one["lines"]: line[one["lines"]].values.item()}) if one["lines"] in costs.dims else costs
            x, y = np.broadcast_arrays(mine.values, line.values)
            order = np.argsort(x, axis=None)
            x, y = x.ravel()[order], y.ravel()[order]
            ax.plot(x, np.where(np.isfinite(y), y, np.nan), **{"marker": "o"} | look)
        ax.set_xscale("log")
        _y_scale(ax, value, one)
    return grid.finish(one, "evaluations of f(q, t)", _label(value), spec, legend=one["lines"])


_DRAW = {
    "heat": _heat,
    "best": _best,
    "slices": _slices,
    "convergence": _convergence,
    "distribution": _distribution,
    "work": _work,
}


# --- panels, axes, labels -----------------------------------------------------------------------------


class _Panels:
    """A grid of equal panels over two dimensions, either of which may be absent."""

    def __init__(self, view, one):
        self.columns, self.rows = one.get("panels"), one.get("rows")
        self.view = view
        many = view.sizes[self.columns] if self.columns else 1
        down = view.sizes[self.rows] if self.rows else 1
        if not self.rows and many > 5:  # a long row wraps
            many, down = math.ceil(many / 2), 2
        width = min(style.PAGE, 1.0 + 2.6 * many)
        height = 0.8 + down * min(2.4, max(1.25, (width - 1.0) / many * 0.95))
        self.figure = figure.Figure(figsize=(width, height))
        self.axes = self.figure.subplots(down, many, squeeze=False, sharex=True, sharey=True)

    def each(self, value):
        """(axes, {dim: label} of the panel, its part of the value)."""
        columns = range(self.view.sizes[self.columns]) if self.columns else [None]
        rows = range(self.view.sizes[self.rows]) if self.rows else [None]
        places = list(itertools.product(rows, columns))
        flat = self.axes.ravel()
        for ax in flat[len(places) :]:
            ax.set_axis_off()
        for ax, (i, j) in zip(flat, places, strict=False):
            chosen = {d: k for d, k in ((self.rows, i), (self.columns, j)) if d is not None}
            place = {d: self.view[d].values[k] for d, k in chosen.items()}
            ax.set_title(", ".join(_named(d, v) for d, v in place.items()))
            present = {d: k for d, k in chosen.items() if d in value.dims}
            yield ax, place, value.isel(present)

    def finish(self, one, x, y, spec, legend=None):
        for ax in self.axes[-1]:
            ax.set_xlabel(x)
        for ax in self.axes[:, 0]:
            ax.set_ylabel(y)
        if legend:
            handles, labels = self.axes[0, 0].get_legend_handles_labels()
            if len(labels) > 1:
                title = _SYMBOLS.get(legend, legend)
                self.figure.legend(handles, labels, loc="outside right upper", title=title)
        title = one.get("title") or ", ".join(_named(d, v) for d, v in _labels(self.view).items())
        if title:
            self.figure.suptitle(title, fontsize=8)
        return self.figure


def _lines(part, dim):
    """(label, look, data) of each line; one line where there is no dimension for it."""
    if not dim or dim not in part.dims:
        yield "", {"color": COLORS[0], "label": "", "linewidth": 1.2}, part
        return
    for i, v in enumerate(part[dim].values):
        look = style.line(str(v)) if str(v) in style.METHODS else {"color": COLORS[i % len(COLORS)], "label": _text(v)}
        yield _text(v), {"linewidth": 1.2} | look, part.isel({dim: i})


def _named(dim, value):
    text = _text(value)
    if dim in ("method", "case", "robot", "stage", "task", "inverse"):
        return text
    unit = UNITS.get(dim, "1")
    return f"{_SYMBOLS.get(dim, dim)} = {text}" + (f" {unit}" if unit != "1" else "")


def _text(value):
    return f"{value:.4g}" if isinstance(value, (float, np.floating)) else str(value)


def _label(value):
    unit = value.attrs.get("units", "")
    name = value.attrs.get("long_name", value.name.replace("_", " "))
    return f"{name} [{unit}]" if unit not in ("", "1") else name


def _axis_label(coordinate):
    unit = coordinate.attrs.get("units", "")
    name = _SYMBOLS.get(coordinate.name, coordinate.name.replace("_", " "))
    return f"{name} [{unit}]" if unit not in ("", "1") else name


def _norm(known, one):
    low, high = one.get("limits", (None, None))
    if not known.size:
        return colors.Normalize(0, 1)
    positive = known[known > 0]
    log = one.get("log")
    if log is None:
        log = known.min() >= 0 and positive.size and np.quantile(positive, 0.98) > 50 * np.quantile(positive, 0.02)
    if log:
        # Values at rounding would waste the colours on twelve empty decades.
        low = max(positive.min(), positive.max() * 1e-9) if low is None else low
        return colors.LogNorm(low, positive.max() if high is None else high, clip=False)
    return colors.Normalize(known.min() if low is None else low, known.max() if high is None else high)


def _scales(ax, x, y):
    for values, scale in ((x, ax.set_xscale), (y, ax.set_yscale)):
        if values is not None and _geometric(values):
            scale("log")


def _geometric(values):
    values = np.asarray(values, float)
    if len(values) < 3 or values.min() <= 0:
        return False
    ratios = values[1:] / values[:-1]
    return bool(np.ptp(ratios) < 1e-6 * ratios[0] and abs(ratios[0] - 1) > 1e-9)


def _y_scale(ax, value, one):
    known = value.values[np.isfinite(value.values)]
    log = one.get("log")
    if log is None:
        positive = known[known > 0]
        log = bool(positive.size and known.min() >= 0 and positive.max() > 50 * positive.min())
    if log:
        ax.set_yscale("log")
        ax.set_ylim(bottom=0.7 * max(known[known > 0].min(), known.max() * 1e-16))
    if "limits" in one:
        ax.set_ylim(*one["limits"])
