"""Files of results: one way to write a dataset, a Markdown table, JSON."""

import dataclasses
import math
import pathlib

import numpy as np


def save_netcdf(data, path) -> None:
    """Write an `xarray.Dataset` as compressed netCDF, made in memory: HDF5 ends the process if the disk is full."""
    packed = [name for name, v in data.variables.items() if v.ndim and v.dtype.kind not in "UO"]
    encoding = {name: {"compression": "gzip", "compression_opts": 6} for name in packed}
    pathlib.Path(path).write_bytes(data.to_netcdf(engine="h5netcdf", encoding=encoding))


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
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
