"""Store: a sweep on disk, in blocks, that survives whatever ends it.

`data.zarr` is made whole, with every coordinate and attribute, before the first block runs; one block of the
grid is one chunk of each variable. A block counts as done once its checksum stands in the group `progress`,
written last, and is believed only if the data still have it. So a killed run, a lost process or a full disk
cost the blocks in flight, and a rerun ends with the very bytes of an undisturbed run.
"""

import contextlib
import json
import math
import pathlib
import shutil
import zlib

import numpy as np

from cnclik import errors
from cnclik.measure import metrics
from cnclik.sweeps import sweep
from cnclik.sweeps.spec import Spec, to_json

DATA = "data.zarr"
_MISSING = -1  # checksum of a block that is not done; also what a count reads before it is


class Store:
    """An open store: the grid it was made for, and its blocks."""

    def __init__(self, folder: pathlib.Path):
        import zarr

        self.folder, self.path = folder, folder / DATA
        self.group = zarr.open_group(self.path, mode="r+")
        self.config = json.loads(self.group.attrs["config"])
        self._checksums = self.group["progress/checksum"]
        self.names = tuple(self.config["variables"])

    @property
    def lanes(self) -> int:
        return self.config["lanes"]

    def missing(self, blocks) -> list:
        """The blocks that are not done, or whose data no longer have their checksum."""
        known = self._checksums[:]
        return [b for b in blocks if known[b.number] == _MISSING or known[b.number] != self._checksum(b)]

    def _checksum(self, block, piece=None):
        total = 0
        for name in self.names:
            try:
                values = self.group[name][block.region] if piece is None else piece[name]
            except (OSError, ValueError, RuntimeError):  # a chunk that can't be decoded
                return None
            total = zlib.crc32(np.ascontiguousarray(values), total)
        return total

    def write(self, block, piece):
        """The data, then the checksum that vouches for them."""
        for name in self.names:
            self.group[name][block.region] = piece[name]
        self._checksums[block.number] = self._checksum(block, piece)


def create(folder: pathlib.Path, spec: Spec, of: sweep.Grid, outputs) -> None:
    """Make the empty store. It appears under its name only when it is whole."""
    import xarray
    import zarr

    from cnclik.measure.dataset import provenance

    building, path = folder / (DATA + ".new"), folder / DATA
    shutil.rmtree(building, ignore_errors=True)
    config = {**_fingerprint(spec), "lanes": of.lanes, "variables": [o.name for o in outputs]}
    units = spec.all_units()
    coords = {}
    for one in of.axes:
        coords |= sweep.coordinates(one, units)
    # Names as variable-length strings: zarr has no settled form for others.
    coords = {k: (d, v.astype(object) if v.dtype.kind == "U" else v, a) for k, (d, v, a) in coords.items()}
    attrs = (
        sweep.environment()
        | {"commit": provenance(float)["commit"]}
        | {
            "question": spec.question,
            "expectation": spec.expectation,
            "spec": to_json(spec),
            "config": json.dumps(config, ensure_ascii=False),
        }
    )
    with _quiet():
        xarray.Dataset(coords=coords, attrs=attrs).to_zarr(building, zarr_format=3, consolidated=False)
        group = zarr.open_group(building, mode="r+")
        dims = tuple(a.name for a in of.axes)
        for o in outputs:
            group.create_array(
                o.name,
                shape=(*of.shape, *o.shape),
                chunks=(*of.block, *(max(n, 1) for n in o.shape)),
                dtype=o.dtype,
                fill_value=np.nan if o.dtype.kind == "f" else _MISSING,
                dimension_names=dims + o.dims,
                attributes={"units": o.unit or units.get(o.name, ""), "long_name": metrics.METRICS[o.name].label},
            )
        progress = group.create_group("progress")
        progress.create_array(
            "checksum",
            shape=(len(of.blocks()),),
            chunks=(1,),
            dtype="int64",
            fill_value=_MISSING,
            dimension_names=("block",),
        )
        zarr.consolidate_metadata(building)
    building.rename(path)


def _fingerprint(spec: Spec) -> dict:
    """What a block's numbers depend on: as JSON gives it back."""
    return json.loads(json.dumps({"data": spec.data(), "environment": sweep.environment()}))


def prepare(spec: Spec, folder, *, fresh=False) -> Store | None:
    """The folder's store if it has one that belongs to this spec. Raises ArgumentError if it belongs to another."""
    folder = pathlib.Path(folder)
    path = folder / DATA
    with _disk(folder):
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".writable"
        probe.write_bytes(b"")
        probe.unlink()
        if fresh and path.exists():
            trash = folder / (DATA + ".old")
            shutil.rmtree(trash, ignore_errors=True)
            path.rename(trash)  # at once: no reader meets half a store
            shutil.rmtree(trash)
    if not path.exists():
        return None
    try:
        store = Store(folder)
    except (OSError, KeyError, ValueError) as error:
        raise errors.fail(
            "out", f"hold a sweep's {DATA} or none (--fresh starts over)", f"{path} is not one: {error}"
        ) from None
    for left in path.rglob("*.partial"):  # of a write that was cut off
        left.unlink(missing_ok=True)
    found = {k: store.config[k] for k in ("data", "environment")}
    where = _difference(found, _fingerprint(spec))
    if where:
        raise errors.fail(
            "out",
            "hold results of this very spec (--fresh starts over, another --out keeps both)",
            f"differs in {where}",
        )
    return store


def _difference(a, b, where=""):
    """The first place where two JSON values differ, in words."""
    if isinstance(a, dict) and isinstance(b, dict):
        for key in [*a, *(k for k in b if k not in a)]:
            found = _difference(a.get(key), b.get(key), f"{where}.{key}" if where else key)
            if found:
                return found
        return None
    if a == b:
        return None
    return f"{where.removeprefix('data.')}: {_short(a)} there, {_short(b)} here"


def _short(value):
    text = "nothing" if value is None else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else text[:57] + "..."


def run(spec: Spec, folder, *, fresh=False, process=0, processes=1, barrier=None, progress=None) -> bool:
    """Compute the blocks of a sweep that its store lacks.

    Args:
      folder: where `data.zarr` is or will be.
      fresh: start over.
      process, processes: this process's number among all that run this together.
      barrier: returns when all processes have called it; called with True when they need each other no more.
      progress: called with (points done, points this process has to do).

    Returns: whether the whole sweep is now done (other processes may still be at it).
    Raises: ArgumentError for a store of another spec, a folder that can't be written, or a full disk; what is
      done is kept, and the same call goes on from there.
    """
    folder, barrier = pathlib.Path(folder), barrier or (lambda last: None)
    of, first, store = spec.grid(), None, None
    if process == 0:
        store = prepare(spec, folder, fresh=fresh)
        if store is None:
            of, first = sweep.fit(spec.study, of)
            with _disk(folder):
                create(folder, spec, of, first.outputs)
            store = Store(folder)
    barrier(False)
    store = store or prepare(spec, folder)
    of = sweep.dataclasses.replace(of, lanes=store.lanes)
    missing = store.missing(of.blocks())
    barrier(True)
    share = _share(spec, of, missing, process, processes)
    todo, done = sum(map(_size, share)), 0
    total = len(missing)
    if progress is not None:
        progress(0, todo)
    for count, (block, piece) in enumerate(sweep.run_blocks(spec.study, of, share, first)):
        with _disk(folder, f" after {count} of {total} blocks; they are kept, and the same command goes on from there"):
            store.write(block, piece)
        done += _size(block)
        if progress is not None:
            progress(done, todo)
    return not store.missing(of.blocks()) if processes > 1 else True


def _size(block):
    return math.prod(cut.stop - cut.start for cut in block.region)


def _share(spec, of, missing, process, processes):
    """This process's run of neighbouring blocks: few programs to compile, and its share of the evaluations."""
    if processes == 1:
        return missing
    costs = [spec.evaluations(p) for p in of.programs]
    ends = np.cumsum([costs[b.program] for b in missing])
    if not len(ends):
        return []
    owner = np.minimum((ends - ends[0] / 2) / ends[-1] * processes, processes - 1).astype(int)
    return [b for b, who in zip(missing, owner, strict=True) if who == process]


def read(folder):
    """The sweep of a folder as an `xarray.Dataset`, loaded on use."""
    import xarray

    path = pathlib.Path(folder) / DATA
    if not path.exists():
        raise errors.fail("folder", f"hold a sweep's {DATA}", f"{str(folder)!r} does not")
    with _quiet():
        return xarray.open_zarr(path, chunks=None)


def blocks_missing(folder) -> int:
    """How many blocks of a folder's sweep are not done."""
    return int(np.sum(Store(pathlib.Path(folder))._checksums[:] == _MISSING))


@contextlib.contextmanager
def _disk(folder, when=""):
    """Errors of the file system as one line."""
    try:
        yield
    except OSError as error:
        reason = f"{error.strerror or error}{when}"
        message = f"Argument `out` must be a folder that can be written, but {str(folder)!r} is not: {reason}."
        raise errors.ArgumentError(message) from error


@contextlib.contextmanager
def _quiet():
    """Without zarr's remark that consolidated metadata is an extension: data open the same without it."""
    import warnings

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Consolidated metadata")
        yield
