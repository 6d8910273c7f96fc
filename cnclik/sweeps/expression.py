"""Expressions: values of a spec that follow from others, such as period = "N*Ts" or alpha = "z/Ts".

A text that is no expression is numbers with a unit, as on the command line: delay = "34ms", q0 = "0 -90 90 deg".
"""

import ast
import functools
import math
import operator
import warnings

import jax.numpy as jnp
import numpy as np

from cnclik import errors, quantities
from cnclik.problem.options import OPTIONS

LONGEST = 500  # characters of an expression: Python's parser takes seconds for some longer ones
FUNCTIONS = {name: name for name in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "exp", "log", "round")}
FUNCTIONS |= {"min": "minimum", "max": "maximum"}  # names of NumPy and JAX
OPERATORS: dict = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv}
OPERATORS |= {ast.Pow: operator.pow, ast.USub: operator.neg, ast.UAdd: operator.pos}
_ALLOWED = (ast.BinOp, ast.UnaryOp, ast.Call, ast.Name, ast.Load, ast.Constant, *OPERATORS)


@functools.cache
def _tree(text: str):
    """Return the syntax tree of an expression; None for a text that is none."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python's own about texts such as 0in
            tree = ast.parse(text.strip() if len(text) <= LONGEST else "", mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None
    return tree if all(isinstance(node, _ALLOWED) for node in ast.walk(tree)) else None


def _result(node, look):
    """Return the value of a syntax tree. Numbers are floats: powers of integers may take hours."""
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return float(value)
        case ast.Name(id="pi"):
            return math.pi
        case ast.Name(id=name) if name not in FUNCTIONS:
            value = look(name)
            if isinstance(value, str):
                raise TypeError(f"{name} is a name, not a number")
            return float(value) if type(value) is int else value
        case ast.UnaryOp():
            return OPERATORS[type(node.op)](_result(node.operand, look))
        case ast.BinOp(op=ast.Pow(), right=ast.Constant(value=int() as power)):
            return _result(node.left, look) ** power  # of a traced number by multiplication
        case ast.BinOp():
            return OPERATORS[type(node.op)](_result(node.left, look), _result(node.right, look))
        case ast.Call(func=ast.Name(id=name), keywords=[]) if name in FUNCTIONS:
            arguments = [_result(argument, look) for argument in node.args]
            return getattr(np if all(map(errors.concrete, arguments)) else jnp, FUNCTIONS[name])(*arguments)
    raise TypeError(f"{ast.unparse(node)} has no value")


def _unit(where: str) -> str:
    """Return the unit of the option that a place such as "axes.q0.low" belongs to; "1" of other values."""
    return next((OPTIONS[part].unit for part in where.split(".")[::-1] if part in OPTIONS), "1")


def is_quantity(value) -> bool:
    """Return whether a value is numbers with a unit, such as "34ms" or ["1 mm", 2]: it has texts, and no expression."""
    texts = [v for v in (value if isinstance(value, list) else [value]) if isinstance(v, str)]
    return bool(texts) and not any(map(_tree, texts))


def names(where: str, value) -> set:
    """Return the names that a value uses: a number, an expression, numbers with a unit, or nested lists of them."""
    if isinstance(value, (list, tuple)):
        return set().union(*(names(where, v) for v in value))
    if not isinstance(value, str):
        return set()
    if (tree := _tree(value)) is not None:
        return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} - {"pi", *FUNCTIONS}
    unit = _unit(where)  # a time in samples depends on the sampling time
    return {"Ts"} if unit == quantities.SAMPLES and "s" in _read(where, value, unit, 1.0).written else set()


def _read(where, text, unit, Ts):
    try:
        return quantities.read(text, unit, Ts, marked=True)
    except ValueError as error:
        allowed = f"numbers, names, + - * / ** and {', '.join(sorted(FUNCTIONS))}"
        raise errors.fail(where, f"be a number or a short expression of {allowed}", str(error)) from None


def evaluate(where: str, value, look):
    """Return a value with its expressions evaluated, a list as an array; `look` returns the value of a name."""
    if isinstance(value, (list, tuple)):
        parts = [evaluate(where, v, look) for v in value]
        try:
            if any(isinstance(part, bool) for part in parts):
                raise TypeError
            if all(map(errors.concrete, parts)):
                return np.array(parts, float)
            return jnp.stack([jnp.asarray(part, float) for part in parts])
        except (TypeError, ValueError, OverflowError):
            raise errors.fail(where, "hold numbers or vectors of one length", f"is {value!r}") from None
    if not isinstance(value, str):
        return value
    if (tree := _tree(value)) is None:
        found = _read(where, value, _unit(where), look("Ts") if "Ts" in names(where, value) else None)
        return np.array(found) if len(found) > 1 else found[0]
    try:
        with np.errstate(all="ignore"):  # users of the value report what is not finite
            result = _result(tree, look)
        if np.iscomplexobj(result):
            raise ValueError("the result is complex")
        return result
    except errors.ArgumentError:
        raise
    except (ArithmeticError, ValueError, TypeError, RecursionError) as error:
        raise errors.fail(where, "be an expression that can be worked out", f"{value!r} is not: {error}") from None


def number(where: str, value):
    """Return the value of an expression that uses no name, such as "pi/2" or "4 ms"."""

    def look(name):
        raise errors.fail(where, "be numbers", f"refers to {name!r}")

    return evaluate(where, value, look)
