"""Axes as a spec writes them: lists, linspace, geomspace, range, samples."""

import difflib

import numpy as np

from cnclik import errors
from cnclik.problem.options import NAME, OPTIONS, check_values
from cnclik.sweeps import expression
from cnclik.sweeps.grid import Axis, axis

NAMES = tuple(name for name, option in OPTIONS.items() if option.kind == NAME)  # never expressions
KINDS = {"linspace": (), "geomspace": (), "range": (), "samples": ("low", "high", "seed", "per")}


def read(name, value, joints=0) -> Axis:
    """An axis from what a spec says of it.

    Args:
      joints: of the widest robot: how many numbers a sample per joint has.
    """
    found = _read(name, value, joints)
    if found.inner:
        if not np.all(np.isfinite(found.values)):
            raise errors.fail(f"axes.{name}", "hold finite values", "does not")
        check_values(f"axes.{name}", name, found.values)
    return found


def per_joint(name, value) -> bool:
    """Whether a spec's axis has one number for each joint of the robot, whichever it is."""
    return isinstance(value, dict) and "samples" in value and (name == "q0" or value.get("per") == "joint")


def _read(name, value, joints):
    where = f"axes.{name}"
    if isinstance(value, list):
        return _listed(where, name, value)
    if not isinstance(value, dict) or len(kinds := [k for k in KINDS if k in value]) != 1:
        raise errors.fail(where, f"be a list or a table with one of {', '.join(KINDS)}", f"is {value!r}")
    kind = kinds[0]
    known_keys(where, value, (kind, *KINDS[kind]))
    if kind == "samples":
        return Axis(name, _samples(where, value, joints if per_joint(name, value) else 0), None)
    numbers = value[kind]
    if kind == "range":
        if not isinstance(numbers, list) or len(numbers) != 2 or any(type(v) is not int for v in numbers):
            raise errors.fail(where, "be range = [first, last] of two integers", f"is {numbers!r}")
        return _listed(where, name, list(range(numbers[0], numbers[1] + 1)))
    if not isinstance(numbers, list) or len(numbers) != 3 or type(numbers[2]) is not int or numbers[2] < 1:
        raise errors.fail(where, f"be {kind} = [first, last, count]", f"is {numbers!r}")
    first, last = (_numbers(where, v) for v in numbers[:2])
    if first.shape != last.shape:
        raise errors.fail(where, "have ends of one shape", f"is {numbers!r}")
    if kind == "geomspace" and not (np.all(first * last > 0)):
        raise errors.fail(where, "have ends of one sign, not 0, for geomspace", f"is {numbers!r}")
    return Axis(name, getattr(np, kind)(first, last, numbers[2]), None)


def _listed(where, name, values):
    if name in NAMES:
        if not values or not all(isinstance(v, str) for v in values):
            raise errors.fail(where, "be a list of names", f"is {values!r}")
        return axis(name, {v: v for v in values})
    try:
        found = axis(where, values)
    except (TypeError, ValueError) as error:
        if isinstance(error, errors.ArgumentError):
            raise
        raise errors.fail(where, "be a list of numbers, vectors or names", f"is {values!r}") from None
    return Axis(name, found.values, found.labels)


def _numbers(where, value):
    """A number or vector, expressions of pi included."""
    for name in expression.names(where, value):
        raise errors.fail(where, "be numbers", f"refers to {name!r}")
    return np.asarray(expression.evaluate(where, value, None), float)


def _samples(where, value, width):
    count = errors.integer(f"{where}.samples", value["samples"], at_least=1)
    seed = errors.integer(f"{where}.seed", value.get("seed", 0), at_least=0)
    if value.get("per", "joint") != "joint":
        raise errors.fail(f"{where}.per", "be 'joint'", f"is {value['per']!r}")
    low, high = (_numbers(f"{where}.{k}", value.get(k, default)) for k, default in (("low", 0.0), ("high", 1.0)))
    if low.ndim > 1 or high.ndim > 1 or not np.all(low <= high):
        raise errors.fail(where, "have low ≤ high", f"is {value!r}")
    shape = np.broadcast_shapes(low.shape, high.shape, (width,) if width else ())
    return low + (high - low) * np.random.default_rng(seed).random((count, *shape))


def known_keys(where, table, names):
    """Raise ArgumentError for a key that is none of the names, with the nearest one."""
    for key in table:
        if key not in names:
            raise unknown_key(where, key, names)


def unknown_key(where, key, names):
    near = difflib.get_close_matches(key, list(names), n=1, cutoff=0.4)
    hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(names)}"
    return errors.ArgumentError(f"Argument `{where}` must hold known keys, but holds {key!r} ({hint}).")
