"""Command line arguments into a verb's `Args`: a dataclass whose fields are its options.

The type of a field gives the number and kind of its option's values; the text below it is its help. Numbers with a
unit become numbers in the option's own unit. Every error is one line.
"""

import argparse
import ast
import dataclasses
import inspect
import itertools
import re
import textwrap
import typing

from cnclik import errors, quantities
from cnclik.cli import common

_NUMBER = re.compile(r"-\.?\d|-inf|-nan")


def option(default=dataclasses.MISSING, *, unit="1", metavar="", name="", about="", positional=False):
    """A field of `Args` that needs more than a type and a default.

    Args:
      default: the value, or a function that makes it. Without one the option must be given.
      unit: of its numbers, see `cnclik.quantities.units`.
      metavar: the word for a value in the help; by default its kind.
      name: of the option; by default the field's.
      about: its help, if there is no text below the field.
      positional: whether it is given by its place instead of a name.
    """
    made = {"default_factory" if callable(default) else "default": default}
    return dataclasses.field(
        **made, metadata={"unit": unit, "metavar": metavar, "name": name, "about": about, "positional": positional}
    )


class _Option(typing.NamedTuple):
    """An option and the values that it takes."""

    name: str
    field: str
    kind: "_Kind"
    default: typing.Any
    unit: str
    metavar: str
    about: str
    positional: bool

    @property
    def switch(self) -> bool:
        """Whether it takes no value."""
        return self.kind.base is bool


class _Kind(typing.NamedTuple):
    """The type of an option's values, and how many it has."""

    base: type
    choices: tuple = ()
    held_in: type | None = None  # tuple, for several values
    values: int | None = 1  # their number; None: any; 0: a switch
    optional: bool = False
    repeated: bool = False  # whether it may be given several times

    @property
    def numeric(self) -> bool:
        """Whether all values are numbers."""
        return self.base in (int, float)


def parse(Args, argv, *, prog, description):
    """`argv` as an instance of the dataclass `Args`; `--help` prints and exits.

    Its attribute `written` has {option: the unit that each of its numbers was given in, or None}.

    Raises: ArgumentError with the option, what it must be and what it is, or with the nearest name.
    """
    every, argv = _options(Args), [str(a) for a in argv]
    if {"-h", "--help"} & set(argv):
        more = Args.__doc__ if not Args.__doc__.startswith("Args(") else ""  # the text that dataclasses write
        _parser(every, prog, f"{description}\n\n{inspect.cleandoc(more)}").print_help()
        raise SystemExit(0)
    named, places = {one.name: one for one in every if not one.positional}, [one for one in every if one.positional]
    loose, given = _split(named, argv)
    if len(loose) > len(places):
        alone = " and ".join(one.name for one in places) or "nothing"
        raise errors.ArgumentError(f"What stands without an option must be {alone}, but is {' '.join(loose)!r}.")
    made = {one.field: _value(one.kind, [word]) for one, word in zip(places, loose, strict=False)}
    written, Ts = {}, next((one.default for one in every if one.field == "Ts"), None)
    for one, typed in sorted(given, key=lambda g: g[0].unit == quantities.SAMPLES):  # samples last: they need Ts
        values, units = _in_own_units(one, typed, Ts)
        name = one.name[2:].replace("-", "_")
        written[name] = (*written.get(name, ()), *units) if one.kind.repeated else units
        if not _fits(one.kind, values):
            found = f"{' '.join(typed)!r}" + (f", {' '.join(values)} {one.unit}" if values != typed else "")
            raise errors.ArgumentError(f"Option `{one.name}` must be {_words(one.kind)}, but is {found}.")
        value = _value(one.kind, values)
        made[one.field] = [*made.get(one.field, []), value] if one.kind.repeated else value
        Ts = value if one.field == "Ts" else Ts
    for one in every:
        if one.field not in made and one.default is dataclasses.MISSING:
            kind, what = ("Argument", f": {one.about.rstrip('.')}") if one.positional else ("Option", "")
            raise errors.ArgumentError(f"{kind} `{one.name}` must be given, but is not{what}.")
    args = Args(**made)
    object.__setattr__(args, "written", written)  # no field; the class may be frozen
    return args


def of_options(Args, said) -> str:
    """The text of an error or a remark on an option: options are named as they are written on the command line."""
    known, text = {one.name for one in _options(Args)}, str(said)

    def written(found):
        name = f"--{found[2].replace('_', '-')}"
        return f"{'Option ' * bool(found[1])}`{name}`" if name in known else found[0]

    first = re.match(_NAMED, text)
    return text if first is None or written(first) == first[0] else common.as_options(re.sub(_NAMED, written, text))


_NAMED = "(Argument )?`([^`]+)`"


def _options(Args) -> list:
    """The options of a dataclass, positional ones included."""
    hints, about, every = typing.get_type_hints(Args), _texts(Args), []
    for field in dataclasses.fields(Args):
        marks, lazy = field.metadata, field.default_factory
        positional, name = marks.get("positional", False), marks.get("name") or field.name
        kind = _kind(hints[field.name])
        metavar = marks.get("metavar") or (name.upper() if positional else _metavar(kind))
        every.append(_Option(
            metavar if positional else "--" + name.replace("_", "-"), field.name, kind,
            field.default if lazy is dataclasses.MISSING else lazy(), marks.get("unit", "1"), metavar,
            marks.get("about") or about.get(field.name, ""), positional,
        ))  # fmt: skip
    return every


def _texts(Args) -> dict:
    """{field: the text below it} of a dataclass and its bases."""
    found = {}
    for kind in reversed(Args.__mro__[:-1]):
        try:
            made: typing.Any = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
        except (OSError, TypeError):  # made by `make_dataclass`, or no source is there
            continue
        for field, text in itertools.pairwise(made.body):
            if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
                found[ast.unparse(field.target)] = " ".join(ast.literal_eval(text.value).split())
    return found


def _split(named, argv):
    """(positional words, [(option, its values)]); the values of --no-NAME are ["False"].

    Raises: ArgumentError for an unknown option, or one without a value.
    """
    off = {"--no-" + name[2:]: one for name, one in named.items() if one.switch}
    loose, given, queue = [], [], list(argv)
    while queue:
        token = queue.pop(0)
        if not _is_option(token):
            loose.append(token)
            continue
        typed, equals, value = token.partition("=")
        name = "--" + typed.lstrip("-").replace("_", "-")
        name = "--smoothing" if name == "--filter" and "--smoothing" in named else name
        one = (named | off).get(name)
        if one is None or not typed.startswith("--"):
            raise _unknown(named, typed, value if equals else "".join(queue[:1]))
        values = [value] if equals else _values(one, queue)
        queue = queue if equals else queue[len(values) :]
        if not values and not one.switch:
            raise errors.ArgumentError(f"Option `{name}` must be given {_words(one.kind)}, but has no value.")
        if one.switch and values in ([], ["True"], ["False"]):
            values = [str((values != ["False"]) is (name not in off))]
        given.append((one, values))
    return loose, given


def _values(one, queue) -> list:
    """The values that an option takes from the head of a queue; a separate unit counts as one of them."""
    values = list(itertools.takewhile(lambda t: not _is_option(t), queue))
    most = one.kind.values
    if most is not None and values[most : most + 1] and values[most] in quantities.units(one.unit):
        most += 1
    return values[:most]


def _in_own_units(one, values, Ts):
    """(values as numbers without units, their units). A value that is no number passes, and is refused later."""
    if not one.kind.numeric or values == ["None"] or not values:
        return values, ()
    try:
        found = quantities.read(" ".join(values), one.unit, Ts)
    except ValueError as error:
        rate = _as_time(" ".join(values)) if one.field == "Ts" else ""
        raise errors.ArgumentError(f"Option `{one.name}` must be {_words(one.kind)}, but {error}.{rate}") from None
    if not any(found.written) and len(found) == len(values):
        return values, found.written
    return [f"{v:.0f}" if v.is_integer() and abs(v) < 1e15 else repr(v) for v in found], found.written


def _is_option(token) -> bool:
    return token.startswith("-") and len(token) > 1 and not _NUMBER.match(token)


def _unknown(named, found, value):
    """The error for an unknown option. Args: value: the word after it."""
    rate = _as_time(f"{value}Hz") if "--Ts" in named and found.lstrip("-") in ("hz", "rate", "frequency") else ""
    try:
        errors.one_of("Option", found, list(named))
    except errors.ArgumentError as error:
        return errors.ArgumentError(str(error).replace("Argument `Option`", "Option", 1) + rate)


def _as_time(text) -> str:
    """A sentence with the sampling time of a rate such as "250Hz"; "" if the value is no rate."""
    rate = re.fullmatch(r"([0-9.]+) *(?:Hz)+", text, re.IGNORECASE)
    hertz = (quantities.number(rate[1]) if rate else None) or 0.0
    return f" A rate of {hertz:g} Hz is --Ts {1e3 / hertz:.6g}ms." if hertz > 0 else ""


# --- types --------------------------------------------------------------------------------------------


def _kind(hint) -> _Kind:
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Literal:
        return _Kind(str, choices=inner)
    if origin is list:
        return _kind(inner[0])._replace(repeated=True)
    if origin is tuple:
        return _kind(inner[0])._replace(held_in=tuple, values=None if ... in inner else len(inner))
    if origin:  # such as `float | None`
        return _kind(inner[0])._replace(optional=True)
    return _Kind(hint, values=0 if hint is bool else 1)


def _fits(kind, values) -> bool:
    if kind.optional and values == ["None"]:
        return True
    if kind.base is bool:
        return values in (["True"], ["False"])
    return kind.values in (None, len(values)) and all(_is_one(kind, v) for v in values)


def _is_one(kind, value) -> bool:
    if kind.choices:
        return value in kind.choices
    if kind.base is int:
        return re.fullmatch("[+-]?[0-9]{1,999}", value) is not None
    return kind.base is not float or quantities.number(value) is not None


def _value(kind, values):
    """Values converted to a kind that they fit."""
    if kind.optional and values == ["None"]:
        return None
    if kind.base is bool:
        return values == ["True"]
    made = [kind.base(v) for v in values]
    return kind.held_in(made) if kind.held_in else made[0]


def _words(kind) -> str:
    """A kind in words: "an integer", "one of a, b", "3 numbers"."""
    if kind.choices:
        return f"{'some' if kind.held_in else 'one'} of {', '.join(kind.choices)}"
    if kind.held_in:
        each = {int: "integers", float: "numbers"}.get(kind.base, "values")
        return f"{kind.values} {each}" if kind.values else each
    words = {int: "an integer", float: "a number", str: "a text", bool: "True or False"}
    return words.get(kind.base, f"a {kind.base.__name__}".lower())


# --- help ---------------------------------------------------------------------------------------------


def _metavar(kind) -> str:
    """The words for an option's values in the help: "X", "INT INT", "NAME ...", "{one,two}"."""
    one = {int: "INT", float: "X", str: "NAME"}.get(kind.base, "PATH")
    one = "{" + ",".join(kind.choices) + "}" if kind.choices else one
    return " ".join([one] * kind.values) if kind.values else f"{one} ..."


class _Form(argparse.RawDescriptionHelpFormatter):
    """Help without breaks within a name, such as EXP-RK4."""

    def _split_lines(self, text, width):
        return textwrap.wrap(text, width, break_on_hyphens=False)


def _parser(every, prog, description):
    """The parser that prints the help."""
    needed = {one.name: one.default is dataclasses.MISSING for one in every if one.positional}
    usage = " ".join([prog, "[options]", *(name if must else f"[{name}]" for name, must in needed.items())])
    parser = argparse.ArgumentParser(prog, usage, description.strip(), formatter_class=_Form)
    for one in every:
        about = one.about.replace("%", "%%")
        if one.default not in (None, False, (), [], dataclasses.MISSING):
            shown = " ".join(map(str, one.default)) if isinstance(one.default, tuple) else one.default
            about = f"{about} (default: {'on' if shown is True else shown})"
        if one.positional:
            parser.add_argument(one.field, metavar=one.name, help=about)
        elif one.switch:
            parser.add_argument(one.name, "--no-" + one.name[2:], action="store_true", dest=one.field, help=about)
        else:
            parser.add_argument(one.name, metavar=one.metavar, dest=one.field, help=about)
    return parser
