"""Store: a sweep on disk, in blocks, that survives interruptions.

`data.zarr` is created with all coordinates and attributes before the first block runs. One block of the grid is one
chunk of each variable, and is done once all of its chunks are there; zarr writes a chunk whole or not at all, with a
checksum. So a killed run, a lost process or a full disk costs only the blocks in progress, and a rerun ends with the
same bytes as an undisturbed run.
"""

import contextlib
import dataclasses
import json
import os
import pathlib
import warnings
from typing import Any

import jax
import numpy as np

from cnclik import errors
from cnclik.sweeps.axes import Axis
from cnclik.sweeps.grid import Grid, fit, run_blocks
from cnclik.sweeps.spec import Spec
from cnclik.writing import hidden_folder

DATA = "data.zarr"


class Store:
    """An open store: its grid and its blocks. Raises: ArgumentError if there is none that can be read."""

    def __init__(self, folder, mode="r"):
        import zarr

        self.path = errors.path("out", folder) / DATA
        try:
            self.group: Any = zarr.open_group(self.path, mode=mode)
            self.config = json.loads(str(self.group.attrs["config"]))
            with zarr.config.set({"array.write_empty_chunks": True}):  # a block of NaN is done, too
                self.arrays = {name: self.group[name] for name in self.config["variables"]}
        except (OSError, KeyError, ValueError, TypeError, RecursionError) as error:
            raise errors.fail("out", f"hold a sweep's {DATA} or none", f"{self.path} is not one: {error}") from None
        axes = tuple(Axis(n, range(size), None if inner else ()) for n, size, inner in self.config["axes"])
        self.grid = Grid(axes, self.config["lanes"])  # as cut when the store was created

    def labelled(self, spec) -> bool:
        """Return whether all coordinates can be read, and those of the axes are a spec's."""
        with contextlib.suppress(OSError, KeyError, ValueError, RuntimeError):  # of a damaged chunk
            found = {name: array[...].tolist() for name, array in self.group.arrays() if name not in self.arrays}
            wanted = Grid(spec.axes).coordinates({}).items()
            return all(found[name] == np.asarray(values).tolist() for name, (_, values, _) in wanted)
        return False

    def missing(self) -> list:
        """Return the blocks that are not done, or damaged."""
        return [block for block in self.grid.blocks() if not self._is_done(block)]

    def _is_done(self, block) -> bool:
        chunk = [str(cut.start // step) for cut, step in zip(block.region, self.grid.block, strict=True)]
        with contextlib.suppress(OSError, ValueError, RuntimeError):  # of a damaged chunk
            for name, array in self.arrays.items():
                if not os.path.isfile(self.path.joinpath(name, "c", *chunk)):
                    return False
                array[block.region]  # compares its checksum
            return True
        return False

    def write(self, block, piece) -> None:
        """Write a block."""
        for name, array in self.arrays.items():
            array[block.region] = piece[name]


def create(folder: pathlib.Path, spec: Spec, of: Grid, outputs) -> None:
    """Create the empty store. It appears only once it is complete."""
    import xarray
    import zarr
    from zarr.codecs import Crc32cCodec, ZstdCodec

    packed: Any = {"compressors": [ZstdCodec(level=0), Crc32cCodec()]}  # no damaged chunk is unpacked
    data = xarray.Dataset(coords=spec.coordinates(of), attrs=spec.attributes(of, outputs))
    texts = {name: v.astype(object) for name, v in data.coords.items() if v.dtype.kind == "U"}  # all that zarr settled
    data = data.assign_coords(texts)
    with hidden_folder(folder) as hidden, _quiet():
        path = hidden / DATA
        data.to_zarr(path, zarr_format=3, consolidated=False, encoding=dict.fromkeys(data.variables, packed))
        group = zarr.open_group(path, mode="r+")
        for o in outputs:
            fill = np.nan if o.dtype.kind == "f" else -1  # of counts
            about: Any = {"dimension_names": [a.name for a in of.axes], "attributes": o.about, "fill_value": fill}
            group.create_array(o.name, shape=of.shape, chunks=of.block, dtype=o.dtype, **about, **packed)
        zarr.consolidate_metadata(path)
        path.rename(folder / DATA)


def opened(spec: Spec, folder) -> Store | None:
    """Return the folder's store if it belongs to this spec; None if there is none.

    Raises: ArgumentError if it belongs to another spec, or is not a sweep's.
    """
    if not os.path.exists(folder / DATA):
        return None
    store = Store(folder, mode="r+")
    for table, here in spec.fingerprint().items():
        there = store.config[table]
        if differing := [name for name in there | here if _compared(name, there) != _compared(name, here)]:
            must = "hold results of this very spec (another --out keeps both)"
            raise errors.fail("out", must, f"differs in {', '.join(differing)}: see config of {store.path}")
    if not store.labelled(spec):
        must = "hold whole coordinates: remove it, or give another --out"
        raise errors.fail("out", must, f"those of {store.path} are damaged")
    return store


def _compared(name, table) -> tuple:
    """An entry of a table; of axes also their order and that of their labels, in which equal tables may differ."""
    value = table.get(name)
    return value, [[axis, *values] for axis, values in value.items()] if name == "axes" and value else None


def run(spec: Spec, folder, *, progress=None) -> bool:
    """Compute the blocks of a sweep that its store lacks, in float64 whatever JAX's own precision is.

    Where `jax.distributed` is initialized, each of its processes computes a share.

    Args:
      folder: where `data.zarr` is or will be.
      progress: called with (points done, points this process has to do).

    Returns: whether the whole sweep is now done (other processes may still be at it).
    Raises: ArgumentError for a store of another spec, a folder that can't be written, a full disk, or another
      process that could not start; completed blocks are kept, and the same call continues from there.
    """
    process, processes = jax.process_index(), jax.process_count()
    folder, first, store = errors.path("out", folder), None, None
    with _together(processes):
        with _disk(folder):
            folder.mkdir(parents=True, exist_ok=True)
        if process == 0 and (store := opened(spec, folder)) is None:
            of, first = fit(spec.study, spec.grid())
            with _disk(folder):
                create(folder, spec, of, first.outputs)
    with _together(processes, last=True):
        store = store or opened(spec, folder)
        if store is None:
            raise errors.fail("out", "be one folder that all processes share", f"{str(folder)!r} is empty here")
        of, missing = dataclasses.replace(spec.grid(), lanes=store.grid.lanes), store.missing()
    # Adjacent blocks, so that each process compiles few programs.
    share = missing[len(missing) * process // processes : len(missing) * (process + 1) // processes]
    todo, done = sum(b.size for b in share), 0
    report = progress or (lambda done, todo: None)
    report(0, todo)
    for count, (block, piece) in enumerate(run_blocks(spec.study, of, share, first)):
        with _disk(folder, f" after {count} of {len(missing)} blocks; they are kept, and the same command goes on"):
            store.write(block, piece)
        done += block.size
        report(done, todo)
    return processes == 1 or not store.missing()


@contextlib.contextmanager
def _together(processes, last=False):
    """Wait for all processes; if one fails, all of them stop. After the `last` time they need each other no more."""
    try:
        yield
    except BaseException:
        _meet(processes, False, last)
        raise
    if not _meet(processes, True, last):
        raise errors.fail("distributed", "find every process ready", "another one failed, and reports why")


def _meet(processes, well, last) -> bool:
    """Wait for all processes, and return whether all of them are well."""
    if processes == 1:
        return well
    from jax.experimental import multihost_utils

    well = bool(multihost_utils.process_allgather(well).all())
    if last or not well:
        jax.distributed.shutdown()  # a process that fails or ends must not stop the others
    return well


def read(out):
    """Return the sweep of a folder as an `xarray.Dataset`, loaded on use. Loops that are not done are NaN, or -1 for
    counts; a damaged block raises on use.

    Raises: ArgumentError if there is none, or if its description is damaged.
    """
    import xarray

    store = Store(out)
    with _quiet():
        data = xarray.open_zarr(store.path, chunks=None)
    return data[list(store.arrays)].assign_coords(data.coords)  # in the spec's order, vectors of samples included


@contextlib.contextmanager
def _disk(folder, when=""):
    """Report file system errors in one line."""
    try:
        yield
    except OSError as error:
        why = f"{errors.reason(error)}{when}"
        message = f"Argument `out` must be a folder that can be written, but {str(folder)!r} is not: {why}."
        raise errors.ArgumentError(message) from error


@contextlib.contextmanager
def _quiet():
    """Silence zarr's warning that consolidated metadata is an extension; the data open without it, too."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Consolidated metadata")
        yield
