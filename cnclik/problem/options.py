"""Options: one vocabulary for the command line, sweeps and Python.

An option is an argument of a function or a field of a record. Its kind and default are those of the signature; its
help and unit those of the docstring. Sources are read, not imported: help needs no JAX.
"""

import ast
import dataclasses
import pathlib
import re
from typing import Any, NamedTuple

from cnclik import errors
from cnclik.quantities import SAMPLES, Quantities, read_each

ROBOTS = {"panda": "flange", "ur5": "tool flange"}  # built-in ones by name, {name: its tip}
PLANAR = dict.fromkeys(("planar", "planar-clockwise"), "end of the last link")  # planar:1,1; the paper's turn clockwise
TASKS = ("pose", "position", "orientation")
NAME, NUMBER, INTEGER, SWITCH = "name", "number", "integer", "switch"
REQUIRED = object()  # the default of what must be given
_KINDS = {"bool": SWITCH, "int": INTEGER, "float": NUMBER, "Number": NUMBER, "Point": NUMBER}
_IN_WORDS = {NAME: "a text", NUMBER: "a number", INTEGER: "an integer"}


class Option(NamedTuple):
    """One argument, as signature and docstring describe it."""

    name: str
    kind: str  # NAME, NUMBER, INTEGER or SWITCH
    several: bool  # whether it takes any number of values
    choices: tuple
    default: Any
    positional: bool
    unit: str  # or "q", the unit of the joints; "x", the metres of a point; "1"
    help: str

    @property
    def values(self) -> str:
        """What it takes, in words."""
        if self.choices:
            return f"{'some' if self.several else 'one'} of {', '.join(self.choices)}"
        return f"{_IN_WORDS[self.kind].split()[1]}s" if self.several else _IN_WORDS[self.kind]


def source(file: str) -> str:
    """The source of a file of the package, such as "integrate/drive.py"."""
    return (pathlib.Path(__file__).parents[1] / file).read_text(encoding="utf-8")


def arguments(text: str, name: str, shared=None) -> dict[str, Option]:
    """Return {argument: Option} of a function or a record that a source defines.

    Arguments in front of the `*` are positional. Args: shared: {argument: help} of those without a line of their own.
    """
    node: Any = next(one for one in ast.parse(text).body if getattr(one, "name", "") == name)
    each: Any
    if isinstance(node, ast.ClassDef):
        fields = (v for v in node.body if isinstance(v, ast.AnnAssign))
        each = [(ast.unparse(v.target), v.annotation, v.value, False) for v in fields]
    else:
        places, named, of_places = node.args.args, node.args.kwonlyargs, node.args.defaults
        defaults = [*[None] * (len(places) - len(of_places)), *of_places, *node.args.kw_defaults]
        pairs = zip((*places, *named), defaults, strict=True)
        each = [(v.arg, v.annotation, default, v in places) for v, default in pairs]
    lines = re.findall(r"^  (\w+): (.+(?:\n    .+)*)", ast.get_docstring(node) or "", re.M)
    texts = (shared or {}) | {key: " ".join(words.split()) for key, words in lines}
    return {key: _option(key, texts[key], *about) for key, *about in each if key in texts}


def _option(name, text, annotation, default, positional):
    hint = ast.unparse(annotation).removesuffix(" | None")
    inner = re.sub(r"^tuple\[(.*), \.\.\.\]$", r"\1", hint)
    kind = _KINDS.get(inner, NUMBER if "Array" in inner else NAME)
    unit = re.search(r"\[([^]]+)\]", text)
    own = unit[1].removeprefix("whole ") if unit and kind in (NUMBER, INTEGER) else "1"
    return Option(
        name,
        kind,
        several=re.search("Array|Point|tuple", hint) is not None,
        choices=ast.literal_eval(f"({inner[8:-1]},)") if inner.startswith("Literal[") else (),
        default=REQUIRED if default is None else ast.literal_eval(default),
        positional=positional,
        unit="x" if inner == "Point" else {"rad, m": "q"}.get(own, own),
        help=text[0].upper() + text[1:],
    )


DRIVE = {name: one._replace(default=None) for name, one in arguments(source("integrate/drive.py"), "Drive").items()}
OPTIONS = arguments(source("problem/build.py"), "problem_from") | DRIVE
DEFAULTS = {name: one.default for name, one in OPTIONS.items() if one.default not in (None, REQUIRED)}


# --- values -------------------------------------------------------------------------------------------


def numbers_of(one: Option, value, Ts=None) -> Quantities:
    """Return the numbers of a text such as "34ms", or of a list that holds such texts, in the option's own unit.

    Args: Ts: the sampling time [s], by which times become samples.
    """
    try:
        numbers = read_each([value] if isinstance(value, str) else value, one.unit, Ts, marked=False)
    except ValueError as error:
        raise errors.fail(one.name, f"be {one.values}", str(error)) from None
    for v in numbers:
        if one.kind == INTEGER and not v.is_integer():
            raise errors.fail(one.name, "be an integer", f"is {value!r}")
    return numbers


def in_own_units(given: dict, Ts=DEFAULTS["Ts"]) -> dict:
    """Return {option: value} with texts such as "34ms" as numbers in the option's own unit. Args: Ts: if not given."""
    made = dict(given)
    for name in sorted(given, key=lambda name: OPTIONS[name].unit == SAMPLES):  # samples last: they need Ts
        one, value = OPTIONS[name], given[name]
        several = one.several and isinstance(value, (list, tuple)) and any(isinstance(v, str) for v in value)
        if one.kind != NAME and (isinstance(value, str) or several):
            of = made.get("Ts", Ts) if one.unit == SAMPLES else None
            value = numbers_of(one, value, of and errors.number("Ts", of, positive=True))
        if isinstance(value, Quantities) and len(value) == 1 and one.unit not in ("q", "x"):
            value = (int if one.kind == INTEGER else float)(value[0])
        made[name] = value
    return made


def drive_from(given, drive=None):
    """Return a drive with the options of a table in place of its own, of which lists are one number per joint."""
    from cnclik.integrate.drive import Drive  # here, as help needs none

    given = {name: v for name, v in given.items() if v is not None}
    given |= {name: errors.array(name, v, (None,)) for name, v in given.items() if isinstance(v, (tuple, list))}
    if "smoothed" in given and not {"smoothing", "cutoff"} & set(given) and not (drive and drive.filters):
        raise errors.fail("smoothed", "come with a smoothing or a cutoff", "comes without")
    return dataclasses.replace(drive or Drive(), **given) if given else drive


def check_units(name: str, values, chain) -> None:
    """Raise ArgumentError if the unit of a number, as a `Quantities` has it, is not that of its joint."""
    for joint, unit, given in zip(chain.joint_names, chain.units, getattr(values, "written", ()), strict=False):
        if given and given != unit:
            found = f"joint {joint!r} is in {unit}, and {given} is given"
            raise errors.fail(name, "have the units of what it is for", found)
