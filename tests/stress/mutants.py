"""`python -m tests.stress.mutants`: which random one-line faults do the tests not see?

Each mutant is a copy of the tree with one fault in `law`, `integrate`, `robot`, `engine`, `stability` or `reaching`: a
sign, a comparison or a constant changed, + for -, a term or a condition dropped. First each test file runs once under
`coverage` (ten minutes, kept in a folder for temporary files while the tree stays as it is). The tests that run the
fault's line then run until the first failure, those of its room first.

    python -m tests.stress.mutants --count 60                     # a new seed each day
    python -m tests.stress.mutants --seed 3 --first 17 --count 1  # one again; or the rest of a run that was ended

A row is printed as it comes. Exit code 1 if more than one in twenty survives.
"""

import argparse
import ast
import os
import pathlib
import random
import shlex
import shutil
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).parents[2]
ROOMS = ("law", "integrate", "robot", "engine", "stability", "reaching")
COMPARED = (  # and the other way round
    *((ast.Lt, ast.GtE), (ast.Gt, ast.LtE), (ast.Lt, ast.LtE), (ast.Gt, ast.GtE)),
    *((ast.Eq, ast.NotEq), (ast.Is, ast.IsNot), (ast.In, ast.NotIn)),
)
OPERATED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult}
SWAPPED = {"minimum": "maximum", "maximum": "minimum", "min": "max", "max": "min", "sin": "cos", "cos": "sin"}
TOLD = ("fail", "ArgumentError", "brief", "zip")  # messages are not faults, nor is what `strict` checks
LIMIT = ("-o", "faulthandler_timeout=300", "-o", "faulthandler_exit_on_timeout=true")
QUIET = ("-q", "-n", "0", "-p", "no:cacheprovider", *LIMIT)


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
        case ast.Constant(int(value) | float(value)) if not 0 < value < 1e-4:  # that is for rounding
            return ast.Constant(value + 1 if value in (0, 1) else value * 2)
        case ast.Attribute(value, name, context) if name in SWAPPED:
            return ast.Attribute(value, SWAPPED[name], context)


def places(node):
    """(parent, field, index or None, node) of what may be changed: nothing that speaks to people or type checkers."""
    for field, value in ast.iter_fields(node):
        for k, below in enumerate(value if isinstance(value, list) else [value]):
            told = isinstance(below, ast.Call) and ast.unparse(below.func).rpartition(".")[2] in TOLD
            told = told or getattr(below, "arg", None) == "unroll"  # which is about speed alone
            skipped = told or field in ("annotation", "returns", "decorator_list")
            if isinstance(below, ast.AST) and not skipped and not isinstance(below, ast.Raise | ast.JoinedStr):
                yield node, field, k if isinstance(value, list) else None, below
                yield from places(below)


def tuned(path, line) -> bool:
    """Whether a line of a module is constants alone that say what runs as C, or how long is searched."""
    numbers = ast.Name, ast.Tuple, ast.BinOp, ast.operator, ast.Constant, ast.expr_context, ast.Assign
    every = all(isinstance(node, numbers) for node in ast.walk(line))
    return every and (path.parts[-2] == "engine" or path.stem in ("descent", "starts", "search", "maps"))


def drawn(seed, number) -> tuple:
    """(file, line, fault in words, text of the whole file) of a number: a room by chance, then a place in it."""
    draw = random.Random(f"{seed} {number}")
    paths = sorted((ROOT / "cnclik" / draw.choice(ROOMS)).rglob("*.py"))
    path = draw.choices(paths, [path.stat().st_size for path in paths])[0]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    every = [*places(ast.Module([line for line in tree.body if not tuned(path, line)], []))]
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


def met() -> list:
    """(test file, seconds, its coverage) of each test file."""
    from coverage import CoverageData  # `pip install coverage`; no other test needs it

    paths, rows = sorted(ROOT.glob("tests/**/test_*.py")), []
    newest = max(path.stat().st_mtime_ns for path in (*ROOT.glob("cnclik/**/*.py"), *ROOT.glob("tests/**/*.py")))
    kept = pathlib.Path(tempfile.gettempdir(), f"cnclik-met-{newest}")
    kept.mkdir(exist_ok=True)
    settings, part = kept / "settings", kept / "part"
    settings.write_text(f"[run]\nsource = {ROOT / 'cnclik'}\ndynamic_context = test_function\n")
    for path in (path.relative_to(ROOT) for path in paths if path.parent.name != "stress"):
        name, begun = ".".join(path.parts), time.monotonic()
        if not [*kept.glob(f"{name} *")]:
            run = [sys.executable, "-m", "coverage", "run", f"--rcfile={settings}", f"--data-file={part}"]
            if subprocess.run([*run, "-m", "pytest", *QUIET, path], cwd=ROOT).returncode:
                continue  # what fails without a fault sees none
            part.rename(kept / f"{name} {time.monotonic() - begun:.0f}")
        (data,) = kept.glob(f"{name} *")
        rows.append((path, int(data.name.split()[1]), CoverageData(str(data))))
        rows[-1][2].read()
    return rows


def likely(file, line, rows) -> tuple[list, list]:
    """The tests that run a line, and their files, the cheapest first: a test may find traced what one before it ran."""
    cases, every = [], ast.walk(ast.parse((ROOT / file).read_text(encoding="utf-8")))
    first = max(s.lineno for s in every if isinstance(s, ast.stmt) and s.lineno <= line <= s.end_lineno)  # of its own
    for path, seconds, coverage in rows:
        contexts = coverage.contexts_by_lineno(str(ROOT / file))
        names = {name for k in range(first, line + 1) for name in contexts.get(k, ())}
        if names:
            own = [name.rpartition(".")[2] for name in names if not name.startswith("jax.")]  # it has a test_event
            tests = sorted({f"{path}::{name}" for name in own if name}) or [str(path)]
            elsewhere = path.parts[1] != file.parts[1]  # a fault is seen first where it belongs
            cases.append((elsewhere, seconds * len(tests) / len(coverage.measured_contexts()), str(path), tests))
    cases.sort()
    return [test for *_, tests in cases for test in tests], [path for *_, path, _ in cases]


def tested(file, line, text, folder, seconds, rows) -> str:
    """The first test that sees another text of a file, or that none does."""
    target = pathlib.Path(folder, file)
    kept = target.read_text(encoding="utf-8")
    target.write_text(text, encoding="utf-8")
    own, said = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": ""}, "SURVIVES"
    for some in filter(None, likely(file, line, rows)):
        run = f"ulimit -t {seconds}; exec {shlex.join([sys.executable, '-m', 'pytest', '-x', *QUIET, *some])}"
        done = subprocess.run(run, shell=True, cwd=folder, env=own, capture_output=True, text=True)
        if done.returncode not in (0, 4, 5):  # 4, 5: no test was there
            lines = [row for row in done.stdout.splitlines() if row.startswith(("FAILED", "ERROR"))]
            lines += [f"exit code {done.returncode}: {done.stderr[-300:]}"]
            said = f"NOT SEEN in {seconds} s" if done.returncode in (-9, -24) else lines[0].partition(" - ")[0]
            break
    target.write_text(kept, encoding="utf-8")
    return said


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.stress.mutants", description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--seed", default=time.strftime("%Y-%m-%d"), help="by default the date")
    parser.add_argument("--seconds", type=int, default=200, help="of the processor, for the tests of a mutant")
    args = parser.parse_args()
    survived = 0
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(
            ROOT, folder, ignore=shutil.ignore_patterns(".git", ".venv", ".*cache*", "site"), dirs_exist_ok=True
        )
        rows = met()
        for number in range(args.first, args.first + args.count):
            (file, line, fault, text), begun = drawn(args.seed, number), time.monotonic()
            print(f"{number}: {file}:{line}\n    {fault}", flush=True)
            seen = tested(file, line, text, folder, args.seconds, rows)
            survived += not seen.startswith(("FAILED", "ERROR", "exit"))
            print(f"  {seen} ({time.monotonic() - begun:.0f} s)", flush=True)
    print(f"Seed {args.seed}: {args.count - survived} of {args.count} faults were seen.")
    sys.exit(survived > args.count / 20)


if __name__ == "__main__":
    main()
