"""A command line into the arguments of a verb's function, whose signature and docstring are its options.

What stands before the `*` of the signature is given by its place, all else by name. Numbers with a unit become numbers
in the option's own unit. Every error is one line.
"""

import inspect
import itertools
import re
import shutil
import textwrap

from cnclik import errors, quantities
from cnclik.problem.options import INTEGER, NAME, NUMBER, OPTIONS, REQUIRED, SWITCH, arguments, numbers_of, source

LOG = arguments(source("cli/log.py"), "read")
GROUPS = {  # options that verbs share, by the titles of the help; a verb's TAKES names its groups
    "robot and task": ("robot", "tip", "base", "task", "q0"),
    "path": ("reference", "target", "radius", "period", "speed", "begin"),
    "law": ("alpha", "damping", "limits", "feedforward"),
    "loop": ("method", "M", "Ts", "N"),
    "drive": ("delay", "lag", "natural_frequency", "damping_ratio", "command", "feedback", "cutoff", "smoothed"),
    "log": tuple(LOG),
}
PROBLEM = tuple(title for title in GROUPS if title != "log")
HELP = {  # of arguments without a line of their own
    "robot": OPTIONS["robot"].help,
    "log": LOG["log"].help,
    "N": OPTIONS["N"].help,
    "json": "Print the answer as JSON and nothing else.",
    "figures": "Draw the figures.",
    "overwrite": "Write over files that cnclik did not make, too.",
}
OUTPUT = ("out", "overwrite", "json", "csv", "figures")  # options of the last group of the help
_NUMBER = re.compile(r"-\.?\d|-inf|-nan")


def options_of(verb) -> dict:
    """{title: {argument: Option}} of a verb's module; "" for its own, which go before shared ones of that name."""
    own = arguments(inspect.getsource(verb), "run", HELP)
    groups = {"": {name: one for name, one in own.items() if name not in OUTPUT}}
    for title in getattr(verb, "TAKES", ()):
        known = LOG if title == "log" else OPTIONS
        names = [name for name in GROUPS[title] if name not in getattr(verb, "LEFT_OUT", ())]
        groups[title] = {name: groups[""].pop(name, known[name]) for name in names}
    return groups | {"output": {name: one for name, one in own.items() if name in OUTPUT}}


def _places(verb, every) -> list:
    """Options that are given by their place, in the order of the signature."""
    order = list(inspect.signature(verb.run).parameters)
    return sorted((one for one in every if one.positional), key=lambda one: order.index(one.name))


def _flag(one) -> str:
    """How an option, or a place, is written."""
    return one.name.upper() if one.positional else f"--{one.name.replace('_', '-')}"


def parse(verb, argv, *, prog, description) -> dict:
    """{argument: value} of `verb.run`; `--help` prints and exits.

    Shared options are there only if they are given, their numbers as `Quantities`.

    Raises: ArgumentError with the option, what it must be and what it is, or with the nearest name.
    """
    groups, argv = options_of(verb), [str(a) for a in argv]
    if {"-h", "--help"} & set(argv):
        print(_help(verb, groups, prog, description))
        raise SystemExit(0)
    every = [one for some in groups.values() for one in some.values()]
    named, places = {_flag(one): one for one in every if not one.positional}, _places(verb, every)
    loose, given = _split(named, argv, prog)
    if len(loose) > len(places):
        alone = " and ".join(map(_flag, places)) or "nothing"
        raise errors.ArgumentError(f"What stands without an option must be {alone}, but is {' '.join(loose)!r}.")
    made = dict(zip((one.name for one in places), loose, strict=False))
    Ts = next((one.default for one in every if one.name == "Ts"), None)
    for one, words in sorted(given, key=lambda g: g[0].unit == quantities.SAMPLES):  # samples last: they need Ts
        value = _value(one, words, Ts, shared=one is OPTIONS.get(one.name))
        made[one.name] = [*made.get(one.name, []), value] if one.repeated else value
        Ts = value[0] if one.name == "Ts" and isinstance(value, list) else Ts
    for one in every:
        if one.name not in made and one.default is REQUIRED:
            kind, what = ("Argument", f": {one.help.rstrip('.')}") if one.positional else ("Option", "")
            raise errors.ArgumentError(f"{kind} `{_flag(one)}` must be given, but is not{what}.")
    return made


def _value(one, words, Ts, shared):
    """The value of some words. Raises: ArgumentError where they don't fit."""
    if one.kind == SWITCH:
        return words == ["on"]
    for word in words if one.choices else ():
        if word not in one.choices:
            raise errors.fail(one.name, f"be {one.values}", f"is {word!r}")
    if one.kind == NAME:
        return tuple(words) if one.several else words[0]
    try:
        found = numbers_of(one, " ".join(words), Ts)
    except errors.ArgumentError as error:
        rate = _as_time(" ".join(words)) if one.name == "Ts" else ""
        raise errors.ArgumentError(f"{error}{rate}") from None
    if shared or one.several:
        return found
    return int(found[0]) if one.kind == INTEGER else found[0]


def of_options(verb, said) -> str:
    """The text of an error or a remark on an option: options are named as they are written on the command line."""
    known = {name: one for some in options_of(verb).values() for name, one in some.items()}

    def written(found):
        one = known.get(found[2].replace("-", "_"))
        return found[0] if one is None or one.positional else f"{'Option ' * bool(found[1])}`{_flag(one)}`"

    return re.sub("(Argument )?`([^`]+)`", written, str(said))


def _split(named, argv, prog):
    """(positional words, [(option, its words)]); of a switch the word is "on" or "off".

    Raises: ArgumentError for an unknown option, or one without a value.
    """
    switches = {f"--no-{flag[2:]}": one for flag, one in named.items() if one.kind == SWITCH}
    loose, given, queue = [], [], list(argv)
    while queue:
        token = queue.pop(0)
        if not _is_option(token):
            loose.append(token)
            continue
        typed, equals, value = token.partition("=")
        name = "--" + typed.lstrip("-").replace("_", "-")
        one = (named | switches).get(name)
        if one is None or not typed.startswith("--") or (equals and one.kind == SWITCH):
            raise _unknown(named, token if one else typed, value if equals else "".join(queue[:1]), prog)
        if one.kind == SWITCH:
            given.append((one, ["off" if name in switches else "on"]))
            continue
        words = [value] if equals else _words(one, queue)
        queue = queue if equals else queue[len(words) :]
        if not words:
            raise errors.fail(one.name, f"be given {one.values}", "has no value")
        given.append((one, words))
    return loose, given


def _words(one, queue) -> list:
    """The words of an option at the head of a queue; a separate unit counts as one of them."""
    words = list(itertools.takewhile(lambda token: not _is_option(token), queue))
    unit = words[1:2] and words[1] in quantities.units(one.unit)
    return words if one.several else words[: 1 + bool(unit)]


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


def _help(verb, groups, prog, description) -> str:
    """The help: options in groups, positional arguments first and output last."""
    width = min(shutil.get_terminal_size().columns, 120)
    places = _places(verb, [one for some in groups.values() for one in some.values()])
    usage = [_flag(one) if one.default is REQUIRED else f"[{_flag(one)}]" for one in places]
    about = inspect.cleandoc(verb.run.__doc__ or "").partition("\nArgs:")[0].strip()
    lines = [" ".join(["usage:", prog, "[options]", *usage]), "", description, "", about]
    for title, some in groups.items():
        lines += ["", f"{title or 'options'}:"] * bool(some)
        for one in sorted(some.values(), key=lambda one: not one.positional):
            default = "" if one.default in (None, False, (), REQUIRED) else f" (default: {_shown(one.default)})"
            off = f", --no-{_flag(one)[2:]}" * (one.default is True)
            head = f"  {_flag(one)}{off} {'' if one.positional else _metavar(one)}".rstrip()
            text = textwrap.wrap(one.help + default, width - 26, break_on_hyphens=False)
            first = [f"{head:<25} {text.pop(0)}"] if len(head) < 26 and text else [head]
            lines += [*first, *(f"{'':25} {line}" for line in text)]
    return "\n".join(lines)


def _shown(default) -> str:
    return "on" if default is True else " ".join(map(str, default)) if isinstance(default, tuple) else str(default)


def _metavar(one) -> str:
    words = {SWITCH: "", INTEGER: "INT", NUMBER: "X"}.get(one.kind, one.name.upper())
    words = "{" + ",".join(one.choices) + "}" if one.choices else words
    return f"{words} ..." if one.several else words
