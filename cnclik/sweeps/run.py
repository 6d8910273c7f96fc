"""run_spec: a question of many loops, from its TOML file to the labelled data, in one call."""

from cnclik.sweeps import store
from cnclik.sweeps.about import attributes, coordinates_of
from cnclik.sweeps.spec import Spec, read
from cnclik.sweeps.sweep import collect, dataset


def run_spec(spec, out=None, *, set=(), fresh=False, progress=None):
    """Run a spec, in float64 whatever JAX's own precision is.

    Args:
      spec: a `Spec`, or the path of its TOML file.
      out: folder for a store, `data.zarr`, which goes on where an interrupted run ended; None keeps the data in
        memory.
      set: strings "name=value" that override what the file says, as --set of `cnclik sweep`.
      fresh: start over, even where `out` holds results.
      progress: called with (points done, points to do).

    Returns: `xarray.Dataset` with the axes as dimensions and, where linear theory has one for the spec's laws, the
    coordinate `limit`, the largest stable z = alpha·Ts; from a store, loaded on use.
    Raises: ArgumentError for what can't be run, or a folder that holds something else.
    """
    spec = spec if isinstance(spec, Spec) else read(spec, set)
    if out is not None:
        store.run(spec, out, fresh=fresh, progress=progress)
        return store.read(out)
    of, outputs, arrays = collect(spec.study, spec.grid(), progress)
    return dataset(of, outputs, arrays, coordinates_of(spec, of), attributes(spec, of, outputs))
