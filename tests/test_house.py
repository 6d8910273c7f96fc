"""Names are there and have a place on the site, no link is dead, and versions agree; `tests/lint.py` has more rules.

Sphinx checks the rest of the site, `.ci/run site`.
"""

import dataclasses
import importlib
import inspect
import re
import subprocess
import sys
import types

import cnclik as ck
from tests import lint

ROOMS = [room for room in lint.ROOMS if room not in (*lint.BASE, "paper")]  # that users reach by name


def named(page) -> list:
    """Public names that a page of the API describes, whole."""
    found, module = [], ""
    for line in lint.text(page).splitlines():
        if said := re.match(r"\.\. currentmodule:: (\S+)", line):
            module = said[1]
        elif said := re.match(r"\.\. (?:auto\w+|py:data):: (\S+)", line):
            found.append(f"{module}.{said[1]}")
    return found


NAMED = [name for page in sorted((lint.ROOT / "docs/api").glob("*.md")) for name in named(page)]


def test_the_api_has_every_public_name():
    """Those of a room by the room's own name, or by the package's where it is the same thing; none twice."""
    rooms = {name for name in ck.__all__ if isinstance(getattr(ck, name), types.ModuleType)}
    assert set(ROOMS) == rooms and len(set(NAMED)) == len(NAMED)
    assert not {f"cnclik.{name}" for name in ck.__all__ if name not in rooms} - set(NAMED)
    for room in ROOMS:
        assert getattr(ck, room).__doc__, room
        for name in getattr(ck, room).__all__:
            short = {f"cnclik.{name}"} if name in ck.__all__ else set()
            assert set(NAMED) & (short | {f"cnclik.{room}.{name}", f"cnclik.{room}.{name}.{name}"}), name


EVERY = {n: getattr(importlib.import_module(n.rpartition(".")[0]), n.rpartition(".")[2]) for n in NAMED}
RECORDS = {name: thing for name, thing in EVERY.items() if isinstance(thing, type) and dataclasses.is_dataclass(thing)}


def test_the_api_explains_every_field():
    """In the docstring, or by a comment on its line, which the site shows."""
    for name, cls in RECORDS.items():
        named = re.findall(r"\w+", " ".join(base.__doc__ or "" for base in cls.__mro__[:-1]))
        text = "".join(inspect.getsource(base) for base in cls.__mro__[:-1])
        for field, said in re.findall(r"^ +(\w+)\b.*  # (.*)", text, re.M):
            named += [field, *re.findall(r"\w+", said)]
        assert not {field.name for field in dataclasses.fields(cls)} - set(named), name


def prose(path) -> str:
    """A page without what is fenced or in backticks."""
    text = re.sub(r"^```.*?^```", "", lint.text(path), flags=re.M | re.S)
    return re.sub(r"`[^`\n]*`", lambda found: "x" * len(found[0]), text)


def anchors(path) -> set:
    """The names that GitHub gives to a page's headings."""
    text = re.sub(r"^```.*?^```", "", lint.text(path), flags=re.M | re.S)
    found, seen = set(), {}
    for title in re.findall(r"^#{1,6} (.+)$", text, re.M):
        name = re.sub(r"[^\w\- ]", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title).lower()).strip().replace(" ", "-")
        seen[name] = seen.get(name, -1) + 1
        found.add(f"{name}-{seen[name]}" if seen[name] else name)
    return found


def test_no_link_is_dead():
    wrong = []
    for page in lint.written():
        for address in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
            if re.match(r"[a-z]+:", address):
                continue
            where, _, place = address.partition("#")
            to = (page.parent / where).resolve() if where else page
            if not to.exists() or (place and to.suffix == ".md" and place not in anchors(to)):
                wrong.append(f"{page.relative_to(lint.ROOT)}: {address}")
    assert not wrong


def test_rooms_are_reached_by_attribute_and_by_import():
    """In a process of their own, by attribute first, where a module is called as what a room offers."""
    code = (
        "import cnclik.export.write, cnclik.tuning.tune, cnclik as ck, importlib\n"
        f"assert all(getattr(ck, n) is importlib.import_module('cnclik.' + n) for n in {ROOMS[::-1]})\n"
        "assert all(map(callable, [ck.export.c, ck.tuning.tune, ck.reach, ck.tune]))"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=lint.ROOT)


def test_the_version_is_one():
    files = {
        "pyproject.toml": r'^version = "(.*)"',
        "CITATION.cff": r"^version: (.*)$",
        ".conda/recipe.yaml": r'^  version: "(.*)"',
        "CHANGELOG.md": r"^## \[(\d.*)\]",
    }
    said = {re.search(pattern, lint.text(lint.ROOT / file), re.M)[1] for file, pattern in files.items()}
    assert said == {ck.__version__}


def test_public_functions_say_what_they_take_and_return():
    wrong = []
    for name in ck.__all__:
        if not inspect.isfunction(function := getattr(ck, name)):
            continue
        about = inspect.signature(function)
        wrong += [f"{name}({p.name})" for p in about.parameters.values() if p.annotation is p.empty]
        wrong += [f"{name} ->"] * (about.return_annotation is about.empty)
    assert not wrong
