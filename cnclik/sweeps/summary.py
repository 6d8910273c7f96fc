"""Summary: the scalar metrics of a sweep as one small table, and its best loops."""

import functools
import itertools
import json

import numpy as np

from cnclik.measure.files import save_csv

FILES = ("summary.csv", "config.json")
_WRONG = {  # counts of steps that are 0 for a safe loop, and the words for it
    "diverged": "not diverging",
    "growing": "not diverging",
    "over_velocity": "within velocity limits",
}
_APART = ("case", "robot")  # axes along which errors are not compared
_CHOSEN = ("alpha", "weights")  # axes of vectors that are a choice, as numbers are; others are starts and targets
STATISTICS = {"min": 0.0, "q10": 0.1, "median": 0.5, "q90": 0.9, "max": 1.0}  # quantiles


def scalars(data) -> list:
    """Return the variables with one number for each loop."""
    return [name for name in data.data_vars if set(data[name].dims) <= set(data.coords)]


def main_value(data):
    """Return the metric that ranks the loops of a sweep: its first error, otherwise its first number."""
    names = scalars(data)
    return next((n for n in names if n.endswith("error")), names[0] if names else None)


def judged(data):
    """Return (error of each loop, whether it is safe, what safe means here) for the first error; None without one.

    A loop is safe if its error is finite, and it is stable and keeps the velocity limits as far as the metrics and the
    linear limit show. NaN counts as infinite.
    """
    name = main_value(data)
    if name is None or not name.endswith("error"):
        return None
    value = data[name].fillna(np.inf)
    safe, words = np.isfinite(value), ["finite"]
    for wrong in [n for n in _WRONG if n in data]:
        safe &= data[wrong] == 0
        words.append(_WRONG[wrong])
    if "stable" in data:
        safe &= data.stable == 1
        words.append("ending stable")
    fixed = json.loads(data.attrs.get("spec", "{}")).get("fixed", {})
    alpha, Ts = (data[n] if n in data.dims and data[n].dtype.kind == "f" else fixed.get(n) for n in ("alpha", "Ts"))
    known = not any(v is None or isinstance(v, str | list) for v in (alpha, Ts))
    z = data["z"] if "z" in data.dims else alpha * Ts if known else None
    if z is not None and "limit" in data.coords:
        safe &= ~(z >= data.limit)
        words.append("below the linear stability limit")
    return value, safe, ", ".join(dict.fromkeys(words))


def best(data) -> list:
    """Return sentences that name the safe loops with the least error for each case and robot; none without an error.

    Starts, targets and seeds count by their worst value. Loops that tie are all named.
    """
    if (found := judged(data)) is None:
        return []
    value, safe, words = found
    drawn = [d for d in value.dims if d == "seed" or (f"{d}_value" in data.coords and d not in _CHOSEN)]
    value, safe = value.max(drawn, keep_attrs=True), safe.all(drawn)
    apart, said = [d for d in _APART if d in value.dims], []
    for labels in itertools.product(*(data[d].values.tolist() for d in apart)):
        where = dict(zip(apart, labels, strict=True))
        errors, fine = value.sel(where), safe.sel(where)
        count = "".join(f"{d} {label}: " for d, label in where.items()) + _how_many(int(fine.sum()), errors.size)
        line = f"{count} safe ({words})"
        if fine.any():
            least = float(errors.where(fine).min())
            line += f", {_named(data, errors, np.argwhere(((errors == least) & fine).values), least)}"
        said.append(f"{line[0].upper()}{line[1:]}.")
    return said


def _named(data, errors, places, least) -> str:
    """Return which loops have the least error, in words."""
    size = f"{least:.3g} {errors.attrs.get('units', '')}".strip()
    axes, one = [], {}
    for dim, numbers in zip(errors.dims, places.T, strict=True):
        values = data.get(f"{dim}_value", data[dim]).values[np.unique(numbers)]
        one[dim] = values[0]
        words = [text(v) for v in values]
        words = f"{words[0]} to {words[-1]}" if len(words) > 4 else " or ".join(words)
        axes.append(f"{dim} {words} {data[dim].attrs.get('units', '')}".removesuffix(" 1").strip())
    if {"alpha", "Ts"} <= set(one) and len(places) == 1:
        axes.append(f"z = {text(one['alpha'] * one['Ts'])}")
    ties = f"; {len(places):,} loops tie" * (len(places) > 1)
    what = f"{errors.name} {size}" if errors.size == 1 else f"the best by {errors.name} ({size}{ties})"
    return f"{what}{': ' * bool(axes)}{', '.join(axes)}"


def _how_many(safe, every) -> str:
    """Return such as "3 of 4 loops are", and "the loop is not" where there is one."""
    if every == 1:
        return f"the loop is{' not' * (not safe)}"
    return f"{f'{safe:,}' if safe else 'none'} of {every:,} loops {'are' if safe > 1 else 'is'}"


def text(value) -> str:
    """Return a coordinate's value, four digits."""
    if isinstance(value, np.ndarray):
        return f"[{', '.join(f'{v:.4g}' for v in value.ravel())}]"
    return f"{value:.4g}" if isinstance(value, float | np.floating) else str(value)


def table(data) -> list:
    """Return statistics of every scalar metric over the numeric axes, for each combination of the others.

    Each row is a dict with the labels of the other axes, `metric`, `units`, min, q10, median, q90, max, mean (over
    finite values) and finite (their share).
    """
    inner = {d for d in data.dims if d in data.coords and (data[d].dtype.kind == "f" or f"{d}_value" in data.coords)}
    rows = []
    for name in scalars(data):
        values = data[name]
        outer = [d for d in values.dims if d not in inner]
        moved = values.transpose(*outer, ...).values.astype(float)
        for place in np.ndindex(moved.shape[: len(outer)]):
            labels = {d: data[d].values[i] if d in data.coords else i for d, i in zip(outer, place, strict=True)}
            rows.append(labels | {"metric": name, "units": values.attrs.get("units", "")} | _statistics(moved[place]))
    return rows


def _statistics(values) -> dict:
    known, ranked = values[np.isfinite(values)], values[~np.isnan(values)]  # infinite ones count as large
    quantiles = np.quantile(ranked, [*STATISTICS.values()], method="lower") if ranked.size else [np.nan] * 5
    found = dict(zip(STATISTICS, map(float, quantiles), strict=True))
    return found | {"mean": float(known.mean()) if known.size else np.nan, "finite": known.size / max(values.size, 1)}


def write(data, folder) -> None:
    """Write the table and the configuration."""
    rows = table(data)
    names = list(dict.fromkeys(name for row in rows for name in row))
    texts = ([f"{v:.6g}" if isinstance(v, float) else v for v in map(row.get, names)] for row in rows)
    config = {k: v for k, v in data.attrs.items() if k not in ("question", "expectation")}
    config |= {name: json.loads(data.attrs[name]) for name in ("spec", "config")}
    numbers, settings = FILES
    folder.write(numbers, functools.partial(save_csv, [names, *texts]))
    folder.write_text(settings, json.dumps(config, indent=1, ensure_ascii=False) + "\n")
