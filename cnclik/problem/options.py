"""Options: the names, units and defaults by which a loop is described.

The command line, sweeps and Python share the arguments of `problem_from` and the fields of `Drive`. An option's kind
and default are those of the signature; its help, unit and condition those of the docstring. The sources are read, not
imported: help needs no JAX.
"""

import ast
import pathlib
import re
from typing import Any, NamedTuple

from cnclik import errors
from cnclik.quantities import SAMPLES, read_each

NAME, NUMBER, NUMBERS, INTEGER = "name", "number", "numbers", "integer"
_KINDS = {"str": NAME, "MethodLike": NAME, "int": INTEGER, "float": NUMBER, "Number": NUMBER}
_FITS = {"positive": lambda v: v > 0, "at least 0": lambda v: v >= 0, "other than 0": lambda v: v != 0}


class Option(NamedTuple):
    """One argument that describes a loop."""

    kind: str  # NAME, NUMBER, NUMBERS or INTEGER
    help: str
    default: Any
    unit: str  # or "q", the unit of the joints; "x", the metres of a point; "1"
    must: str  # condition on each number: a key of `_FITS`, or ""


def arguments(file: str, name: str) -> dict[str, Option]:
    """Return {argument: Option} of a function or a record in a file of the package, such as "integrate/drive.py"."""
    tree = ast.parse((pathlib.Path(__file__).parents[1] / file).read_text(encoding="utf-8"))
    node: Any = next(one for one in tree.body if getattr(one, "name", "") == name)
    if isinstance(node, ast.ClassDef):
        each = [
            (ast.unparse(one.target), one.annotation, one.value) for one in node.body if isinstance(one, ast.AnnAssign)
        ]
    else:
        defaults = [*[None] * len(node.args.args), *node.args.kw_defaults]
        signature = zip((*node.args.args, *node.args.kwonlyargs), defaults, strict=True)
        each = [(one.arg, one.annotation, default) for one, default in signature]
    texts = dict(re.findall(r"^  (\w+): (.+(?:\n    .+)*)", ast.get_docstring(node) or "", re.M))
    return {
        key: _option(ast.unparse(annotation), default and ast.literal_eval(default), " ".join(texts[key].split()))
        for key, annotation, default in each
        if key in texts
    }


def _option(annotation, default, text) -> Option:
    hint = annotation.removesuffix(" | None")
    kind = _KINDS.get(hint, NUMBERS if re.search("Array|Point|tuple", hint) else NAME)
    found = re.search(r"\[([^]]+)\]", text)
    unit = found[1].removeprefix("whole ") if found and kind != NAME else "1"
    unit = "x" if hint == "Point" else {"rad, m": "q"}.get(unit, unit)
    must = next((words for words in _FITS if re.search(rf"\b{words}\b", text)), "")
    return Option(kind, text[0].upper() + text[1:], default, unit, must)


DRIVE = {name: one._replace(default=None) for name, one in arguments("integrate/drive.py", "Drive").items()}
OPTIONS = arguments("problem/build.py", "problem_from") | DRIVE
DEFAULTS = {name: one.default for name, one in OPTIONS.items() if one.default is not None}


def check_values(where: str, name: str, values) -> None:
    """Raise ArgumentError unless the option may have all numbers of an array."""
    must = OPTIONS[name].must if name in OPTIONS else ""
    if must and (wrong := ~_FITS[must](values)).any():
        raise errors.fail(where, f"hold values that are {must}", f"holds {values[wrong][0]:g}")


def in_own_units(given: dict) -> tuple:
    """({option: value}, {option: the unit of each number}); texts such as "34ms" become numbers in the option's unit.

    Raises: ArgumentError for a text that holds no such numbers, or no unit.
    """
    made, written = dict(given), {}
    texts = [name for name, value in given.items() if _is_text(value, OPTIONS[name].kind)]
    for name in sorted(texts, key=lambda name: OPTIONS[name].unit == SAMPLES):  # samples last: they need Ts
        kind, _, _, unit, _ = OPTIONS[name]
        value, Ts = given[name], made.get("Ts", DEFAULTS["Ts"])
        if unit == SAMPLES and not errors.concrete(errors.number("Ts", Ts, positive=True)):
            raise errors.fail(name, "be in samples where `Ts` is traced", f"is {value!r}")
        try:
            found = read_each([value] if isinstance(value, str) else value, unit, Ts)
        except ValueError as error:
            each = ", a list of numbers" * (kind == NUMBERS)
            raise errors.fail(name, f"be a number{each}, or a text of numbers with their unit", str(error)) from None
        if kind == INTEGER and not found[0].is_integer():
            raise errors.fail(name, "be an integer", f"is {value!r}, {found[0]:g} {unit}")
        written[name] = found.written
        several = len(found) > 1 or not isinstance(value, str)
        made[name] = list(found) if several else int(found[0]) if kind == INTEGER else found[0]
    return made, written


def _is_text(value, kind) -> bool:
    """Whether the numbers of an option are given as a text, or as a list that holds one."""
    several = kind == NUMBERS and isinstance(value, (list, tuple))
    return kind != NAME and (isinstance(value, str) or (several and any(isinstance(v, str) for v in value)))


def check_units(chain, task, written: dict) -> None:
    """Raise ArgumentError if a unit does not fit what it is for: degrees for a prismatic joint or a position.

    Args: written: {option: the given unit of each number, or None}; see `cnclik.quantities.read`.
    """
    parts, axes = ["m"] * bool(task.lengths) + ["rad"] * bool(task.angles), list(task.units)
    size = parts[:1] if task.lengths else ["1"]  # of a singular value
    wanted = {"error_clamp": parts, "noise": axes, "damping": size, "threshold": size}
    wanted |= {"tolerance": ["m", "rad"], "accept": ["m", "rad"]}
    for name, units in written.items():
        of_joints = name in ("near", "jump") or (name in OPTIONS and OPTIONS[name].unit == "q")
        for k, unit in enumerate(list(chain.units) if of_joints else wanted.get(name, ())):
            given = units[k if len(units) > k else 0] if units else None
            if given and given.partition("/")[0] != unit:
                what = f"joint {chain.joint_names[k]!r} is in {unit}" if of_joints else f"number {k + 1} is in {unit}"
                raise errors.fail(name, "have the units of what it is for", f"{what}, and {given} is given")


def units(law, task, width=None) -> dict:
    """{option: unit} for a law's joints and a task.

    Args:
      width: number of values of a point; those after the position are a quaternion's, without unit.
    """
    point = ["m"] * bool(task.lengths) + ["1"] * (not task.lengths or bool(task.angles and (width or 0) > 3))
    known = {"q": ", ".join(dict.fromkeys(law.chain.units)), "x": ", ".join(point)}
    known["m, 1"] = "m" if task.lengths else "1"
    return {name: known.get(one.unit, one.unit) for name, one in OPTIONS.items() if one.kind != NAME}
