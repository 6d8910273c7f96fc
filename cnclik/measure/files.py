"""Files of results: one way to write a dataset, one way to write a Markdown table."""


def save_netcdf(data, path) -> None:
    """An `xarray.Dataset` as compressed netCDF."""
    numbers = [name for name, values in data.variables.items() if values.dtype.kind in "fiub" and values.ndim]
    packed = {name: {"zlib": True, "complevel": 6} for name in numbers}
    data.to_netcdf(path, engine="h5netcdf", encoding=packed)


def markdown(header, rows, *, left=1) -> str:
    """A Markdown table; the first `left` columns are set left, the others right. Cells may hold any one-line text."""
    header, *rows = ([str(cell).replace("|", "\\|") for cell in row] for row in (header, *rows))
    rule = ["---" if i < left else "---:" for i in range(len(header))]
    return "".join(f"| {' | '.join(row)} |\n" for row in (header, rule, *rows))
