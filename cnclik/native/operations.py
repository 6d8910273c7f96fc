"""Operations: what a node can do, how it is worked out now, and how it is written in C."""

from typing import NamedTuple

import numpy as np


class Operation(NamedTuple):
    """One operation on scalars."""

    kind: str  # of its result; "" for that of its last argument
    text: str  # in C; {0}, {1} … are its arguments, {f} is "f" in single precision
    now: object  # the same in NumPy
    cost: int = 1  # floating-point operations, as they are counted


def _libm(name, now, cost=20, arguments=1):
    inside = ", ".join(f"{{{i}}}" for i in range(arguments))
    return Operation("real", f"{name}{{f}}({inside})", now, cost)


def _rounded(x):
    return np.copysign(np.floor(np.abs(x) + 0.5), x)


def _whole(x):
    """XLA's cast: towards 0, what is too large to the nearest, NaN to 0."""
    return 0 if np.isnan(x) else int(np.clip(float(x), -(2**31), 2**31 - 1))


OPERATIONS = {
    "add": Operation("", "{0} + {1}", np.add),
    "sub": Operation("", "{0} - {1}", np.subtract),
    "mul": Operation("", "{0} * {1}", np.multiply),
    "div": Operation("", "{0} / {1}", np.divide),
    "neg": Operation("", "-{0}", np.negative),
    "abs": Operation("", "fabs{f}({0})", np.abs),
    "sqrt": _libm("sqrt", np.sqrt, 1),
    "sin": _libm("sin", np.sin),
    "cos": _libm("cos", np.cos),
    "atan2": _libm("atan2", np.arctan2, 20, 2),
    "max": Operation("", "({0} > {1} || {0} != {0}) ? {0} : {1}", np.maximum),
    "min": Operation("", "({0} < {1} || {0} != {0}) ? {0} : {1}", np.minimum),
    "select": Operation("", "{0} ? {1} : {2}", lambda c, a, b: a if c else b),
    "lt": Operation("bool", "{0} < {1}", np.less),
    "le": Operation("bool", "{0} <= {1}", np.less_equal),
    "gt": Operation("bool", "{0} > {1}", np.greater),
    "ge": Operation("bool", "{0} >= {1}", np.greater_equal),
    "eq": Operation("bool", "{0} == {1}", np.equal),
    "ne": Operation("bool", "{0} != {1}", np.not_equal),
    "and": Operation("", "{0} & {1}", lambda a, b: a & b, 0),
    "or": Operation("", "{0} | {1}", lambda a, b: a | b, 0),
    "xor": Operation("", "{0} ^ {1}", lambda a, b: a ^ b, 0),
    "not": Operation("bool", "!{0}", lambda a: not a, 0),
    "is_finite": Operation("bool", "isfinite({0})", np.isfinite),
    "round_even": _libm("nearbyint", np.round, 1),
    "round_away": _libm("round", _rounded, 1),
    "floor": _libm("floor", np.floor, 1),
    "ceil": _libm("ceil", np.ceil, 1),
    "to_real": Operation("real", "(@REAL@){0}", float),
    "to_int": Operation("int", "@TO_INT@({0})", _whole),
    "bool_to_int": Operation("int", "(int32_t){0}", int, 0),
    "exp": _libm("exp", np.exp),
    "exp2": _libm("exp2", np.exp2),
    "expm1": _libm("expm1", np.expm1),
    "log": _libm("log", np.log),
    "log1p": _libm("log1p", np.log1p),
    "tan": _libm("tan", np.tan),
    "asin": _libm("asin", np.arcsin),
    "acos": _libm("acos", np.arccos),
    "atan": _libm("atan", np.arctan),
    "sinh": _libm("sinh", np.sinh),
    "cosh": _libm("cosh", np.cosh),
    "tanh": _libm("tanh", np.tanh),
    "asinh": _libm("asinh", np.arcsinh),
    "acosh": _libm("acosh", np.arccosh),
    "atanh": _libm("atanh", np.arctanh),
    "cbrt": _libm("cbrt", np.cbrt),
    "erf": _libm("erf", None),
    "pow": _libm("pow", np.power, 40, 2),
    "rem": _libm("fmod", np.fmod, 20, 2),
    "nextafter": _libm("nextafter", np.nextafter, 5, 2),
}


def folded(op, values, dtype, args):
    """The result of an operation on known numbers, as it would come out at run time; None where NumPy has no such."""
    operation = OPERATIONS[op]
    if operation.now is None:
        return None
    typed = [dtype.type(v) if a.kind == "real" else v for v, a in zip(values, args, strict=True)]
    if op == "div" and args[0].kind == "int":
        return None
    with np.errstate(all="ignore"):
        return operation.now(*typed)
