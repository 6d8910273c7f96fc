"""Files of results: one way to write a dataset, a table, a Markdown table."""

import csv
import dataclasses
import io
import math
import os
import pathlib

import numpy as np


def save_netcdf(data, path) -> None:
    """Write an `xarray.Dataset` as compressed netCDF, made in memory: HDF5 ends the process if the disk is full."""
    numbers = [name for name, values in data.variables.items() if values.dtype.kind in "fiub" and values.ndim]
    packed = {name: {"zlib": True, "complevel": 6} for name in numbers}
    pathlib.Path(path).write_bytes(data.to_netcdf(engine="h5netcdf", encoding=packed))


def save_labelled(data, path) -> None:
    """Write a `Labelled` as `save_netcdf` does, without xarray, whose import takes a second process half a second."""
    import h5netcdf
    import h5py

    with io.BytesIO() as memory:
        with h5netcdf.File(memory, "w") as file:
            for name, (dims, values, attrs) in (data.variables | data.coords).items():
                values, dims = np.asarray(values), (dims,) if isinstance(dims, str) else dims
                file.dimensions.update(
                    {dim: n for dim, n in zip(dims, values.shape, strict=True) if dim not in file.dimensions}
                )
                text, packed = values.dtype.kind == "U", {"compression": "gzip", "compression_opts": 6}
                kind, packed = (h5py.string_dtype(), {}) if text else (values.dtype, packed if dims else {})
                variable = file.create_variable(name, dims, kind, **packed)
                variable[...] = values.astype(object) if text else values
                variable.attrs.update(attrs)
            file.attrs.update(data.attrs | {"coordinates": " ".join(sorted(data.coords))})
        pathlib.Path(path).write_bytes(memory.getvalue())


def save_csv(rows, path) -> None:
    """Write rows as CSV; the first has the names of the columns."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def markdown(header, rows, *, left=1) -> str:
    """Return a Markdown table. The first `left` columns are aligned left, the others right; a cell is one line."""
    header, *rows = ([str(cell).replace("|", "\\|") for cell in row] for row in (header, *rows))
    rule = ["---" if i < left else "---:" for i in range(len(header))]
    return "".join(f"| {' | '.join(row)} |\n" for row in (header, rule, *rows))


def plain(value):
    """Return a value for JSON. A record is a table of its fields; NaN and inf are null."""
    if dataclasses.is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):
        return plain(np.asarray(value).tolist())
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
