"""Axes as a spec writes them: lists, linspace, geomspace, samples."""

import operator

import numpy as np

from cnclik import errors
from cnclik.problem.options import NAME, OPTIONS, check_values
from cnclik.sweeps import expression
from cnclik.sweeps.grid import COUNTED, Axis, axis

NAMES = tuple(name for name, option in OPTIONS.items() if option.kind == NAME)  # their values are never expressions
MOST_VALUES = 10_000_000  # numbers of an axis, at most
KEYS = {"linspace": (), "geomspace": (), "samples": ("low", "high", "seed")}


def read(name: str, value, joints=1) -> Axis:
    """Return an axis from its entry in a spec, a list or a table such as { linspace = [1, 40, 20] }.

    Args: joints: of the widest robot, the number of values of each sample.
    """
    where = f"axes.{name}"
    if isinstance(value, list):
        values = [_number(where, v) for v in value]
        if any(isinstance(v, bool) or (name in NAMES and not isinstance(v, str)) for v in values):
            raise errors.fail(where, "hold names" if name in NAMES else "hold numbers", f"is {value!r}")
        if any(isinstance(v, str) for v in values):  # names, or expressions: one program each
            values = list(map(str, values))
    else:
        with np.errstate(all="ignore"):  # huge ends give values that are not finite, which `axis` reports
            values = _generated(where, value, joints)
    if name in COUNTED and not isinstance(values[0], str):
        values = _counts(where, values)
    found = axis(name, values, where)
    if not isinstance(found.values[0], str):
        check_values(where, name, np.asarray(found.values))
    return found


def is_drawn(value) -> bool:
    """Return whether an axis, as written, is of samples: a value per joint of whichever robot."""
    return isinstance(value, dict) and "samples" in value


def _number(where, value):
    """Return the number or list that a value such as "4 ms" or "pi/2" stands for; what needs names as it is."""
    if not isinstance(value, str) or where.partition(".")[2] in NAMES or expression.names(where, value):
        return value
    return np.asarray(expression.evaluate(where, value, None)).tolist()


def _counts(where, values):
    """Return whole numbers as such."""
    if not all(isinstance(v, (int, float, np.number)) and v % 1 == 0 for v in values):
        raise errors.fail(where, "hold one whole number each", f"is {np.array(values, object).tolist()!r}")
    return np.array(values, int)


def _generated(where, value, joints):
    """Return the numbers of a table such as { geomspace = [1, 40, 20] }."""
    kind = next((kind for kind in KEYS if isinstance(value, dict) and kind in value), None)
    if kind is None:
        must = f"be a list, labelled tables, or a table with one of {', '.join(KEYS)}"
        raise errors.fail(where, must, f"is {value!r}")
    known_keys(where, value, (kind, *KEYS[kind]))
    if kind == "samples":
        count = errors.integer(f"{where}.samples", value["samples"], at_least=1)
        seed = errors.integer(f"{where}.seed", value.get("seed", 0), at_least=0)
        low, high = (_end(where, value.get(key, default)) for key, default in (("low", 0.0), ("high", 1.0)))
        _few_enough(where, count * joints)
        try:
            low, high = (np.broadcast_to(end, joints) for end in (low, high))
        except ValueError:
            low = np.inf
        if not np.all(low <= high):
            raise errors.fail(where, "have low ≤ high, each a number or one for every joint", f"is {value!r}")
        return low + (high - low) * np.random.default_rng(seed).random((count, joints))
    try:
        first, last, count = value[kind]
        first, last, count = _end(where, first), _end(where, last), operator.index(count)
        _few_enough(where, count * max(first.size, last.size))
        return getattr(np, kind)(first, last, count)
    except errors.ArgumentError:
        raise
    except (TypeError, ValueError) as error:
        zero = "; geomspace has no 0" * ("zero" in str(error))
        raise errors.fail(where, f"be {kind} = [first, last, count]", f"is {value[kind]!r}{zero}") from None


def _end(where, value):
    """Return a number or vector, expressions of pi included."""

    def look(name):
        raise errors.fail(where, "be numbers", f"refers to {name!r}")

    return np.asarray(expression.evaluate(where, [value], look)[0])


def _few_enough(where, count):
    """Raise ArgumentError for more numbers than fit into memory, before they are computed."""
    if count > MOST_VALUES:
        raise errors.fail(where, f"hold at most {MOST_VALUES:,} values", f"asks for {count:,}")


def known_keys(where: str, table, names) -> None:
    """Raise ArgumentError for a key of a table that is unknown, with the nearest known name."""
    for key in table:
        if key not in names:
            known = errors.nearest(key, names) or f" (known are {', '.join(names)})"
            raise errors.ArgumentError(f"Argument `{where}` must hold known keys, but holds {key!r}{known}.")
