"""Sweep: a study over a labelled grid, or a spec's loops, as an xarray.Dataset."""

import json
import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from cnclik import errors
from cnclik.measure.dataset import provenance
from cnclik.precision import of_numbers
from cnclik.sweeps import store
from cnclik.sweeps.axes import axis
from cnclik.sweeps.grid import UNITS, Grid, fit, run_blocks
from cnclik.sweeps.spec import Spec, read

if TYPE_CHECKING:
    import xarray as xr

LANES = 16384  # lanes in a block: enough to keep the processor busy, few enough for its cache


@of_numbers
def sweep(
    study: Callable,
    *,
    lanes: int = LANES,
    progress: Callable[[int, int], object] | None = None,
    **axes: Any,
) -> "xr.Dataset":
    """Run a study over the grid of some axes, in float64 whatever JAX's own precision is.

    Only a jax.Array that was made in float32 before the call and is used by the study keeps its precision, and a loop
    that starts from it runs in float32; the attribute `dtype` shows it. Give such values as NumPy arrays.

    Args:
      study: a pure function of the named values, returning a record, a dict or `Metrics` of scalars (or of arrays:
        further dimensions), such as a function that calls `solve` and `measure_run`.
      axes: name=values, in the order of the wanted dimensions. Numbers in a list or an array, also integers, run inside
        one compiled program: alpha=[1, 5, 10] is one axis of floats. M stays an integer, for picard(M, maximum=...); so
        does a range or an array of integers. An array of shape (S, ...) is S values of shape (...). Compiled in, with
        one program each, are N, delay, strings, objects with a name (methods), and the values of a dict {label: value},
        such as M={1: 1, 5: 5}.
      lanes: largest number of points in one block.
      progress: called with (points done, points in all).

    Returns: `xarray.Dataset` with the axes as dimensions, `units` on every variable, the configuration in attrs.
    Raises: ArgumentError for an axis that cannot be read.
    """
    if not callable(study):
        raise errors.fail("study", "be a function of named values", f"is {study!r}")
    of = Grid(tuple(axis(name, values) for name, values in axes.items()), errors.integer("lanes", lanes, at_least=1))
    of, outputs, arrays = _collect(study, of, progress)
    config = {
        "study": getattr(study, "__qualname__", type(study).__name__),
        "axes": {a.name: a.values.tolist() if a.inner else [str(v) for v in a.labels] for a in of.axes},
    }
    return _dataset(of, outputs, arrays, of.coordinates(UNITS), {"config": json.dumps(config), "lanes": of.lanes})


def run_spec(spec, out=None, *, set=(), progress=None) -> "xr.Dataset":
    """Run a spec, from its TOML file to the labelled data, in float64 whatever JAX's own precision is.

    Args:
      spec: a `Spec`, or the path of its TOML file.
      out: folder for a store, `data.zarr`, which continues an interrupted run; None keeps the data in memory.
      set: strings "name=value" that replace values of the file, as `--set` of `cnclik sweep`.
      progress: called with (points done, points to do).

    Returns: `xarray.Dataset` with the axes as dimensions and the coordinates `limit`, the largest stable z = alpha·Ts
      of linear theory, and `alpha_Ts`, z of the largest gain; from a store, loaded on use.
    Raises: ArgumentError for what cannot be run, or a folder that holds something else.
    """
    errors.kind("progress", progress, (Callable, type(None)), "be a function or None")
    errors.kind("spec", spec, (Spec, str, os.PathLike), "be a path")
    spec = spec if isinstance(spec, Spec) else read(spec, [set] if isinstance(set, str) else set)
    if out is not None:
        store.run(spec, out, progress=progress)
        return store.read(out)
    of, outputs, arrays = _collect(spec.study, spec.grid(), progress)
    return _dataset(of, outputs, arrays, spec.coordinates(of), spec.attributes(of, outputs))


def _collect(study, of, progress):
    """Compute the whole grid: (the grid as cut, outputs, {name: array over the grid})."""
    of, first = fit(study, of)
    arrays = {o.name: np.empty((*of.shape, *o.shape), o.dtype) for o in first.outputs}
    done = 0
    for block, piece in run_blocks(study, of, of.blocks(), first):
        for name, values in piece.items():
            arrays[name][block.region] = values
        done += block.size
        if progress is not None:
            progress(done, of.size)
    return of, first.outputs, arrays


def _dataset(of, outputs, arrays, coords, attrs):
    """Return arrays over the grid as a labelled `xarray.Dataset`."""
    import xarray

    names = tuple(a.name for a in of.axes)
    data = {o.name: (names + o.dims, arrays[o.name], o.about) for o in outputs}
    floats = [o.dtype for o in outputs if jax.numpy.issubdtype(o.dtype, np.floating)]
    dtype = min(floats, key=lambda d: d.itemsize, default=np.dtype(float))
    return xarray.Dataset(data, coords, attrs=attrs | provenance(dtype))
