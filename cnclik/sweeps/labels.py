"""Labels: units, symbols and provenance of a sweep's data, in memory and in a store. Figures and tables read them."""

import json

import numpy as np

from cnclik.measure.dataset import provenance
from cnclik.sweeps.grid import Grid
from cnclik.sweeps.limits import linear_limit

# Units of axes, and of results that do not state one.
UNITS = {
    **{"alpha": "1/s", "Ts": "s", "t": "s", "horizon": "s", "duration": "s", "period": "s"},
    **{"z": "1", "M": "1", "N": "1", "step": "1", "seed": "1", "method": "1", "stage": "1", "robot": "1", "case": "1"},
}
SYMBOLS = {"alpha": "α", "z": "z = α·Ts", "damping": "λ", "M": "passes M"}


def coordinates(of: Grid, units) -> dict:
    """Coordinates of all axes: their values; for an axis of vectors, their numbers with the values beside them.

    Returns: {name: (dimensions, values, attributes)}.
    """
    found = {}
    for name, values, labels in of.axes:
        task, _, option = name.removeprefix("tasks.").removeprefix("walls.").rpartition(".")
        symbol = SYMBOLS.get(option, option.replace("_", " ")) + (f" of {task}" if task else "")
        about = {"units": units.get(name, ""), "long_name": symbol}
        if labels is not None:
            found[name] = (name, np.asarray(labels), about | {"units": units.get(name, "1")})
        elif values.ndim == 1:
            found[name] = (name, values, about)
        else:
            parts = (f"{name}_{i}" for i in range(values.ndim - 1))
            found[name] = (name, np.arange(len(values)), about | {"units": "1"})
            found[f"{name}_value"] = ((name, *parts), values, about)
    return found


def environment(dtype=np.float64) -> dict:
    """What the numbers depend on besides the configuration: versions, dtype, device."""
    return {name: value for name, value in provenance(dtype).items() if name != "commit"}


def coordinates_of(spec, of: Grid) -> dict:
    """All coordinates of a spec's data, {name: (dimensions, values, attributes)}: its axes and the linear limit."""
    return coordinates(of, spec.all_units()) | linear_limit(spec, of)


def attributes(spec, of: Grid, outputs) -> dict:
    """Attributes of a spec's data: the question, and in `config` all that the numbers depend on."""
    asked = {"question": spec.question, "expectation": spec.expectation}
    config = fingerprint(spec) | {
        "lanes": of.lanes,
        "variables": [o.name for o in outputs],
        "axes": [[a.name, len(a), a.inner] for a in of.axes],
    }
    written = {"name": spec.name} | asked | spec.data() | {"figures": spec.figures}
    return (
        {"commit": provenance(float)["commit"]}
        | asked
        | {"spec": json.dumps(written, ensure_ascii=False), "config": json.dumps(config, ensure_ascii=False)}
    )


def fingerprint(spec) -> dict:
    """What a block's numbers depend on, as JSON returns it."""
    return json.loads(json.dumps({"data": spec.data(), "environment": environment()}))
