"""Command line arguments into a verb's `Args`; whatever is wrong with them comes out as one line."""

import contextlib
import dataclasses
import difflib
import io
import re
import typing

import tyro

from cnclik import errors

_FRAME = re.compile("[│╭╮╰╯|]")
_RULE = re.compile("^[─-]{3,}$")


def parse(Args, argv, *, prog, description):
    """`argv` as an instance of the dataclass `Args`; `--help` prints and exits as tyro does.

    Raises: ArgumentError naming the option, what it must be and what it is, or the nearest name.
    """
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            return tyro.cli(Args, args=list(argv), prog=prog, description=description)
    except SystemExit as leaving:
        if not leaving.code:
            raise
    raise errors.ArgumentError(_one_line(Args, argv, said.getvalue()))


def _one_line(Args, argv, said) -> str:
    message = _message(said)
    options = _options(Args)
    unknown = re.match("Unrecognized options?: (.*)", message)
    if unknown:
        tokens = unknown[1].split(", ")
        first = next((t for t in tokens if t.startswith("-")), tokens[0]).strip()
        near = difflib.get_close_matches(first.split("=")[0], list(options), n=1, cutoff=0.4)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        return f"Option must be one of {', '.join(options)}, but is {first!r}{hint}."
    missing = re.match(r"Missing from .*?: (\S+) (.*?)\.? \(required\)", message)
    if missing:
        return f"Argument `{missing[1]}` must be given, but is not: {missing[2]}."
    named = next((n for n in sorted(options, key=len, reverse=True) if n in message), None)
    if named and message.startswith("Missing value"):
        return f"Option `{named}` must be given {_kind(options[named])}, but has no value."
    if named:
        found = _value(argv, named)
        return f"Option `{named}` must be {_kind(options[named])}, but is {found}."
    return message if message.endswith(".") else message + "."


def _message(said) -> str:
    """The text of tyro's box between its title and its first rule, without the frame, as one line."""
    body = []
    for line in said.splitlines()[1:]:
        text = _FRAME.sub("", line).strip()
        rule = bool(_RULE.match(text))
        if rule and body:
            break
        if text and not rule:  # frames of plain ASCII have a rule below the title, too
            body.append(text)
    return " ".join(body)


def _options(Args, prefix="") -> dict:
    """{"--name": type} of a dataclass; those of nested dataclasses as "--outer.name"."""
    hints, marked = typing.get_type_hints(Args), typing.get_type_hints(Args, include_extras=True)
    found = {}
    for field in dataclasses.fields(Args):
        marks = getattr(marked[field.name], "__metadata__", ())
        if tyro.conf.Positional in marks:
            continue
        renamed = next((n for n in (getattr(m, "name", None) for m in marks) if n), field.name)
        name = prefix + renamed.replace("_", "-")
        if dataclasses.is_dataclass(hints[field.name]):
            found |= _options(hints[field.name], name + ".")
        else:
            found["--" + name] = hints[field.name]
    return found


def _kind(hint) -> str:
    """A type in words: "an integer", "one of a, b", "3 numbers"."""
    words = {int: "an integer", float: "a number", str: "a text", bool: "True or False"}
    if hint in words:
        return words[hint]
    origin, inner = typing.get_origin(hint), [a for a in typing.get_args(hint) if a is not type(None)]
    if origin is typing.Literal:
        return "one of " + ", ".join(map(str, inner))
    if origin in (tuple, list):
        each = {int: "integers", float: "numbers"}.get(inner[0], "values")
        return f"{len(inner)} {each}" if origin is tuple and ... not in inner else each
    if len(inner) >= 1 and origin is not None:  # a union, such as `float | None`
        return " or ".join(_kind(a) for a in inner)
    return f"a {getattr(hint, '__name__', hint)}".lower()


def _value(argv, option) -> str:
    """What was given for an option, as typed."""
    argv = [str(a) for a in argv]
    for i, token in enumerate(argv):
        name, _, value = token.partition("=")
        if name.replace("_", "-") == option:
            rest = [value] if value else []
            for following in argv[i + 1 :] if not value else []:
                if following.startswith("--"):
                    break
                rest.append(following)
            return repr(" ".join(rest)) if rest else "not given"
    return "not given"
