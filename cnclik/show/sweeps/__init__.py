"""Figures of a sweep: heat maps, who is best, slices, distributions.

Every kind works from the dataset alone. Dimensions that a figure doesn't name become lines, panels and rows; samples of
starts are summed up by their median, and what is left is shown at its middle.
"""

import functools
import json

import numpy as np

from cnclik import errors
from cnclik.show.sweeps import kinds
from cnclik.show.sweeps.layout import arrange, defaults, view
from cnclik.sweeps.labels import coordinates

__all__ = ["check", "defaults", "drawings", "figures"]


def check(spec) -> None:
    """Raise ArgumentError unless all figures of a spec can be laid out, before anything runs."""
    import xarray

    of = spec.grid()
    dims, shape = tuple(a.name for a in of.axes), of.shape
    values = {name: (dims, np.broadcast_to(0.0, shape)) for name in spec.metrics}
    data = xarray.Dataset(values, coordinates(of, spec.all_units()))
    for i, table in enumerate(spec.figures):
        with errors.within(f"figure[{i}]"):
            arrange(data, table)


def drawings(data, tables=None) -> dict:
    """Return {name: function of no arguments that draws it} of the figures that `figures` makes.

    A table that can't be laid out is a function that raises: it costs the others nothing.
    """
    if tables is None:
        tables = json.loads(data.attrs.get("spec", "{}")).get("figures")
    out: dict = {}
    for i, table in enumerate(tables or defaults(data)):
        name = table.get("name") or "_".join(filter(None, [table.get("kind"), table.get("value")]))
        try:
            with errors.within(f"figure[{i}]"):
                layout = arrange(data, table)
            name = table.get("name") or f"{layout.kind}_{layout.value}"
            make = functools.partial(kinds.KINDS[layout.kind], view(data, layout), layout)
        except (LookupError, TypeError, ValueError) as error:  # a table that fits no data; ArgumentErrors are such
            make = functools.partial(_raise, error)
        numbered = (name if k == 1 else f"{name}_{k}" for k in range(1, len(out) + 2))
        out[next(n for n in numbered if n not in out)] = make
    return out


def figures(data, tables=None) -> dict:
    """Return {name: matplotlib Figure} of the data's spec, or of `tables`, or good ones if none are asked for.

    Args:
      data: dataset of a sweep.
      tables: as [[figure]] in a spec.
    """
    return {name: make() for name, make in drawings(data, tables).items()}


def _raise(error):
    raise error
