"""Algebra: folds operations on known numbers, and simplifies others.

The rules treat NaN, infinity and the sign of 0 as XLA does (which leaves out an addition of 0), with one exception: 0
times anything is 0, and 0 minus it has its other sign, where the 0 is a constant of the model (`Node.exact`).
"""

import numpy as np

COMPARISONS = frozenset(["lt", "le", "gt", "ge", "eq", "ne"])
COMMUTES = frozenset(["add", "mul", "max", "min", "and", "or", "xor", "eq", "ne"])


def _converted(value, dtype):
    """XLA's cast, in which whole numbers wrap around; None for a float that may not fit."""
    if value.dtype.kind == "f" and dtype.kind in "iu" and not 0 <= value <= min(np.iinfo(dtype).max, 1 << 24):
        return None
    return value.astype(dtype)


_FOLDED = {
    **{"add": np.add, "sub": np.subtract, "mul": np.multiply, "neg": np.negative, "abs": np.abs, "sqrt": np.sqrt},
    **{"max": np.maximum, "min": np.minimum, "sin": np.sin, "cos": np.cos, "tan": np.tan, "exp": np.exp},
    **{"log": np.log, "exp2": np.exp2, "expm1": np.expm1, "log1p": np.log1p, "atan2": np.arctan2, "asin": np.arcsin},
    **{"acos": np.arccos, "atan": np.arctan, "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "pow": np.power},
    **{"floor": np.floor, "ceil": np.ceil, "square": np.square, "is_finite": np.isfinite},
    **{"lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal, "eq": np.equal},
    **{"ne": np.not_equal, "and": np.bitwise_and, "or": np.bitwise_or, "xor": np.bitwise_xor, "not": np.invert},
    **{"rsqrt": lambda x: 1 / np.sqrt(x), "sign": lambda x: np.sign(x) if x else x},
}


def folded(name, values, dtype, params):
    """The result of an operation on known numbers; None if it has to be computed at run time."""
    with np.errstate(all="ignore"):
        if name in ("max", "min") and dtype.kind == "f" and not any(values):
            return None  # the signs of zeros decide, not in NumPy
        if name in ("div", "rem") and dtype.kind == "f":
            return (np.divide if name == "div" else np.fmod)(*values)
        if name in ("div", "rem"):
            a, b = map(int, values)
            quotient = 0 if b == 0 else abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1)
            return None if b in (0, -1) else quotient if name == "div" else a - b * quotient
        if name == "convert_element_type":
            return _converted(values[0], dtype)
        if name == "integer_pow":
            return values[0] ** dtype.type(params) if dtype.kind == "f" else None
        if name == "round":
            return np.round(values[0]) if params == 1 else None
        fold = _FOLDED.get(name)
        return None if fold is None else fold(*values)


def _power_of_two(value) -> bool:
    return bool(np.isfinite(value)) and value != 0 and np.frexp(abs(value))[0] == 0.5


def _add(g, args, params, dtype):
    a, b = args
    if dtype.kind == "b":
        return None
    if a.zero:
        return b
    if b.zero:
        return a
    if b.op == "neg":
        return g.op("sub", a, b.args[0])
    if a.op == "neg":
        return g.op("sub", b, a.args[0])
    return g.op("mul", g.const(2, dtype), a) if a is b else None


def _sub(g, args, params, dtype):
    a, b = args
    if b.zero:
        return a
    if a.zero and (a.exact or dtype.kind != "f" or np.signbit(a.value)):  # 0 − 0 is 0
        return g.op("neg", b)
    return g.op("add", a, b.args[0]) if b.op == "neg" else None


def _mul(g, args, params, dtype):
    if dtype.kind == "b":
        return None
    if args[0] is args[1] and (found := _squared(g, args[0])) is not None:
        return found
    for x, y in (args, args[::-1]):
        if not x.known:
            if x.op == "neg" and not y.known:
                return g.op("neg", g.op("mul", x.args[0], y))
            if y.number in g.squares and x.op == "mul" and not y.known:
                for root, rest in (x.args, x.args[::-1]):
                    if root is y:  # 1/√d, whose square is known
                        return g.op("mul", rest, g.squares[y.number])
                    if root is y.args[1]:
                        return rest
        elif x.value == 1:
            return y
        elif x.value == 0 and (x.exact or dtype.kind != "f"):
            return x
        elif x.value == -1 and dtype.kind in "fi":
            return g.op("neg", y)
        elif dtype.kind == "f" and y.op == "mul" and any(a.known for a in y.args) and _power_of_two(x.value):
            known, rest = y.args if y.args[0].known else y.args[::-1]
            return g.op("mul", g.const(known.value * x.value, dtype), rest)
    return None


def _div(g, args, params, dtype):
    a, b = args
    if b.known and dtype.kind == "f" and _power_of_two(b.value) and np.isfinite(1 / b.value):
        return g.op("mul", g.const(1 / b.value, dtype), a)
    return a if b.known and b.value == 1 else None


def _neg(g, args, params, dtype):
    (a,) = args
    if a.op == "neg":
        return a.args[0]
    return g.op("sub", *a.args[::-1]) if a.op == "sub" and dtype.kind != "f" else None  # −(x − x) is −0


def _select(g, args, params, dtype):
    which, *cases = args
    if which.known:
        return cases[min(max(int(which.value), 0), len(cases) - 1)]
    if cases.count(cases[0]) == len(cases):
        return cases[0]
    return None


def _logic(absorbing):
    def simpler(g, args, params, dtype):
        for x, y in (args, args[::-1]):
            if x.known and dtype.kind == "b":
                return x if bool(x.value) is absorbing else y
            if x.zero and dtype.kind in "iu":
                return x if absorbing is False else y
        return args[0] if args[0] is args[1] else None

    return simpler


def _pow(g, args, params, dtype):
    """Integer powers by repeated squaring, as XLA computes them."""
    y, x, out = abs(params), args[0], g.const(1, dtype)
    while y:
        if y & 1:
            out = g.op("mul", out, x)
        y >>= 1
        x = g.op("mul", x, x) if y else x
    return out if params >= 0 else g.op("div", g.const(1, dtype), out)


def _squared(g, x):
    """x·x without a root, where x is 1/√d or a product with it; otherwise None."""
    root = next((a for a in x.args if a.number in g.squares), None) if x.op == "mul" else None
    if root is None:
        return g.squares.get(x.number)
    rest = x.args[x.args[0] is root]
    return g.op("mul", g.op("mul", rest, rest), g.squares[root.number])


def _less_to(g, args, params, dtype):
    """a < b in the order of a sort, in which NaN is last."""
    a, b = args
    less = g.op("lt", a, b)
    return g.op("or", less, g.op("and", g.op("ne", b, b), g.op("eq", a, a))) if a.dtype.kind == "f" else less


def _one_minus_square(g, args, params, dtype):
    one, (x,) = g.const(1, dtype), args  # jax 0.11 has it in derivatives of tanh, asin and acos
    return g.op("mul", g.op("add", one, x), g.op("sub", one, x))


SIMPLER = {
    **{"add": _add, "sub": _sub, "mul": _mul, "div": _div, "neg": _neg, "select_n": _select},
    **{"and": _logic(False), "or": _logic(True), "integer_pow": _pow},
    **dict.fromkeys(("max", "min"), lambda g, args, params, dtype: args[0] if args[0] is args[1] else None),
    "not": lambda g, args, params, dtype: args[0].args[0] if args[0].op == "not" else None,
    "lt_to": _less_to,
    "le_to": lambda g, args, params, dtype: g.op("not", _less_to(g, args[::-1], params, dtype)),
    "one_minus_square": _one_minus_square,
    "square": lambda g, args, params, dtype: g.op("mul", args[0], args[0]),
    "clamp": lambda g, args, params, dtype: g.op("min", g.op("max", args[1], args[0]), args[2]),
    "convert_element_type": lambda g, args, params, dtype: args[0] if args[0].dtype == dtype else None,
}
