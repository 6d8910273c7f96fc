"""Axes as a spec writes them: lists, linspace, geomspace, range, samples."""

import math

import numpy as np

from cnclik import errors
from cnclik.problem.options import NAME, OPTIONS, check_values
from cnclik.sweeps import expression
from cnclik.sweeps.grid import COMPILED_IN, COUNTED, LEVEL, Axis, axis

NAMES = tuple(name for name, option in OPTIONS.items() if option.kind == NAME)  # never expressions
MOST_VALUES = 10_000_000  # values of an axis, at most
MOST_WHOLE = 2**53  # larger integers are not exact as floats
KINDS = {"linspace": (), "geomspace": (), "range": (), "samples": ("low", "high", "seed", "per")}


def read(name, value, joints=0) -> Axis:
    """An axis from its entry in a spec.

    Args:
      joints: of the widest robot, the number of values of a sample per joint.
    """
    where = f"axes.{name}"
    with np.errstate(all="ignore"):  # huge ends give values that are not finite, which `axis` reports
        values = value if isinstance(value, list) else _generated(where, value, joints if per_joint(name, value) else 0)
    if is_name(name):
        if not isinstance(values, list) or not all(isinstance(v, str) for v in values):
            raise errors.fail(where, "be a list of names", f"is {values!r}")
        values = {v: v for v in values}
    if isinstance(values, list):
        values = [_worked_out(where, v) for v in values]
    if isinstance(values, np.ndarray) and name not in COUNTED + COMPILED_IN and not name.endswith(LEVEL):
        values = values.astype(float)
    nested = values.ndim > 1 if isinstance(values, np.ndarray) else any(isinstance(v, list) for v in values)
    if name in COUNTED and nested:
        raise errors.fail(where, "hold one number each", f"is {value!r}")
    if isinstance(values, list) and any(isinstance(v, bool) for v in values):
        raise errors.fail(where, "hold numbers", f"is {value!r}")
    found = axis(name, values, where)
    if found.inner:
        check_values(where, name.rpartition(".")[2], found.values)
    return found


def is_name(name) -> bool:
    """Whether values of an option, also one of a task, are names and never expressions."""
    return name.rpartition(".")[2] in NAMES


def per_joint(name, value) -> bool:
    """Whether a spec's axis has one value per joint of whichever robot."""
    return isinstance(value, dict) and "samples" in value and (name == "q0" or value.get("per") == "joint")


def _generated(where, value, joints):
    if not isinstance(value, dict) or len(kinds := [k for k in KINDS if k in value]) != 1:
        raise errors.fail(where, f"be a list or a table with one of {', '.join(KINDS)}", f"is {value!r}")
    (kind,) = kinds
    known_keys(where, value, (kind, *KINDS[kind]))
    if kind == "samples":
        return _samples(where, value, joints)
    numbers = value[kind]
    if kind == "range":
        if not isinstance(numbers, list) or len(numbers) != 2 or any(type(v) is not int for v in numbers):
            raise errors.fail(where, "be range = [first, last] of two integers", f"is {numbers!r}")
        _few_enough(where, numbers[1] - numbers[0] + 1)
        if max(map(abs, numbers)) > MOST_WHOLE:
            raise errors.fail(where, f"have a range within ±{MOST_WHOLE:,}", f"is {numbers!r}")
        return np.arange(numbers[0], numbers[1] + 1)
    if not isinstance(numbers, list) or len(numbers) != 3 or type(numbers[2]) is not int or numbers[2] < 1:
        raise errors.fail(where, f"be {kind} = [first, last, count]", f"is {numbers!r}")
    _few_enough(where, numbers[2])
    first, last = (_numbers(where, v) for v in numbers[:2])
    if first.shape != last.shape:
        raise errors.fail(where, "have ends of one shape", f"is {numbers!r}")
    _few_enough(where, numbers[2] * first.size)
    if kind == "geomspace" and not np.all(first * last > 0):
        raise errors.fail(where, "have ends of one sign, not 0, for geomspace", f"is {numbers!r}")
    return getattr(np, kind)(first, last, numbers[2])


def _few_enough(where, count):
    """Raise ArgumentError for more values than fit into memory, before they are computed."""
    if count > MOST_VALUES:
        raise errors.fail(where, f"hold at most {MOST_VALUES:,} values", f"asks for {count:,}")


def _numbers(where, value):
    """A number or vector, expressions of pi included."""
    for name in expression.names(where, value):
        raise errors.fail(where, "be numbers", f"refers to {name!r}")
    return expression.evaluate(where, [value], None)[0]


def _worked_out(where, value):
    """The number or list that a self-contained value such as "4 ms" or "pi/2" stands for; others unchanged."""
    apart = not isinstance(value, str) or expression.names(where, value)
    return value if apart else _numbers(where, value).tolist()


def _samples(where, value, width):
    count = errors.integer(f"{where}.samples", value["samples"], at_least=1)
    _few_enough(where, count)
    seed = errors.integer(f"{where}.seed", value.get("seed", 0), at_least=0)
    if value.get("per", "joint") != "joint":
        raise errors.fail(f"{where}.per", "be 'joint'", f"is {value['per']!r}")
    low, high = (_numbers(f"{where}.{k}", value.get(k, default)) for k, default in (("low", 0.0), ("high", 1.0)))
    try:
        shape = np.broadcast_shapes(low.shape, high.shape, (width,) if width else ())
        fits = len(shape) < 2 and np.all(low <= high)
    except ValueError:
        fits = False
    if not fits:
        raise errors.fail(where, "have low ≤ high, each a number or one for every joint", f"is {value!r}")
    _few_enough(where, count * math.prod(shape))
    return low + (high - low) * np.random.default_rng(seed).random((count, *shape))


def known_keys(where, table, names):
    """Raise ArgumentError for an unknown key, with the nearest known name."""
    for key in table:
        if key not in names:
            dotted = key.startswith(("tasks.", "walls."))  # in quotes it is one name, not a path of names
            found = f"{key!r}{' (write it without quotes)' if dotted else meant(key, names)}"
            raise errors.ArgumentError(f"Argument `{where}` must hold known keys, but holds {found}.")


def meant(found, names) -> str:
    """The text that suggests what an unknown name may mean."""
    return errors.nearest(found, names) or f" (known are {', '.join(names)})"
