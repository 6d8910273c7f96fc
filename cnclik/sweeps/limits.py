"""Limits: the linear theory's largest stable z = alpha·Ts for every program of a spec, kept beside its data."""

import dataclasses
import functools

import jax
import numpy as np

from cnclik.law.inverse import Pseudoinverse
from cnclik.stability.linear import stability_limit
from cnclik.sweeps.grid import Grid

NAME = "limit"
_ABOUT = {"units": "1", "long_name": "largest stable z of linear theory"}
_DIGITS = 10  # as many as the search for the limit is good for, and the same on every machine


def linear_limit(spec, of: Grid) -> dict:
    """The largest z with |R(z)| ≤ 1 as a coordinate, over the axes on which it depends.

    R(z) is what a step does to the error where J J# = I and the gain is one number: for the exact pseudoinverse.
    NaN stands for every other law (damped, transposed, gains per axis), inf for a method without a limit.

    Returns: {"limit": (dimensions, values, attributes)}; {} where no loop has one, or where the spec's own axis z
    isn't alpha·Ts.
    """
    passes = next((a for a in of.inner if a.name == "M"), None)
    counts = [None] if passes is None else passes.values
    values = np.array([[_limit(spec, program, of, m) for m in counts] for program in of.programs])
    values = values.reshape(*(len(a) for a in of.outer), *([] if passes is None else [len(passes)]))
    dims = [a.name for a in of.outer] + ([] if passes is None else ["M"])
    for i in reversed(range(len(dims))):
        first = np.take(values, [0], axis=i)
        if np.array_equal(values, np.broadcast_to(first, values.shape), equal_nan=True):
            values = np.take(values, 0, axis=i)
            del dims[i]
    return {} if np.all(np.isnan(values)) else {NAME: (tuple(dims), values, _ABOUT)}


def _limit(spec, program, of, m):
    """The limit of one program, with m passes where M is an axis; NaN where linear theory has none."""
    ends = []
    for end in (0, -1):
        lane = program | {a.name: a.values[end] for a in of.inner}
        law, _, _, Ts, _, method, stage = spec.build(**lane)
        if not isinstance(law.inverse, Pseudoinverse) or np.ndim(law.alpha) != 0:
            return np.nan
        if "z" in lane and not np.isclose(float(law.alpha) * float(Ts), lane["z"], rtol=1e-6):
            return np.nan
        ends.append(int(stage.M))
    if m is None and ends[0] != ends[1]:  # M follows from some other axis
        return np.nan
    if not method.implicit:
        return _stable(method, None, 0)
    return _stable(method, dataclasses.replace(stage, M=0, maximum=0), int(ends[0] if m is None else m))


@functools.cache
def _stable(method, stage, m):
    if stage is not None:  # M as an array: one compiled program for every M
        stage = dataclasses.replace(stage, M=np.asarray(m), maximum=max(m, 16))
    with jax.enable_x64(True):
        found = float(stability_limit(method, stage))
    return float(f"{found:.{_DIGITS}g}")
