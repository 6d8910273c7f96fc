"""The house: imports run one way, no room uses another's private names, modules stay short, each helper stands once."""

import ast
import functools
import graphlib
import importlib
import inspect
import pathlib
import re
import subprocess
import sys

import pytest

import cnclik

PACKAGE = pathlib.Path(__file__).parents[1] / "cnclik"
GROUND = (
    *("errors", "record", "cache", "precision", "threads"),
    *("reading", "writing", "version", "quantities"),
)
BASE = ("engine", "robot", "task", "law", "integrate")  # reached through the names of the package alone
ROOMS = (
    *(*BASE, "reaching", "problem", "measure", "stability", "diagnosis", "sweeps", "tuning", "export", "show", "paper"),
)
ORDER = {name: 0 for name in GROUND} | {name: i for i, name in enumerate((*ROOMS, "cli"), 1)}
MOST_LINES = 500
MOST_OF_A_FUNCTION = 60


def files():
    return sorted(PACKAGE.rglob("*.py"))


def room(path):
    """The room a file belongs to; the package's own front door and `python -m cnclik` belong to none."""
    name = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    return None if name in ("__init__", "__main__") else name


@functools.cache
def nodes(path):
    """Every node of a file's syntax tree. Kept while this module's tests run: most of them walk through all files."""
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


@pytest.fixture(scope="module", autouse=True)
def _forget_trees():
    yield
    nodes.cache_clear()


def imported(path):
    """(line, room, name) of everything a file imports from the package, at its top or inside a function."""
    for node in nodes(path):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "cnclik":
            _, *inner = node.module.split(".")
            for alias in node.names:
                yield node.lineno, inner[0] if inner else alias.name, alias.name
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "cnclik":
                    yield node.lineno, ([*alias.name.split("."), ""])[1], ""


def test_every_file_belongs_to_a_room_of_the_order():
    assert {room(path) for path in files()} - {None} == set(ORDER)


def test_imports_run_one_way_and_touch_no_private_name():
    wrong = []
    for path in files():
        own = room(path)
        for line, other, name in imported(path) if own else ():
            if other not in ORDER:
                wrong.append(f"{path}:{line} imports the package's front door")
            elif ORDER[other] > ORDER[own]:
                wrong.append(f"{path}:{line} imports {other}, which stands on {own}")
            elif other != own and name.startswith("_") and name != "__version__":
                wrong.append(f"{path}:{line} imports {other}.{name}")
    assert not wrong


def test_imports_have_no_circle():
    """Those inside functions counted."""
    modules = {path.relative_to(PACKAGE.parent).with_suffix("").parts: path for path in files()}
    graph = {}
    for name, path in modules.items():
        every = [node for node in nodes(path) if isinstance(node, ast.ImportFrom)]
        wanted = [(*(node.module or "").split("."), alias.name) for node in every for alias in node.names]
        graph[name] = {one if one in modules else one[:-1] for one in wanted if {one, one[:-1]} & {*modules}}
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError


def test_a_room_imports_its_own_modules_at_the_top():
    """Inside a function, only with the reason on the same line: such imports hide circles."""
    hidden = []
    for path in files():
        lines = path.read_text(encoding="utf-8").splitlines()
        top = {node.lineno for node in nodes(path) if isinstance(node, ast.stmt) and node.col_offset == 0}
        inner = {line for line, other, _ in imported(path) if other == room(path) and line not in top}
        hidden += [f"{path.relative_to(PACKAGE)}:{line}" for line in inner if "  # " not in lines[line - 1]]
    assert not hidden


def test_names_are_imported_from_where_they_are_defined():
    """Or from the front door of a room."""
    wrong = []
    for path in (*files(), *sorted(pathlib.Path(__file__).parent.rglob("*.py"))):
        for node in nodes(path):
            if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith("cnclik."):
                continue
            source = PACKAGE.joinpath(*node.module.split(".")[1:]).with_suffix(".py")
            known = defined(source) if source.exists() else {alias.name for alias in node.names}
            wrong += [f"{path}:{node.lineno} {alias.name}" for alias in node.names if alias.name not in known]
    assert not wrong


def test_attributes_of_a_module_are_defined_there():
    passed_on = []
    for path in files():
        modules = {
            alias.asname or alias.name: source
            for node in nodes(path)
            if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "cnclik"
            for alias in node.names
            if (source := PACKAGE.joinpath(*node.module.split(".")[1:], f"{alias.name}.py")).exists()
        }
        passed_on += [
            f"{path.relative_to(PACKAGE)}:{node.lineno} {ast.unparse(node)}"
            for node in nodes(path)
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules
            if node.attr not in defined(modules[node.value.id])
        ]
    assert not passed_on


@functools.cache
def defined(path):
    """Names that a file defines; what is in annotations alone is passed on by `record`."""
    found = set()
    for node in nodes(path):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            found.add(node.name)
        elif isinstance(node, ast.alias) and node.asname and path.name == "record.py":
            found.add(node.asname)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
    return found


def private_names(path):
    """(line, room, name) of every private name of the package that a file uses: `module._name`, or imported."""
    modules = {}
    for node in nodes(path):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("cnclik"):
            for alias in node.names:
                where, of = (
                    PACKAGE.joinpath(*node.module.split(".")[1:], alias.name),
                    [*node.module.split("."), alias.name],
                )
                if where.is_dir() or where.with_suffix(".py").exists():
                    modules[alias.asname or alias.name] = of[1]
                elif re.match("_[a-zA-Z]", alias.name):
                    yield node.lineno, of[1], alias.name
    for node in nodes(path):
        of_a_name = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
        if of_a_name and node.value.id in modules and re.match("_[a-zA-Z]", node.attr):
            yield node.lineno, modules[node.value.id], node.attr


def test_no_attribute_of_another_room_is_private():
    every = [(path, *found) for path in files() for found in private_names(path)]
    assert not [f"{path}:{line} {name}" for path, line, other, name in every if other != room(path)]


def test_tests_pin_no_private_name():
    every = [(path, *found) for path in pathlib.Path(__file__).parent.rglob("*.py") for found in private_names(path)]
    assert not [f"{path}:{line} {name}" for path, line, _, name in every]


def test_no_file_is_long():
    assert not [str(p) for p in files() if len(p.read_text(encoding="utf-8").splitlines()) > MOST_LINES]


def test_no_function_is_long():
    """Lines from `def` to its end, functions inside counted and its docstring left out."""
    long = []
    for path in files():
        for node in nodes(path):
            if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                continue
            first = node.body[0]
            said = first.end_lineno - first.lineno + 1 if ast.get_docstring(node, clean=False) is not None else 0
            if (lines := node.end_lineno - node.lineno + 1 - said) > MOST_OF_A_FUNCTION:
                long.append(f"{path.relative_to(PACKAGE)}:{node.lineno} {node.name} {lines}")
    assert not long


ONCE = {  # what may stand in one place only, and where
    r"cpu_count\(": "threads.py",
    r"\.to_netcdf\(": "measure/files.py",
    r"\.savefig\(": "show/style.py",
    r"\bProgress\(|rich\.track": "cli/progress.py",
    r"jnp\.where\(zero, 0\.0, jnp\.sqrt\(": "robot/rotations.py",
    r"np\.array2string\(": "record.py",
    r"\"\| ---|\| --- \|": "measure/files.py",
}


@pytest.mark.parametrize("pattern", ONCE)
def test_each_helper_stands_once(pattern):
    found = {str(p.relative_to(PACKAGE)) for p in files() if re.search(pattern, p.read_text(encoding="utf-8"))}
    assert found <= {ONCE[pattern]}


def test_who_takes_any_exception_says_why():
    """On the same line, but where it is raised again."""
    anything, silent = ("Exception", "BaseException"), []
    for path in files():
        text = path.read_text(encoding="utf-8")
        for node in nodes(path):
            broad = again = False
            if isinstance(node, ast.ExceptHandler):
                broad = node.type is None or ast.unparse(node.type) in anything
                again = ast.unparse(node.body[-1]) == "raise"
            elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("suppress"):
                broad = any(ast.unparse(kind) in anything for kind in node.args)
            if broad and not again and "  # " not in text.splitlines()[node.lineno - 1]:
                silent.append(f"{path.relative_to(PACKAGE)}:{node.lineno}")
    assert not silent


def test_what_is_there_is_asked_so_that_no_name_is_too_long_for_it():
    asked = re.compile(r"\.(exists|is_file|is_dir)\(\)")  # pathlib's raise where the system knows no such name
    found = [(path.name, line) for path in files() for line in asked.findall(path.read_text(encoding="utf-8"))]
    assert not found, "os.path's answer False"


def test_no_rule_of_the_linter_is_switched_off_by_hand():
    assert not [str(p) for p in files() if "noqa: E731" in p.read_text(encoding="utf-8")]


def test_every_public_name_is_there():
    assert not [name for name in cnclik.__all__ if getattr(cnclik, name, None) is None]
    assert sorted(set(cnclik.__all__)) == sorted(cnclik.__all__) and dir(cnclik) == sorted(cnclik.__all__)


@pytest.mark.parametrize("name", [r for r in ROOMS if r not in BASE])
def test_a_room_is_reached_by_attribute_and_by_import(name):
    room = importlib.import_module(f"cnclik.{name}")
    assert getattr(cnclik, name) is room and room.__doc__
    assert not [public for public in room.__all__ if not hasattr(room, public)]


def test_rooms_are_reached_in_a_process_of_their_own():
    """By attribute first, in any order; one process for all: each would load JAX anew."""
    names = [r for r in reversed(ROOMS) if r not in BASE]
    same = "getattr(cnclik, n) is importlib.import_module('cnclik.' + n)"
    code = f"import cnclik, importlib; assert all({same} for n in {names})"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=PACKAGE.parent)


def test_a_name_is_what_a_room_offers_where_a_module_is_called_alike():
    code = (
        "import cnclik.export.write, cnclik.reaching.public, cnclik.tuning.tune\n"
        "import cnclik as ck\n"
        "offered = [ck.export.c, ck.reaching.reach, ck.tuning.tune, ck.reach, ck.tune]\n"
        "print([type(one).__name__ for one in offered])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=PACKAGE.parent)
    assert done.stdout.split() == ["['function',", *["'function',"] * 3, "'function']"], done.stderr


def test_the_version_is_one():
    root = PACKAGE.parent
    said = {
        re.search(pattern, (root / file).read_text(encoding="utf-8"), re.M)[1]
        for file, pattern in (
            ("pyproject.toml", r'^version = "(.*)"'),
            ("CITATION.cff", r"^version: (.*)$"),
            (".conda/recipe.yaml", r'^  version: "(.*)"'),
            ("CHANGELOG.md", r"^## \[(\d.*)\]"),
        )
    }
    assert said == {cnclik.__version__}


def test_methods_have_names_of_their_own():
    import cnclik as ck

    named = {name: method for name, method in ck.METHODS.items() if name.startswith("EXP-")}
    assert len(named) == 4 and all(getattr(ck, name.replace("-", "_")) is method for name, method in named.items())


def test_fields_say_what_they_are():
    """Arrays by their shapes, see `cnclik.record`; no field is just an object."""
    fields = [(p, n) for p in files() for n in nodes(p) if isinstance(n, ast.AnnAssign)]
    assert not [f"{path}:{node.lineno}" for path, node in fields if "object" in ast.unparse(node.annotation).split()]


def test_public_functions_say_what_they_take_and_return():
    wrong = []
    for name in cnclik.__all__:
        if not inspect.isfunction(function := getattr(cnclik, name)):
            continue
        about = inspect.signature(function)
        wrong += [f"{name}({p.name})" for p in about.parameters.values() if p.annotation is p.empty]
        wrong += [f"{name} ->"] * (about.return_annotation is about.empty)
    assert not wrong
