"""`python -m tests.stress.mutants`: which random one-line faults do the tests not see?

Each mutant is a copy of the tree with one fault in `law`, `integrate`, `robot`, `engine`, `stability` or `reaching`: a
sign, a comparison or a constant changed, + for -, a term or a condition dropped. The room's own tests run first, then
those of the rooms that stand on it, each until the first failure. What no test sees is printed with the line.

    python -m tests.stress.mutants --count 60               # a new seed each day
    python -m tests.stress.mutants --seed 3 --number 17     # one again

Exit code 1 if more than one in twenty survives.
"""

import argparse
import ast
import os
import pathlib
import random
import shutil
import subprocess
import sys
import tempfile
import time
from typing import NamedTuple

ROOT = pathlib.Path(__file__).parents[2]
TESTS = {  # of each room: its own, then those that would see what its own don't
    "law": ("law", "integrate", "task"),
    "integrate": ("integrate", "stability", "law"),
    "robot": ("robot", "task", "law", "integrate"),
    "engine": ("engine", "integrate", "export"),
    "stability": ("stability", "integrate", "diagnosis"),
    "reaching": ("reaching",),
}
MOST = 1200  # CPU seconds of a directory of tests: a mutant that hangs is seen, too
COMPARED = {
    **{ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq},
    **{ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In},
}
OPERATED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult}
SWAPPED = {"minimum": "maximum", "maximum": "minimum", "min": "max", "max": "min", "sin": "cos", "cos": "sin"}
TOLD = ("fail", "ArgumentError", "brief")  # messages are not faults
CHECKED = ("strict", "frozen", "kw_only", "slots")  # keywords that no answer hangs on


class Mutant(NamedTuple):
    """A file, its line, the fault in words, and the text of the whole file."""

    file: pathlib.Path
    line: int
    fault: str
    text: str


def other(node, draw):
    """A node that stands for one as its fault; None for most."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARED:
        return ast.Compare(node.left, [COMPARED[type(node.ops[0])](), *node.ops[1:]], node.comparators)
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATED:
        changed = ast.BinOp(node.left, OPERATED[type(node.op)](), node.right)
        additive = isinstance(node.op, ast.Add | ast.Sub)
        return draw.choice((changed, node.left, node.right)) if additive else changed
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        return node.operand
    if isinstance(node, ast.BoolOp):
        joined = ast.BoolOp(ast.And() if isinstance(node.op, ast.Or) else ast.Or(), node.values)
        return draw.choice((joined, *node.values))
    if isinstance(node, ast.Constant) and type(node.value) is bool:
        return ast.Constant(not node.value)
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        return ast.Constant(node.value + 1 if node.value in (0, 1) else node.value * 2)
    if isinstance(node, ast.Attribute) and node.attr in SWAPPED:
        return ast.Attribute(node.value, SWAPPED[node.attr], node.ctx)
    return None


def places(node):
    """(parent, field, index or None, node) of what may be changed: nothing that speaks to people or type checkers."""
    for field, value in ast.iter_fields(node):
        for k, below in enumerate(value if isinstance(value, list) else [value]):
            if not isinstance(below, ast.AST) or field in ("annotation", "returns"):
                continue
            told = isinstance(below, ast.Call) and ast.unparse(below.func).rpartition(".")[2] in TOLD
            checked = isinstance(below, ast.keyword) and below.arg in CHECKED
            if told or checked or isinstance(below, ast.Raise | ast.JoinedStr):
                continue
            yield node, field, k if isinstance(value, list) else None, below
            yield from places(below)


def drawn(seed, number, rooms=tuple(TESTS)) -> Mutant:
    """The mutant of a number: a room by chance, then a place in it."""
    draw = random.Random(f"{seed} {number}")
    texts = {
        path: path.read_text(encoding="utf-8") for path in sorted((ROOT / "cnclik" / draw.choice(rooms)).rglob("*.py"))
    }
    path = draw.choices([*texts], [len(text) for text in texts.values()])[0]
    tree = ast.parse(texts[path])
    every = [*places(tree)]
    draw.shuffle(every)
    for parent, field, k, node in every:
        fault = other(node, draw)
        if fault is not None:
            words = f"{ast.unparse(node)}\n    {ast.unparse(fault)}"
            if k is None:
                setattr(parent, field, fault)
            else:
                getattr(parent, field)[k] = fault
            return Mutant(path.relative_to(ROOT), node.lineno, words, ast.unparse(ast.fix_missing_locations(tree)))
    return drawn(seed, f"{number}'", rooms)  # a file without a number in it


def tested(mutant: Mutant, folder) -> str:
    """The first test that sees it, or nothing."""
    target, room = pathlib.Path(folder, mutant.file), mutant.file.parts[1]
    kept = target.read_text(encoding="utf-8")
    nearest = f"tests/{room}/test_{mutant.file.stem}.py"
    for tests in [nearest] * pathlib.Path(folder, nearest).exists() + [f"tests/{name}" for name in TESTS[room]]:
        target.write_text(mutant.text, encoding="utf-8")
        seen = failed(folder, tests)
        target.write_text(kept, encoding="utf-8")
        if seen:
            return seen
    return ""


def failed(folder, tests) -> str:
    """The first test that fails of a directory or file of tests, or nothing."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "--no-header", "-p", "no:cacheprovider", tests]
    own = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    line = ["sh", "-c", f'ulimit -t {MOST}; exec "$@"', "sh", *command]
    done = subprocess.run(line, cwd=folder, env=own, capture_output=True, text=True)
    if done.returncode in (0, 5):  # passed; none there
        return ""
    lines = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return lines[0].partition(" - ")[0] if lines else f"{tests}: exit code {done.returncode}"


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.stress.mutants", description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", default=time.strftime("%Y-%m-%d"), help="by default the date")
    parser.add_argument("--number", help="one mutant again")
    parser.add_argument("--rooms", nargs="*", choices=TESTS, default=list(TESTS))
    parser.add_argument("--show", action="store_true", help="print the mutants and run nothing")
    args = parser.parse_args()
    tried, survivors = 0, []
    with tempfile.TemporaryDirectory() as folder:
        for name in ("cnclik", "tests", "pyproject.toml", "sweeps", "docs", "README.md"):
            source, copy = ROOT / name, pathlib.Path(folder, name)
            shutil.copytree(source, copy) if source.is_dir() else shutil.copy(source, copy)
        for number in [args.number] if args.number else range(args.count):
            mutant = drawn(args.seed, number, tuple(args.rooms))
            what = f"{number}: {mutant.file}:{mutant.line}\n    {mutant.fault}"
            if not args.show:
                begun, seen = time.monotonic(), tested(mutant, folder)
                survivors += [] if seen else [what]
                what += f"\n  {seen or 'SURVIVES'} ({time.monotonic() - begun:.0f} s)"
            print(what, flush=True)
            tried += 1
    if not args.show:
        print(
            f"\nSeed {args.seed}: {tried - len(survivors)} of {tried} faults were seen. Survivors:",
            *survivors,
            sep="\n",
        )
    sys.exit(len(survivors) > tried / 20)


if __name__ == "__main__":
    main()
