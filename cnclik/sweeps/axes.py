"""Axes as a spec writes them: lists, linspace, geomspace, samples."""

import operator

import numpy as np

from cnclik import errors
from cnclik.problem.options import NAME, OPTIONS, check_values
from cnclik.sweeps import expression
from cnclik.sweeps.grid import Axis, axis

NAMES = tuple(name for name, option in OPTIONS.items() if option.kind == NAME)  # their values are never expressions
MOST_VALUES = 10_000_000  # numbers of an axis, at most
FORMS = {  # of a table: what it must be
    "linspace": "be linspace = [first, last, count]",
    "geomspace": "be geomspace = [first, last, count], without 0",
    "samples": "have low ≤ high, each a number or one for every joint",
}


def read(name: str, value, joints: int | None = None) -> Axis:
    """Return an axis from its entry in a spec, a list or a table such as { linspace = [1, 40, 20] }.

    Args: joints: of the widest robot, the number of values of each sample; None where it is not known yet.
    """
    where = f"axes.{name}"
    if isinstance(value, list):
        values = [_number(name, v) for v in value]
        if any(isinstance(v, bool) or (name in NAMES and not isinstance(v, str)) for v in values):
            raise errors.fail(where, "hold names" if name in NAMES else "hold numbers", f"is {value!r}")
        if any(isinstance(v, str) for v in values):  # names, or expressions: one program each
            values = list(map(str, values))
    else:
        with np.errstate(all="ignore"):  # huge ends give values that are not finite, which `axis` reports
            values = _generated(where, value, joints)
    if name == "M" and not isinstance(values[0], str):
        if any(np.ndim(v) or v % 1 for v in values):
            raise errors.fail(where, "hold one whole number each", f"is {value!r}")
        values = np.array(values, int)
    made = axis(name, values, where)
    if not isinstance(made.values[0], str):
        check_values(where, name, np.asarray(made.values))
    return made


def is_drawn(value) -> bool:
    """Return whether an axis, as written, is of samples: a value per joint of whichever robot."""
    return isinstance(value, dict) and "samples" in value


def _number(name, value):
    """Return the number or list that a value such as "4 ms" or "pi/2" stands for; what needs names as it is."""
    where = f"axes.{name}"
    if not isinstance(value, str) or name in NAMES or expression.names(where, value):
        return value
    return np.asarray(expression.evaluate(where, value)).tolist()


def _generated(where, value, joints):
    """Return the numbers of a table such as { geomspace = [1, 40, 20] }."""
    kind = next((kind for kind in FORMS if isinstance(value, dict) and kind in value), None)
    if kind is None:
        must = f"be a list, labelled tables, or a table with one of {', '.join(FORMS)}"
        raise errors.fail(where, must, f"is {value!r}")
    known_keys(where, value, (kind, *("low", "high", "seed") * (kind == "samples")))
    try:
        if kind == "samples":
            ends, shape = (value.get("low", 0.0), value.get("high", 1.0)), (operator.index(value[kind]), joints or 1)
        else:
            ends, shape = value[kind][:2], (operator.index(value[kind][2]),)
        low, high = (np.asarray(expression.evaluate(where, [end])[0]) for end in ends)
        if (count := np.prod(shape, dtype=float) * (kind == "samples" or max(low.size, high.size))) > MOST_VALUES:
            raise errors.fail(where, f"hold at most {MOST_VALUES:,} values", f"asks for {count:,.0f}")
        if kind != "samples":
            return getattr(np, kind)(low, high, *shape)
        if joints is None:
            return np.zeros((1, 1))
        low, high = np.broadcast_to(low, joints), np.broadcast_to(high, joints)
        if not np.all(low <= high):
            raise ValueError
        return low + (high - low) * np.random.default_rng(value.get("seed", 0)).random(shape)
    except errors.ArgumentError:
        raise
    except (TypeError, ValueError, LookupError):
        raise errors.fail(where, FORMS[kind], f"is {value!r}") from None


def known_keys(where: str, table, names) -> None:
    """Raise ArgumentError for a key of a table that is unknown, with the nearest known name."""
    for key in table:
        errors.one_of(f"key of {where}", key, names)
