"""Labels: units, symbols, provenance and linear limit of a sweep's data, in memory and in a store."""

import json

import jax
import numpy as np

from cnclik.law.inverse import Pseudoinverse
from cnclik.measure.dataset import provenance
from cnclik.sweeps.grid import Grid

# Units of axes, and of results that do not state one.
UNITS = {
    **{"alpha": "1/s", "Ts": "s", "t": "s", "horizon": "s", "duration": "s", "period": "s"},
    **{"z": "1", "M": "1", "N": "1", "step": "1", "seed": "1", "method": "1", "stage": "1", "robot": "1", "case": "1"},
}
LIMIT = "limit"
_DIGITS = 10  # digits to which the search for it is accurate, and equal on every machine
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
            words = np.asarray(labels)  # such as "8ms", which have their own unit
            found[name] = (name, words, about | {"units": "1" if words.dtype.kind == "U" else units.get(name, "1")})
        elif values.ndim == 1:
            found[name] = (name, values, about)
        else:
            parts = (f"{name}_{i}" for i in range(values.ndim - 1))
            found[name] = (name, np.arange(len(values)), about | {"units": "1"})
            found[f"{name}_value"] = ((name, *parts), values, about)
    return found


def linear_limit(spec, of: Grid) -> dict:
    """The largest z with |R(z)| ≤ 1 as a coordinate, over the axes on which it depends.

    R(z) multiplies the error in a step if J J# = I and the gain is one number: for the exact pseudoinverse. It is NaN
    for every other law (damped, transposed, gains per axis) and for drives with a lag, and inf for a method without a
    limit.

    Returns: {"limit": (dimensions, values, attributes)}; {} if no loop has one, or if the spec's own axis z is not
      alpha·Ts.
    """
    passes = [a for a in of.inner if a.name == "M"]
    counts = [{"M": m} for m in passes[0].values] if passes else [{}]
    with jax.enable_x64(True):
        values = np.array([_limits(spec, program, counts) for program in of.programs])
    values = values.reshape([len(a) for a in (*of.outer, *passes)])
    dims = [a.name for a in (*of.outer, *passes)]
    for i in reversed(range(len(dims))):
        first = np.take(values, [0], axis=i)
        if np.array_equal(values, np.broadcast_to(first, values.shape), equal_nan=True):
            values = np.take(values, 0, axis=i)
            del dims[i]
    about = {"units": "1", "long_name": "largest stable z of linear theory"}
    return {} if np.all(np.isnan(values)) else {LIMIT: (tuple(dims), values, about)}


def _limits(spec, program, counts) -> list:
    """The limit of one program for each count of passes; NaN if linear theory has none or lanes differ in it."""
    lanes = [program | spec.first(last=last) for last in (False, True)]
    for lane in lanes:
        made = spec.build(**lane)
        law, drive = made.law, made.drive
        if not isinstance(law.inverse, Pseudoinverse) or np.ndim(law.alpha) != 0:
            return [np.nan] * len(counts)
        if drive is not None and (drive.order or drive.filters or drive.feedback != "measured"):
            return [np.nan] * len(counts)
        if "z" in lane and not np.isclose(float(law.alpha) * float(made.Ts), float(lane["z"]), rtol=1e-6):
            return [np.nan] * len(counts)
    out = []
    for passes in counts:
        found = {float(f"{spec.lookup(**lane | passes)[1](LIMIT):.{_DIGITS}g}") for lane in lanes}
        out.append(found.pop() if len(found) == 1 else np.nan)
    return out


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
