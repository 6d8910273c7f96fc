"""Summary: the scalar metrics of a sweep as one small table, and its best loops."""

import functools
import itertools
import json
import operator
import warnings

import numpy as np

FILES = ("summary.csv", "config.json")
_WRONG = ("diverged", "growing", "over_velocity")  # counts of steps that are 0 for a safe loop
_APART = ("case", "robot")  # axes along which errors are not compared
CHOSEN = ("alpha", "weights", "error_clamp")  # axes of vectors that are a choice; others are starts and targets
STATISTICS = {"min": 0.0, "q10": 0.1, "median": 0.5, "q90": 0.9, "max": 1.0}  # quantiles


def scalars(data) -> list:
    """Return the variables with one number for each loop."""
    return [name for name in data.data_vars if set(data[name].dims) <= set(data.coords)]


def main_value(data):
    """Return the metric that ranks the loops of a sweep: its first error, otherwise its first number."""
    names = scalars(data)
    return next((n for n in names if n.endswith("error")), names[0] if names else None)


def best(data) -> list:
    """Return sentences that name the safe loops with the least error for each case and robot; none without an error.

    A loop is safe if its error is finite, and it is stable and keeps the velocity limits as far as the metrics and the
    linear limit show. Starts, targets and seeds count by their worst value. Loops that tie are all named.
    """
    if (name := main_value(data)) is None or not name.endswith("error"):
        return []
    value = data[name].fillna(np.inf)
    checks = [np.isfinite(value), *(data[wrong] == 0 for wrong in _WRONG if wrong in data)]
    checks += [data.stable != 0] if "stable" in data else []  # NaN: of a moving target
    share = share_of_limit(data)
    checks += [~(share >= 1)] if share is not None else []
    drawn = [d for d in value.dims if d == "seed" or (f"{d}_value" in data.coords and d not in CHOSEN)]
    safe = functools.reduce(operator.and_, checks).all(drawn)
    value = value.max(drawn, keep_attrs=True).where(safe)
    apart, lines = [d for d in _APART if d in value.dims], []
    for labels in itertools.product(*(data[d].values.tolist() for d in apart)):
        where = dict(zip(apart, labels, strict=True))
        errors, count = value.sel(where), int(safe.sel(where).sum())
        line = "".join(f"{d} {label}: " for d, label in where.items()) + (f"{count:,}" if count else "none")
        line += f" of {errors.size:,} loops {'are' if count > 1 else 'is'} safe"
        line += f", the best by {_named(data, errors)}" if count else ""
        lines.append(f"{line[0].upper()}{line[1:]}.")
    return lines + ["No loop was compared with the linear limit."] * (share is None)


def share_of_limit(data):
    """Return z = alpha·Ts over the largest stable one; None where one of both is not known."""
    z, limit = (data.coords.get(name) for name in ("alpha_Ts", "limit"))
    return None if z is None or limit is None else z / limit


def _named(data, errors) -> str:
    """Return which loops have the least error, in words."""
    least, axes = float(errors.min()), []
    places = np.argwhere((errors == least).values)
    for dim, numbers in zip(errors.dims, places.T, strict=True):
        words = [text(v) for v in data.get(f"{dim}_value", data[dim]).values[np.unique(numbers)]]
        words = f"{words[0]} to {words[-1]}" if len(words) > 4 else " or ".join(words)
        axes.append(f"{dim} {words} {unit_of(data[dim])}".strip())
    size = f"{least:.3g} {errors.attrs.get('units', '')}".strip()
    ties = f"; {len(places):,} loops tie" * (len(places) > 1)
    return f"{errors.name} ({size}{ties}){': ' * bool(axes)}{', '.join(axes)}"


def unit_of(variable) -> str:
    """Return a variable's unit; "" of a number without one."""
    return "" if (unit := variable.attrs.get("units", "")) == "1" else unit


def text(value) -> str:
    """Return a coordinate's value, four digits."""
    if isinstance(value, np.ndarray):
        return f"[{', '.join(f'{v:.4g}' for v in value.ravel())}]"
    return f"{value:.4g}" if isinstance(value, float | np.floating) else str(value)


def table(data) -> list:
    """Return statistics of every scalar metric over the numeric axes, for each combination of the others.

    Each row is a dict with the labels of the other axes, `metric`, `units`, min, q10, median, q90, max, mean (over
    finite values) and finite (their share). NaN is left out, and infinite values count as large.
    """
    inner = {d for d in data.dims if d in data.coords and (data[d].dtype.kind == "f" or f"{d}_value" in data.coords)}
    rows = []
    for name in scalars(data):
        values = data[name].astype(float).expand_dims("metric")  # there are statistics of a single loop, too
        over = ["metric", *(d for d in data[name].dims if d in inner)]
        finite = np.isfinite(values)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of what no loop has, such as `stable` on a path
            statistics = values.quantile([*STATISTICS.values()], over, method="lower").to_dataset("quantile")
        statistics = statistics.rename(dict(zip(STATISTICS.values(), STATISTICS, strict=True)))
        statistics["mean"], statistics["finite"] = values.where(finite).mean(over), finite.mean(over)
        units = ("metric", [data[name].attrs.get("units", "")])
        frame = statistics.expand_dims(metric=[name]).assign_coords(units=units).to_dataframe().reset_index()
        outer = [d for d in data[name].dims if d not in inner]
        rows += frame[[*outer, "metric", "units", *STATISTICS, "mean", "finite"]].to_dict("records")
    return rows


def write(data, folder) -> None:
    """Write the table and the configuration."""
    import pandas

    config = {k: v for k, v in data.attrs.items() if k not in ("question", "expectation")}
    config |= {name: json.loads(data.attrs[name]) for name in ("spec", "config")}
    csv = functools.partial(pandas.DataFrame(table(data)).to_csv, index=False, float_format="%.6g", na_rep="nan")
    folder.write(FILES[0], csv)
    folder.write_text(FILES[1], json.dumps(config, indent=1, ensure_ascii=False) + "\n")
