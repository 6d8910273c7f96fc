"""Labels: units, symbols, provenance and linear limit of a sweep's data, in memory and in a store."""

import itertools
import json
import math

import jax
import numpy as np

from cnclik.measure.dataset import provenance
from cnclik.sweeps.grid import Grid

LIMIT = "limit"
SYMBOLS = {"alpha": "α", "z": "z = α·Ts", "damping": "λ", "M": "passes M"}
UNITS = {"alpha": "1/s"} | dict.fromkeys(("Ts", "t", "horizon", "duration", "period"), "s")  # of axes and results
UNITS |= dict.fromkeys(("z", "M", "N", "step", "seed", "method", "stage", "robot"), "1")
DIGITS = 10  # to which the limit is accurate, and equal on every machine
MOST_LIMITS = 1000  # each takes some milliseconds


def coordinates(of: Grid, units) -> dict:
    """Return coordinates of all axes, {name: (dimensions, values, attributes)}; for an axis of vectors their numbers,
    with the values beside them."""
    coords = {}
    for name, values, labels in of.axes:
        about = {"units": units.get(name, ""), "long_name": SYMBOLS.get(name, name.replace("_", " "))}
        if labels is not None:
            values = np.asarray(labels)
            if values.dtype.kind == "U":  # such as "8ms", which have their own unit
                about["units"] = "1"
        elif values.ndim > 1:
            parts = (f"{name}_{i}" for i in range(values.ndim - 1))
            coords[f"{name}_value"] = ((name, *parts), values, about)
            values, about = np.arange(len(values)), about | {"units": "1"}
        coords[name] = (name, values, about)
    return coords


def coordinates_of(spec, of: Grid) -> dict:
    """Return all coordinates of a spec's data: its axes, and the largest stable z = alpha·Ts over those it depends on.

    It holds at any posture, exactly where J# is exact; with damping a little more may be stable. inf: any z. There is
    none where the spec's own axis z is not alpha·Ts, or for more than a thousand combinations.
    """
    coords, needs, first = coordinates(of, spec.all_units()), spec.needs(LIMIT), of.programs[0]
    axes = [a for a in of.axes if a.name in needs or needs & set().union(*spec.tables.get(a.name, {}).values())]
    if math.prod(map(len, axes)) > MOST_LIMITS:
        return coords
    with jax.enable_x64(True):
        for loop in (spec.loop(first), spec.loop(first | spec.first(last=True))):
            if "z" in spec.first() and not np.isclose(np.max(loop["alpha"]) * loop["Ts"], loop["z"], rtol=1e-6):
                return coords
        points = itertools.product(*(a.values for a in axes))
        loops = (spec.loop(first | dict(zip([a.name for a in axes], point, strict=True))) for point in points)
        limits = [float(f"{loop[LIMIT]:.{DIGITS}g}") for loop in loops]
    about = {"units": "1", "long_name": "largest stable z of linear theory"}
    return coords | {LIMIT: (tuple(a.name for a in axes), np.reshape(limits, [len(a) for a in axes]), about)}


def attributes(spec, of: Grid, outputs) -> dict:
    """Return attributes of a spec's data: the question, and in `config` all that the numbers depend on."""
    asked = {name: text for name in ("question", "expectation") if (text := getattr(spec, name))}
    axes = [[a.name, len(a), a.inner] for a in of.axes]
    config = fingerprint(spec) | {"lanes": of.lanes, "variables": [o.name for o in outputs], "axes": axes}
    written = {"name": spec.name} | asked | spec.data() | {"figures": spec.figures}
    texts = {name: json.dumps(value, ensure_ascii=False) for name, value in (("spec", written), ("config", config))}
    return provenance(float) | asked | texts


def fingerprint(spec) -> dict:
    """Return what a block's numbers depend on, as JSON returns it."""
    return json.loads(json.dumps({"data": spec.data(), "environment": provenance(float)}))
