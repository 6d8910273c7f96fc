"""Limits: the linear theory's largest stable z = alpha·Ts for every program of a spec, kept beside its data."""

import jax
import numpy as np

from cnclik.law.inverse import Pseudoinverse
from cnclik.sweeps.grid import Grid

NAME = "limit"
_ABOUT = {"units": "1", "long_name": "largest stable z of linear theory"}
_DIGITS = 10  # digits to which the search is accurate, and equal on every machine


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
    return {} if np.all(np.isnan(values)) else {NAME: (tuple(dims), values, _ABOUT)}


def _limits(spec, program, counts) -> list:
    """The limit of one program for each count of passes; NaN if linear theory has none or lanes differ in it."""
    lanes = [program | spec.first(last=last) for last in (False, True)]
    for lane in lanes:
        made = spec.build(**lane)
        law, drive = made.law, made.drive
        if not isinstance(law.inverse, Pseudoinverse) or np.ndim(law.alpha) != 0:
            return [np.nan] * len(counts)
        if drive is not None and (drive.order or drive.feedback != "measured"):
            return [np.nan] * len(counts)
        if "z" in lane and not np.isclose(float(law.alpha) * float(made.Ts), float(lane["z"]), rtol=1e-6):
            return [np.nan] * len(counts)
    out = []
    for passes in counts:
        found = {float(f"{spec.lookup(**lane | passes)[1](NAME):.{_DIGITS}g}") for lane in lanes}
        out.append(found.pop() if len(found) == 1 else np.nan)
    return out
