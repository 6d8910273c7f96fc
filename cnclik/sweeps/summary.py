"""Summary: the scalar metrics of a sweep as one small table, its best loops, and its exports to other formats."""

import functools
import itertools
import json
import pathlib

import numpy as np

from cnclik import errors
from cnclik.measure.files import save_csv, save_netcdf

FILES = ("summary.csv", "config.json")
HISTORY = ("time", "step")
_WRONG = {  # counts of steps that are 0 for a safe loop, and the word for it
    "not diverging": ("diverged", "growing"),
    "within velocity limits": ("over_velocity",),
}
_APART = ("case", "robot")  # axes along which errors are not compared
_CHOSEN = ("alpha", "weights")  # axes of vectors that are a choice, as numbers are; others are starts and targets


def scalars(data) -> list:
    """Variables with one number for each loop."""
    return [name for name in data.data_vars if not set(data[name].dims) & set(HISTORY)]


def main_value(data):
    """The metric that ranks the loops of a sweep: its first error, otherwise its first number."""
    names = scalars(data)
    return next((n for n in names if n.endswith("error")), names[0] if names else None)


def judged(data):
    """(error of each loop, whether it is safe, the meaning of safe here) for the first error; None without one.

    A loop is safe if its error is finite, and it is stable and keeps the velocity limits as far as the metrics and the
    linear limit show. NaN counts as infinite.
    """
    name = main_value(data)
    if name is None or not name.endswith("error"):
        return None
    value = data[name].fillna(np.inf)
    safe, words = np.isfinite(value), ["finite"]
    for what, names in _WRONG.items():
        for wrong in (n for n in names if n in data):
            safe &= data[wrong] == 0
            words.append(what)
    if "stable" in data:
        safe &= data.stable == 1
        words.append("ending stable")
    z = _z(data)
    if z is not None and "limit" in data.coords and data.limit.notnull().any():
        safe &= ~(z >= data.limit)
        words.append("below the linear stability limit")
    return value, safe, ", ".join(dict.fromkeys(words))


def _z(data):
    """alpha·Ts of the loops, of axes and fixed numbers; None where one of them is neither."""
    if "z" in data.dims:
        return data["z"]
    fixed = json.loads(data.attrs.get("spec", "{}")).get("fixed", {})
    alpha, Ts = (data[name] if name in data.dims else fixed.get(name) for name in ("alpha", "Ts"))
    return None if any(v is None or isinstance(v, str | list) for v in (alpha, Ts)) else alpha * Ts


def best(data) -> list:
    """Sentences that name the safe loop with the least error for each case and robot; empty without an error.

    Starts, targets and seeds count by their worst value.
    """
    if (found := judged(data)) is None:
        return []
    value, safe, words = found
    drawn = [d for d in value.dims if d == "seed" or (f"{d}_value" in data.coords and not d.endswith(_CHOSEN))]
    value, safe = value.max(drawn, keep_attrs=True), safe.all(drawn)
    apart, said = [d for d in _APART if d in value.dims], []
    for labels in itertools.product(*(data[d].values.tolist() for d in apart)):
        where = dict(zip(apart, labels, strict=True))
        own, fine = value.sel(where), safe.sel(where)
        of = f"{', '.join(f'{d} {label}' for d, label in where.items())}: " * bool(where)
        count = f"{of}{_how_many(int(fine.sum()), own.size)} safe ({words})"
        if not fine.any():
            said.append(f"{count}.")
            continue
        place = np.unravel_index(np.argmin(np.where(fine, own, np.inf)), own.shape)
        at = {d: data.get(f"{d}_value", data[d]).values[i] for d, i in zip(own.dims, place, strict=True)}
        axes = [f"{d} {text(v)} {data[d].attrs.get('units', '')}".removesuffix(" 1").strip() for d, v in at.items()]
        axes += [f"z = {text(at['alpha'] * at['Ts'])}"] if {"alpha", "Ts"} <= set(at) else []
        least = f"{own.values[place]:.3g} {value.attrs.get('units', '')}".strip()
        same = int(((own == own.values[place]) & fine).sum())
        least += f", as {same - 1:,} others" * (same > 2)
        name = f"{value.name} {least}" if own.size == 1 else f"the best by {value.name} ({least})"
        said.append(f"{count}, {name}{': ' * bool(axes)}{', '.join(axes)}.")
    return [line[0].upper() + line[1:] for line in said]


def _how_many(safe, every) -> str:
    """Such as "3 of 4 loops are", and "the loop is not" where there is one."""
    if every == 1:
        return f"the loop is{' not' * (not safe)}"
    return f"{f'{safe:,}' if safe else 'none'} of {every:,} loops {'are' if safe > 1 else 'is'}"


def text(value) -> str:
    """A coordinate's value, four digits."""
    if isinstance(value, np.ndarray):
        return f"[{', '.join(f'{v:.4g}' for v in value.ravel())}]"
    return f"{value:.4g}" if isinstance(value, float | np.floating) else str(value)


def table(data):
    """Statistics of every scalar metric over the numeric axes, for each combination of the others.

    Returns: list of dicts with the names of the other axes, `metric`, `units`, min, q10, median, q90, max,
      mean (over finite values) and finite (their share).
    """
    inner = [d for d in data.dims if d in data.coords and (data[d].dtype.kind == "f" or f"{d}_value" in data.coords)]
    rows = []
    for name in scalars(data):
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
    ranked = values[~np.isnan(values)]  # infinite values count as large, NaN is left out
    quantiles = np.quantile(ranked, [0, 0.1, 0.5, 0.9, 1], method="lower") if ranked.size else np.full(5, np.nan)
    found = dict(zip(("min", "q10", "median", "q90", "max"), quantiles.tolist(), strict=True))
    return found | {"mean": float(known.mean()) if known.size else np.nan, "finite": float(finite.mean())}


def texts(data, digits=6) -> list:
    """The table as rows of texts, header first."""
    rows = table(data)
    names = list(dict.fromkeys(name for row in rows for name in row))
    found = ([row.get(name, "") for name in names] for row in rows)
    return [names, *([f"{v:.{digits}g}" if isinstance(v, float) else v for v in row] for row in found)]


def write(data, folder) -> None:
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
