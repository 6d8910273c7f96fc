"""Command line arguments into a verb's `Args`; whatever is wrong with them comes out as one line.

The arguments are held against the dataclass before tyro reads them, so that no message depends on tyro's wording, and
numbers with a unit become numbers in the option's own.
"""

import contextlib
import dataclasses
import io
import itertools
import re
import typing

import tyro

from cnclik import errors, quantities

_FRAME = re.compile("[^\x20-\u024f\u0370-\u03ff]+")  # what tyro draws around its messages
_NUMBER = re.compile(r"-\.?\d|-inf|-nan")


@dataclasses.dataclass(frozen=True)
class Unit:
    """Mark of an option: the unit of its numbers, see `cnclik.quantities.units`."""

    unit: str


class _Kind(typing.NamedTuple):
    """What an option takes: a type, and the unit of its numbers; and whether it must be given."""

    hint: object
    unit: str = "1"
    required: bool = False


def parse(Args, argv, *, prog, description):
    """`argv` as an instance of the dataclass `Args`; `--help` prints and exits as tyro does.

    Its attribute `written` has {option: the unit that each of its numbers was given in, or None}.

    Raises: ArgumentError naming the option, what it must be and what it is, or the nearest name.
    """
    argv, written = [str(a) for a in argv], {}
    if not {"-h", "--help"} & set(argv):
        argv, written = _checked(Args, argv)
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            made = tyro.cli(Args, args=argv, prog=prog, description=description)
        object.__setattr__(made, "written", written)  # beside the fields, of frozen ones too
        return made
    except SystemExit as leaving:
        if not leaving.code:
            raise
    raise errors.ArgumentError(" ".join(_FRAME.sub(" ", said.getvalue()).split()))


def _checked(Args, argv):
    """(argv with numbers in the options' own units, units as they were written).

    Raises: ArgumentError for an unknown option, a value of the wrong kind, one too many or one missing.
    """
    options, positionals = _fields(Args)
    switches = {"--no-" + name[2:]: kind for name, kind in options.items() if kind.hint is bool}
    loose, queue, given = [], list(argv), []
    while queue:
        token = queue.pop(0)
        if not _is_option(token):
            loose.append(token)
            continue
        written, equals, value = token.partition("=")
        name = "--" + written.lstrip("-").replace("_", "-")
        kind = (options | switches).get(name)
        if kind is None or not written.startswith("--"):
            raise _unknown(options, written)
        values = [value] if equals else _values(kind, queue)
        queue = queue if equals else queue[len(values) :]
        if not values and _least(kind.hint):
            raise errors.ArgumentError(f"Option `{name}` must be given {_words(kind.hint)}, but has no value.")
        given.append((name, kind, values))
    given.sort(key=lambda one: one[1].unit == quantities.SAMPLES)  # a time is samples once the sampling time is known
    Ts, units, tokens = next((f.default for f in dataclasses.fields(Args) if f.name == "Ts"), None), {}, []
    for name, kind, values in given:
        values, units[name[2:].replace("-", "_")] = _in_own_units(name, kind, values, Ts)
        if not _fits(kind.hint, values):
            raise errors.ArgumentError(f"Option `{name}` must be {_words(kind.hint)}, but is {' '.join(values)!r}.")
        Ts = quantities.number(values[0]) if name == "--Ts" else Ts
        tokens += [name, *values]
    most = sum(_most(hint) or len(loose) for hint, _, _ in positionals.values())
    if len(loose) > most:
        raise _unknown(options, loose[most])
    for name, (_, required, what) in list(positionals.items())[len(loose) :]:
        if required:
            raise errors.ArgumentError(f"Argument `{name}` must be given, but is not{': ' + what if what else ''}.")
    for name, kind in options.items():
        if kind.required and all(name != one for one, *_ in given):
            raise errors.ArgumentError(f"Option `{name}` must be given, but is not.")
    return [*loose, *tokens], units


def _values(kind, queue) -> list:
    """The values at the head of a queue that an option takes, a unit that stands apart among them."""
    values = list(itertools.takewhile(lambda t: not _is_option(t), queue))
    most = _most(kind.hint)
    if most is not None and values[most : most + 1] and values[most] in quantities.units(kind.unit):
        most += 1
    return values[:most]


def _in_own_units(name, kind, values, Ts):
    """(values as numbers without units, the units that they had); what is no number passes, and fits nothing."""
    if not _is_numeric(kind.hint) or values == ["None"] or not values:
        return values, ()
    try:
        found = quantities.read(" ".join(values), kind.unit, Ts)
    except ValueError as error:
        raise errors.ArgumentError(f"Option `{name}` must be {_words(kind.hint)}, but {error}.") from None
    if not any(found.written) and len(found) == len(values):
        return values, found.written
    return [f"{v:.0f}" if v.is_integer() and abs(v) < 1e15 else repr(v) for v in found], found.written


def _is_option(token) -> bool:
    return token.startswith("-") and len(token) > 1 and not _NUMBER.match(token)


def _unknown(options, found):
    try:
        errors.one_of("Option", found, list(options))
    except errors.ArgumentError as error:
        return errors.ArgumentError(str(error).replace("Argument `Option`", "Option", 1))


def _fields(Args):
    """({"--name": _Kind}, {"NAME": (type, required, what it is)}): the options of a dataclass and its positionals."""
    hints, marked = typing.get_type_hints(Args), typing.get_type_hints(Args, include_extras=True)
    options, positionals = {}, {}
    for field in dataclasses.fields(Args):
        marks = getattr(marked[field.name], "__metadata__", ())
        about = {key: v for m in marks for key in ("name", "metavar", "help") if (v := getattr(m, key, None))}
        required = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        if tyro.conf.Positional in marks:
            name = about.get("metavar", field.name.upper())
            positionals[name] = hints[field.name], required, about.get("help", "").rstrip(".")
        else:
            append = tyro.conf.UseAppendAction in marks
            hint = hints[field.name]
            hint = typing.get_args(hint)[0] if append else hint
            unit = next((m.unit for m in marks if isinstance(m, Unit)), "1")
            options["--" + about.get("name", field.name).replace("_", "-")] = _Kind(hint, unit, required)
    return options, positionals


# --- types --------------------------------------------------------------------------------------------


def _parts(hint):
    """(origin, arguments) of a type, None left out of a union; of a plain type (None, (type,))."""
    origin = typing.get_origin(hint)
    return origin, tuple(a for a in typing.get_args(hint) if a is not type(None)) if origin else (hint,)


def _most(hint):
    """How many values an option may take."""
    origin, inner = _parts(hint)
    if hint is bool:
        return 0
    if origin in (tuple, list):
        return len(inner) if origin is tuple and ... not in inner else None
    return 1 if origin is typing.Literal or not origin else _most(inner[0])


def _least(hint):
    most = _most(hint)
    return 0 if most is None else most


def _fits(hint, values) -> bool:
    origin, inner = _parts(hint)
    if hint is bool:
        return values in ([], ["True"], ["False"])
    if origin is typing.Literal:
        return values[0] in map(str, inner)
    if origin in (tuple, list):
        each = inner if _most(hint) else inner[:1] * len(values)
        return len(each) == len(values) and all(_fits(kind, [v]) for kind, v in zip(each, values, strict=True))
    if origin:  # a union, such as `float | None`
        return values == ["None"] or any(_fits(kind, values) for kind in inner)
    if hint is int:
        return re.fullmatch("[+-]?[0-9]+", values[0]) is not None
    return hint is not float or quantities.number(values[0]) is not None


def _is_numeric(hint) -> bool:
    """Whether all that an option takes are numbers."""
    origin, inner = _parts(hint)
    if origin is typing.Literal:
        return False
    return all(map(_is_numeric, (a for a in inner if a is not ...))) if origin else hint in (int, float)


def _words(hint) -> str:
    """A type in words: "an integer", "one of a, b", "3 numbers"."""
    words = {int: "an integer", float: "a number", str: "a text", bool: "True or False"}
    origin, inner = _parts(hint)
    if hint in words:
        return words[hint]
    if origin is typing.Literal:
        return "one of " + ", ".join(map(str, inner))
    if origin in (tuple, list):
        each = {int: "integers", float: "numbers"}.get(inner[0], "values")
        return f"{len(inner)} {each}" if _most(hint) else each
    if origin:
        return " or ".join(_words(a) for a in inner)
    return f"a {getattr(hint, '__name__', hint)}".lower()
