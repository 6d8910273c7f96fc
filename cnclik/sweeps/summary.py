"""Summary: the scalar metrics of a sweep as one small table, and its exports to other formats."""

import functools
import json
import pathlib

import numpy as np

from cnclik import errors
from cnclik.measure.files import save_csv, save_netcdf

FILES = ("summary.csv", "config.json")


def table(data):
    """Statistics of every scalar metric over the numeric axes, for each combination of the others.

    Returns: list of dicts with the names of the other axes, `metric`, `units`, min, q10, median, q90, max,
    mean (over finite values) and finite (the share of values that are).
    """
    inner = [d for d in data.dims if d in data.coords and (data[d].dtype.kind == "f" or f"{d}_value" in data.coords)]
    names = [n for n in data.data_vars if not set(data[n].dims) & {"time", "step"}]
    rows = []
    for name in names:
        values = data[name]
        outer = [d for d in values.dims if d not in inner]
        moved = values.transpose(*outer, ...).values.reshape(*(values.sizes[d] for d in outer), -1)
        for place in np.ndindex(moved.shape[:-1]):
            labels = {d: data[d].values[i] if d in data.coords else i for d, i in zip(outer, place, strict=True)}
            rows.append(labels | {"metric": name, "units": values.attrs.get("units", "")} | _statistics(moved[place]))
    return rows


def _statistics(values):
    values = np.asarray(values, float)
    finite = np.isfinite(values)
    known = values[finite]
    ranked = values[~np.isnan(values)]  # infinite ones count as large, undefined ones not at all
    quantiles = np.quantile(ranked, [0, 0.1, 0.5, 0.9, 1], method="lower") if ranked.size else np.full(5, np.nan)
    found = dict(zip(("min", "q10", "median", "q90", "max"), quantiles.tolist(), strict=True))
    return found | {"mean": float(known.mean()) if known.size else np.nan, "finite": float(finite.mean())}


def texts(data, digits=6) -> list:
    """The table as rows of texts, its header first."""
    rows = table(data)
    names = list(dict.fromkeys(name for row in rows for name in row))
    found = ([row.get(name, "") for name in names] for row in rows)
    return [names, *([f"{v:.{digits}g}" if isinstance(v, float) else v for v in row] for row in found)]


def write(data, folder) -> None:
    """Write summary.csv and config.json into an output folder."""
    config = {k: v for k, v in data.attrs.items() if k not in ("question", "expectation")}
    config |= {name: json.loads(data.attrs[name]) for name in ("spec", "config")}
    numbers, settings = FILES
    folder.write(numbers, functools.partial(save_csv, texts(data)))
    folder.write_text(settings, json.dumps(config, indent=1, ensure_ascii=False) + "\n")


def export(data, folder, kind: str) -> pathlib.Path:
    """Write the whole dataset as data.nc (netCDF) or data.csv; returns the path.

    A CSV has one row per loop (per loop and instant where there are histories); vectors along an axis, such as starts,
    are columns q0[0], q0[1], ...
    """
    target = pathlib.Path(folder) / f"data.{errors.one_of('export', kind, ('nc', 'csv'))}"
    if kind == "nc":
        save_netcdf(data, target)
        return target
    for dim in [d for d in data.dims if f"{d}_value" in data.coords]:
        columns = data[f"{dim}_value"].values.reshape(data.sizes[dim], -1).T
        data = data.drop_vars(f"{dim}_value").assign({f"{dim}[{i}]": (dim, c) for i, c in enumerate(columns)})
    if not data.dims:
        data = data.expand_dims("loop")
    data.to_dataframe().to_csv(target)
    return target
