"""Sentences from data: paragraphs, lists of names, names in the order of their numbers, readings that hold."""

import textwrap

from cnclik.paper.readings import ARMS
from cnclik.paper.tables import number, own, short


def paragraph(*sentences, bullet=False) -> str:
    """A paragraph, or an item of a list."""
    lead, rest = ("- ", "  ") if bullet else ("", "")
    fill = textwrap.TextWrapper(120, lead, rest, break_long_words=False, break_on_hyphens=False).fill
    return fill(" ".join(" ".join(sentences).split()))


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
