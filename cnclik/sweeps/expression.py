"""Expressions: values of a spec that depend on others, such as duration = "N*Ts" or alpha = "z/Ts".

A text that is not an expression may be numbers with a unit, as on the command line: delay = "34ms", q0 = "0 -90 90
deg".
"""

import ast
import functools
import math
import operator
import warnings
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from cnclik import errors, quantities
from cnclik.problem.options import OPTIONS

DEEPEST = 100  # nested brackets and signs, at most
MOST = 2.0**1000  # intermediate results, at most: Python's integers would grow until memory runs out


def _power(base, exponent):
    """A power, limited also for integers, which have no largest value."""
    whole = isinstance(base, int) and isinstance(exponent, int) and abs(base) > 1
    if whole and exponent * math.log2(abs(base)) > math.log2(MOST):
        raise OverflowError("a power is too large")
    return operator.pow(base, exponent)


_BINARY = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: _power,
}
_CALLS = {"sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "exp", "log", "round"}
_PAIRS = {"min": np.minimum, "max": np.maximum}
_FUNCTIONS = _CALLS | set(_PAIRS)
_CONSTANTS = {"pi": math.pi}


class _Written(NamedTuple):
    """Numbers with a unit, of an option that has a unit."""

    text: str
    own: str
    units: tuple  # unit of each number, or None

    @property
    def needs(self) -> set:
        """The names they depend on: a time in samples depends on the sampling time."""
        return {"Ts"} if self.own == quantities.SAMPLES and "s" in self.units else set()

    def value(self, known):
        found = quantities.read(self.text, self.own, *map(known, self.needs))
        return np.array(found) if len(found) > 1 else int(found[0]) if found[0].is_integer() else found[0]


@functools.cache
def parse(name: str, text: str):
    """The tree of an expression, or `_Written` for numbers with a unit. Raises: ArgumentError for anything else."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python's own about texts such as 0in
            tree = ast.parse(text, mode="eval").body
        _check(tree)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return _written(name, text)
    return tree


def _written(name, text):
    # axes.q0.low has the unit of q0
    own = next((OPTIONS[part].unit for part in name.split(".")[::-1] if part in OPTIONS), "1")
    try:
        return _Written(text, own, quantities.read(text, own, Ts=1.0, marked=True).written)
    except ValueError as error:
        allowed = f"numbers, names, + - * / ** and {', '.join(sorted(_FUNCTIONS))}"
        raise errors.fail(name, f"be a number or a short expression of {allowed}", str(error)) from None


def _check(node, deep=0):
    if deep > DEEPEST:
        raise ValueError
    match node:
        case ast.Constant(value=value) if type(value) in (int, float) and abs(value) <= MOST:
            parts = ()
        case ast.Name(id=found) if found not in _FUNCTIONS:
            parts = ()
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            parts = (left, right)
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=operand):
            parts = (operand,)
        case ast.Call(func=ast.Name(id=found), args=parts, keywords=[]) if found in _FUNCTIONS:
            if len(parts) != 1 + (found in _PAIRS):
                raise ValueError
        case _:
            raise ValueError
    for part in parts:
        _check(part, deep + 1)


def names(name: str, value) -> set:
    """Names that a value (a number, an expression, or nested lists of them) uses."""
    if isinstance(value, (list, tuple)):
        return set().union(*(names(name, v) for v in value))
    if not isinstance(value, str):
        return set()
    tree = parse(name, value)
    if isinstance(tree, _Written):
        return tree.needs
    found = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    return found - _FUNCTIONS - set(_CONSTANTS)


def units(name: str, value) -> tuple:
    """The unit of each number of a value, or None."""
    if isinstance(value, (list, tuple)):
        return sum((units(name, v) for v in value), ())
    tree = parse(name, value) if isinstance(value, str) else None
    return tree.units if isinstance(tree, _Written) else (None,)


def evaluate(name: str, value, known):
    """A value with its expressions evaluated; `known` looks up a name. Lists become arrays."""
    if isinstance(value, (list, tuple)):
        parts = [evaluate(name, v, known) for v in value]
        try:
            if any(isinstance(p, bool) for p in parts):
                raise TypeError
            if all(errors.concrete(p) for p in parts):
                return np.array(parts, float)
            return jnp.stack([jnp.asarray(p, float) for p in parts])
        except (TypeError, ValueError, OverflowError):
            raise errors.fail(name, "hold numbers or vectors of one length", f"is {value!r}") from None
    if not isinstance(value, str):
        return value

    def walk(node):
        match node:
            case ast.Constant(value=number):
                return number
            case ast.Name(id=found):
                value = _CONSTANTS[found] if found in _CONSTANTS else known(found)
                if isinstance(value, str):  # Python's + and * accept texts
                    raise TypeError(f"{found} is a name, not a number")
                return value
            case ast.BinOp(left=left, op=op, right=right):
                return _BINARY[type(op)](walk(left), walk(right))
            case ast.UnaryOp(op=op, operand=operand):
                return -walk(operand) if isinstance(op, ast.USub) else walk(operand)
            case ast.Call(func=ast.Name(id=found), args=arguments):
                return _call(found, *map(walk, arguments))

    tree = parse(name, value)
    try:
        if isinstance(tree, _Written):
            return tree.value(known)
        with np.errstate(all="ignore"):  # users of the value report what is not finite
            found = walk(tree)
        if np.iscomplexobj(found):
            raise ValueError("the result is complex")
        return found
    except (ArithmeticError, ValueError, TypeError, RecursionError) as error:
        raise errors.fail(name, "be an expression that can be worked out", f"{value!r} is not: {error}") from None


def _call(name, *arguments):
    if name in _PAIRS:
        known = all(isinstance(a, (int, float)) for a in arguments)
        return float(_PAIRS[name](*arguments)) if known else getattr(jnp, f"{name}imum")(*arguments)
    (argument,) = arguments
    if isinstance(argument, (int, float)):
        return round(argument) if name == "round" else getattr(math, name)(argument)
    return getattr(jnp, name)(argument)
