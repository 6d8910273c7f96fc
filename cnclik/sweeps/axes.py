"""Axes: the dimensions of a sweep, of Python values or as a spec writes them: lists, linspace, geomspace, samples."""

import operator
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from cnclik import errors
from cnclik.problem.options import NAME, OPTIONS
from cnclik.sweeps import expression

NAMES = tuple(name for name, option in OPTIONS.items() if option.kind == NAME)  # their values are never expressions
COMPILED_IN = ("N", "delay", "measurement_delay")  # numbers that change a program's shape
MOST_VALUES = 10_000_000  # of a generated axis
FORMS = {  # of a table: what it must be
    "linspace": "be linspace = [first, last, count]",
    "geomspace": "be geomspace = [first, last, count], without 0",
    "samples": "have low ≤ high, each a number or one for every joint",
}


class Axis(NamedTuple):
    """One dimension of the grid."""

    name: str
    values: Any  # inner: an array whose first dimension is the axis; outer: a tuple of objects
    labels: tuple | None = None  # labels of an outer axis; None for an inner one

    def __len__(self):
        return len(self.values)

    @property
    def inner(self) -> bool:
        return self.labels is None


def axis(name: str, values, where=None) -> Axis:
    """Return an axis of Python values, as `sweep` takes them. Args: where: its name in messages."""
    where = where or name
    if isinstance(values, Mapping):
        made = Axis(name, tuple(values.values()), tuple(values))
    elif not isinstance(values, (list, tuple, range, np.ndarray, jax.Array)) or getattr(values, "ndim", 1) == 0:
        raise errors.fail(where, "be an axis: an array, a list, or a dict of labelled values", f"is {values!r}")
    elif (numbers := _numbers(name, where, values)) is not None:
        made = Axis(name, numbers)
    else:
        labels = tuple(v if isinstance(v, (str, bool)) else getattr(v, "name", None) for v in values)
        if None in labels:
            must = "hold numbers, names or named objects, or be a dict {label: value}"
            raise errors.fail(where, must, f"is {values!r}")
        made = Axis(name, tuple(values), labels)
    if not len(made):
        raise errors.fail(where, "hold at least one value", "is empty")
    if made.inner and not np.all(np.isfinite(made.values)):
        raise errors.fail(where, "hold finite values", "does not")
    return compiled_in(made, where) if name in COMPILED_IN else made


def _numbers(name, where, values):
    """Return the numbers or vectors of an axis as one array; None if they are something else."""
    try:
        array = np.asarray(values)
    except ValueError:
        raise errors.fail(where, "hold values of one shape", f"is {values!r}") from None
    if array.dtype.kind not in "fiu" or any(isinstance(v, bool) for v in values):
        return None
    if name == "M" and np.all(array % 1 == 0):
        return array.astype(int)
    return array.astype(float) if isinstance(values, (list, tuple)) or array.dtype.kind == "f" else array


def compiled_in(of: Axis, where: str) -> Axis:
    """Return an axis of numbers as an outer one; whole numbers are integers."""
    if not of.inner:
        return of
    if of.values.ndim != 1:
        raise errors.fail(where, "hold single numbers, as each is compiled in", "holds vectors")
    numbers = tuple(int(v) if float(v).is_integer() and of.name in COMPILED_IN else v.item() for v in of.values)
    return Axis(of.name, numbers, numbers)


def read(name: str, value, joints: int) -> Axis:
    """Return an axis from its entry in a spec. Args: joints: the number of values of each sample."""
    where = f"axes.{name}"
    if isinstance(value, list):
        values = [_number(name, v) for v in value]
        if any(isinstance(v, bool) or (name in NAMES and not isinstance(v, str)) for v in values):
            raise errors.fail(where, "hold names" if name in NAMES else "hold numbers", f"is {value!r}")
        if any(isinstance(v, str) for v in values):  # names, or expressions: one program each
            return axis(name, list(map(str, values)), where)
    else:
        with np.errstate(all="ignore"):  # huge ends give values that are not finite, which `axis` reports
            values = _generated(where, value, joints)
    made = axis(name, values, where)
    numbers = np.asarray(made.values)
    if name == "M" and (numbers.ndim > 1 or numbers.dtype.kind == "f"):
        raise errors.fail(where, "hold one whole number each", f"is {value!r}")
    return made


def _number(name, value):
    """Return the number or list that a value such as "4 ms" or "pi/2" stands for; what needs names as it is."""
    where = f"axes.{name}"
    if not isinstance(value, str) or name in NAMES or expression.names(where, value):
        return value
    return np.asarray(expression.evaluate(where, value)).tolist()


def _generated(where, value, joints):
    """Return the numbers of a table such as { geomspace = [1, 40, 20] }."""
    kind = next((kind for kind in FORMS if isinstance(value, dict) and kind in value), "")
    if not kind:
        must = f"be a list, labelled tables, or a table with one of {', '.join(FORMS)}"
        raise errors.fail(where, must, f"is {value!r}")
    known_keys(where, value, (kind, *("low", "high", "seed") * (kind == "samples")))
    try:
        drawn = value.get("low", 0.0), value.get("high", 1.0), value[kind]
        low, high, count = drawn if kind == "samples" else value[kind]
        if (count := operator.index(count)) > MOST_VALUES:
            raise errors.fail(where, f"hold at most {MOST_VALUES:,} values", f"asks for {count:,}")
        low, high = (expression.evaluate(where, [end])[0] for end in (low, high))
        if kind != "samples":
            return getattr(np, kind)(low, high, count)
        low, high = np.broadcast_to(low, joints), np.broadcast_to(high, joints)
        return np.random.default_rng(value.get("seed", 0)).uniform(low, high, (count, joints))
    except errors.ArgumentError:
        raise
    except (TypeError, ValueError, OverflowError):
        raise errors.fail(where, FORMS[kind], f"is {value!r}") from None


def known_keys(where: str, table, names) -> None:
    """Raise ArgumentError for a key of a table that is unknown, with the nearest known name."""
    for key in table:
        errors.one_of(f"key of {where}", key, names)
