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
FILTER = ("smoothing", "cutoff", "smoothed")
GROUPS = {  # options that verbs share, by the titles of the help; a verb's TAKES names its groups
    "robot and task": ("robot", "tip", "task"),
    "path": ("reference", "target", "radius", "period", "speed", "begin"),
    "law": ("alpha", "damping", "limits", "feedforward"),
    "loop": ("q0", "Ts", "N", "method", "M"),
    "drive": ("delay", "lag", "natural_frequency", "damping_ratio", "command", "feedback", *FILTER),
    "log": tuple(LOG),
}
PROBLEM = ("robot and task", "path", "law", "loop", "drive")
HELP = {  # of arguments without a line of their own
    "json": "Print the answer as JSON and nothing else.",
    "figures": "Draw the figures.",
    "overwrite": "Write over files that cnclik did not make, too.",
}
OUTPUT = ("out", "overwrite", "json", "figures")  # options of the last group of the help


def options_of(verb) -> dict:
    """{title: {argument: Option}} of a verb's module; "" for its own, which go before shared ones of that name."""
    own, groups = arguments(inspect.getsource(verb), "run", HELP), {}
    for title in getattr(verb, "TAKES", ()):
        known = LOG if title == "log" else OPTIONS
        groups[title] = {name: own.pop(name, known[name]) for name in GROUPS[title]}
    output = {name: own.pop(name) for name in OUTPUT if name in own}
    return {"": own} | groups | {"output": output}


def _flag(one) -> str:
    """How an option, or a place, is written."""
    return one.name.upper() if one.positional else f"--{one.name.replace('_', '-')}"


def _sorted(verb, groups) -> tuple:
    """(options that are given by their place, in the order of the signature; {flag: option} of the others)."""
    every, order = [one for some in groups.values() for one in some.values()], [*inspect.signature(verb.run).parameters]
    places = sorted((one for one in every if one.positional), key=lambda one: order.index(one.name))
    return places, {_flag(one): one for one in every if not one.positional}


def parse(verb, argv, *, prog, description) -> dict:
    """{argument: value} of `verb.run`; `--help` prints and exits.

    Shared options are there only if they are given, their numbers as `Quantities`; samples as texts, as they may need a
    file's Ts.

    Raises: ArgumentError with the option, what it must be and what it is, or with the nearest name.
    """
    groups, queue = options_of(verb), [str(a) for a in argv]
    if {"-h", "--help"} & set(queue):
        print(_help(verb, groups, prog, description))
        raise SystemExit(0)
    places, named = _sorted(verb, groups)
    flags = named | {f"--no-{flag[2:]}": one for flag, one in named.items() if one.kind == SWITCH}
    made: dict = {}
    words: dict = {}  # {option: its words}
    free, last = list(places), None  # last: the option whose words end here
    while queue:
        token = queue.pop(0)
        if not _is_option(token):
            if not free and last:
                raise errors.fail(last.name, f"be {last.values}", f"is {' '.join([*words[last], token])!r}")
            if not free:
                raise errors.ArgumentError(f"{token!r} is one too many; `{prog} --help` lists the options.")
            made[free.pop(0).name], last = token, None
            continue
        typed, equals, value = token.partition("=")
        if (one := flags.get(typed)) is None or (equals and one.kind == SWITCH):
            near = re.search("'(.*)'", errors.nearest(typed.lstrip("-"), [flag[2:] for flag in named]))
            instead = f"did you mean --{near[1]}?" if near else f"`{prog} --help` lists the options."
            raise errors.ArgumentError(f"Unknown option {token if one else typed}; {instead}")
        if one.kind == SWITCH:
            made[one.name], last = typed in named, None
            continue
        several = [value] if equals else _words(one, queue)
        del queue[: 0 if equals else len(several)]
        if not any(several):
            raise errors.fail(one.name, f"be given {one.values}", "has no value")
        if one in words and not (one.several and one.kind == NAME):
            raise errors.fail(one.name, "be given once", "is given twice")
        words[one], last = [*words.get(one, []), *several], one
    made |= {one.name: _value(one, some) for one, some in words.items()}
    for one in (*free, *named.values()):
        if one.name not in made and one.default is REQUIRED:
            kind, what = ("Argument", f": {one.help.rstrip('.')}") if one.positional else ("Option", "")
            raise errors.ArgumentError(f"{kind} `{_flag(one)}` must be given, but is not{what}.")
    return made


def _words(one, queue) -> list:
    """The words of an option at the head of a queue; a separate unit counts as one of them."""
    words = list(itertools.takewhile(lambda token: not _is_option(token), queue))
    unit = words[1:2] and words[1] in quantities.units(one.unit)
    return words if one.several else words[: 1 + bool(unit)]


def _is_option(token) -> bool:
    return re.match(r"-(?!\.?\d|inf|nan|$)", token) is not None  # no negative number


def _value(one, words):
    """The value of some words. Raises: ArgumentError where they don't fit."""
    for word in words if one.choices else ():
        if word not in one.choices:
            raise errors.fail(one.name, f"be {one.values}", f"is {word!r}")
    if one.kind == NAME:
        return tuple(words) if one.several else words[0]
    if one.unit == quantities.SAMPLES:
        return " ".join(words)
    numbers = numbers_of(one, " ".join(words))
    if one is OPTIONS.get(one.name) or one.several:
        return numbers
    if len(numbers) > 1:
        raise errors.fail(one.name, f"be {one.values}", f"is {' '.join(words)!r}")
    return int(numbers[0]) if one.kind == INTEGER else numbers[0]


def of_options(verb, said) -> str:
    """The text of an error or a remark on an option: options are named as they are written on the command line."""
    known = {name: one for some in options_of(verb).values() for name, one in some.items()}

    def written(match):
        one = known.get(match[2].replace("-", "_"))
        return match[0] if one is None or one.positional else f"{'Option ' * bool(match[1])}`{_flag(one)}`"

    return re.sub("(Argument )?`([^`]+)`", written, str(said))


def _help(verb, groups, prog, description) -> str:
    """The help: options in groups, positional arguments first and output last."""
    width = min(max(shutil.get_terminal_size().columns, 40), 120)
    usage = [_flag(one) if one.default is REQUIRED else f"[{_flag(one)}]" for one in _sorted(verb, groups)[0]]
    about = inspect.cleandoc(verb.run.__doc__ or "").partition("\nArgs:")[0].strip()
    lines = [" ".join(["usage:", prog, "[options]", *usage]), "", description, "", about]
    for title, some in groups.items():
        lines += ["", f"{title or 'options'}:"] * bool(some)
        for one in sorted(some.values(), key=lambda one: not one.positional):
            words = {SWITCH: "", INTEGER: "INT", NUMBER: "X"}.get(one.kind, one.name.upper())
            words = "{" + ",".join(one.choices) + "}" if one.choices else words
            words = "" if one.positional else words + " ..." * one.several
            off = f", --no-{_flag(one)[2:]}" * (one.default is True)
            head = f"  {_flag(one)}{off} {words}".rstrip()
            default = "" if one.default in (None, True, False, (), REQUIRED) else f" (default: {one.default})"
            text = textwrap.wrap(one.help + default, width - 26, break_on_hyphens=False)
            first = [f"{head:<25} {text.pop(0)}"] if len(head) < 26 and text else [head]
            lines += [*first, *(f"{'':25} {line}" for line in text)]
    return "\n".join(lines)
