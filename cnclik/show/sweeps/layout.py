"""Layout: which dimension of a sweep's data goes where in a figure."""

from typing import Any, NamedTuple

import numpy as np

from cnclik import errors
from cnclik.show import style
from cnclik.sweeps.axes import known_keys
from cnclik.sweeps.summary import main_value, scalars

LONGEST = 8  # a longer dimension gets no panels
KINDS = {
    "heat": ("x", "y"),
    "best": ("x", "y"),
    "slices": ("x", "over", "lines"),
    "distribution": ("over", "lines"),
}
ROLES = ("x", "y", "over", "lines", "panels", "rows", "across")  # keys that name a dimension
REDUCE = ("median", "mean", "min")
KEYS = ("kind", "name", "title", "value", "panels", "rows", "across", "reduce", "select", "log", "limits")


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
    select: dict
    reduce: str
    title: str | None
    log: bool | None  # None: as the values are
    limits: tuple | None


def numeric(data) -> list:
    """Return the dimensions with numbers along them, those of a question of stability first."""
    dims = [d for d in data.dims if d in data.coords and data[d].dtype.kind in "if" and f"{d}_value" not in data.coords]
    return sorted(dims, key=lambda d: (d != "alpha", d != "Ts"))


def samples(data) -> list:
    """Return the dimensions that count vectors, such as random starts, or draws of noise."""
    return [d for d in data.dims if f"{d}_value" in data.coords or d == "seed"]


def defaults(data) -> list:
    """Return figures worth having, from the shape of the grid alone: tables as [[figure]] in a spec."""
    axes, starts, value = [d for d in numeric(data) if d != "seed"], samples(data), main_value(data)
    if value is None:
        return []
    methods = data.sizes.get("method", 1)
    tables: list = []
    if len(axes) > 1:
        kinds = ("heat", "best") if methods > 1 else ("heat",)
        tables += [{"kind": kind, "value": value, "x": axes[0], "y": axes[1]} for kind in kinds]
    elif axes:
        tables.append({"kind": "slices", "value": value, "x": axes[0]})
    if starts:
        tables.append({"kind": "distribution", "value": value, "over": starts[0]})
    if "Ts" in data.dims and "evaluations" in scalars(data) and len(np.unique(data.evaluations)) > methods:
        tables.append({"kind": "slices", "value": value, "x": "evaluations", "over": "Ts", "name": f"work_{value}"})
    return tables


def arrange(data, table: dict) -> Layout:
    """Give every dimension of the data its place in a figure.

    Args:
      table: as [[figure]] in a spec; what it doesn't say is chosen here.

    Raises: ArgumentError for a key or a value that is none, or a figure without its axes.
    """
    kind = errors.one_of("kind", table.get("kind"), KINDS)
    known_keys("table", table, (*KEYS, *KINDS[kind]))
    value = errors.one_of("value", table.get("value", main_value(data)), scalars(data))
    select = errors.kind("select", table.get("select", {}), dict, "be a table of a dimension and its value")
    for dim, wanted in select.items():
        _check_selected(f"select.{dim}", wanted, data[errors.one_of("select", dim, list(data[value].dims))])
    dims = [d for d in data[value].dims if d not in select]
    axes, drawn = [d for d in numeric(data) if d in dims], [d for d in samples(data) if d in dims]
    known = {"x": [*dims, *scalars(data)]} if kind == "slices" else {}
    roles: dict[str, Any] = dict.fromkeys(ROLES)
    roles |= {role: errors.one_of(role, table[role], known.get(role, dims)) for role in ROLES if role in table}
    _choose_axes(kind, roles, [d for d in axes if d not in drawn], drawn, dims)
    free = [d for d in dims if d not in (*roles.values(), *["method"] * (kind == "best"))]
    reduced = tuple(d for d in dims if d == roles["across"] or (d in free and d in drawn))
    # The rest: methods and stages first, then M.
    free = sorted((d for d in free if d not in reduced), key=lambda d: (d not in ("method", "stage"), d != "M"))
    places = [("lines", len(style.COLORS))] if "lines" in KINDS[kind] else []
    for role, most in (*places, ("panels", LONGEST), ("rows", LONGEST)):
        if roles[role] is None:
            roles[role] = next((d for d in free if data.sizes[d] <= most), None)
            free = [d for d in free if d != roles[role]]
    return Layout(kind, value, **roles, reduced=reduced, middle=tuple(free), select=dict(select), **_looks(table))


def _choose_axes(kind, roles, axes, drawn, dims):
    """Fill in the axes that a kind of figure needs."""
    if "y" in KINDS[kind]:
        for role, other in (("x", "y"), ("y", "x")):
            roles[role] = roles[role] or next((d for d in axes if d != roles[other]), None)
        if None in (roles["x"], roles["y"]):
            raise errors.fail("kind", "be 'slices' for one numeric axis", f"is {kind!r}, and the axes are {axes}")
    if kind == "best" and ("method" not in dims or "method" in roles.values()):
        raise errors.fail("kind", "be 'heat' for a single method", "is 'best'")
    if kind == "slices":
        roles["x"] = roles["x"] or next(iter(axes), None)
        if roles["x"] is None:
            raise errors.fail("x", "be a dimension or a variable", "is not given, and no axis has numbers")
        if roles["x"] not in dims:
            roles["over"] = errors.one_of("over", roles["over"] or "Ts", dims)
    if kind == "distribution":
        roles["over"] = roles["over"] or next(iter((*drawn, *axes)), None)


def _looks(table) -> dict:
    """Return the look of a table, checked."""
    for key in ("name", "title"):
        errors.kind(key, table.get(key, "-"), str, "be a text")
    name, limits = table.get("name", "-"), table.get("limits")
    if set(name) & set("/\\") or name in ("", ".", ".."):
        raise errors.fail("name", "be a file's name without a folder", f"is {name!r}")
    return {
        "reduce": errors.one_of("reduce", table.get("reduce", "median"), REDUCE),
        "title": table.get("title"),
        "log": errors.truth("log", table["log"]) if "log" in table else None,
        "limits": None if limits is None else tuple(np.asarray(errors.array("limits", limits, (2,))).tolist()),
    }


def _check_selected(where, wanted, coordinate):
    """Raise ArgumentError unless a coordinate has a value; of numbers the nearest counts."""
    if coordinate.dtype.kind != "f":
        errors.one_of(where, str(wanted), list(map(str, coordinate.values)))
        return
    low, high = float(coordinate.min()), float(coordinate.max())
    slack = 1e-9 * max(abs(low), abs(high))  # computed ends are rounded
    if not low - slack <= errors.number(where, wanted) <= high + slack:
        raise errors.fail(where, f"lie between {low:g} and {high:g}", f"is {wanted:g}")


def view(data, layout: Layout):
    """Return the part of the data that the figure shows."""
    shown = data[[layout.value, *[layout.x] * (layout.x in data.data_vars and layout.x != layout.value)]]
    for dim, wanted in layout.select.items():
        shown = shown.sel({dim: wanted}, method="nearest" if shown[dim].dtype.kind == "f" else None)
    if layout.reduced:
        shown = getattr(shown, layout.reduce)(layout.reduced, keep_attrs=True)
        words = shown[layout.value].attrs.get("long_name", "")
        if layout.reduce == "mean" and words.startswith("1 if "):  # a verdict
            shown[layout.value].attrs["long_name"] = words.replace("1 if", "share with", 1)
    return shown.isel({d: shown.sizes[d] // 2 for d in layout.middle})
