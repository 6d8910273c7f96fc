"""Layout: which dimension of a sweep's data goes where in a figure."""

import itertools
import re
from typing import Any, NamedTuple

import numpy as np

from cnclik import errors
from cnclik.show import style
from cnclik.sweeps.check import ROLES
from cnclik.sweeps.summary import HISTORY, main_value, scalars, text

LONGEST = 8  # a longer dimension gets neither panels nor separate figures


class Layout(NamedTuple):
    """One figure: what it shows, the dimension in each role (None: nothing), and how it is drawn."""

    kind: str
    value: str  # name of the variable shown
    x: str | None
    y: str | None
    lines: str | None
    panels: str | None
    rows: str | None
    over: str | None  # dimension along which a line runs, without an axis
    among: str | None  # dimension whose best value is shown
    across: str | None  # a dimension summed up by `reduce`, as samples are
    reduced: tuple  # dimensions summed up, by `reduce`
    middle: tuple  # long dimensions without a role: shown at their middle
    apart: tuple  # short ones: a figure for each of their values
    select: dict
    reduce: str = "median"
    title: str | None = None
    log: bool | None = None  # None: as the values are
    limits: tuple | None = None
    boundary: bool = True


def numeric(data) -> list:
    """Return the dimensions with numbers along them."""
    return [d for d in data.dims if d in data.coords and data[d].dtype.kind in "if" and f"{d}_value" not in data.coords]


def samples(data) -> list:
    """Return the dimensions that count vectors, such as random starts."""
    return [d for d in data.dims if f"{d}_value" in data.coords]


def defaults(data) -> list:
    """Return figures worth having, from the shape of the grid alone: tables as [[figure]] in a spec."""
    axes, starts, value = _liked(numeric(data)), samples(data), main_value(data)
    if value is None:  # the data hold only histories
        return []
    methods = data.sizes.get("method", 1)
    costs = data["evaluations"].values if "Ts" in data.dims and "evaluations" in scalars(data) else []
    out = []
    if len(axes) >= 2:
        kinds = ("heat", "best") if methods > 1 else ("heat",)
        out += [{"kind": kind, "value": value, "x": axes[0], "y": axes[1]} for kind in kinds]
    elif axes:
        out.append({"kind": "slices", "value": value, "x": axes[0]})
    if starts:
        out.append({"kind": "distribution", "value": value, "over": starts[0]})
    if len(np.unique(costs)) > methods:
        out.append({"kind": "work", "value": value})
    return out


def _liked(axes) -> list:
    """Return the axes, those of a question of stability first."""
    return sorted(axes, key=lambda d: (d != "Ts", d != "alpha"))


def arrange(data, table: dict) -> Layout:
    """Give every dimension of the data its place in a figure.

    Args:
      table: as [[figure]] in a spec; what it doesn't say is chosen here.

    Raises: ArgumentError for a variable or dimension that the data don't have, or a figure without its axes.
    """
    kind, select, value = table["kind"], table.get("select", {}), table.get("value") or main_value(data)
    errors.one_of("figure.value", value, scalars(data))
    if kind == "work":
        errors.one_of("figure.value", "evaluations", list(data.data_vars))
    for dim in select:
        errors.one_of("figure.select", dim, list(data.dims))
    dims = [d for d in data[value].dims if d not in HISTORY and d not in select]
    axes, starts = [d for d in numeric(data) if d in dims], [d for d in samples(data) if d in dims]
    roles: dict[str, Any] = {role: table.get(role) for role in ROLES}
    for role, dim in roles.items():
        if dim is not None:
            errors.one_of(f"figure.{role}", dim, dims)
    _choose_axes(kind, roles, axes, starts)
    if kind == "best":
        errors.one_of("figure.among", roles["among"], dims)
    free = [d for d in dims if d not in roles.values()]
    reduced = tuple(d for d in dims if d == roles["across"] or (d in free and d in starts))
    # The rest: methods and stages first, then M.
    free = sorted((d for d in free if d not in reduced), key=lambda d: (d not in ("method", "stage"), d != "M"))
    places = [("panels", LONGEST), ("rows", LONGEST)]
    if kind in ("slices", "work", "distribution"):
        places.insert(0, ("lines", len(style.COLORS)))
    for role, most in places:
        if roles[role] is None:
            roles[role] = next((d for d in free if data.sizes[d] <= most), None)
            free = [d for d in free if d != roles[role]]
    long = tuple(d for d in free if data.sizes[d] > LONGEST)
    apart = tuple(d for d in free if d not in long)
    options: dict[str, Any] = {k: table[k] for k in ("reduce", "title", "log", "limits", "boundary") if k in table}
    return Layout(kind, value, **roles, reduced=reduced, middle=long, apart=apart, select=dict(select), **options)


def _choose_axes(kind, roles, axes, starts):
    """Fill in the axes that a kind of figure needs."""
    first = next(iter(axes), None)
    usual = {
        "best": ("among", "method"),
        "slices": ("x", first),
        "work": ("over", "Ts"),
        "distribution": ("over", next(iter(starts), first)),
    }
    if kind in usual:
        role, dim = usual[kind]
        roles[role] = roles[role] or dim
    if kind in ("heat", "best"):
        for role, other in (("x", "y"), ("y", "x")):
            roles[role] = roles[role] or next((d for d in _liked(axes) if d != roles[other]), None)
        if None in (roles["x"], roles["y"]):
            raise errors.fail("figure", f"have two numeric axes for the kind {kind!r}", f"has {axes}")
    if kind == "slices" and roles["x"] is None:
        raise errors.fail("figure", "have a numeric axis for the kind 'slices'", "has none")


def views(data, layout: Layout) -> list:
    """Return the parts of the data that are one figure each: [(suffix for the file's name, dataset)]."""
    view = data[list(dict.fromkeys((layout.value, "evaluations")))] if layout.kind == "work" else data[[layout.value]]
    for dim, wanted in layout.select.items():
        view = _selected(view, dim, wanted)
    if layout.reduced:
        view = getattr(view, layout.reduce)(layout.reduced, keep_attrs=True)
        words = view[layout.value].attrs.get("long_name", "")
        if layout.reduce == "mean" and words.startswith("1 if "):  # a verdict
            view[layout.value].attrs["long_name"] = words.replace("1 if", "share with", 1)
    view = view.isel({d: view.sizes[d] // 2 for d in layout.middle})
    out = []
    for place in itertools.product(*(range(data.sizes[d]) for d in layout.apart)):
        labels = (text(data[d].values.tolist()[i]) for d, i in zip(layout.apart, place, strict=True))
        suffix = "".join("_" + re.sub(r"[^\w.+,-]+", "-", label) for label in labels)
        out.append((suffix, view.isel(dict(zip(layout.apart, place, strict=True)))))
    return out


def _selected(view, dim, wanted):
    if view[dim].dtype.kind == "f":
        return view.sel({dim: wanted}, method="nearest")
    known = view[dim].values.tolist()
    if wanted not in known:
        raise errors.fail(f"figure.select.{dim}", f"be one of {', '.join(map(str, known))}", f"is {wanted!r}")
    return view.sel({dim: wanted})
