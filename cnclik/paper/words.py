"""Sentences from data: a template that is filled, lists of names, readings that hold."""

import re
import textwrap

from cnclik.paper.readings import ARMS
from cnclik.paper.tables import number, own, short


def filled(template, fields) -> str:
    """The template with its {fields}; its lines, each a paragraph or an item of a list, in lines of 120 characters."""
    lines = template.format(**fields).splitlines()
    return re.sub(r"\n{3,}", "\n\n", "\n".join(map(_wrapped, lines))) + "\n"


def _wrapped(line) -> str:
    if line.startswith(("|", "#")):
        return line
    item = "".join(re.findall(r"^(?:- |\d\. )", line))
    words = textwrap.TextWrapper(120, "", " " * len(item), break_long_words=False, break_on_hyphens=False)
    return words.fill(" ".join(line.split()))


def joined(words) -> str:
    """ "a", "a and b", "a, b and c"."""
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last


def ranked(values: dict) -> list:
    """Names, the least value first."""
    return sorted(values, key=lambda name: abs(values[name]))


def listed(values: dict, form=number) -> str:
    return ", ".join(f"{name} {form(value)}" for name, value in values.items())


def by_reading(records) -> dict:
    """{reading, as far as it matters: [records]} of those that hold."""
    found = {}
    for record in records:
        if record["holds"] and own(record):
            found.setdefault(short(record), []).append(record)
    return found


def under(records) -> str:
    """ "under `printed/once` (5-dof)" and so on, or "under no reading"."""
    found = by_reading(records)
    named = [f"`{name}` ({joined([str(ARMS[r['arm']]) for r in held])})" for name, held in found.items()]
    return f"only under {joined(named)}" if named else "under no reading"
