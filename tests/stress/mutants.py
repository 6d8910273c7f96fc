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
    """A file, its line, and what stands there instead."""

    file: pathlib.Path
    line: int
    before: str
    after: str
    text: str  # of the whole file


def faults(node, draw):
    """Nodes that may stand for one; none for most."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARED:
        yield ast.Compare(node.left, [COMPARED[type(node.ops[0])](), *node.ops[1:]], node.comparators)
    elif isinstance(node, ast.BinOp) and type(node.op) in OPERATED:
        yield ast.BinOp(node.left, OPERATED[type(node.op)](), node.right)
        if isinstance(node.op, ast.Add | ast.Sub):
            yield draw.choice((node.left, node.right))
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        yield node.operand
    elif isinstance(node, ast.BoolOp):
        yield ast.BoolOp(ast.And() if isinstance(node.op, ast.Or) else ast.Or(), node.values)
        yield draw.choice(node.values)
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield ast.Constant(node.value + 1 if node.value in (0, 1) else node.value * 2)
    elif isinstance(node, ast.Constant) and type(node.value) is bool:
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Attribute) and node.attr in SWAPPED:
        yield ast.Attribute(node.value, SWAPPED[node.attr], node.ctx)


def silent(tree) -> set:
    """Ids of nodes that say something to people, or to type checkers: no fault in them is one of the program's."""
    found = set()
    for node in ast.walk(tree):
        spoken = isinstance(node, ast.Raise) or (
            isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] in TOLD
        )
        parts = [node] if spoken or isinstance(node, ast.JoinedStr) else []
        parts += [node] if isinstance(node, ast.keyword) and node.arg in CHECKED else []
        for name in ("annotation", "returns"):
            parts += [part] if isinstance(part := getattr(node, name, None), ast.AST) else []
        for part in parts:
            found |= {id(inner) for inner in ast.walk(part)}
    return found


def drawn(seed, number, rooms=tuple(TESTS)) -> Mutant:
    """The mutant of a number: a room by chance, then a place in it."""
    draw = random.Random(f"{seed} {number}")
    folder = ROOT / "cnclik" / draw.choice(rooms)
    texts = {path: path.read_text(encoding="utf-8") for path in sorted(folder.rglob("*.py"))}
    path = draw.choices([*texts], [len(text) for text in texts.values()])[0]
    text = texts[path]
    tree = ast.parse(text)
    quiet = silent(tree)
    places = [
        n for n in ast.walk(tree) if id(n) not in quiet and getattr(n, "lineno", 0) == getattr(n, "end_lineno", 1)
    ]
    draw.shuffle(places)
    lines = text.encode().splitlines(keepends=True)
    for node in places:
        for other in draw.sample(some := list(faults(node, draw)), len(some)):
            row = lines[node.lineno - 1]
            made = row[: node.col_offset] + f"({ast.unparse(other)})".encode() + row[node.end_col_offset :]
            whole = b"".join([*lines[: node.lineno - 1], made, *lines[node.lineno :]]).decode()
            try:
                if ast.dump(ast.parse(whole)) == ast.dump(tree):
                    continue
            except SyntaxError:  # within an f-string, or a pattern
                continue
            return Mutant(path.relative_to(ROOT), node.lineno, row.decode().strip(), made.decode().strip(), whole)
    return drawn(seed, f"{number}'", rooms)  # a file without a number in it


def tested(mutant: Mutant, folder, room) -> str:
    """The first test that sees it, or nothing."""
    target = pathlib.Path(folder, mutant.file)
    kept = target.read_text(encoding="utf-8")
    nearest = f"tests/{room}/test_{mutant.file.stem}.py"
    every = [nearest] * pathlib.Path(folder, nearest).exists() + [f"tests/{name}" for name in TESTS[room]]
    for tests in every:
        target.write_text(mutant.text, encoding="utf-8")
        seen = failed(folder, tests)
        target.write_text(kept, encoding="utf-8")
        if seen and "::" in seen and failed(folder, seen):
            sys.exit(f"{seen} fails without a fault, too: nothing can be said of {mutant.file}:{mutant.line}.")
        if seen:
            return seen
    return ""


def failed(folder, tests) -> str:
    """The first test that fails of a directory or file of tests, or nothing."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "--no-header", "-p", "no:cacheprovider", tests]
    own = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    line = ["sh", "-c", f'ulimit -t {MOST}; exec "$@"', "sh", *command]
    done = subprocess.run(line, cwd=folder, env=own, capture_output=True, text=True)
    if done.returncode < 0:
        return f"{tests} doesn't end, or the process dies of it"
    if done.returncode in (0, 5):  # passed; none there
        return ""
    lines = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return (
        lines[0].partition(" ")[2].partition(" - ")[0]
        if lines
        else f"{tests}: {(done.stdout + done.stderr).strip()[-200:]}"
    )


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.stress.mutants", description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", default=time.strftime("%Y-%m-%d"), help="by default the date")
    parser.add_argument("--number", help="one mutant again")
    parser.add_argument("--rooms", nargs="*", choices=TESTS, default=list(TESTS))
    parser.add_argument("--seconds", type=float, default=float("inf"), help="no mutant is begun after these")
    parser.add_argument("--show", action="store_true", help="print the mutants and run nothing")
    args = parser.parse_args()
    numbers = [args.number] if args.number else range(args.count)
    begun, tried, survivors = time.monotonic(), 0, []
    with tempfile.TemporaryDirectory() as folder:
        for name in ("cnclik", "tests", "pyproject.toml", "sweeps", "docs", "README.md"):
            source, copy = ROOT / name, pathlib.Path(folder, name)
            shutil.copytree(source, copy) if source.is_dir() else shutil.copy(source, copy)
        for number in numbers:
            if time.monotonic() - begun > args.seconds:
                break
            mutant = drawn(args.seed, number, tuple(args.rooms))
            what = f"{number}: {mutant.file}:{mutant.line}\n    {mutant.before}\n    {mutant.after}"
            if args.show:
                print(what)
                continue
            start, tried = time.monotonic(), tried + 1
            seen = tested(mutant, folder, mutant.file.parts[1])
            survivors += [] if seen else [what]
            print(f"{what}\n  {seen or 'SURVIVES'} ({time.monotonic() - start:.0f} s)", flush=True)
    print(f"\nSeed {args.seed}: {tried - len(survivors)} of {tried} faults were seen. Survivors:", *survivors, sep="\n")
    sys.exit(len(survivors) > tried / 20)


if __name__ == "__main__":
    main()
