"""Figures of a sweep: heat maps, slices, distributions, work diagrams, and who is best.

Every kind works from the dataset alone. Dimensions that a figure doesn't name become panels, then rows, then
figures of their own; samples of starts are summed up by their median.
"""

import functools
import json

from cnclik.show.sweeps import kinds
from cnclik.show.sweeps.layout import arrange, defaults, views

__all__ = ["defaults", "drawings", "figures"]

KINDS = {name: getattr(kinds, name) for name in ("heat", "best", "slices", "distribution", "work")}


def drawings(data, tables=None) -> dict:
    """Return {name: function of no arguments that draws it} of the figures that `figures` makes.

    A table that can't be laid out is a function that raises: it costs the others nothing.
    """
    if tables is None:
        tables = json.loads(data.attrs.get("spec", "{}")).get("figures")
    out = {}
    for table in tables or defaults(data):
        name = table.get("name") or "_".join([table["kind"], *filter(None, [table.get("value")])])
        try:
            layout = arrange(data, table)
            name = table.get("name") or f"{layout.kind}_{layout.value}"
            for suffix, view in views(data, layout):
                out[_unused(name + suffix, out)] = functools.partial(KINDS[layout.kind], view, layout)
        except (LookupError, TypeError, ValueError) as error:  # a table that fits no data; ArgumentErrors are such
            out[_unused(name, out)] = functools.partial(_raise, error)
    return out


def figures(data, tables=None) -> dict:
    """Return the figures that the data's spec asks for, or `tables`, or good ones if none are asked for.

    Args:
      data: dataset of a sweep.
      tables: as [[figure]] in a spec.

    Returns: {name: matplotlib Figure}; draw inside `with style.style():`.
    """
    return {name: make() for name, make in drawings(data, tables).items()}


def _raise(error):
    raise error


def _unused(name, taken):
    """Return the name, numbered where it is taken."""
    names = (name if i == 1 else f"{name}_{i}" for i in range(1, len(taken) + 2))
    return next(n for n in names if n not in taken)
