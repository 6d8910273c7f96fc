"""Expressions of specs: drawn from their grammar and beyond it, then mutated."""

import numpy as np

from cnclik import errors
from cnclik.sweeps import expression
from tests.stress.fuzz.nasty import NUMBERS, TEXTS, any_of, chance, slipped

KNOWN = {"a": 2.0, "b": -0.5, "n": 3, "N": 1000, "z": np.float64(0.3), "zero": 0, "huge": 1e308,
         "v": np.array([1.0, -2.0]), "method": "EE", "big": 10**300, "Ts": 1e-320}  # fmt: skip
CALLS = ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "exp", "log", "round", "min", "max", "abs", "eval", "pow")
SIGNS = ("+", "-", "*", "/", "**", "**", "//", "%", "@", "<<", " and ", ",", "==", ".", ":=")


def draw(rng):
    if chance(rng, 0.02):
        return _long(rng)
    text = _expression(rng, int(rng.integers(1, 6)))
    for _ in range(int(rng.integers(3)) if chance(rng, 0.3) else 0):
        text = slipped(rng, text)
    return [text, "pi"] if chance(rng, 0.1) else text


def _expression(rng, depth):
    odd = chance(rng, 0.03)
    match int(rng.integers(8)) if depth else int(rng.integers(2)):
        case 0:
            return (
                any_of(rng, NUMBERS) if odd else any_of(rng, ("0", "1", "2", "9", "0.5", "1e-3", "1e308", "1000", "3"))
            )
        case 1:
            return any_of(rng, (*TEXTS, "unknown")) if odd else any_of(rng, (*KNOWN, "pi", "a", "n", "z"))
        case 2:
            few = any_of(rng, CALLS if odd else CALLS[:12])
            count = 2 if few in ("min", "max") else 1
            count = int(rng.integers(4)) if odd else count
            return f"{few}({', '.join(_expression(rng, depth - 1) for _ in range(count))})"
        case 3:
            return f"{any_of(rng, '+-~!' if odd else '+-')}{_expression(rng, depth - 1)}"
        case 4:
            return f"({_expression(rng, depth - 1)})"
        case _:
            sign = any_of(rng, SIGNS if odd else SIGNS[:6])
            return f"{_expression(rng, depth - 1)}{sign}{_expression(rng, depth - 1)}"


def _long(rng):
    """Deep, long or tall."""
    count = int(10 ** rng.uniform(1, 5))
    inner = any_of(rng, ("a", "n", "9", "2", "v", "1e308", "big"))
    return any_of(
        rng,
        ("(" * count + inner + ")" * count, "-" * count + inner, "+".join([inner] * count), "**".join([inner] * count),
         "sin(" * count + inner + ")" * count, "*".join([inner] * count), "(" * count, f"{inner}**{count}", "a" * count,
         "round(" * count + inner + ")" * count, "min(a," * count + inner + ")" * count, f"{inner}**-{count}"),
    )  # fmt: skip


def _known(name):
    return KNOWN[errors.one_of("name", name, KNOWN)]  # as a spec, which knows every name before it looks one up


def attempt(value, folder) -> None:
    """A number, or a vector of them; nothing else may come of it."""
    expression.names("alpha", value)
    found = expression.evaluate("alpha", value, _known)
    if isinstance(value, list):
        assert found.shape[0] == len(value) and found.dtype == float, repr(found)
    elif value != "method":
        assert np.asarray(found).dtype.kind in "iufO" and np.size(found) <= 2, repr(found)
