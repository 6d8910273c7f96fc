"""`python .ci/lint.py`: what ruff and mypy don't know of this house. pre-commit and `.ci/run` call it, without JAX.

Imports run one way and are of no private name; pages, docstrings and messages are short sentences, and no link is dead.
Exit code 1 with a line for each fault.
"""

import ast
import functools
import graphlib
import pathlib
import re
import sys

ROOT = pathlib.Path(__file__).parents[1]
PACKAGE = ROOT / "cnclik"
GROUND = ("errors", "record", "cache", "precision", "threads", "reading", "writing", "version", "quantities")
BASE = ("engine", "robot", "task", "law", "integrate", "reaching")  # reached through the names of the package alone
ROOMS = (*(*BASE, "problem", "measure", "stability", "diagnosis", "sweeps", "tuning", "export", "show", "paper"),)
ORDER = {name: 0 for name in GROUND} | {name: i for i, name in enumerate((*ROOMS, "cli"), 1)}
LONG_SENTENCE = 40  # words


@functools.cache
def text(path):
    return path.read_text(encoding="utf-8")


@functools.cache
def nodes(path):
    """Every node of a file's syntax tree."""
    return list(ast.walk(ast.parse(text(path))))


@functools.cache
def files(folder=PACKAGE):
    return sorted(folder.rglob("*.py"))


def room(path):
    """The room a file belongs to; the package's own front door and `python -m cnclik` belong to none."""
    name = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    return None if name in ("__init__", "__main__") else name


def target_room(source, name):
    """The room that `from source import name` is from."""
    return [*source.split("."), name][1]


def imports(path):
    """(line, module, name) of everything a file imports from the package, at its top or inside a function."""
    for node in nodes(path):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "cnclik":
            yield from ((node.lineno, node.module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from ((node.lineno, a.name, "") for a in node.names if a.name.split(".")[0] == "cnclik")


def module(name):
    """The file of `cnclik.x.y`, or None where that is a room or a name."""
    path = PACKAGE.joinpath(*name.split(".")[1:]).with_suffix(".py")
    return path if path.exists() else None


# --- code: each yields (path, line, what is wrong) -----------------------------------------------------


def order():
    """Each file has its room, imports run one way, and none is of a private name."""
    for path in files():
        own = room(path)
        if own and own not in ORDER:
            yield path, 1, f"{own} has no place in the order of rooms"
        for line, source, name in imports(path) if own in ORDER else ():
            other = target_room(source, name)
            if other not in ORDER:
                yield path, line, "imports the package's front door"
            elif ORDER[other] > ORDER[own]:
                yield path, line, f"imports {other}, which stands on {own}"


def circles():
    """Those inside functions counted."""
    graph = {}
    for path in files():
        targets = [module(f"{source}.{name}") or module(source) for _, source, name in imports(path)]
        graph[path] = {target for target in targets if target}
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        yield error.args[1][0], 1, " imports ".join(path.stem for path in error.args[1])


def private():
    """Private names are imported from the own room alone; by tests from none."""
    for path in (*files(), *files(ROOT / "tests")):
        own = room(path) if path.is_relative_to(PACKAGE) else ""
        for line, source, name in imports(path):
            if re.match("_[a-zA-Z]", name) and (other := target_room(source, name)) != own:
                yield path, line, f"imports the private {other}.{name}"


# --- words --------------------------------------------------------------------------------------------


def sentences(page):
    """Those of paragraphs, items and cells, without code, formulas and tables that a program writes."""
    page = re.sub(r"\A---\n.*?^---\n|^ *```.*?^ *```|^\$\$.*?^\$\$", "", page, flags=re.M | re.S)
    for block in re.split(r"\n\s*\n", re.sub(r"^    .*$", "", page, flags=re.M)):
        cells = block.replace("\n", "|").split("|") if block.startswith("|") else re.split(r"\n(?=\s*[-*\d])", block)
        for part in cells:
            part = re.sub(r"`[^`]*`", "CODE", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", part.replace("\n", " ")))
            yield from re.split(r"(?<=[.!?:;])(?:\*\*)?\s+(?=[A-ZÀ-Ž0-9*J\[(])", part)


def faults(page):
    """Sentences of a text that are too long."""
    for sentence in sentences(page):
        if len(re.findall(r"[^\W\d_]{2,}", sentence)) > LONG_SENTENCE:
            yield f"more than {LONG_SENTENCE} words: {sentence.strip()[:100]}"


def written():
    """Pages of the site, and of results."""
    made = ("results", "gallery-pages")  # by a build
    outside = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "sweeps/README.md")]
    docs = [p for p in sorted((ROOT / "docs").rglob("*.md")) if p.relative_to(ROOT / "docs").parts[0] not in made]
    return (*outside, *docs, *sorted((ROOT / "results").rglob("*.md")))


def pages():
    """Their sentences."""
    for path in written():
        yield from ((path, 1, fault) for fault in faults(text(path)))


def unfenced(path) -> str:
    return re.sub(r"^```.*?^```", "", text(path), flags=re.M | re.S)


def anchors(path) -> set:
    """The names that GitHub gives to a page's headings."""
    found, seen = set(), {}
    for title in re.findall(r"^#{1,6} (.+)$", unfenced(path), re.M):
        name = re.sub(r"[^\w\- ]", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title).lower()).strip().replace(" ", "-")
        seen[name] = seen.get(name, -1) + 1
        found.add(f"{name}-{seen[name]}" if seen[name] else name)
    return found


def links():
    """To files that are there, and to headings that they have."""
    for page in written():
        for address in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`\n]*`", "", unfenced(page))):
            if re.match(r"[a-z]+:", address):
                continue
            where, _, place = address.partition("#")
            to = (page.parent / where).resolve() if where else page
            if not to.exists() or (place and to.suffix == ".md" and place not in anchors(to)):
                yield page, 1, f"links to {address}, which is not there"


def strings():
    """Docstrings, help texts and messages of the package; a name in an f-string stands for one word."""
    for path in files():
        for node in nodes(path):
            if isinstance(node, ast.JoinedStr):
                value = "".join(p.value if isinstance(p, ast.Constant) else "NAME" for p in node.values)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                value = node.value
            else:
                continue
            listed = isinstance(node, ast.Constant) and (node.lineno == 1 or "{" in value)
            yield from ((path, node.lineno, fault) for fault in faults(value) if not listed)


CHECKS = (order, circles, private, pages, links, strings)


def main():
    """Print every fault."""
    count = 0
    for check in CHECKS:
        for path, line, what in check():
            print(f"{path.relative_to(ROOT)}:{line}: {what} ({check.__name__})")
            count += 1
    print(f"{count} faults.")
    sys.exit(count > 0)


if __name__ == "__main__":
    main()
