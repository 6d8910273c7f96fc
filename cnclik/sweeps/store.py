"""Store: a sweep on disk, in blocks, that survives interruptions.

`data.zarr` is created with all coordinates and attributes before the first block runs; one block of the grid is one
chunk of each variable. A block is done once its checksum is in the group `progress`, written last, and only while the
data match it. So a killed run, a lost process or a full disk costs only the blocks in progress, and a rerun ends with
the same bytes as an undisturbed run. Coordinates have checksums too, compared before they are unpacked: a rerun
rewrites a damaged one, and a reader refuses it.
"""

import contextlib
import dataclasses
import functools
import json
import os
import pathlib
import re
import tempfile
import warnings
import zlib
from typing import Any

import numpy as np

from cnclik import errors
from cnclik.reading import read_bytes
from cnclik.sweeps import program
from cnclik.sweeps.grid import Axis, Grid
from cnclik.sweeps.labels import attributes, coordinates_of, environment, fingerprint
from cnclik.sweeps.spec import Spec
from cnclik.writing import OWN, hidden_folder, remove_abandoned

DATA = "data.zarr"
_MARK = OWN  # file in a store: {file: checksum} of its description and of its coordinates
_DESCRIPTION = "zarr.json"  # file that describes a group or an array
_NOT_DONE = -1  # checksum of an unfinished block, and its value of counts


class Store:
    """An open store: its grid and its blocks. Raises: ArgumentError if there is none."""

    def __init__(self, folder: pathlib.Path, *, name="out", mode="r+"):
        import zarr

        self.folder, self.path = folder, folder / DATA
        try:
            self._mark = _checked_mark(self.path)
            self.group: Any = zarr.open_group(self.path, mode=mode)
            self.config = json.loads(str(self.group.attrs["config"]))
            self.lanes, self.names = self.config["lanes"], self.config["variables"]
            self.coordinates = sorted(set(self.group.array_keys()) - set(self.names))
            self._checksums = self.group["progress/checksum"]
        except (OSError, KeyError, ValueError, TypeError) as error:
            raise errors.fail(name, f"hold a sweep's {DATA} or none", f"{self.path} is not one: {error}") from None

    def opened(self):
        """The data as an `xarray.Dataset`, in the spec's order, loaded on use and unchecked."""
        import xarray

        with _quiet():
            data = xarray.open_zarr(self.path, chunks=None)
        # Selecting variables would drop the vectors of an axis of samples.
        return data[list(self.names)].assign_coords(data.coords)

    def blocks(self) -> list:
        """All blocks, numbered as when the store was created."""
        axes = tuple(Axis(n, range(size), None if inner else ()) for n, size, inner in self.config["axes"])
        return Grid(axes, self.lanes).blocks()

    def missing(self) -> list:
        """The blocks that are not done, or whose data do not match their checksum."""
        known = self._known()
        return [b for b in self.blocks() if known[b.number] == _NOT_DONE or known[b.number] != self._checksum(b)]

    def without(self, name, missing) -> np.ndarray:
        """A variable as if the missing blocks had not been started; their data are not read."""
        array, numbers = self.group[name], {b.number for b in missing}
        values = np.full(array.shape, array.fill_value, array.dtype)
        for block in self.blocks():
            if block.number not in numbers:
                values[block.region] = array[block.region]
        return values

    def _known(self):
        with contextlib.suppress(*_UNREADABLE):
            return self._checksums[:]
        known = np.full(self._checksums.shape, _NOT_DONE)  # some chunk is unreadable: read them one by one
        for number in range(len(known)):
            with contextlib.suppress(*_UNREADABLE):
                known[number] = self._checksums[number]
        return known

    def _checksum(self, block):
        try:
            return _checksum_of(self.group[name][block.region] for name in self.names)
        except _UNREADABLE:
            return None

    def write(self, block, piece):
        """Writes the data, then their checksum."""
        for name in self.names:
            self.group[name][block.region] = piece[name]
        self._checksums[block.number] = _checksum_of(piece[name] for name in self.names)

    def damaged_coordinates(self) -> list:
        """Names of the coordinates that differ from what was written."""
        if set(self._mark) == {_DESCRIPTION}:  # a store made by version 0.2
            return []
        other = self._mark.items() ^ _file_checksums(self.path, self.coordinates).items()
        return sorted({file.partition("/")[0] for file, _ in other})

    def foreign(self):
        """The first file in the store that does not belong to it, or None."""
        array = "|".join(map(re.escape, (*self.names, *self.coordinates, "progress/checksum")))
        own = re.compile(
            rf"\{_MARK}(\.partial)?|((({array})|progress)/)?zarr\.json|({array})/c(/\d+)*(\.\w+\.partial)?"
        )
        files = (p.relative_to(self.path).as_posix() for p in sorted(self.path.rglob("*")) if not os.path.isdir(p))
        return next((name for name in files if not own.fullmatch(name)), None)

    def repair(self, spec: Spec) -> None:
        """Rewrites damaged coordinates, which follow from the spec."""
        if self.damaged_coordinates():
            for name, (_, values, _) in coordinates_of(spec, spec.grid()).items():
                self.group[name][...] = _storable(values)
            _mark(self.path, self.coordinates)


_UNREADABLE = (OSError, ValueError, RuntimeError)  # raised when reading a damaged chunk


def _checksum_of(arrays) -> int:
    return functools.reduce(lambda total, values: zlib.crc32(np.ascontiguousarray(values).data, total), arrays, 0)


def _mark(path, coordinates) -> None:
    """Writes the checksums of the description and the coordinates, which never change, atomically."""
    partial = path / f"{_MARK}.partial"
    partial.write_text(json.dumps(_file_checksums(path, coordinates)))
    partial.replace(path / _MARK)


def _checked_mark(path) -> dict:
    """The checksums. Raises: ValueError if the description is not as written, OSError if there are none."""
    found = json.loads(read_bytes("out", path / _MARK, "a store's checksums"))
    found = {_DESCRIPTION: found} if isinstance(found, int) else {file: int(v) for file, v in dict(found).items()}
    if found.get(_DESCRIPTION) != _file_checksums(path, ())[_DESCRIPTION]:
        raise ValueError("its description is damaged")
    return found


def _file_checksums(path, coordinates) -> dict:
    """{file: checksum} of the description and of the values of coordinates."""
    values = (f for name in coordinates for f in (path / name).rglob("*") if f.name != _DESCRIPTION)
    own = [path / _DESCRIPTION, *(f for f in values if os.path.isfile(f) and f.suffix != ".partial")]
    return {f.relative_to(path).as_posix(): zlib.crc32(read_bytes("out", f, "a sweep's file")) for f in own}


def _codecs():
    """How chunks are written: compressed, then with a checksum, so that no damaged chunk is unpacked."""
    from zarr.codecs import Crc32cCodec, ZstdCodec

    return [ZstdCodec(level=0), Crc32cCodec()]


def _storable(values):
    """Names as variable-length strings, the only form of text that zarr has settled."""
    return values.astype(object) if values.dtype.kind == "U" else values


def create(folder: pathlib.Path, spec: Spec, of: Grid, outputs) -> None:
    """Create the empty store. It appears only once it is complete; one that another process made meanwhile stays."""
    with hidden_folder(folder) as hidden:
        _build(hidden / DATA, spec, of, outputs)
        try:
            (hidden / DATA).rename(folder / DATA)
        except OSError:
            if not os.path.exists(folder / DATA):
                raise


def _build(path, spec, of, outputs):
    import xarray
    import zarr

    coords = {name: (d, _storable(v), about) for name, (d, v, about) in coordinates_of(spec, of).items()}
    with _quiet():
        xarray.Dataset(coords=coords, attrs=environment() | attributes(spec, of, outputs)).to_zarr(
            path, zarr_format=3, consolidated=False, encoding={name: {"compressors": _codecs()} for name in coords}
        )
        group = zarr.open_group(path, mode="r+")
        for o in outputs:
            group.create_array(
                o.name,
                shape=(*of.shape, *o.shape),
                chunks=(*of.block, *(max(n, 1) for n in o.shape)),
                dtype=o.dtype,
                fill_value=np.nan if o.dtype.kind == "f" else _NOT_DONE,
                dimension_names=(*(a.name for a in of.axes), *o.dims),
                attributes=o.about,
                compressors=_codecs(),
            )
        checksums = {"shape": len(of.blocks()), "chunks": 1, "dtype": "int64", "fill_value": _NOT_DONE}
        checksums["compressors"] = _codecs()
        group.create_group("progress").create_array("checksum", **checksums, dimension_names=("block",))
        zarr.consolidate_metadata(path)
    _mark(path, coords)


def prepare(spec: Spec, folder, *, fresh=False, overwrite=False) -> Store | None:
    """The folder's store, repaired, if it belongs to this spec.

    Raises: ArgumentError if it belongs to another spec or, even with `fresh`, if it is not a sweep's.
    """
    folder = errors.path("out", folder)
    path = folder / DATA
    with _disk(folder):
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()  # check that the folder is writable
    if not os.path.exists(path):
        return None
    store = Store(folder)
    if fresh:
        foreign = store.foreign()
        if foreign is not None:
            raise errors.fail("out", f"hold nothing but the sweep's own files in {DATA}", f"there is {foreign[:80]!r}")
        with _disk(folder), hidden_folder(folder) as hidden:
            path.rename(hidden / DATA)  # atomically: no reader sees half a store
        return None
    found = {k: store.config[k] for k in ("data", "environment")}
    where = _difference(found, fingerprint(spec))
    if where:
        words = "hold results of this very spec (--fresh starts over, another --out keeps both)"
        raise errors.fail("out", words, f"differs in {where}")
    with _disk(folder):
        remove_abandoned(path.rglob("*.partial"))  # left by an interrupted write
        store.repair(spec)
    return store


def _difference(a, b, where=""):
    """The first difference of two JSON values, in words."""
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


def run(spec: Spec, folder, *, fresh=False, overwrite=False, process=0, processes=1, meet=None, progress=None) -> bool:
    """Compute the blocks of a sweep that its store lacks, in float64 whatever JAX's own precision is.

    Args:
      folder: where `data.zarr` is or will be.
      fresh: start over. overwrite: also in a folder with files that are not a sweep's.
      process, processes: this process's number among all that run this together.
      meet: meet(well, last) returns when all processes have called it: whether all of them are well. After `last`
        they need each other no more.
      progress: called with (points done, points this process has to do).

    Returns: whether the whole sweep is now done (other processes may still be at it).
    Raises: ArgumentError for a store of another spec, a folder that can't be written, a full disk, or another
      process that could not start; completed blocks are kept, and the same call continues from there.
    """
    folder, meet = errors.path("out", folder), meet or (lambda well, last: well)
    of, first, store = spec.grid(), None, None
    with _together(meet):
        if process == 0:
            store = prepare(spec, folder, fresh=fresh, overwrite=overwrite)
            if store is None:
                of, first = program.fit(spec.study, of)
                with _disk(folder):
                    create(folder, spec, of, first.outputs)
                store = prepare(spec, folder, overwrite=overwrite)  # ours, or that of a quicker process
                assert store is not None
                first = first if store.lanes == of.lanes else None
    with _together(meet, last=True):
        store = store or prepare(spec, folder)
        if store is None:
            raise errors.fail("out", "be one folder that all processes share", f"{str(folder)!r} is empty here")
        of = dataclasses.replace(of, lanes=store.lanes)
        missing = store.missing()
    share = _share(spec, of, missing, process, processes)
    todo, done = sum(b.size for b in share), 0
    if progress is not None:
        progress(0, todo)
    for count, (block, piece) in enumerate(program.run_blocks(spec.study, of, share, first)):
        when = f" after {count} of {len(missing)} blocks; they are kept, and the same command goes on from there"
        with _disk(folder, when):
            store.write(block, piece)
        done += block.size
        if progress is not None:
            progress(done, todo)
    return processes == 1 or not store.missing()


@contextlib.contextmanager
def _together(meet, last=False):
    """Waits for all processes; if one fails, all of them stop."""
    try:
        yield
    except BaseException:
        meet(False, last)
        raise
    if not meet(True, last):
        raise errors.fail("distributed", "find every process ready", "another one failed, and reports why")


def _share(spec, of, missing, process, processes):
    """This process's adjacent blocks: few programs to compile, and its share of the evaluations."""
    if processes == 1:
        return missing
    costs = [spec.evaluations(p) for p in of.programs]
    ends = np.cumsum([costs[b.program] for b in missing])
    if not len(ends):
        return []
    owner = np.minimum((ends - ends[0] / 2) / ends[-1] * processes, processes - 1).astype(int)
    return [b for b, who in zip(missing, owner, strict=True) if who == process]


def read(folder):
    """The sweep of a folder as an `xarray.Dataset`, loaded on use.

    Every block is first compared with its checksum, which reads all of it once; a damaged one counts as not done
    (`blocks_missing`): NaN, and -1 for counts, never other numbers.

    Raises: ArgumentError if there is none, or if its coordinates are damaged.
    """
    return read_and_missing(folder)[0]


def read_and_missing(folder):
    """The result of `read`, and the number of blocks that are not done or damaged."""
    folder = errors.path("folder", folder)
    if not os.path.exists(folder / DATA):  # a name of any length will do
        raise errors.fail("folder", f"hold a sweep's {DATA}", f"{str(folder)!r} does not")
    store = Store(folder, name="folder", mode="r")
    damaged = store.damaged_coordinates()
    if damaged:
        words = "hold whole coordinates (the command that made the sweep repairs them)"
        raise errors.fail("folder", words, f"{str(folder)!r} has damaged {', '.join(damaged)}")
    data = store.opened()
    missing = store.missing()
    if missing:
        data = data.assign({n: v.copy(data=store.without(n, missing)) for n, v in data.items()})
    return data, len(missing)


def blocks_missing(folder) -> int:
    """Number of blocks of a folder's sweep that are not done or damaged."""
    return len(Store(errors.path("folder", folder), name="folder", mode="r").missing())


@contextlib.contextmanager
def _disk(folder, when=""):
    """Reports file system errors in one line."""
    try:
        yield
    except OSError as error:
        why = f"{errors.reason(error)}{when}"
        message = f"Argument `out` must be a folder that can be written, but {str(folder)!r} is not: {why}."
        raise errors.ArgumentError(message) from error


@contextlib.contextmanager
def _quiet():
    """Silences zarr's warning that consolidated metadata is an extension; the data open without it, too."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Consolidated metadata")
        yield
