"""Names are there and have a place on the site, and versions agree; `.ci/lint.py` has the rules of files alone."""

import dataclasses
import importlib
import inspect
import pathlib
import re
import subprocess
import sys
import types

import cnclik as ck

ROOT = pathlib.Path(__file__).parents[1]
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


NAMED = [name for page in sorted((ROOT / "docs/api").glob("*.md")) for name in named(page)]


def test_the_api_has_every_public_name():
    """Those of a room by the room's own name, or by the package's where it is the same thing; none twice."""
    rooms = {name for name in ck.__all__ if isinstance(getattr(ck, name), types.ModuleType)}
    assert set(ROOMS) == rooms and len(set(NAMED)) == len(NAMED)
    assert not {f"cnclik.{name}" for name in ck.__all__ if name not in ROOMS} - set(NAMED)
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


def test_rooms_are_reached_by_attribute_and_by_import():
    """In a process of their own, by attribute first, where a module is called as what a room offers."""
    code = (
        "import cnclik.export.write, cnclik.tuning.tune, cnclik as ck, importlib\n"
        f"assert all(getattr(ck, n) is importlib.import_module('cnclik.' + n) for n in {ROOMS[::-1]})\n"
        "assert all(map(callable, [ck.export.c, ck.tuning.tune, ck.reach, ck.tune]))"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_the_version_is_one():
    files = {
        "pyproject.toml": r'^version = "(.*)"',
        "CITATION.cff": r"^version: (.*)$",
        ".conda/recipe.yaml": r'^  version: "(.*)"',
        "CHANGELOG.md": r"^## \[(\d.*)\]",
    }
    said = {re.search(pattern, (ROOT / file).read_text(encoding="utf-8"), re.M)[1] for file, pattern in files.items()}
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
