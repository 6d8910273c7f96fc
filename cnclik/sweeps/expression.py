"""Expressions: values of a spec that follow from others, such as period = "N*Ts" or alpha = "z/Ts".

A text that is no expression is numbers with a unit, as on the command line: delay = "34ms", q0 = "0 -90 90 deg".
"""

import ast
import functools
import math
import warnings

import jax.numpy as jnp
import numpy as np

from cnclik import errors, quantities
from cnclik.problem.options import OPTIONS

LONGEST = 500  # characters of an expression: Python's parser takes seconds for some longer ones
FUNCTIONS = {name: name for name in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "exp", "log", "round")}
FUNCTIONS |= {"min": "minimum", "max": "maximum"}  # names of NumPy and JAX
_ALLOWED = (ast.Expression, ast.BinOp, ast.UnaryOp, ast.Call, ast.Name, ast.Load, ast.Constant)
_ALLOWED += (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow, ast.USub, ast.UAdd)


def _call(name, *arguments):
    return getattr(np if all(map(errors.concrete, arguments)) else jnp, name)(*arguments)


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
            stacked = (
                np.array(parts, float) if all(map(errors.concrete, parts)) else jnp.stack([*map(jnp.asarray, parts)])
            )
            return stacked.astype(float)
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
