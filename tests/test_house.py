"""Names are there, and versions agree; the house's rules are in `tests/lint.py`."""

import importlib
import inspect
import re
import subprocess
import sys

import cnclik
from tests import lint

REACHED = [room for room in lint.ROOMS if room not in (*lint.BASE, "paper")]


def test_every_public_name_is_there():
    assert not [name for name in cnclik.__all__ if getattr(cnclik, name, None) is None]
    assert sorted(set(cnclik.__all__)) == sorted(cnclik.__all__) and dir(cnclik) == sorted(cnclik.__all__)


def test_rooms_are_reached_by_attribute_and_by_import():
    """Also in a process of their own, by attribute first, where a module is called as what a room offers."""
    for name in REACHED:
        room = importlib.import_module(f"cnclik.{name}")
        assert getattr(cnclik, name) is room and room.__doc__
        assert not [public for public in room.__all__ if not hasattr(room, public)]
    code = (
        "import cnclik.export.write, cnclik.tuning.tune, cnclik as ck, importlib\n"
        f"assert all(getattr(ck, n) is importlib.import_module('cnclik.' + n) for n in {REACHED[::-1]})\n"
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
    assert said == {cnclik.__version__}


def test_public_functions_say_what_they_take_and_return():
    wrong = []
    for name in cnclik.__all__:
        if not inspect.isfunction(function := getattr(cnclik, name)):
            continue
        about = inspect.signature(function)
        wrong += [f"{name}({p.name})" for p in about.parameters.values() if p.annotation is p.empty]
        wrong += [f"{name} ->"] * (about.return_annotation is about.empty)
    assert not wrong
