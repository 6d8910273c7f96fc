"""Pages are read at full speed: short sentences, the field's words, and no page longer than 280 lines."""

import ast
import pathlib
import re

import pytest

ROOT = pathlib.Path(__file__).parents[1]
MADE = (("results",), ("gallery-pages",))  # by a build of the site
OUTSIDE = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "sweeps/README.md")
PAGES = [*(ROOT / name for name in OUTSIDE), *sorted((ROOT / "docs").rglob("*.md"))]
NAMES = [p.relative_to(ROOT).as_posix() for p in PAGES if p.relative_to(ROOT).parts[1:2] not in MADE]
MOST_WORDS, MOST_LINES = 40, 280
# Words with a meaning of their own in earlier texts, and the field's word for each.
PRIVATE = {
    r"bears?": "tolerates",
    r"(takes?|taken|took) back": "removes",
    r"(is|are|was|were) told": "knows, is given, reports",
    r"tells": "shows, reports",
    r"fore(tells?|told)": "predicts",
    r"unless (said|told)": "unless stated otherwise, by default",
    r"it is said": "cnclik reports",
    r"says": "shows, states",
    r"(comes?|is|are|samples?) late": "is delayed by",
    r"late error": "delayed error",
    r"by nothing": "zero",
    r"one's": "your",
    r"were the \w+ (a|one) sample": "even with one more sample",
}


def prose(text):
    """Paragraphs, items and cells, without code, formulas and tables that a program writes."""
    text = re.sub(r"\A---\n.*?^---\n", "", text, flags=re.M | re.S)
    text = re.sub(r"^ *```.*?^ *```", "", text, flags=re.M | re.S)
    text = re.sub(r"^\$\$.*?^\$\$", "", text, flags=re.M | re.S)
    text = re.sub(r"^<!-- (\w+) -->.*?^<!-- end -->", "", text, flags=re.M | re.S)
    text = re.sub(r"^    .*$", "", text, flags=re.M)
    for block in re.split(r"\n\s*\n", text):
        if block.startswith("|"):
            yield from block.replace("\n", "|").split("|")
        else:
            yield from re.split(r"\n(?=\s*(?:[-*]|\d+\.) )", block)


def sentences(text):
    for part in prose(text):
        part = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", part.replace("\n", " "))
        yield from re.split(r"(?<=[.!?:;])(?:\*\*)?\s+(?=[A-ZÀ-Ž0-9*`J\[(])", re.sub(r"`[^`]*`", "CODE", part))


def long(text):
    return [s for s in sentences(text) if len(re.findall(r"[^\W\d_]{2,}", s)) > MOST_WORDS]


def private(text):
    return [
        (s, word, plain) for s in sentences(text) for word, plain in PRIVATE.items() if re.search(rf"\b{word}\b", s)
    ]


def texts(source):
    """(line, text, whether it consists of sentences) of each string of a module; its own docstring is often a list."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts = [part.value if isinstance(part, ast.Constant) else "NAME" for part in node.values]
            yield node.lineno, "".join(parts), True
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value, node.lineno > 1 and "{" not in node.value


@pytest.mark.parametrize("name", NAMES)
def test_a_page_is_plain(name):
    text = (ROOT / name).read_text(encoding="utf-8")
    assert text.count("\n") <= MOST_LINES
    assert not long(text) and not private(text)


@pytest.mark.parametrize("room", sorted({p.relative_to(ROOT).parts[1] for p in (ROOT / "cnclik").rglob("*.py")}))
def test_what_the_package_shows_is_plain(room):
    """Docstrings, help texts and messages; a name in an f-string stands for one word."""
    found = [
        (p.relative_to(ROOT).as_posix(), line, fault)
        for p in ([ROOT / "cnclik" / room] if room.endswith(".py") else (ROOT / "cnclik" / room).rglob("*.py"))
        for line, text, is_prose in texts(p.read_text(encoding="utf-8"))
        for fault in (*private(text), *(long(text) if is_prose else ()))
    ]
    assert not found


def test_results_are_told_in_short_sentences():
    pages = sorted((ROOT / "results").rglob("*.md"))
    assert pages and not [(p, s) for p in pages for s in long(p.read_text(encoding="utf-8"))]


def test_it_finds_what_it_looks_for():
    text = "It bears 2 samples more.\n\n```\nbears\n```\n\n| a | it tells |\n| --- | --- |\n| " + "word " * 41 + "| |\n"
    found = list(sentences(text))
    assert [s for s in found if re.search(r"\bbears\b", s)] == ["It bears 2 samples more."]
    assert len([s for s in found if s.count("word") > MOST_WORDS]) == 1 and any("tells" in s for s in found)
