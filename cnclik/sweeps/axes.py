"""Axes: the dimensions of a sweep, of Python values or as a spec writes them: lists, linspace, geomspace, samples.

Values may be expressions of others, such as period = "N*Ts" or alpha = "z/Ts". A text that is no expression is numbers
with a unit, as on the command line: delay = "34ms", q0 = "0 -90 90 deg".
"""

import ast
import functools
import math
import operator
import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors, quantities
from cnclik.problem.options import NAME, OPTIONS
from cnclik.record import xp_for

NAMES = tuple(name for name, option in OPTIONS.items() if option.kind == NAME)  # their values are never expressions
COMPILED_IN = ("N", "delay", "measurement_delay")  # numbers that change a program's shape
MOST_VALUES = 10_000_000  # of a generated axis
FORMS = {  # of a table
    "linspace": "[first, last, count]",
    "geomspace": "[first, last, count], without 0",
    "samples": "count, low and high each a number or one for every joint",
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


def read(name: str, value, joints: int | None) -> Axis:
    """Return an axis from its entry in a spec. Args: joints: the number of values of each sample; None: not known."""
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
    if name in ("M", "seed") and (numbers.ndim > 1 or np.any(numbers % 1)):
        raise errors.fail(where, "hold one whole number each", f"is {value!r}")
    return made


def _number(name, value):
    """Return the number or list that a value such as "4 ms" or "pi/2" stands for; what needs names as it is."""
    where = f"axes.{name}"
    if not isinstance(value, str) or name in NAMES or names(where, value):
        return value
    return np.asarray(evaluate(where, value)).tolist()


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
        low, high = (evaluate(where, [end])[0] for end in (low, high))
        if kind != "samples":
            return getattr(np, kind)(low, high, count)
        joints = joints or max(np.size(low), np.size(high))
        low, high = np.broadcast_to(low, joints), np.broadcast_to(high, joints)
        return np.random.default_rng(value.get("seed", 0)).uniform(low, high, (count, joints))
    except errors.ArgumentError:
        raise
    except (TypeError, ValueError, OverflowError):
        raise errors.fail(where, f"be {kind} = {FORMS[kind]}", f"is {value!r}") from None


def known_keys(where: str, table, names) -> None:
    """Raise ArgumentError for a key of a table that is unknown, with the nearest known name."""
    for key in table:
        errors.one_of(f"key of {where}", key, names)


# --- expressions --------------------------------------------------------------------------------------

LONGEST = 500  # characters of an expression: Python's parser takes seconds for some longer ones
FUNCTIONS = {name: name for name in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "exp", "log", "round")}
FUNCTIONS |= {"min": "minimum", "max": "maximum"}  # names of NumPy and JAX
_ALLOWED = (ast.Expression, ast.BinOp, ast.UnaryOp, ast.Call, ast.Name, ast.Load, ast.Constant)
_ALLOWED += (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow, ast.USub, ast.UAdd)


def _call(name, *arguments):
    return getattr(xp_for(arguments), name)(*arguments)


KNOWN = {name: functools.partial(_call, its) for name, its in FUNCTIONS.items()} | {"pi": math.pi}


@functools.cache
def _code(text: str):
    """Return an expression of numbers, as floats (powers of integers may take hours), names and functions, compiled;
    None for a text that is none."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python's own about texts such as 0in
            tree = ast.parse(text.strip() if len(text) <= LONGEST else "", "spec", "eval")
        for node in ast.walk(tree):
            match node:
                case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in FUNCTIONS:
                    if len(args) != 1 + (name in ("min", "max")):
                        return None
                case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                    node.value = float(value)
                case ast.Call() | ast.Constant():
                    return None
            if not isinstance(node, _ALLOWED):
                return None
        return compile(tree, "spec", "eval")
    except (SyntaxError, ValueError, OverflowError, RecursionError, MemoryError):
        return None


def _unit(where: str) -> str:
    """Return the unit of the option that a place such as "axes.q0.low" belongs to; "1" of other values."""
    return next((OPTIONS[part].unit for part in where.split(".")[::-1] if part in OPTIONS), "1")


def is_quantity(value) -> bool:
    """Return whether a value is numbers with a unit, such as "34ms" or ["1 mm", 2]: it has texts, and no expression."""
    texts = [v for v in (value if isinstance(value, list) else [value]) if isinstance(v, str)]
    return bool(texts) and not any(map(_code, texts))


def names(where: str, value) -> set:
    """Return the names that a value uses: a number, an expression, numbers with a unit, or nested lists of them."""
    if isinstance(value, (list, tuple)):
        return set().union(*(names(where, v) for v in value))
    if not isinstance(value, str):
        return set()
    if (code := _code(value)) is not None:
        return set(code.co_names) - set(KNOWN)
    timed = _unit(where) == quantities.SAMPLES and "s" in _read(where, value, 1.0).written
    return {"Ts"} if timed else set()  # a time in samples depends on the sampling time


def _read(where, text, Ts):
    try:
        return quantities.read(text, _unit(where), Ts, marked=True)
    except ValueError as error:
        allowed = f"numbers, names, + - * / ** and {', '.join(FUNCTIONS)}"
        raise errors.fail(where, f"be a number or a short expression of {allowed}", str(error)) from None


def evaluate(where: str, value, look=None):
    """Return a value with its expressions evaluated, a list as an array; `look` returns the value of a name, if it may
    use names."""
    if isinstance(value, (list, tuple)):
        parts = [evaluate(where, v, look) for v in value]
        try:
            if any(isinstance(part, bool) for part in parts):
                raise TypeError
            if all(map(errors.concrete, parts)):
                return np.array(parts, float)
            return jnp.stack([*map(jnp.asarray, parts)]).astype(float)
        except (TypeError, ValueError, OverflowError):
            raise errors.fail(where, "hold numbers or vectors of one length", f"is {value!r}") from None
    if not isinstance(value, str):
        return value
    used = dict.fromkeys(names(where, value))
    if used and look is None:
        raise errors.fail(where, "be numbers", f"refers to {next(iter(used))!r}")
    used = {name: look(name) for name in used}
    if (code := _code(value)) is None:
        numbers = _read(where, value, used.get("Ts"))
        return np.array(numbers) if len(numbers) > 1 else numbers[0]
    try:
        if texts := [name for name, v in used.items() if isinstance(v, str)]:
            raise TypeError(f"{texts[0]} is a name, not a number")
        used = {name: float(v) if isinstance(v, int) else v for name, v in used.items()}
        with np.errstate(all="ignore"):  # users of the value report what is not finite
            result = eval(code, KNOWN | {"__builtins__": {}}, used)
        if callable(result) or np.iscomplexobj(result):
            raise ValueError("the result is no real number")
        return result
    except (ArithmeticError, ValueError, TypeError, RecursionError) as error:
        raise errors.fail(where, "be an expression that can be worked out", f"{value!r} is not: {error}") from None
