"""Command line arguments into a verb's `Args`: a dataclass whose fields are its options.

The type of a field gives the number and kind of its option's values; the text below it is its help. Numbers with a
unit become numbers in the option's own unit. Every error is one line.
"""

import ast
import dataclasses
import inspect
import itertools
import re
import shutil
import textwrap
import types
import typing

from cnclik import errors, quantities

OUTPUT = ("out", "overwrite", "json", "csv", "figures")  # options of the last group of the help
_NUMBER = re.compile(r"-\.?\d|-inf|-nan")


def option(default=dataclasses.MISSING, *, unit="1", metavar="", about="", positional=False, group=""):
    """A field of `Args` that needs more than a type and a default.

    Args:
      default: the value, or a function that makes it. Without one the option must be given.
      unit: of its numbers, see `cnclik.quantities.units`.
      metavar: the word for its values in the help; by default their kind.
      about: its help, if there is no text below the field.
      positional: whether it is given by its place instead of a name.
      group: its title in the help; by default the verb's own, or "output".
    """
    made = {"default_factory" if callable(default) else "default": default}
    marks = {"unit": unit, "metavar": metavar, "about": about, "positional": positional, "group": group}
    return dataclasses.field(**made, metadata=marks)


class _Option(typing.NamedTuple):
    """An option and the values that it takes."""

    name: str
    field: str
    base: type  # of each value
    choices: tuple
    number: int | None  # of values; None: any; 0: a switch
    several: bool  # whether they are a tuple
    repeated: bool  # whether it may be given several times
    default: typing.Any
    unit: str
    metavar: str
    about: str
    positional: bool
    group: str

    def value(self, words):
        """Return the value of some words. Raises: ArgumentError where they don't fit."""
        if self.number == 0:
            return words == ["on"]
        if self.number not in (None, len(words)) or not all(map(self._takes, words)):
            raise self.error(f"is {' '.join(words)!r}")
        made = [self.base(word) for word in words]
        return tuple(made) if self.several else made[0]

    def _takes(self, word) -> bool:
        if self.choices:
            return word in self.choices
        if self.base is int:
            return re.fullmatch("[+-]?[0-9]{1,999}", word) is not None
        return self.base is not float or quantities.number(word) is not None

    def error(self, found, must="be"):
        """The error for values that are no such ones."""
        words = {int: "an integer", float: "a number", str: "a text"}.get(self.base, "a path")
        if self.choices:
            words = f"{'some' if self.several else 'one'} of {', '.join(self.choices)}"
        elif self.several:
            words = {int: "integers", float: "numbers"}.get(self.base, "values")
            words = f"{self.number} {words}" if self.number else words
        return errors.ArgumentError(f"Option `{self.name}` must {must} {words}, but {found}.")


def parse(Args, argv, *, prog, description):
    """`argv` as an instance of the dataclass `Args`; `--help` prints and exits.

    Its attribute `written` has {option: the unit that each of its numbers was given in, or None}.

    Raises: ArgumentError with the option, what it must be and what it is, or with the nearest name.
    """
    every, argv = options_of(Args), [str(a) for a in argv]
    if {"-h", "--help"} & set(argv):
        more = Args.__doc__ if not Args.__doc__.startswith("Args(") else ""  # the text that dataclasses write
        print(_help(every, prog, f"{description}\n\n{inspect.cleandoc(more)}".strip()))
        raise SystemExit(0)
    named, places = {one.name: one for one in every if not one.positional}, [one for one in every if one.positional]
    loose, given = _split(named, argv, prog)
    if len(loose) > len(places):
        alone = " and ".join(one.name for one in places) or "nothing"
        raise errors.ArgumentError(f"What stands without an option must be {alone}, but is {' '.join(loose)!r}.")
    made = {one.field: one.value([word]) for one, word in zip(places, loose, strict=False)}
    written, Ts = {}, next((one.default for one in every if one.field == "Ts"), None)
    for one, typed in sorted(given, key=lambda g: g[0].unit == quantities.SAMPLES):  # samples last: they need Ts
        words, units = _in_own_units(one, typed, Ts)
        value = one.value(words)
        written[one.field] = (*written.get(one.field, ()), *units) if one.repeated else units
        made[one.field] = [*made.get(one.field, []), value] if one.repeated else value
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
    known, text = {one.name for one in options_of(Args)}, str(said)

    def written(found):
        name = f"--{found[2].replace('_', '-')}"
        return f"{'Option ' * bool(found[1])}`{name}`" if name in known else found[0]

    return re.sub("(Argument )?`([^`]+)`", written, text)


def options_of(Args) -> list:
    """The options of a dataclass, positional ones included."""
    hints, about, every = typing.get_type_hints(Args), _texts(Args), []
    for field in dataclasses.fields(Args):
        marks, lazy, hint = field.metadata, field.default_factory, hints[field.name]
        repeated = typing.get_origin(hint) is list
        hint = typing.get_args(hint)[0] if repeated else hint
        if typing.get_origin(hint) in (types.UnionType, typing.Union):  # such as `float | None`
            hint = typing.get_args(hint)[0]
        several = typing.get_origin(hint) is tuple
        inner = typing.get_args(hint) if several else (hint,)
        choices = typing.get_args(inner[0]) if typing.get_origin(inner[0]) is typing.Literal else ()
        base = str if choices else inner[0]
        count = 0 if base is bool else None if ... in inner else len(inner)
        positional, word = marks.get("positional", False), {int: "INT", float: "X", str: "NAME", bool: ""}
        values = "{" + ",".join(choices) + "}" if choices else word.get(base, "PATH")
        values = f"{values} ..." if count is None else " ".join([values] * count)
        metavar = marks.get("metavar") or (field.name.upper() if positional else values)
        every.append(_Option(
            metavar if positional else "--" + field.name.replace("_", "-"), field.name, base, choices, count, several,
            repeated, field.default if lazy is dataclasses.MISSING else lazy(), marks.get("unit", "1"), metavar,
            marks.get("about") or about.get(field.name, ""), positional,
            marks.get("group") or "output" * (field.name in OUTPUT),
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


def _split(named, argv, prog):
    """(positional words, [(option, its words)]); of a switch the word is "on" or "off".

    Raises: ArgumentError for an unknown option, or one without a value.
    """
    switches = {f"--no-{name[2:]}": one for name, one in named.items() if one.number == 0}
    loose, given, queue = [], [], list(argv)
    while queue:
        token = queue.pop(0)
        if not _is_option(token):
            loose.append(token)
            continue
        typed, equals, value = token.partition("=")
        name = "--" + typed.lstrip("-").replace("_", "-")
        one = (named | switches).get(name)
        if one is None or not typed.startswith("--") or (equals and one.number == 0):
            raise _unknown(named, token if one else typed, value if equals else "".join(queue[:1]), prog)
        if one.number == 0:
            given.append((one, ["off" if name in switches else "on"]))
            continue
        words = [value] if equals else _words(one, queue)
        queue = queue if equals else queue[len(words) :]
        if not words:
            raise one.error("has no value", "be given")
        given.append((one, words))
    return loose, given


def _words(one, queue) -> list:
    """The words of an option at the head of a queue; a separate unit counts as one of them."""
    words, most = list(itertools.takewhile(lambda t: not _is_option(t), queue)), one.number
    if most is not None and words[most : most + 1] and words[most] in quantities.units(one.unit):
        most += 1
    return words[:most]


def _in_own_units(one, words, Ts):
    """(words as numbers without units, their units). A word that is no number passes, and is refused later."""
    if one.base not in (int, float):
        return words, ()
    try:
        found = quantities.read(" ".join(words), one.unit, Ts)
    except ValueError as error:
        rate = _as_time(" ".join(words)) if one.field == "Ts" else ""
        raise errors.ArgumentError(f"{str(one.error(error)).removesuffix('.')}.{rate}") from None
    if not any(found.written) and len(found) == len(words):
        return words, found.written
    return [f"{v:.0f}" if v.is_integer() and abs(v) < 1e15 else repr(v) for v in found], found.written


def _is_option(token) -> bool:
    return token.startswith("-") and len(token) > 1 and not _NUMBER.match(token)


def _unknown(named, typed, value, prog):
    """The error for an unknown option. Args: value: the word after it."""
    rate = _as_time(f"{value}Hz") if "--Ts" in named and typed.lstrip("-") in ("hz", "rate", "frequency") else ""
    near = re.search("'(.*)'", errors.nearest(typed, named))
    instead = f"did you mean {near[1]}?" if near else f"`{prog} --help` lists the options."
    return errors.ArgumentError(f"Unknown option {typed}; {instead}{rate}")


def _as_time(text) -> str:
    """A sentence with the sampling time of a rate such as "250Hz"; "" if the value is no rate."""
    rate = re.fullmatch(r"([0-9.]+) *(?:Hz)+", text, re.IGNORECASE)
    hertz = (quantities.number(rate[1]) if rate else None) or 0.0
    return f" A rate of {hertz:g} Hz is --Ts {1e3 / hertz:.6g}ms." if hertz > 0 else ""


# --- help ---------------------------------------------------------------------------------------------


def _help(every, prog, description) -> str:
    """The help: options in groups, positional arguments first and output last."""
    width = min(shutil.get_terminal_size().columns, 120)
    needed = {one.name: one.default is dataclasses.MISSING for one in every if one.positional}
    usage = " ".join(["usage:", prog, "[options]", *(name if must else f"[{name}]" for name, must in needed.items())])
    titles = dict.fromkeys(["", *(one.group for one in every if one.group != "output"), "output"])
    lines = [usage, "", description]
    for title in titles:
        some = [one for one in every if one.group == title]
        lines += ["", f"{title or 'options'}:"] * bool(some)
        for one in some:
            shown = " ".join(map(str, one.default)) if isinstance(one.default, tuple) else one.default
            shown = None if one.default in (None, False, (), [], dataclasses.MISSING) else shown
            default = "" if shown is None else f" (default: {'on' if shown is True else shown})"
            off = f", --no-{one.name[2:]}" * (one.default is True)
            head = f"  {one.name}{off} {'' if one.positional else one.metavar}".rstrip()
            text = textwrap.wrap(one.about + default, width - 26, break_on_hyphens=False)
            first = [f"{head:<25} {text.pop(0)}"] if len(head) < 26 and text else [head]
            lines += [*first, *(f"{'':25} {line}" for line in text)]
    return "\n".join(lines)
