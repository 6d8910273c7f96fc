"""Files of results: one way to write a dataset, a Markdown table, JSON."""

import dataclasses
import io
import math
import pathlib

import numpy as np

from cnclik.record import fields_of


def save_netcdf(data, path) -> None:
    """Write an `xarray.Dataset`, or what `labelled` returns, as compressed netCDF, without xarray.

    It is made in memory: HDF5 ends the process if the disk is full.
    """
    import h5netcdf
    import h5py

    variables, coords, about = data if isinstance(data, tuple) else (data.data_vars, data.coords, data.attrs)
    with io.BytesIO() as memory:
        with h5netcdf.File(memory, "w") as file:
            for name, variable in [*variables.items(), *coords.items()]:
                known = isinstance(variable, tuple)
                dims, values, attrs = variable if known else (variable.dims, variable.values, variable.attrs)
                values, dims = np.asarray(values), (dims,) if isinstance(dims, str) else dims
                sizes = zip(dims, values.shape, strict=True)
                file.dimensions.update({dim: n for dim, n in sizes if dim not in file.dimensions})
                text = values.dtype.kind in "UO"
                packed = {"compression": "gzip", "compression_opts": 6} if dims and not text else {}
                made = file.create_variable(name, dims, h5py.string_dtype() if text else values.dtype, **packed)
                made[...] = values.astype(object) if text else values
                made.attrs.update(attrs)
            file.attrs.update(about | {"coordinates": " ".join(sorted(coords))})
        pathlib.Path(path).write_bytes(memory.getvalue())


def markdown(header, rows, *, left=1) -> str:
    """Return a Markdown table. The first `left` columns are aligned left, the others right; a cell is one line."""
    header, *rows = ([str(cell).replace("|", "\\|") for cell in row] for row in (header, *rows))
    rule = ["---" if i < left else "---:" for i in range(len(header))]
    return "".join(f"| {' | '.join(row)} |\n" for row in (header, rule, *rows))


def plain(value):
    """Return a value for JSON. A record is a table of its fields; NaN and inf are null."""
    if dataclasses.is_dataclass(value):
        value = fields_of(value)
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):
        return plain(np.asarray(value).tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
