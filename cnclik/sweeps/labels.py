"""Labels: units, symbols and provenance of what a sweep holds. Figures and tables read them from the data."""

import numpy as np

from cnclik.sweeps.grid import Axis

# Units of axes and of results that bring none.
UNITS = {
    **{"alpha": "1/s", "Ts": "s", "t": "s", "horizon": "s", "duration": "s", "period": "s"},
    **{"z": "1", "M": "1", "N": "1", "step": "1", "seed": "1", "method": "1", "stage": "1", "robot": "1", "case": "1"},
}
SYMBOLS = {"alpha": "α", "z": "z = α·Ts", "damping": "λ"}


def coordinates(one: Axis, units) -> dict:
    """Coordinates of an axis: its values; for an axis of vectors their numbers, and the values beside them.

    Returns: {name: (dimensions, values, attributes)}.
    """
    about = {"units": units.get(one.name, ""), "long_name": SYMBOLS.get(one.name, one.name.replace("_", " "))}
    if not one.inner:
        return {one.name: (one.name, np.asarray(one.labels), about | {"units": units.get(one.name, "1")})}
    if one.values.ndim == 1:
        return {one.name: (one.name, one.values, about)}
    parts = tuple(f"{one.name}_{i}" for i in range(one.values.ndim - 1))
    return {
        one.name: (one.name, np.arange(len(one)), about | {"units": "1"}),
        f"{one.name}_value": ((one.name, *parts), one.values, about),
    }


def environment(dtype=np.float64) -> dict:
    """What the numbers depend on beside the configuration: versions, dtype, device."""
    from cnclik.measure.dataset import provenance

    found = provenance(dtype)
    return {name: found[name] for name in ("cnclik", "jax", "numpy", "dtype", "device")}
