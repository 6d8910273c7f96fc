"""The site's sources: every public name has a place, and no link is dead. Sphinx checks the rest, `.ci/run site`."""

import dataclasses
import importlib
import inspect
import pathlib
import re
import types

import cnclik as ck

ROOT = pathlib.Path(__file__).parents[1]
DOCS = ROOT / "docs"
MADE = ("results", "gallery-pages")  # by a build
PAGES = sorted(p for p in DOCS.rglob("*.md") if p.relative_to(DOCS).parts[0] not in MADE)
OUTSIDE = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "sweeps/README.md")]
LINKED = [*PAGES, *OUTSIDE, *sorted(ROOT.glob("results/**/*.md"))]
ROOMS = ("problem", "measure", "stability", "diagnosis", "sweeps", "tuning", "export", "show")


def named(page) -> list:
    """Public names that a page of the API describes, whole."""
    found, module = [], ""
    for line in page.read_text(encoding="utf-8").splitlines():
        if said := re.match(r"\.\. currentmodule:: (\S+)", line):
            module = said[1]
        elif said := re.match(r"\.\. (?:auto\w+|py:data):: (\S+)", line):
            found.append(f"{module}.{said[1]}")
    return found


NAMED = [name for page in sorted((DOCS / "api").glob("*.md")) for name in named(page)]


def test_the_api_has_every_public_name():
    """Those of a room by the room's own name, or by the package's where it is the same thing; none twice."""
    rooms = {name for name in ck.__all__ if isinstance(getattr(ck, name), types.ModuleType)}
    assert set(ROOMS) == rooms and len(set(NAMED)) == len(NAMED)
    assert not {f"cnclik.{name}" for name in ck.__all__ if name not in rooms} - set(NAMED)
    for room in ROOMS:
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
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    return re.sub(r"`[^`\n]*`", lambda found: "x" * len(found[0]), text)


def anchors(path) -> set:
    """The names that GitHub gives to a page's headings."""
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    found, seen = set(), {}
    for title in re.findall(r"^#{1,6} (.+)$", text, re.M):
        name = re.sub(r"[^\w\- ]", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title).lower()).strip().replace(" ", "-")
        seen[name] = seen.get(name, -1) + 1
        found.add(f"{name}-{seen[name]}" if seen[name] else name)
    return found


def test_no_link_is_dead():
    wrong = []
    for page in LINKED:
        for address in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
            if re.match(r"[a-z]+:", address):
                continue
            where, _, place = address.partition("#")
            to = (page.parent / where).resolve() if where else page
            if not to.exists() or (place and to.suffix == ".md" and place not in anchors(to)):
                wrong.append(f"{page.relative_to(ROOT)}: {address}")
    assert not wrong
