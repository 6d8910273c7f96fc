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
_MATH = {name: getattr(math, name) for name in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "exp", "log")}
FUNCTIONS = _MATH | {"round": round, "min": min, "max": max}
_PAIRS = {"min": "minimum", "max": "maximum"}  # names of JAX
_ALLOWED = (
    *(ast.Expression, ast.BinOp, ast.UnaryOp, ast.Call, ast.Name, ast.Load, ast.Constant),
    *(ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow, ast.USub, ast.UAdd),
)


@functools.cache
def _code(text: str):
    """Return an expression compiled; None for a text that is none."""
    if len(text) > LONGEST:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python's own about texts such as 0in
            tree = ast.parse(text.strip(), mode="eval")
            calls = {node.func: node for node in ast.walk(tree) if isinstance(node, ast.Call)}
            if all(_is_allowed(node, calls) for node in ast.walk(tree)):
                return compile(_Floats().visit(tree), text, "eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError, OverflowError):
        pass
    return None


def _is_allowed(node, calls) -> bool:
    if isinstance(node, ast.Constant):
        return type(node.value) in (int, float)
    if isinstance(node, ast.Call):
        count = 2 if getattr(node.func, "id", "") in _PAIRS else 1
        return isinstance(node.func, ast.Name) and len(node.args) == count and not node.keywords
    if isinstance(node, ast.Name):
        return (node.id in FUNCTIONS) == (node in calls)
    return isinstance(node, _ALLOWED)


class _Floats(ast.NodeTransformer):
    """Numbers as floats, but for exponents: powers of integers may take hours, those of floats overflow."""

    def visit_Constant(self, node):
        return ast.copy_location(ast.Constant(float(node.value)), node)

    def visit_BinOp(self, node):
        node.left = self.visit(node.left)
        if not (isinstance(node.op, ast.Pow) and isinstance(node.right, ast.Constant)):
            node.right = self.visit(node.right)
        return node


class _Known(dict):
    """What an expression's names stand for."""

    def __init__(self, look):
        super().__init__({name: functools.partial(_call, name) for name in FUNCTIONS}, pi=math.pi)
        self.look = look

    def __missing__(self, name):
        value = self.look(name)
        if isinstance(value, str):
            raise TypeError(f"{name} is a name, not a number")
        return float(value) if type(value) is int else value


def _call(name, *arguments):
    if all(isinstance(argument, (int, float)) for argument in arguments):
        return FUNCTIONS[name](*arguments)
    return getattr(jnp, _PAIRS.get(name, name))(*arguments)


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
        return set(code.co_names) - set(FUNCTIONS) - {"pi"}
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
    if (code := _code(value)) is None:
        found = _read(where, value, _unit(where), look("Ts") if "Ts" in names(where, value) else None)
        return np.array(found) if len(found) > 1 else found[0]
    try:
        with np.errstate(all="ignore"):  # users of the value report what is not finite
            found = eval(code, {"__builtins__": {}}, _Known(look))
        if np.iscomplexobj(found):
            raise ValueError("the result is complex")
        return found
    except errors.ArgumentError:
        raise
    except (ArithmeticError, ValueError, TypeError, RecursionError) as error:
        raise errors.fail(where, "be an expression that can be worked out", f"{value!r} is not: {error}") from None
