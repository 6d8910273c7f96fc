"""User errors, in one grammar: "Argument `Ts` must be positive, but is -0.1."

Shapes are always checked; values only where they are concrete (never a tracer). Neither JAX nor NumPy
is loaded for a message.
"""

import contextlib
import difflib
import math
import os
import pathlib
import re
import sys
import warnings
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jax import Array

_MOST = 800  # characters of a message
_LISTED = 300  # characters of a list of names, beyond which the one that was probably meant stands for it
MOST = 100_000_000  # of steps of one run, targets of one call: beyond it no machine has the memory
_NUMPY = re.compile(r"(?<!\w)'[^']*'|np\.[a-z]+[0-9]*_?\(([^()]*)\)")  # a user's text, or a number as NumPy writes it


class ArgumentError(ValueError):
    """An argument that cannot be used; the message is one line, fit for a terminal."""

    def __init__(self, message: str):
        super().__init__(_one_line(message))


def _one_line(text: str) -> str:
    """Without its middle if it is long: what it must be stands at the beginning, what it is at the end."""
    line = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in " ".join(text.split()))
    return line if len(line) <= _MOST else f"{line[: _MOST - 301]} … {line[-298:]}"


def fail(name: str, must: str, found) -> ArgumentError:
    """The error of an argument: what it must be and what it is."""
    name = name if len(name) <= 80 else f"{name[:79]}…"
    found = _NUMPY.sub(lambda match: match[1] or match[0], " ".join(found.split()))
    return ArgumentError(f"Argument `{name}` must {must}, but {found if len(found) <= 120 else found[:119] + '…'}.")


@contextlib.contextmanager
def called(old: str, new: str):
    """Context manager, or decorator: an error of `old` is one of `new`; for "" one of `name` is one of `new.name`."""
    old, new = (f"{old}`", f"{new}`") if old else ("", f"{new}.")
    try:
        yield
    except ArgumentError as error:
        raise ArgumentError(str(error).replace(f"Argument `{old}", f"Argument `{new}", 1)) from None


def in_a_line(error: Exception) -> str:
    """Kind and text of an error."""
    text = " ".join(f"{type(error).__name__}: {error}".split()).removesuffix(":")
    return text if len(text) <= 200 else text[:199] + "…"


def reason(error: Exception) -> str:
    """The text of an error of the file system, or of a name that cannot be one."""
    return getattr(error, "strerror", None) or str(error)


def path(name: str, value) -> pathlib.Path:
    """A path, from a text or a path."""
    return pathlib.Path(kind(name, value, (str, os.PathLike), "be a path"))


# --- values -------------------------------------------------------------------------------------------


def concrete(value) -> bool:
    """Whether the value is known now, and may be looked at."""
    jax = sys.modules.get("jax")  # where it isn't loaded nothing is traced
    return jax is None or not isinstance(value, jax.core.Tracer)


def number(name: str, value, *, positive=False, at_least=None) -> "float | Array":
    """A finite real number (or a traced scalar); returned as it came."""
    if type(value) is float and math.isfinite(value) and at_least is None and (value > 0 or not positive):
        return value  # what most are
    import numpy as np

    if isinstance(value, (str, bytes, list, tuple, type(None))) or np.ndim(value) != 0:
        raise fail(name, "be a number", f"is {value!r}")
    if not concrete(value):
        return value
    try:
        known = float(value)
    except (TypeError, ValueError, OverflowError):
        raise fail(name, "be a number", f"is {value!r}") from None
    if not math.isfinite(known):
        raise fail(name, "be finite", f"is {known}")
    if positive and known <= 0:
        raise fail(name, "be positive", f"is {known:g}")
    if at_least is not None and known < at_least:
        raise fail(name, f"be at least {at_least:g}", f"is {known:g}")
    return value


def integer(name: str, value, *, at_least: int, at_most: int | None = None) -> int:
    """A Python integer not below `at_least` nor above `at_most`."""
    import numpy as np

    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise fail(name, "be an integer", f"is {value!r}")
    if value < at_least:
        raise fail(name, f"be at least {at_least}", f"is {value}")
    if at_most is not None and value > at_most:
        raise fail(name, f"be at most {at_most:,}", f"is {value}")
    return int(value)


def truth(name: str, value) -> bool:
    """A Python bool of True or False."""
    import numpy as np

    if not isinstance(value, (bool, np.bool_)):
        raise fail(name, "be True or False", f"is {value!r}")
    return bool(value)


def kind(name: str, value, of, must: str | None = None):
    """A value of a class, or of one of several; `must`: how the first is asked for, where that is no "be a …"."""
    if not isinstance(value, of):
        first = of[0] if isinstance(of, tuple) else of
        raise fail(name, must or f"be a {first.__name__}", f"is {type(value).__name__}")
    return value


def array(name: str, value, *shapes, finite=True, positive=False, at_least=None, most=None, of="numbers") -> "Array":
    """A real array of one of the shapes (None matches any length but 0); returned as one of float32 or float64.

    Args: most: what no entry is beyond, of either sign. of: what the entries are, such as "joint values".
    """
    import numpy as np

    jax: Any = sys.modules.get("jax")
    try:
        found: Any = value
        if not (isinstance(value, np.ndarray) or (jax is not None and isinstance(value, jax.Array))):
            traced = jax is not None and not all(map(concrete, jax.tree.leaves(value)))
            found = jax.numpy.asarray(value) if traced else np.asarray(value)
        if found.dtype.kind not in "iuf":  # NumPy would make numbers of "5", True and None
            raise TypeError
    except (TypeError, ValueError):
        raise fail(name, "be an array of real numbers", f"is {value!r}") from None
    if isinstance(found, np.ma.MaskedArray):
        found = np.ma.filled(found.astype(float), np.nan)
    if found.dtype.char not in "fd" or not found.dtype.isnative:  # JAX takes no other byte order
        found = found.astype(float)
    if shapes and found.shape not in shapes:
        if not any(_fits(found.shape, shape) for shape in shapes):
            raise _misshapen(name, found.shape, shapes, of)
        if not found.size:
            raise fail(name, f"hold {of}", "is empty")
    if concrete(found):
        known = np.asarray(found)
        # A product of finite numbers is mostly finite, and five times quicker than a look at each of few.
        if finite and not math.isfinite(np.vdot(known, known)) and not (good := np.isfinite(known)).all():
            where = tuple(map(int, np.argwhere(~good)[0]))
            raise fail(name, "be finite", f"is {known[where]}" + f" at index {where}" * (known.ndim > 0))
        if most is not None and (np.abs(known) > most).any():
            raise fail(name, f"be within ±{most:g}", f"reaches {np.abs(known).max():g}")
        if positive and (known <= 0).any():
            raise fail(name, "be positive", f"is {known.min():g}")
        if at_least is not None and (known < at_least).any():
            raise fail(name, f"be at least {at_least:g}", f"is {known.min():g}")
    return found


def _misshapen(name, shape, shapes, of):
    """The error for another shape: a list of another length has as many numbers, all else a shape."""
    lengths = [str(*s) for s in shapes if len(s) == 1]
    if len(shape) > 1 or "None" in lengths or all(len(s) > 1 for s in shapes):
        return fail(name, f"have shape {' or '.join(map(_show, shapes))}", f"has shape {_show(shape)}")
    wanted = ["be a single number"] * (() in shapes)
    lengths = [length for length in dict.fromkeys(lengths) if not (wanted and length == "1")]
    if lengths:
        wanted.append(f"have {' or '.join(lengths)} {of if lengths != ['1'] else of.removesuffix('s')}")
    wanted += [f"{'have ' * (not lengths)}shape {_show(s)}" for s in shapes if len(s) > 1]
    return fail(name, " or ".join(wanted), f"has {shape[0]}" if shape else "is a single number")


def _fits(shape, wanted):
    return len(shape) == len(wanted) and all(w is None or s == w for s, w in zip(shape, wanted, strict=True))


def _show(shape):
    return str(shape).replace("None", "n")


def traced(name: str, fn, *args):
    """Shapes of what a user's function makes of numbers that JAX traces."""
    import jax

    try:
        return jax.eval_shape(fn, *args)
    except ArgumentError:
        raise
    except Exception as error:
        must = "be of functions that JAX traces, such as jnp.sin and jnp.where, and give numbers"
        raise fail(name, must, f"raises {in_a_line(error)}") from error


# --- names --------------------------------------------------------------------------------------------


def one_of(name: str, value, names) -> str:
    """A name from a list; the nearest one is suggested."""
    if not isinstance(value, str) or value not in names:
        names = [str(n) for n in names]
        listed, near = ", ".join(names), nearest(value, names)
        listed = f"{len(names)} names" if near and len(listed) > _LISTED else listed
        raise fail(name, f"be one of {listed}", f"is {value!r}{near}")
    return value


def ending(name: str, path, *endings) -> str:
    """What the name of a file ends with, in small letters."""
    found = path.suffix.lower()
    if found not in endings:
        raise fail(name, f"end with {', '.join(endings)}", f"is {path.name!r}")
    return found


_ALIAS = {  # what the field calls methods and options that have short names here
    **dict.fromkeys(("euler", "forward euler", "explicit euler"), "ee"),
    **dict.fromkeys(("backward euler", "implicit euler"), "ie"),
    **dict.fromkeys(("dt", "timestep", "hz", "rate", "freq", "frequency"), "ts"),
    **dict.fromkeys(("latency", "dead-time", "dead_time"), "delay"),
    **{"gain": "alpha", "kp": "alpha", "lambda": "damping"},
}


def nearest(value, names) -> str:
    """Which of the names may have been meant, to stand behind a wrong one; nothing where none is near."""
    alike = {str(name).casefold(): name for name in names}
    folded = str(value).casefold()
    word = folded.lstrip("-")
    alias = folded.removesuffix(word) + _ALIAS.get(word, word)
    near = difflib.get_close_matches(alias if alias in alike else folded, alike, n=1, cutoff=0.6)
    return f" (did you mean {alike[near[0]]!r}?)" if near else ""


# --- input that is used, but is probably not meant ----------------------------------------------------


class Remark(UserWarning):
    """Input that can be used but is probably not meant: degrees as radians, millimetres as metres."""


def remark(text: str) -> None:
    """Warn the user, at their own line of Python; on the command line it is a line of its own, and in `--json`."""
    depth, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "cnclik":
        depth, frame = depth + 1, frame.f_back
    warnings.warn(_one_line(text), Remark, stacklevel=depth)
