"""`python -m tests.stress.mutants`: which random one-line faults do the tests not see?

Each mutant is a copy of the tree with one fault in `law`, `integrate`, `robot`, `engine`, `stability` or `reaching`: a
sign, a comparison or a constant changed, + for -, a term or a condition dropped. Tests run until the first failure:
those that name what the file defines, the room's other ones, then those of the rooms that stand on it.

    python -m tests.stress.mutants --count 60                     # a new seed each day
    python -m tests.stress.mutants --seed 3 --first 17 --count 1  # one again; or the rest of a run that was ended

A row is printed as it comes. Exit code 1 if more than one in twenty survives.
"""

import argparse
import ast
import os
import pathlib
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).parents[2]
TESTS = {  # of each room: its own, then those that would see what its own don't
    "law": ("law", "integrate", "task"),
    "integrate": ("integrate", "stability", "law"),
    "robot": ("robot", "task", "law", "integrate"),
    "engine": ("engine", "integrate", "export", "reaching"),
    "stability": ("stability", "integrate", "diagnosis"),
    "reaching": ("reaching", "cli"),
}
COMPARED = (  # and the other way round
    *((ast.Lt, ast.GtE), (ast.Gt, ast.LtE), (ast.Lt, ast.LtE), (ast.Gt, ast.GtE)),
    *((ast.Eq, ast.NotEq), (ast.Is, ast.IsNot), (ast.In, ast.NotIn)),
)
OPERATED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult}
SWAPPED = {"minimum": "maximum", "maximum": "minimum", "min": "max", "max": "min", "sin": "cos", "cos": "sin"}
TOLD = ("fail", "ArgumentError", "brief", "zip")  # messages are not faults, nor is what `strict` checks


def other(node, draw):
    """A node that stands for one as its fault; None for most."""
    match node:
        case ast.Compare(left, [op, *more], right):
            others = [b for pair in COMPARED for a, b in (pair, pair[::-1]) if a is type(op)]
            return ast.Compare(left, [draw.choice(others)(), *more], right)
        case ast.BinOp(left, op, right) if type(op) in OPERATED:
            changed = ast.BinOp(left, OPERATED[type(op)](), right)
            return draw.choice((changed, left, right)) if isinstance(op, ast.Add | ast.Sub) else changed
        case ast.UnaryOp(ast.USub() | ast.Not(), operand):
            return operand
        case ast.BoolOp(op, values):
            return draw.choice((ast.BoolOp(ast.And() if isinstance(op, ast.Or) else ast.Or(), values), *values))
        case ast.Constant(bool(value)):
            return ast.Constant(not value)
        case ast.Constant(int(value) | float(value)):
            return ast.Constant(value + 1 if value in (0, 1) else value * 2)
        case ast.Attribute(value, name, context) if name in SWAPPED:
            return ast.Attribute(value, SWAPPED[name], context)


def places(node):
    """(parent, field, index or None, node) of what may be changed: nothing that speaks to people or type checkers."""
    for field, value in ast.iter_fields(node):
        for k, below in enumerate(value if isinstance(value, list) else [value]):
            told = isinstance(below, ast.Call) and ast.unparse(below.func).rpartition(".")[2] in TOLD
            skipped = told or field in ("annotation", "returns", "decorator_list")
            if isinstance(below, ast.AST) and not skipped and not isinstance(below, ast.Raise | ast.JoinedStr):
                yield node, field, k if isinstance(value, list) else None, below
                yield from places(below)


def drawn(seed, number) -> tuple:
    """(file, line, fault in words, text of the whole file) of a number: a room by chance, then a place in it."""
    draw = random.Random(f"{seed} {number}")
    paths = sorted((ROOT / "cnclik" / draw.choice([*TESTS])).rglob("*.py"))
    path = draw.choices(paths, [path.stat().st_size for path in paths])[0]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    every = [*places(tree)]
    draw.shuffle(every)
    for parent, field, k, node in every:
        if (fault := other(node, draw)) is not None:
            words = f"{ast.unparse(node)}\n    {ast.unparse(fault)}"
            if k is None:
                setattr(parent, field, fault)
            else:
                getattr(parent, field)[k] = fault
            return path.relative_to(ROOT), node.lineno, words, ast.unparse(ast.fix_missing_locations(tree))
    return drawn(seed, f"{number}'")  # a file without a number in it


def likely(file) -> list:
    """Test files, those first that are likeliest to see a fault in a file of the package."""
    defined, ranks = set(re.findall(r"^(?:def|class) (\w+)", (ROOT / file).read_text(encoding="utf-8"), re.M)), {}
    for place, room in enumerate(TESTS[file.parts[1]]):
        for path in sorted((ROOT / "tests" / room).glob("test_*.py")):
            names = defined & set(re.findall(r"\w+", path.read_text(encoding="utf-8")))
            ranks[str(path.relative_to(ROOT))] = path.stem != f"test_{file.stem}", place, -len(names)
    return sorted(ranks, key=ranks.get)


def tested(file, text, folder, seconds) -> str:
    """The first test that sees another text of a file, or that none does."""
    target = pathlib.Path(folder, file)
    kept = target.read_text(encoding="utf-8")
    target.write_text(text, encoding="utf-8")
    options = "-x -q -n 0 -p no:cacheprovider -o faulthandler_timeout=300 -o faulthandler_exit_on_timeout=true"
    line = f"ulimit -t {seconds}; exec {sys.executable} -m pytest {options} {' '.join(likely(file))}"
    own = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": ""}
    done = subprocess.run(line, shell=True, cwd=folder, env=own, capture_output=True, text=True)
    target.write_text(kept, encoding="utf-8")
    if done.returncode in (0, -9, -24):
        return "SURVIVES" if done.returncode == 0 else f"NOT SEEN in {seconds} s"
    lines = [line.partition(" - ")[0] for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return [*lines, f"exit code {done.returncode}: {done.stderr[-300:]}"][0]


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.stress.mutants", description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--seed", default=time.strftime("%Y-%m-%d"), help="by default the date")
    parser.add_argument("--seconds", type=int, default=600, help="of the processor, for the tests of a mutant")
    args = parser.parse_args()
    survived = 0
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(".*", "results", "site"), dirs_exist_ok=True)
        for number in range(args.first, args.first + args.count):
            (file, line, fault, text), begun = drawn(args.seed, number), time.monotonic()
            print(f"{number}: {file}:{line}\n    {fault}", flush=True)
            seen = tested(file, text, folder, args.seconds)
            survived += not seen.startswith(("FAILED", "ERROR", "exit"))
            print(f"  {seen} ({time.monotonic() - begun:.0f} s)", flush=True)
    print(f"Seed {args.seed}: {args.count - survived} of {args.count} faults were seen.")
    sys.exit(survived > args.count / 20)


if __name__ == "__main__":
    main()
