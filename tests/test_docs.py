"""README and docs, executed: every fenced Python block, every command line, page by page in the order of reading.

Commands run with smaller numbers and, where nothing in them belongs to one robot, on a small arm; `-m slow` runs them
as printed.
"""

import os
import pathlib
import re
import shlex
import shutil
import subprocess
import sys
from types import SimpleNamespace
from unittest import mock

import jax
import pytest

from cnclik.cli import main
from cnclik.show.viewer import has_viser
from tests.oracles import robot_file

ROOT = pathlib.Path(__file__).parents[1]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))

# Less of the same, by verb.
FEWER = {"solve": {"--N": ["5"], "--no-figures": []}, "map": {"--N": ["8"]}, "view": {"--N": ["5"]}}
LESS = (("1_000_000", "1_000"), ("65_536", "1_000"), (", 200)", ", 4)"))
SMALL = "planar:1,1,1"  # in the place of panda where no option speaks of seven joints or of the space they move in
ELSEWHERE = {"reproduce": "tests/paper/test_reproduce.py", "check": "tests/cli/test_cli_diagnose.py"}
# Pages of many programs, or of humanoids: with `-m slow` only, as in a full build of the site.
LONG = ["drives", "reach", "robots", "stacks", "sweeps", "theory", "tuning"]
NO_FILES = ("robots", "solve", "stability", "diagnose")  # without --out nothing on a page reads what they write
NEEDS_OTHER_MACHINES = ("srun", "ssh", "--distributed")
# In the place of every spec: what the pages read from sweeps/plane.toml is in it.
SPEC = """
question = "Which?"
expectation = "That one."
metrics = ["mean_error", "max_error"]
[fixed]
task = "xy"
N = 8
[axes]
method = ["EE", "CN"]
alpha = [2.0, 5.0]
Ts = [0.05, 0.1]
[axes.case.track2]
robot = "planar-clockwise:1,1"
q0 = [0, "pi/2"]
reference = "line"
start = [1, 1]
target = [0, 1]
"""


def parts(page):
    """What a page shows, in its order: ("python", code) and ("command", line)."""
    text = page.read_text(encoding="utf-8")
    found = []
    for block in re.finditer(r"^```(\w*)\n(.*?)^```", text, re.M | re.S):
        if block[1] == "python":
            found.append((block.start(), "python", block[2]))
        else:
            found += [(block.start(), "command", line) for line in commands(block[2])]
    outside = re.sub(r"^```.*?^```", lambda m: " " * len(m[0]), text, flags=re.M | re.S)
    for line in re.finditer(r"^ {4}(\$ )?(cnclik \S.*)$", outside, re.M):
        found += [(line.start(), "command", one) for one in commands(line[2])]
    for line in re.finditer(r"`(cnclik [a-z]+ [^`]*)`", outside):
        found += [(line.start(), "command", one) for one in commands(line[1])]
    return [(kind, text) for _, kind, text in sorted(found, key=lambda item: item[0])]


def commands(text):
    lines = (line.strip().removeprefix("$ ").partition("  #")[0].strip() for line in text.splitlines())
    return [line for line in lines if line.startswith("cnclik ") and not any(w in line for w in NEEDS_OTHER_MACHINES)]


def fewer(argv):
    """The same command with less to do."""
    verb, *rest = argv
    small = verb in ("solve", "stability", "export") or {"--reference", "--random"} & set(rest)
    if small and not set(rest) & {"--q0", "--target", "--limits"}:
        rest = [SMALL if word in ("panda", "panda.urdf", "ur5", "robot.urdf") else word for word in rest]
        if SMALL in rest and "--tip" in rest:
            del rest[rest.index("--tip") : rest.index("--tip") + 2]
    less = {"--random": ["12"]} if "--random" in rest else FEWER.get("map" if "map" in rest else verb, {})
    for option, few in less.items():
        if option in rest:
            del rest[(at := rest.index(option)) : at + 1 + len(few)]
        rest += [option, *few]
    return [verb, *rest]


def prepare(folder, less):
    """What the pages speak of: robots' files, specs, waypoints."""
    named = {"panda": "panda", "robot": "ur5"} | {name: name for name in ("g1", "allegro", "baxter", "tiago")}
    for name, file in named.items():
        shutil.copy(robot_file(file), folder / f"{name}.urdf")
    shutil.copytree(ROOT / "sweeps", folder / "sweeps")
    for spec in folder.glob("sweeps/*.toml") if less else ():
        spec.write_text(SPEC, encoding="utf-8")
    rows = ("time,x,y,z,qw,qx,qy,qz", "0,0.4,0.0,0.4,0,1,0,0", "2,0.45,0.1,0.4,0,1,0,0", "4,0.4,0.0,0.4,0,1,0,0")
    (folder / "way.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    for file in (ROOT / "docs" / "problems").glob("*.py"):
        shutil.copy(file, folder / file.name)
    (folder / "study.toml").write_text(SPEC, encoding="utf-8")
    rings = "\n".join(f"{1.5 + 0.1 * (-0.8) ** k:.9f}" for k in range(60))
    (folder / "log.csv").write_text(f"q1\n{rings}\n", encoding="utf-8")
    (folder / "targets.csv").write_text("0.5,0.1,0.4,0,1,0,0\n0.3,-0.4,0.5,0,1,0,0\n", encoding="utf-8")


class _Interrupted:
    """In place of an event: Ctrl-C for a command that waits for it."""

    def wait(self):
        raise KeyboardInterrupt


def read_aloud(page, folder, less):
    """Run a page from its top to its end, as a reader would who types all of it into one shell and one Python."""
    prepare(folder, less)
    names, done = {"__name__": "page"}, []
    before = [text for other in PAGES[: PAGES.index(page)] for _, text in parts(other)] if less else []
    swept = any(re.fullmatch(r"cnclik sweep \S+", text) for text in before)
    for kind, text in parts(page):
        if kind == "python":
            code = text
            for many, few in LESS if less else ():
                code = code.replace(many, few)
            with jax.enable_x64(False):  # Python users get float32
                exec(compile(code, page.name, "exec"), names)
            continue
        argv = shlex.split(text.partition(" > ")[0])[1:]
        if text in before and argv[0] in NO_FILES and "--out" not in argv:
            continue
        argv = fewer(argv) if less else argv
        named = any(word.partition(".")[0].isupper() and word[0].isalpha() for word in argv[:2])  # "LOG", "FILE.csv"
        if argv[0] in ELSEWHERE or named or argv in done:
            continue
        done.append(argv)
        if less and len(argv) == 2 and argv[0] == "sweep":
            assert pathlib.Path(argv[1]).is_file()
            if swept:
                continue  # every spec is the same one
            swept = True
        if argv[0] == "view" and not has_viser():
            continue
        try:
            with mock.patch("cnclik.cli.view.threading", SimpleNamespace(Event=_Interrupted)):
                main(argv)
        except SystemExit as left:
            assert not left.code, f"{text} ended with {left.code}"


@pytest.mark.parametrize(
    "page", [pytest.param(p, marks=[pytest.mark.slow] * (p.stem in LONG)) for p in PAGES], ids=lambda p: p.name
)
def test_a_page_runs(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name, fewer_points in (("CHART_POINTS", 3), ("CELLS", 8), ("PASSES", (0, 1))):
        monkeypatch.setattr(f"cnclik.cli.stability.{name}", fewer_points)
    monkeypatch.setattr("cnclik.show.style.DPI", 50)
    read_aloud(page, tmp_path, less=True)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_a_page_runs_as_printed(page, tmp_path):
    """In a process of its own: its programs have the form and the optimisation that a reader's have."""
    read = f"read_aloud(PAGES[{PAGES.index(page)}], pathlib.Path(), less=False)"
    code = f"import pathlib; from tests.test_docs import PAGES, read_aloud; {read}"
    own = os.environ | {"PYTHONPATH": str(ROOT)}
    del own["XLA_FLAGS"], own["CFLAGS"]
    ended = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=own, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr[-3000:]
