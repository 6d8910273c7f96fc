"""Command line arguments into a verb's `Args`; whatever is wrong with them comes out as one line.

The arguments are held against the dataclass before tyro reads them, so that no message depends on tyro's wording.
"""

import contextlib
import dataclasses
import io
import itertools
import re
import typing

import tyro

from cnclik import errors

_FRAME = re.compile("[^\x20-\u024f\u0370-\u03ff]+")  # what tyro draws around its messages
_NUMBER = re.compile(r"-\.?\d|-inf|-nan")


def parse(Args, argv, *, prog, description):
    """`argv` as an instance of the dataclass `Args`; `--help` prints and exits as tyro does.

    Raises: ArgumentError naming the option, what it must be and what it is, or the nearest name.
    """
    argv = [str(a) for a in argv]
    if not {"-h", "--help"} & set(argv):
        _check(Args, argv)
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            return tyro.cli(Args, args=argv, prog=prog, description=description)
    except SystemExit as leaving:
        if not leaving.code:
            raise
    raise errors.ArgumentError(" ".join(_FRAME.sub(" ", said.getvalue()).split()))


def _check(Args, argv):
    """Raise ArgumentError for an unknown option, a value of the wrong kind, one too many or one missing."""
    options, positionals = _fields(Args)
    switches = {"--no-" + name[2:]: hint for name, hint in options.items() if hint is bool}
    loose, queue = [], list(argv)
    while queue:
        token = queue.pop(0)
        if not _is_option(token):
            loose.append(token)
            continue
        written, equals, value = token.partition("=")
        name = "--" + written.lstrip("-").replace("_", "-")
        hint = (options | switches).get(name)
        if hint is None or not written.startswith("--"):
            raise _unknown(options, written)
        values = list(itertools.takewhile(lambda t: not _is_option(t), queue))[: _most(hint)]
        values = [value] if equals else values
        queue = queue if equals else queue[len(values) :]
        if not values and _least(hint):
            raise errors.ArgumentError(f"Option `{name}` must be given {_kind(hint)}, but has no value.")
        if not _fits(hint, values):
            raise errors.ArgumentError(f"Option `{name}` must be {_kind(hint)}, but is {' '.join(values)!r}.")
    most = sum(_most(hint) or len(loose) for hint, _, _ in positionals.values())
    if len(loose) > most:
        raise _unknown(options, loose[most])
    for name, (_, required, what) in list(positionals.items())[len(loose) :]:
        if required:
            raise errors.ArgumentError(f"Argument `{name}` must be given, but is not{': ' + what if what else ''}.")


def _is_option(token) -> bool:
    return token.startswith("-") and len(token) > 1 and not _NUMBER.match(token)


def _unknown(options, found):
    try:
        errors.one_of("Option", found, list(options))
    except errors.ArgumentError as error:
        return errors.ArgumentError(str(error).replace("Argument `Option`", "Option", 1))


def _fields(Args):
    """({"--name": type}, {"NAME": (type, required, what it is)}): the options of a dataclass and its positionals."""
    hints, marked = typing.get_type_hints(Args), typing.get_type_hints(Args, include_extras=True)
    options, positionals = {}, {}
    for field in dataclasses.fields(Args):
        marks = getattr(marked[field.name], "__metadata__", ())
        about = {key: v for m in marks for key in ("name", "metavar", "help") if (v := getattr(m, key, None))}
        if tyro.conf.Positional in marks:
            required = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
            name = about.get("metavar", field.name.upper())
            positionals[name] = hints[field.name], required, about.get("help", "").rstrip(".")
        else:
            append = tyro.conf.UseAppendAction in marks
            hint = hints[field.name]
            hint = typing.get_args(hint)[0] if append else hint
            options["--" + about.get("name", field.name).replace("_", "-")] = hint
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
    if hint in (int, float):
        with contextlib.suppress(ValueError):
            return hint(values[0]) is not None
        return False
    return True


def _kind(hint) -> str:
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
        return " or ".join(_kind(a) for a in inner)
    return f"a {getattr(hint, '__name__', hint)}".lower()
