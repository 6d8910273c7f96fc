"""Files of results: one way to write a dataset, one way to write a Markdown table, one way to write a number."""

import numpy as np


def save_netcdf(data, path) -> None:
    """An `xarray.Dataset` as compressed netCDF."""
    packed = {
        v: {"zlib": True, "complevel": 6} for v in data.variables if data[v].dtype.kind in "fiub" and data[v].ndim
    }
    data.to_netcdf(path, engine="h5netcdf", encoding=packed)


def markdown(header, rows, *, left=1) -> str:
    """A Markdown table; the first `left` columns are set left, the others right."""
    header = [str(cell) for cell in header]
    rule = ["---" if i < left else "---:" for i in range(len(header))]
    lines = [header, rule, *([str(cell).replace("|", "\\|") for cell in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def in_words(value) -> str:
    """A number, vector or matrix as text, five digits, on one line."""
    return np.array2string(np.asarray(value), precision=5, separator=", ", max_line_width=10**6).replace("\n", "")
