"""Operations: the C form of each elementwise operation, on vectors of lanes, and its cost."""

import functools
import itertools
import math
import pathlib

import numpy as np

from cnclik.engine.graph import IS_KNOWN, UnsupportedError

TYPES = {  # NumPy dtype: C types of (a vector of lanes, a number)
    "float32": ("F32", "float"),
    "float64": ("F64", "double"),
    **{f"int{b}": (f"S{b}", f"int{b}_t") for b in (8, 16, 32, 64)},
    **{f"uint{b}": (f"U{b}", f"uint{b}_t") for b in (8, 16, 32, 64)},
    "bool": ("M", "uint8_t"),
}
vector = {np.dtype(name): of for name, (of, _) in TYPES.items()}.__getitem__  # C type of a vector of lanes
scalar = {np.dtype(name): one for name, (_, one) in TYPES.items()}.__getitem__  # of a number in arguments and results


DTYPES = frozenset(map(np.dtype, TYPES))


def check_dtype(dtype) -> None:
    """Raise UnsupportedError if numbers of a type, or random keys, have no C form."""
    if dtype not in DTYPES:
        raise UnsupportedError(f"numbers of type {dtype} have no C form")


_COSTLY = "sin cos tan exp log atan2 expm1 log1p pow tanh asin acos sinh cosh exp2 logistic"
COST = dict.fromkeys(_COSTLY.split(" "), 30)
COST |= {"div": 6, "sqrt": 8, "rsqrt": 10, "rem": 10}

BINARY = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
COMPARED = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
BITS = {"and": "&", "or": "|", "xor": "^"}
_TRUTH = {  # operations on masks
    **{"eq": "~({0} ^ {1})", "ne": "{0} ^ {1}", "lt": "~{0} & {1}", "le": "~{0} | {1}", "gt": "{0} & ~{1}"},
    **{"ge": "{0} | ~{1}", "max": "{0} | {1}", "min": "{0} & {1}", "add": "{0} | {1}", "mul": "{0} & {1}"},
}
_LIBRARY = "tan exp log log1p expm1 tanh asin acos sinh cosh floor ceil atan cbrt erf exp2 asinh acosh atanh round"
# Functions of the C library, called lane by lane: number of arguments.
LIBRARY = dict.fromkeys(_LIBRARY.split(" "), 1) | {"pow": 2, "fmod": 2, "nextafter": 2}


@functools.cache
def header(name) -> str:
    return (pathlib.Path(__file__).parent / "c" / name).read_text(encoding="utf-8")


def number(value, dtype) -> str:
    """A constant in C, exact in its type."""
    dtype = np.dtype(dtype)
    if dtype.kind == "b":
        return str(-int(value))
    if dtype.kind in "iu":
        suffix = ("U" if dtype.kind == "u" else "") + "LL" * (dtype.itemsize == 8)
        least = dtype.kind == "i" and value == np.iinfo(dtype).min
        return f"(-{-(int(value) + 1)}{suffix} - 1)" if least else f"{int(value)}{suffix}"
    with np.errstate(over="ignore"):  # what is too large for the type is infinite, as in JAX
        value = dtype.type(value)
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return str(value) + "f" if dtype.itemsize == 4 else repr(float(value))


def text(node, of) -> str:
    """An operation in C. `of(argument, plain)` returns an argument's text; plain: a constant as a number."""
    name, args = node.op, node.args
    kind, T = args[-1].dtype.kind, vector(args[-1].dtype)
    if name == "bitcast_convert_type":
        return f"({vector(node.dtype)}){of(args[0], False)}"
    if name == "convert_element_type":
        return _converted(of(args[0], False), args[0].dtype, node.dtype)
    if kind == "b" and name in _TRUTH:
        return _TRUTH[name].format(*[of(a, False) for a in args])
    plain = kind == "f" and (name in BINARY or name in COMPARED) and not all(map(IS_KNOWN, args))
    a = list(map(of, args, itertools.repeat(plain)))
    if kind == "f" and name in BINARY:
        return f" {BINARY[name]} ".join(a)
    if name in COMPARED:
        return f"MASK({f' {COMPARED[name]} '.join(a)})"
    if name in BITS:
        return f"{a[0]} {BITS[name]} {a[1]}"
    if name == "select_n":
        return _selected(node, a, vector(node.dtype), args[0].dtype.kind)
    if kind in "iu" and name in ("add", "sub", "mul"):
        return f"{a[0]} {BINARY[name]} {a[1]}"
    if name in _SIMPLE:
        return _SIMPLE[name].format(*a, T=T)
    if name.startswith("shift_") and args[1].known and 0 <= args[1].value < (bits := 8 * node.dtype.itemsize):
        S = {"shift_left": T, "shift_right_logical": f"U{bits}", "shift_right_arithmetic": f"S{bits}"}[name]
        return f"({T})(({S}){a[0]} {'<<' if name == 'shift_left' else '>>'} {args[1].value})"
    if name == "round":
        return f"round_even_{T}({a[0]})" if node.params == 1 else f"round_{T}({a[0]})"
    if name == "pow" and args[0].dtype != args[1].dtype:
        T = vector(args[0].dtype)
        return f"pow_{T}({a[0]}, {_converted(a[1], args[1].dtype, args[0].dtype)})"
    if name == "rem" and kind == "f":
        return f"fmod_{T}({a[0]}, {a[1]})"
    if name not in NAMES:
        raise UnsupportedError(f"the operation `{name}` has no C form")
    return f"{name}_{T}({', '.join(a)})"


def _selected(node, a, T, kind):
    pick = f"select_{T}"
    if kind == "b":
        return f"{pick}({a[0]}, {a[2]}, {a[1]})"
    made = a[-1]
    for k in range(len(a) - 3, -1, -1):
        made = f"{pick}(MASK({a[0]} == {k}), {a[k + 1]}, {made})"
    return made


def _converted(x, old, new):
    old, new = np.dtype(old), np.dtype(new)
    T, S = vector(new), vector(old)
    if old == new:
        return x
    if new.kind == "b":
        return f"MASK({x} != 0)"
    if old.kind == "b":
        one_or_zero = f"select_{T}({x}, splat_{T}(1), splat_{T}(0))"
        return one_or_zero if new.kind == "f" else f"({T})-__builtin_convertvector({x}, {T})"
    if old.kind == "f" and new.kind in "iu":
        about = np.iinfo(new)
        top = old.type(2.0**about.bits if new.kind == "u" else 2.0 ** (about.bits - 1))
        below, low = number(np.nextafter(top, old.type(0)), old), number(about.min, old)
        held = f"held_{S}({x}, {low}, {below})"
        most, inside = f"splat_{T}({number(about.max, new)})", f"__builtin_convertvector({held}, {T})"
        return f"select_{T}(MASK({x} >= {number(top, old)}), {most}, {inside})"
    return f"__builtin_convertvector({x}, {T})"


_SIMPLE = {
    **{"neg": "-{0}", "not": "~{0}", "square": "{0} * {0}", "rsqrt": "1 / sqrt_{T}({0})"},
    **{"is_finite": "MASK(({0} - {0}) == ({0} - {0}))"},
    "logistic": "1 / (1 + exp_{T}(-{0}))",
}
NAMES = frozenset([  # of all elementwise operations
    *BINARY, *COMPARED, *BITS, *_SIMPLE, *LIBRARY, "abs", "sqrt", "sin", "cos", "atan2", "max", "min",
    "sign", "rem", "bitcast_convert_type", "convert_element_type", "select_n", "shift_left", "shift_right_arithmetic",
    "shift_right_logical",
])  # fmt: skip
